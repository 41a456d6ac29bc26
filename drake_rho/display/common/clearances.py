"""Distances of vehicles from obstacles over time, moving obstacles included."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.style import dense_times
from drake_rho.motion.penetration import deepest, pieces_near
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle

_SLACK = 1e-9
"""Tolerance above the least distance at the knots up to which pieces are searched, as a fraction
of the obstacle's size."""


@dataclasses.dataclass(frozen=True, eq=False)
class ClosestApproaches:
    """The closest approach of each vehicle to an obstacle."""

    times: FloatArray
    """times since the first knot [s], shape (N,)"""
    distances: FloatArray
    """distances from the surface, negative inside [m], shape (N,)"""


@dataclasses.dataclass(frozen=True)
class Approach:
    """A vehicle at an instant."""

    vehicle: int
    """index of the vehicle"""
    time: float
    """time since the first knot [s]"""


@dataclasses.dataclass(frozen=True, eq=False)
class Clearances:
    """Clearance of each vehicle from its nearest obstacle over time.

    A clearance is the distance from the obstacle's surface minus the vehicle's radius and minus
    the largest deviation of the obstacle from its track. The nearest obstacle is the one with the
    least clearance.
    """

    times: FloatArray
    """times since the first knot, ascending, closest approaches included [s], shape (N, M)"""
    clearances: FloatArray
    """clearances, negative where an obstacle is too close [m], shape (N, M)"""
    nearest: IntArray
    """index of the nearest obstacle, shape (N, M)"""


def distances(plan: Drawn, obstacle: Obstacle, times: FloatArray) -> FloatArray:
    """Return the distances of all vehicles from the surface of an obstacle, negative inside.

    Args:
        plan: the vehicles' motion.
        obstacle: the obstacle, with its motion.
        times: since the first knot [s], shape (M,).

    Returns:
        Distances [m], shape (N, M).
    """
    positions = plan.motion().at("position", times)
    return obstacle.distances(positions, plan.scenario.grid.start + times)


def required_distances(plan: Drawn, obstacle: Obstacle) -> FloatArray:
    """Return the distances required between vehicles and an obstacle's surface [m], shape (N,)."""
    least: FloatArray = plan.scenario.fleet.radii + obstacle.deviation
    return least


def closest(plan: Drawn, obstacle: Obstacle) -> ClosestApproaches:
    """Find the closest approach of each vehicle to an obstacle, exact also between the knots."""
    motion, start = plan.motion(), plan.scenario.grid.start
    knots: FloatArray = np.float64(motion.step) * np.arange(motion.positions.shape[1])
    slack = _SLACK * obstacle.shape.size
    below = distances(plan, obstacle, knots).min(axis=1) + slack  # reached by at least one piece
    pieces = pieces_near(motion, obstacle.since(start), np.maximum(below, slack))
    tolerances = np.full(len(pieces.owners), obstacle.shape.tolerance)
    which, times = deepest(obstacle.shape, pieces, below[pieces.owners], tolerances)
    owners = pieces.owners[which]
    found = obstacle.distances(motion.each_at("position", owners, times), start + times)
    order = np.lexsort((found, owners))
    near, firsts = np.unique(owners[order], return_index=True)
    least = ClosestApproaches(np.zeros(len(below)), np.full(len(below), np.inf))  # if not active
    least.times[near], least.distances[near] = times[order[firsts]], found[order[firsts]]
    return least


def nearest(plan: Drawn, obstacle: Obstacle) -> Approach:
    """Find the vehicle and the time with the least clearance from an obstacle."""
    found = closest(plan, obstacle)
    vehicle = int(np.argmin(found.distances - required_distances(plan, obstacle)))
    return Approach(vehicle, float(found.times[vehicle]))


def least_clearances(plan: Drawn, obstacles: Sequence[Obstacle]) -> Clearances:
    """Return each vehicle's least clearance over time from one or more obstacles."""
    times = dense_times(plan)
    least, numbers = nearest_obstacles(plan, obstacles, times)
    whole = np.tile(times, (len(least), 1))
    return _with_exact_minima(plan, obstacles, Clearances(whole, least, numbers))


def nearest_obstacles(
    plan: Drawn, obstacles: Sequence[Obstacle], times: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Find the obstacle nearest to each vehicle, and the clearance from it.

    Args:
        plan: the vehicles' motion.
        obstacles: the obstacles to avoid.
        times: since the first knot [s], shape (M,).

    Returns:
        Clearances as in `Clearances` [m], inf without obstacles, and indices of the obstacles, both
        of shape (N, M).
    """
    least = np.full((len(plan.positions), len(times)), np.inf)
    numbers = np.zeros(least.shape, dtype=np.int64)
    for index, obstacle in enumerate(obstacles):
        clearances = distances(plan, obstacle, times) - required_distances(plan, obstacle)[:, None]
        numbers[clearances < least] = index
        least = np.minimum(clearances, least)
    return least, numbers


def nearest_vehicles(positions: FloatArray) -> tuple[FloatArray, IntArray]:
    """Find the nearest other vehicle of each vehicle over time, and its distance.

    Args:
        positions: scaled by the metric in which distances are measured [m], shape (N, M, 3).

    Returns:
        Distances [m], inf for a single vehicle, and indices, both of shape (N, M).
    """
    from scipy.spatial import cKDTree  # slow to import

    count, times = positions.shape[:2]
    if count == 1:
        return np.full((1, times), np.inf), np.zeros((1, times), dtype=np.int64)
    found = [cKDTree(positions[:, m]).query(positions[:, m], k=2) for m in range(times)]
    away = np.array([distances[:, 1] for distances, _ in found]).T
    # of two vehicles at the same position either may be listed first
    others = np.array([np.where(i[:, 0] == np.arange(count), i[:, 1], i[:, 0]) for _, i in found])
    return away, others.T


def free_radii(plan: Drawn, times: FloatArray) -> FloatArray:
    """Return the radii of the largest free balls around the vehicles.

    A free ball touches no obstacle. If the scenario requires a separation, it also reaches at most
    half-way to the nearest other vehicle.

    Args:
        plan: the motion of vehicles and obstacles.
        times: since the first knot [s], shape (M,).

    Returns:
        Radii [m], shape (N, M); inf if nothing limits them, and not positive inside an obstacle.
    """
    clearances, _ = nearest_obstacles(plan, plan.scenario.bodies, times)
    room: FloatArray = clearances + plan.scenario.fleet.radii[:, None]
    if plan.scenario.separation is not None:
        away, _ = nearest_vehicles(plan.motion().at("position", times))
        room = np.minimum(room, away / 2.0)
    return room


def _with_exact_minima(
    plan: Drawn, obstacles: Sequence[Obstacle], sampled: Clearances
) -> Clearances:
    """Insert each vehicle's exact minimum, from its nearest obstacle, into sampled clearances."""
    vehicles = np.arange(len(sampled.times))
    which = sampled.nearest[vehicles, np.argmin(sampled.clearances, axis=1)]
    times, least = np.zeros(len(which)), np.zeros(len(which))
    for index in np.unique(which):
        of, found = which == index, closest(plan, obstacles[index])
        times[of] = found.times[of]
        least[of] = (found.distances - required_distances(plan, obstacles[index]))[of]
    merged = [
        np.append(old, new[:, None], axis=1)
        for old, new in zip(
            (sampled.times, sampled.clearances, sampled.nearest), (times, least, which), strict=True
        )
    ]
    order = np.argsort(merged[0], axis=1, kind="stable")
    return Clearances(*(np.take_along_axis(each, order, axis=1) for each in merged))
