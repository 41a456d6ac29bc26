"""Bounds on the positions and velocities that vehicles can reach over time, axis by axis.

From the start, and towards the goal, speed changes no faster than the acceleration limits allow,
and positions no faster than that speed. The bounds are necessary, not sufficient: no plan leaves
them, but not every position inside can be reached. They treat the axes independently and ignore
limits on jerk, tilt and thrust.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.norms import Norm
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

_SAMPLES = 65
"""Number of times at which bounds are computed; between them they are nearly linear."""

_UNLIMITED = 1e4
"""Speed in place of no limit, in characteristic lengths of the fleet per duration."""


@dataclasses.dataclass(frozen=True, eq=False)
class ReachableBounds:
    """Bounds on positions and velocities along each axis, for every vehicle."""

    times: FloatArray
    """times of the bounds since the first knot [s], shape (S,)"""
    lower: FloatArray
    """lower bounds on positions [m], shape (N, S, 3)"""
    upper: FloatArray
    """upper bounds on positions [m], shape (N, S, 3)"""
    speeds: FloatArray
    """greatest speed of any vehicle along each axis [m/s], shape (3,)"""

    def of(self, number: int, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds on a vehicle's positions [m], shape (M, 3) each.

        Args:
            number: of the vehicle, from 0.
            times: since the first knot [s], shape (M,).
        """
        lower, upper = (
            np.stack([np.interp(times, self.times, axis) for axis in bound[number].T], axis=-1)
            for bound in (self.lower, self.upper)
        )
        return lower, upper


def reachable_bounds(scenario: Scenario) -> ReachableBounds:
    """Return bounds on the positions and speeds that the vehicles of a scenario can reach."""
    fleet, T = scenario.fleet, scenario.grid.duration
    times = np.linspace(0.0, T, _SAMPLES)
    most = _UNLIMITED * float(fleet.lengths.max()) / T
    fastest = _fastest(scenario, times, most, 1.0)
    slowest = -_fastest(scenario, times, most, -1.0)
    none, ends = np.zeros(len(fastest)), (fleet.start_positions, fleet.goal_positions)
    sides = [
        _within(times, fastest, slowest, none + when, where)
        for when, where in zip((0.0, T), ends, strict=True)
    ]
    lower = np.maximum(sides[0][0], sides[1][0])
    upper = np.minimum(sides[0][1], sides[1][1])
    for each in fleet.waypoints:
        present = np.flatnonzero(each.present)
        when = np.clip(each.times[present] - scenario.grid.start, 0.0, T)
        low, high = _within(
            times, fastest[present], slowest[present], when, each.positions[present]
        )
        off = np.where(np.isfinite(each.within[present]), each.within[present], np.inf)[
            :, None, None
        ]
        lower[present] = np.maximum(lower[present], low - off)
        upper[present] = np.minimum(upper[present], high + off)
    speeds = np.maximum(fastest, -slowest).max(axis=(0, 1))
    return ReachableBounds(times, np.minimum(lower, upper), np.maximum(lower, upper), speeds)


def _fastest(scenario: Scenario, times: FloatArray, most: float, sign: float) -> FloatArray:
    """Return the largest velocities at given times in one direction of each axis, shape (N, S, 3).

    Args:
        scenario: with the limits, starts and goals.
        times: since the first knot [s], shape (S,).
        most: speed in place of no limit [m/s].
        sign: 1 for the positive direction of the axes, -1 for the negative one.

    Returns:
        Velocities in that direction [m/s].
    """
    fleet = scenario.fleet
    along, _ = _sides(scenario, "velocity", "max_speed", sign)
    rising, falling = np.maximum(_sides(scenario, "acceleration", "max_acceleration", sign), 0.0)
    elapsed, remaining = times[:, None], times[-1] - times[:, None]
    start, goal = sign * fleet.start_velocities, sign * fleet.goal_velocities
    goal = np.where(fleet.fixed_velocities[:, None], goal, np.inf)
    with np.errstate(invalid="ignore"):  # zero time times an infinite limit
        begun = start[:, None] + np.where(elapsed > 0.0, elapsed * rising[:, None], 0.0)
        ended = goal[:, None] + np.where(remaining > 0.0, remaining * falling[:, None], 0.0)
    fastest: FloatArray = np.minimum(np.minimum(begun, ended), np.minimum(along, most)[:, None])
    return fastest


def _sides(scenario: Scenario, quantity: Quantity, norm: Norm, sign: float) -> FloatArray:
    """Return bounds on a quantity in the given direction of each axis and the opposite, (2, N, 3).

    Args:
        scenario: with the limits.
        quantity: bounded by a box.
        norm: limit on the norm of the same quantity.
        sign: 1 or -1, the direction of the first bounds.
    """
    fleet = scenario.fleet
    sides = np.full((2, len(scenario.vehicles), 3), np.inf)
    if (bounds := fleet.bounds(quantity)) is not None:
        sides = np.array([bounds.upper, -bounds.lower][:: int(sign)])
    if norm in fleet.norms:
        sides = np.minimum(sides, fleet.norms[norm].limits[:, None])
    return sides


def _within(
    times: FloatArray, fastest: FloatArray, slowest: FloatArray, when: FloatArray, where: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return bounds on positions from one known position per vehicle, shape (N, S, 3) each.

    Args:
        times: of the bounds [s], shape (S,).
        fastest: upper bounds on velocities at these times [m/s], shape (N, S, 3).
        slowest: lower bounds on velocities at these times [m/s], shape (N, S, 3).
        when: times of the known positions [s], shape (N,).
        where: known positions [m], shape (N, 3).
    """
    bounds = []
    for velocities in (fastest, slowest):
        parts = np.diff(times)[:, None] * (velocities[:, 1:] + velocities[:, :-1]) / 2.0
        total = np.concatenate([np.zeros_like(parts[:, :1]), np.cumsum(parts, axis=1)], axis=1)
        k = np.clip(np.searchsorted(times, when, side="right"), 1, len(times) - 1)
        part = ((when - times[k - 1]) / (times[k] - times[k - 1]))[:, None]
        each = np.arange(len(total))
        then = (1.0 - part) * total[each, k - 1] + part * total[each, k]
        bounds.append(where[:, None] + total - then[:, None])
    later = (times >= when[:, None])[..., None]
    return np.where(later, bounds[1], bounds[0]), np.where(later, bounds[0], bounds[1])
