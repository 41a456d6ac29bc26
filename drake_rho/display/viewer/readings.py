"""Readings of the viewer over time: speeds, clearances, and least values of the fleet.

A clearance is the distance minus its limit. For an obstacle it is the distance less the obstacle's
uncertainty, the vehicle's radius and the obstacle's largest deviation from its track. For another
vehicle it is the distance, scaled for downwash, minus the separation. Without a separation, other
vehicles are ignored. The margin in a requirement of positions is the distance from its set's
boundary.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.display.common.clearances import least_clearances
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.minima import Minima, Minimum
from drake_rho.display.common.requirements import RequiredPositions, required_positions, tightest
from drake_rho.motion.nearest_vehicles import nearest_vehicles
from drake_rho.motion.obstacle_clearances import nearest_obstacles
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.times import Clock


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """Minimum of a distance over the fleet as a function of time, with its limit."""

    times: FloatArray
    """increasing times since the first knot, including that of the minimum [s], shape (M,)"""
    values: FloatArray
    """distances [m], shape (M,)"""
    limit: float | None
    """required distance [m]; None if the scenario requires none"""
    closest: tuple[int, int]
    """index of the vehicle at the minimum, and of the other vehicle, obstacle or requirement"""


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """Speeds and clearances of all vehicles over time."""

    times: FloatArray
    """times since the first knot [s], shape (M,)"""
    speeds: FloatArray
    """speeds [m/s], shape (N, M)"""
    clearances: FloatArray
    """least clearances [m], infinite if there is nothing to avoid, shape (N, M)"""
    nearest: IntArray
    """index of the nearest obstacle or, plus the number of obstacles, vehicle, shape (N, M)"""
    obstacles: Curve | None
    """clearance of the closest vehicle from obstacles; None without obstacles"""
    pairs: Curve | None
    """distance of the closest two vehicles; None for a single vehicle"""
    requirements: Curve | None
    """smallest margin in requirements of positions; None without such requirements"""
    required: tuple[RequiredPositions, ...]
    """requirements of positions, R of them"""

    @classmethod
    def of(cls, shown: Drawn, times: FloatArray) -> Readings:
        """Return readings at times since the first knot [s], (M,); minima of curves are exact."""
        motion, scenario = shown.motion(), shown.scenario
        speeds = np.linalg.norm(motion.at("velocity", times), axis=2)
        clear, number = nearest_obstacles(shown, scenario.bodies, times)
        measure = scenario.separation or Separation(1.0)
        away, other = nearest_vehicles(measure.scaled(motion.at("position", times)))
        clearances, nearest = clear, number
        if scenario.separation is not None:
            apart = away - scenario.separation.distance
            nearest = np.where(apart < clear, len(scenario.bodies) + other, number)
            clearances = np.minimum(clear, apart)
        obstacles = _from_obstacles(shown, times, clear) if scenario.bodies else None
        pairs = _between_two(shown, times, away) if len(speeds) > 1 else None
        required = tuple(required_positions(scenario))
        requirements = _of_requirements(shown, times, required) if required else None
        return cls(times, speeds, clearances, nearest, obstacles, pairs, requirements, required)


def _from_obstacles(shown: Drawn, times: FloatArray, clear: FloatArray) -> Curve | None:
    """Return the clearance from obstacles; None if none is active during the flight."""
    found = least_clearances(shown, shown.scenario.bodies)
    if not np.isfinite(found.clearances).any():
        return None
    least = found.minima.least
    nearest = int(found.nearest_at_minima[least.row])
    return _curve(shown, times, clear.min(axis=0), least, nearest)


def _of_requirements(
    shown: Drawn, times: FloatArray, required: Sequence[RequiredPositions]
) -> Curve:
    """Return the smallest margin in all requirements."""
    margins = np.min([each.margins(shown, times).min(axis=0) for each in required], axis=0)
    number, minima = tightest(required, shown)
    return _curve(shown, times, margins, minima.least, number)


def _between_two(shown: Drawn, times: FloatArray, away: FloatArray) -> Curve:
    """Return the distance of the closest two vehicles."""
    separation = shown.scenario.separation
    found = shown.closest_two(separation or Separation(1.0))
    least = Minima(found.one, found.times, found.distances).least
    limit = None if separation is None else separation.distance
    return _curve(shown, times, away.min(axis=0), least, int(found.other[least.row]), limit)


def _curve(
    shown: Drawn,
    times: FloatArray,
    values: FloatArray,
    least: Minimum,
    other: int,
    limit: float | None = 0.0,
) -> Curve:
    """Return a curve with its exact minimum, which replaces a point at the same time.

    Args:
        shown: motion to draw.
        times: times since the first knot [s], shape (M,).
        values: least values of the fleet at these times [m], shape (M,).
        least: minimum over time.
        other: index of the other vehicle, obstacle or requirement at the minimum.
        limit: required value [m], if any.
    """
    (same,) = np.nonzero(Clock.of(shown.scenario.grid.step).same(times, least.time))
    if len(same) > 0:
        values = values.copy()
        values[same[0]] = least.value
    else:
        place = int(np.searchsorted(times, least.time))
        times = np.insert(times, place, least.time)
        values = np.insert(values, place, least.value)
    return Curve(times, values, limit, (least.vehicle, other))
