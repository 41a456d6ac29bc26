"""What a viewer reads off while vehicles fly: speeds, clearances, and the least of all over time.

A clearance here is what is left until a limit is reached: the distance from an obstacle's surface
less the vehicle's radius and how far the obstacle may be off its track, or the distance of another
vehicle, as the separation measures it, less the separation. Where there is no separation other
vehicles do not count.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.display.common.clearances import least_clearances
from drake_rho.display.common.drawable import Drawn, closest_two
from drake_rho.motion.nearest_vehicles import nearest_vehicles
from drake_rho.motion.obstacle_clearances import nearest_obstacles
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
    """The least of a distance over time, with its limit."""

    times: FloatArray
    """since the first knot, rising, that of the least among them [s], shape (M,)"""
    values: FloatArray
    """how much it is [m], shape (M,)"""
    limit: float | None
    """what it keeps above [m]; nothing if the scenario asks for nothing"""
    closest: tuple[int, int]
    """index of the vehicle that is closest of all, and of the vehicle or obstacle that it is to"""


@dataclasses.dataclass(frozen=True, eq=False)
class Readings:
    """Numbers of every vehicle over time."""

    times: FloatArray
    """since the first knot [s], shape (M,)"""
    speeds: FloatArray
    """[m/s], shape (N, M)"""
    clearances: FloatArray
    """[m], inf where there is nothing to keep clear of, shape (N, M)"""
    nearest: IntArray
    """to what: index of an obstacle, or the number of obstacles and a vehicle's index, shape (N, M)
    """
    obstacles: Curve | None
    """clearance of the closest vehicle from obstacles; nothing where there are none"""
    pairs: Curve | None
    """distance of the closest two vehicles; nothing of a single one"""

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
            left = away - scenario.separation.distance
            nearest = np.where(left < clear, len(scenario.bodies) + other, number)
            clearances = np.minimum(clear, left)
        obstacles = _from_obstacles(shown, times, clear) if scenario.bodies else None
        pairs = _between_two(shown, times, away) if len(speeds) > 1 else None
        return cls(times, speeds, clearances, nearest, obstacles, pairs)


def _from_obstacles(shown: Drawn, times: FloatArray, clear: FloatArray) -> Curve | None:
    """Return the clearance from obstacles; None where none is active in the flight."""
    found = least_clearances(shown, shown.scenario.bodies)
    if not np.isfinite(found.clearances).any():
        return None
    i, m = np.unravel_index(np.argmin(found.clearances), found.clearances.shape)
    least = found.times[i, m], found.clearances[i, m]
    return Curve(
        *_with(times, clear.min(axis=0), *least),
        limit=0.0,
        closest=(int(i), int(found.nearest[i, m])),
    )


def _between_two(shown: Drawn, times: FloatArray, away: FloatArray) -> Curve:
    apart = shown.scenario.separation
    found = closest_two(shown, apart or Separation(1.0))
    m = np.argmin(found.distances)
    return Curve(
        *_with(times, away.min(axis=0), found.times[m], found.distances[m]),
        limit=None if apart is None else apart.distance,
        closest=(int(found.one[m]), int(found.other[m])),
    )


def _with(
    times: FloatArray, values: FloatArray, time: float, value: float
) -> tuple[FloatArray, FloatArray]:
    """Return a curve with one more point, which replaces one at the same time."""
    place = int(np.searchsorted(times, time - 1e-9))
    if place < len(times) and times[place] <= time + 1e-9:
        values = values.copy()
        values[place] = value
        return times, values
    return np.insert(times, place, time), np.insert(values, place, value)
