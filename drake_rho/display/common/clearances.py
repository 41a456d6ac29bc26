"""Distances of vehicles from static and moving obstacles over time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.style import dense_times
from drake_rho.motion.nearest_vehicles import nearest_vehicles
from drake_rho.motion.obstacle_clearances import (
    closest,
    nearest_obstacles,
    required_distances,
)
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle


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

    A clearance is the distance from the obstacle, less its uncertainty, the vehicle's radius and
    the largest deviation of the obstacle from its track. The nearest obstacle is the one with the
    least clearance.
    """

    times: FloatArray
    """times since the first knot, ascending, closest approaches included [s], shape (N, M)"""
    clearances: FloatArray
    """clearances, negative where an obstacle is too close [m], shape (N, M)"""
    nearest: IntArray
    """index of the nearest obstacle, shape (N, M)"""


def nearest(plan: Drawn, obstacle: Obstacle) -> Approach:
    """Find the vehicle and the time with the least clearance from an obstacle."""
    found = closest(plan, obstacle)
    vehicle = int(np.argmin(found.distances - required_distances(plan.scenario, obstacle)))
    return Approach(vehicle, float(found.times[vehicle]))


def least_clearances(plan: Drawn, obstacles: Sequence[Obstacle]) -> Clearances:
    """Return each vehicle's least clearance over time from one or more obstacles."""
    times = sample_times(plan, obstacles)
    least, numbers = nearest_obstacles(plan, obstacles, times)
    whole = np.tile(times, (len(least), 1))
    return _with_exact_minima(plan, obstacles, Clearances(whole, least, numbers))


def sample_times(plan: Drawn, obstacles: Sequence[Obstacle]) -> FloatArray:
    """Return `dense_times` and one time in each obstacle's active interval [s].

    An interval may be shorter than the time between samples.
    """
    grid = plan.scenario.grid
    intervals = [np.subtract(each.active, grid.start) for each in obstacles if each.active]
    inside = [np.clip(each, 0.0, grid.duration).mean() for each in intervals]
    times: FloatArray = np.union1d(dense_times(plan), np.array(inside, dtype=np.float64))
    return times


def free_radii(plan: Drawn, times: FloatArray) -> FloatArray:
    """Return the radii of the largest free balls around the vehicles.

    A free ball touches no obstacle. If the scenario requires a separation, it also reaches at most
    half-way to the nearest other vehicle.

    Args:
        plan: the motion of vehicles and obstacles.
        times: times since the first knot [s], shape (M,).

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
        least[of] = (found.distances - required_distances(plan.scenario, obstacles[index]))[of]
    merged = [
        np.append(old, new[:, None], axis=1)
        for old, new in zip(
            (sampled.times, sampled.clearances, sampled.nearest), (times, least, which), strict=True
        )
    ]
    order = np.argsort(merged[0], axis=1, kind="stable")
    return Clearances(*(np.take_along_axis(each, order, axis=1) for each in merged))
