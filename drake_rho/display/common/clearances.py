"""How far vehicles are from obstacles over time, moving obstacles included."""

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
"""How much closer than at the knots an approach need not be, in parts of an obstacle's size."""


@dataclasses.dataclass(frozen=True, eq=False)
class ClosestApproaches:
    """The closest approach of each vehicle to an obstacle."""

    times: FloatArray
    """when, since the first knot [s], shape (N,)"""
    distances: FloatArray
    """how far from the surface, negative inside [m], shape (N,)"""


@dataclasses.dataclass(frozen=True)
class Approach:
    """A vehicle at an instant."""

    vehicle: int
    """its index"""
    time: float
    """since the first knot [s]"""


@dataclasses.dataclass(frozen=True, eq=False)
class Clearances:
    """What is left between each vehicle and the obstacle that leaves it least.

    A clearance is the distance from the surface less the vehicle's radius, and less how far the
    obstacle may be from its track.
    """

    times: FloatArray
    """since the first knot, rising, the closest approaches among them [s], shape (N, M)"""
    clearances: FloatArray
    """negative where an obstacle is too close [m], shape (N, M)"""
    nearest: IntArray
    """index of the obstacle, shape (N, M)"""


def distances(plan: Drawn, obstacle: Obstacle, times: FloatArray) -> FloatArray:
    """Distances of all vehicles from the surface of an obstacle, negative inside.

    Args:
        plan: where the vehicles are.
        obstacle: where it is too.
        times: since the first knot [s], shape (M,).

    Returns:
        Distances [m], shape (N, M).
    """
    positions = plan.motion().at("position", times)
    return obstacle.distances(positions, plan.scenario.grid.start + times)


def required_distances(plan: Drawn, obstacle: Obstacle) -> FloatArray:
    """Least distances from an obstacle's surface that the vehicles keep [m], shape (N,)."""
    least: FloatArray = plan.scenario.fleet.radii + obstacle.deviation
    return least


def closest(plan: Drawn, obstacle: Obstacle) -> ClosestApproaches:
    """The closest approaches, exact between the knots too."""
    motion, start = plan.motion(), plan.scenario.grid.start
    knots: FloatArray = np.float64(motion.step) * np.arange(motion.positions.shape[1])
    slack = _SLACK * obstacle.shape.size
    below = distances(plan, obstacle, knots).min(axis=1) + slack  # some piece reaches that
    pieces = pieces_near(motion, obstacle.since(start), np.maximum(below, slack))
    tolerances = np.full(len(pieces.owners), obstacle.shape.tolerance)
    which, times = deepest(obstacle.shape, pieces, below[pieces.owners], tolerances)
    owners = pieces.owners[which]
    found = obstacle.distances(motion.each_at("position", owners, times), start + times)
    order = np.lexsort((found, owners))
    firsts = order[np.unique(owners[order], return_index=True)[1]]
    return ClosestApproaches(times[firsts], found[firsts])


def nearest(plan: Drawn, obstacle: Obstacle) -> Approach:
    """The approach that leaves least room beside an obstacle."""
    found = closest(plan, obstacle)
    vehicle = int(np.argmin(found.distances - required_distances(plan, obstacle)))
    return Approach(vehicle, float(found.times[vehicle]))


def least_clearances(plan: Drawn, obstacles: Sequence[Obstacle]) -> Clearances:
    """The clearances over time that are least of all obstacles, of which there is at least one."""
    times = dense_times(plan)
    least, numbers = nearest_obstacles(plan, obstacles, times)
    whole = np.tile(times, (len(least), 1))
    return _with_exact_minima(plan, obstacles, Clearances(whole, least, numbers))


def nearest_obstacles(
    plan: Drawn, obstacles: Sequence[Obstacle], times: FloatArray
) -> tuple[FloatArray, IntArray]:
    """How much room each vehicle has beside the obstacle that leaves it least.

    Args:
        plan: where the vehicles are.
        obstacles: what they keep clear of.
        times: since the first knot [s], shape (M,).

    Returns:
        Clearances as in `Clearances` [m], inf where there is no obstacle, and indices of the
        obstacles, both of shape (N, M).
    """
    least = np.full((len(plan.positions), len(times)), np.inf)
    numbers = np.zeros(least.shape, dtype=np.int64)
    for index, obstacle in enumerate(obstacles):
        clearances = distances(plan, obstacle, times) - required_distances(plan, obstacle)[:, None]
        numbers[clearances < least] = index
        least = np.minimum(clearances, least)
    return least, numbers


def nearest_vehicles(positions: FloatArray) -> tuple[FloatArray, IntArray]:
    """How far each vehicle is from the nearest other one, and which that is, over time.

    Args:
        positions: scaled as distances are to be measured [m], shape (N, M, 3).

    Returns:
        Distances [m], inf of a single vehicle, and indices, both of shape (N, M).
    """
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    count, times = positions.shape[:2]
    if count == 1:
        return np.full((1, times), np.inf), np.zeros((1, times), dtype=np.int64)
    found = [cKDTree(positions[:, m]).query(positions[:, m], k=2) for m in range(times)]
    away = np.array([distances[:, 1] for distances, _ in found]).T
    # of two vehicles in the same place either may come first
    others = np.array([np.where(i[:, 0] == np.arange(count), i[:, 1], i[:, 0]) for _, i in found])
    return away, others.T


def free_radii(plan: Drawn, times: FloatArray) -> FloatArray:
    """Radii of balls around vehicles that reach into nothing that they keep clear of.

    These are obstacles, and where there is a separation other vehicles, of which each has half of
    the way between two.

    Args:
        plan: where vehicles and obstacles are.
        times: since the first knot [s], shape (M,).

    Returns:
        Radii [m], shape (N, M); inf where there is nothing, and not positive inside an obstacle.
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
    """Clearances at many instants, and each vehicle's exact least from its nearest obstacle."""
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
