"""Time scaling: the speed profile along paths."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import in_order, is_during_flight

_WITHIN = 0.95
"""Fraction of a vehicle's speed limits that a path uses."""

_GENTLE = 1.0 / 3.0
"""Fraction of the duration for acceleration, and for deceleration, if speed limits allow.
With one third, a straight flight needs little more than the minimum effort."""


def usable_speeds(scenario: Scenario) -> FloatArray:
    """Return the speeds that paths may use in each axis direction [m/s], shape (N, 2, 3).

    Index 0 of the second axis stands for negative directions, index 1 for positive ones. A speed is
    infinite without a limit, and zero if the limits force the vehicle in the opposite direction.
    """
    fleet = scenario.fleet
    most = np.full((len(scenario.vehicles), 2, 3), np.inf)
    if (bounds := fleet.bounds("velocity")) is not None:
        most = np.maximum(np.stack([-bounds.lower, bounds.upper], axis=1), 0.0)
    if "max_speed" in fleet.norms:
        most = np.minimum(most, fleet.norms["max_speed"].limits[:, None, None])
    return _WITHIN * most


@dataclasses.dataclass(frozen=True)
class Leg:
    """Section of a flight between consecutive stops: the start, waypoints and the goal."""

    begin: float
    """time at which it begins, since the first knot [s]"""
    end: float
    """time at which it ends, since the first knot [s]"""
    start: FloatArray
    """position at its beginning [m], shape (3,)"""
    goal: FloatArray
    """position at its end [m], shape (3,)"""


def legs_of(scenario: Scenario, number: int) -> list[Leg]:
    """Return the legs of a vehicle in the order of time."""
    vehicle, grid = scenario.vehicles[number], scenario.grid
    stops = [(0.0, vehicle.start.position)]
    for time, waypoint in in_order(vehicle):
        if is_during_flight(time, grid):
            stops.append((float(grid.since_start(time)), waypoint.position))
    stops.append((grid.duration, scenario.fleet.goal_positions[number]))
    return [Leg(begin, end, start, goal) for (begin, start), (end, goal) in pairwise(stops)]


def time_scaled(path: FloatArray, elapsed: FloatArray, most: FloatArray) -> FloatArray:
    """Return positions along a path at given times, with the gentlest ramps within the speeds.

    Args:
        path: corners of a polyline [m], shape (P, 3).
        elapsed: times from the beginning to the end of the path [s], shape (K,).
        most: largest speeds in the negative and positive axis directions [m/s], shape (2, 3).

    Returns:
        Positions [m], shape (K, 3).
    """
    segments = np.diff(path, axis=0)
    lengths = np.linalg.norm(segments, axis=1)
    speeds = np.where(segments < 0.0, most[0], most[1])
    shortest = float(np.sum(np.max(np.abs(segments) / np.maximum(speeds, 1e-300), axis=1)))
    ramp = min(_GENTLE, max(0.02, 1.0 - shortest / (elapsed[-1] - elapsed[0])))
    gone = np.concatenate([[0.0], np.cumsum(lengths)])
    s = gone[-1] * progress(elapsed, ramp)
    return np.stack([np.interp(s, gone, axis) for axis in path.T], axis=-1)


def progress(times: FloatArray, ramp: float) -> FloatArray:
    """Return the fraction of a path completed at each time, from 0 to 1, shape (M,).

    The speed profile is a trapezoid: speed rises linearly during the fraction `ramp` of the
    duration, is constant, and falls linearly during the last fraction `ramp`.

    Args:
        times: from the beginning to the end of the path [s], shape (M,).
        ramp: fraction of the duration, at most 1/2.
    """
    s = (times - times[0]) / (times[-1] - times[0])
    late = np.clip(s - (1.0 - ramp), 0.0, ramp)
    rising = np.minimum(s, ramp) ** 2 / (2.0 * ramp)
    steady = np.clip(s - ramp, 0.0, 1.0 - 2.0 * ramp)
    done: FloatArray = rising + steady + late - late**2 / (2.0 * ramp)
    return done / (1.0 - ramp)
