"""How far vehicles are from obstacles over time, moving obstacles included."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.display.flown import Drawn
from drake_rho.display.style import dense_times
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle

_PARTS = 24
"""Parts of the time around a close approach at which it is looked for again."""
_ROUNDS = 6
"""How often: at last within 1e-7 of a step, and closer in distance where it is smooth."""


@dataclasses.dataclass(frozen=True, eq=False)
class Closest:
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


def kept(plan: Drawn, obstacle: Obstacle) -> FloatArray:
    """Least distances from an obstacle's surface that the vehicles keep [m], shape (N,)."""
    least: FloatArray = plan.scenario.fleet.radii + obstacle.deviation
    return least


def closest(plan: Drawn, obstacle: Obstacle) -> Closest:
    """The closest approaches, looked for ever closer around the nearest of many instants."""
    times = dense_times(plan)
    nearest = np.argmin(distances(plan, obstacle, times), axis=1)
    return _refined(plan, obstacle, np.arange(len(nearest)), _around(times, nearest))


def nearest(plan: Drawn, obstacle: Obstacle) -> Approach:
    """The approach that leaves least room beside an obstacle."""
    found = closest(plan, obstacle)
    vehicle = int(np.argmin(found.distances - kept(plan, obstacle)))
    return Approach(vehicle, float(found.times[vehicle]))


def least_clearances(plan: Drawn, obstacles: Sequence[Obstacle]) -> Clearances:
    """The clearances over time that are least of all obstacles, of which there is at least one."""
    times = dense_times(plan)
    least = np.full((len(plan.positions), len(times)), np.inf)
    numbers = np.zeros(least.shape, dtype=np.int64)
    for index, obstacle in enumerate(obstacles):
        clearances = distances(plan, obstacle, times) - kept(plan, obstacle)[:, None]
        numbers[clearances < least] = index
        least = np.minimum(clearances, least)
    whole = np.tile(times, (len(least), 1))
    return _with_least(plan, obstacles, Clearances(whole, least, numbers))


def _with_least(plan: Drawn, obstacles: Sequence[Obstacle], sampled: Clearances) -> Clearances:
    """Clearances at many instants, and each vehicle's least near the least of these."""
    rows = []
    for i, moment in enumerate(np.argmin(sampled.clearances, axis=1)):
        index, times = sampled.nearest[i, moment], sampled.times[i]
        found = _refined(plan, obstacles[index], np.array([i]), _around(times, moment[None]))
        m = np.searchsorted(times, found.times[0])
        rows.append(
            (
                np.insert(times, m, found.times[0]),
                np.insert(
                    sampled.clearances[i], m, found.distances[0] - kept(plan, obstacles[index])[i]
                ),
                np.insert(sampled.nearest[i], m, index),
            )
        )
    return Clearances(*(np.array(column) for column in zip(*rows, strict=True)))


def _around(times: FloatArray, moments: IntArray) -> tuple[FloatArray, FloatArray]:
    """The instants before and after some [s]."""
    return times[np.maximum(moments - 1, 0)], times[np.minimum(moments + 1, len(times) - 1)]


def _refined(
    plan: Drawn, obstacle: Obstacle, vehicles: IntArray, bracket: tuple[FloatArray, FloatArray]
) -> Closest:
    """The closest approaches of some vehicles, each between two times [s], shape (V,)."""
    motion, start = plan.motion(), plan.scenario.grid.start
    each, parts = np.arange(len(vehicles)), np.linspace(0.0, 1.0, _PARTS + 1)
    low, high = bracket
    for _ in range(_ROUNDS):
        times = low[:, None] + (high - low)[:, None] * parts
        flat = times.reshape(-1)
        positions = motion.each_at("position", np.repeat(vehicles, len(parts)), flat)
        found = obstacle.distances(positions, start + flat).reshape(times.shape)
        best = np.argmin(found, axis=1)
        low = times[each, np.maximum(best - 1, 0)]
        high = times[each, np.minimum(best + 1, _PARTS)]
    return Closest(times[each, best], found[each, best])
