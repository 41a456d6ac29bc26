"""How fast ways are gone."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

_WITHIN = 0.95
"""Part of a vehicle's limits of speed that a way uses."""

_GENTLE = 1.0 / 3.0
"""Part of the time in which speed rises, and falls, where limits of speed allow it: with it a
straight flight needs little more than the least effort."""


def usable_speeds(scenario: Scenario) -> FloatArray:
    """Speeds against each axis, and along it, that ways may use [m/s], shape (N, 2, 3).

    They are infinite without a limit, and zero where a vehicle has to go the other way.
    """
    fleet = scenario.fleet
    most = np.full((len(scenario.vehicles), 2, 3), np.inf)
    if (bounds := fleet.bounds("velocity")) is not None:
        most = np.maximum(np.stack([-bounds.lower, bounds.upper], axis=1), 0.0)
    if "max_speed" in fleet.norms:
        most = np.minimum(most, fleet.norms["max_speed"].most[:, None, None])
    return _WITHIN * most


@dataclasses.dataclass(frozen=True)
class Leg:
    """A part of a flight: from the start, or a waypoint, to the next or the goal."""

    begin: float
    """since the first knot [s]"""
    end: float
    """since the first knot [s]"""
    start: FloatArray
    """position then [m], shape (3,)"""
    goal: FloatArray
    """position at the end [m], shape (3,)"""


def legs_of(scenario: Scenario, number: int) -> list[Leg]:
    """The legs of a vehicle, one after the other."""
    vehicle, grid = scenario.vehicles[number], scenario.grid
    stops = [(0.0, vehicle.start.position)]
    for waypoint in sorted(vehicle.waypoints, key=lambda each: each.time):
        if 0.0 < waypoint.time - grid.start < grid.duration:
            stops.append((waypoint.time - grid.start, waypoint.position))
    stops.append((grid.duration, vehicle.goal.position))
    return [Leg(begin, end, start, goal) for (begin, start), (end, goal) in pairwise(stops)]


def paced(way: FloatArray, elapsed: FloatArray, most: FloatArray) -> FloatArray:
    """Positions along a way at given times, speed rising and falling as gently as limits allow.

    Args:
        way: corners of a polyline [m], shape (P, 3).
        elapsed: from the beginning to the end of the way [s], shape (K,).
        most: speeds against each axis, and along it [m/s], shape (2, 3).

    Returns:
        Positions [m], shape (K, 3).
    """
    ways = np.diff(way, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    speeds = np.where(ways < 0.0, most[0], most[1])
    shortest = float(np.sum(np.max(np.abs(ways) / np.maximum(speeds, 1e-300), axis=1)))
    ramp = min(_GENTLE, max(0.02, 1.0 - shortest / (elapsed[-1] - elapsed[0])))
    gone = np.concatenate([[0.0], np.cumsum(lengths)])
    s = gone[-1] * progress(elapsed, ramp)
    return np.stack([np.interp(s, gone, axis) for axis in way.T], axis=-1)


def progress(times: FloatArray, ramp: float) -> FloatArray:
    """Part of a way that is done at each time, shape (M,), from the first to the last.

    Speed rises evenly in a part `ramp` of the time, and falls as evenly in the end.
    """
    s = (times - times[0]) / (times[-1] - times[0])
    late = np.clip(s - (1.0 - ramp), 0.0, ramp)
    rising = np.minimum(s, ramp) ** 2 / (2.0 * ramp)
    steady = np.clip(s - ramp, 0.0, 1.0 - 2.0 * ramp)
    done: FloatArray = rising + steady + late - late**2 / (2.0 * ramp)
    return done / (1.0 - ramp)
