"""Boxes (4) to (7), judged at the knots, and for positions at every instant."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.assurance.continuous_time import least_distance
from drake_rho.assurance.report import AT_ALL_TIMES, AT_KNOTS, PRECISION, UNITS, Column
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Bounds
from drake_rho.scenario.records import Quantity, Scenario


def check_boxes(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """The checks of every box that the scenario has."""
    flown: dict[Quantity, FloatArray] = {
        "position": motion.positions,
        "velocity": motion.velocities,
        "acceleration": motion.accelerations,
        "jerk": motion.jerks(),
    }
    first = np.isnan(scenario.fleet.accelerations_before[:, 0])
    for quantity, values in flown.items():
        bounds = scenario.fleet.bounds(quantity)
        if bounds is not None:  # the first jerk has no limit where no acceleration is given before
            knots = _extremes_at_knots(scenario, values, first & (quantity == "jerk"))
            yield _check_box(scenario, quantity, AT_KNOTS, bounds, knots)
    bounds = scenario.fleet.bounds("position")
    if bounds is not None:
        always = _extremes_at_all_times(scenario, motion, bounds)
        yield _check_box(scenario, "position", AT_ALL_TIMES, bounds, always)


@dataclasses.dataclass(frozen=True)
class _Extremes:
    """Least and greatest value on each axis, arrays of shape (N, 2, 3)."""

    times: FloatArray
    values: FloatArray


def _extremes_at_knots(scenario: Scenario, values: FloatArray, skipped: BoolArray) -> _Extremes:
    """Extremes of values at knots, shape (N, M, 3), without the first of vehicles `skipped`."""
    low, high = np.array(values), np.array(values)
    low[skipped, 0], high[skipped, 0] = np.inf, -np.inf
    k = np.stack([np.argmin(low, axis=1), np.argmax(high, axis=1)], axis=1)
    least, greatest = low.min(axis=1), high.max(axis=1)
    return _Extremes(scenario.grid.times[k], np.stack([least, greatest], axis=1))


def _extremes_at_all_times(scenario: Scenario, motion: Motion, bounds: Bounds) -> _Extremes:
    """Extremes of positions: the least of x, y, z and of -x, -y, -z, as distances from a wall."""
    signs = np.array([1.0, -1.0])[:, None, None, None]
    states = (motion.positions, motion.velocities, motion.accelerations)
    p, v, a = (signs * np.moveaxis(each, 1, 2)[:, None, ..., None] for each in states)
    precision = PRECISION * bounds.tolerances[:, None]
    times, least = least_distance(motion.step, (p, v, a), lambda x: x[..., 0], precision)
    return _Extremes(scenario.grid.start + times, signs[..., 0, 0] * least)


def _check_box(
    scenario: Scenario, quantity: Quantity, when: str, bounds: Bounds, extremes: _Extremes
) -> Column:
    """One box: the side that is most exceeded, or closest to it, of each vehicle."""
    values = extremes.values
    excess = np.stack([bounds.lower - values[:, 0], values[:, 1] - bounds.upper], axis=1)
    side, axis = _worst_side(excess, bounds.tolerances[:, None])
    i = np.arange(len(values))
    nothing = values[:, 0, 0] > values[:, 1, 0]  # all knots were skipped
    at = f" {when}" if quantity == "position" else ""
    return Column(
        constraint=f"{quantity} box",
        parts=[f"{'xyz'[x]} {('lower', 'upper')[s]}{at}" for s, x in zip(side, axis, strict=True)],
        times=extremes.times[i, side, axis],
        values=values[i, side, axis],
        limits=np.where(side == 0, bounds.lower[i, axis], bounds.upper[i, axis]),
        excess=excess[i, side, axis],
        tolerances=bounds.tolerances[i, axis],
        unit=UNITS[quantity],
        asked=when == AT_KNOTS or scenario.between_knots,
        due=np.isfinite(bounds.lower[:, 0]) & ~nothing,
    )


def _worst_side(excess: FloatArray, tolerances: FloatArray) -> tuple[IntArray, IntArray]:
    """Side and axis of the largest excess; a side that is broken comes before one that holds.

    Tolerances differ from axis to axis, so among sides that are broken it is the one that is most
    tolerances beyond.

    Args:
        excess: shape (N, 2, 3).
        tolerances: broadcast to it.

    Returns:
        Indices, each of shape (N,).
    """
    excess = np.where(np.isnan(excess), np.inf, excess)
    broken = np.any(excess > tolerances, axis=(1, 2), keepdims=True)
    order = np.where(broken, excess / tolerances, excess).reshape(len(excess), -1)
    side, axis = np.unravel_index(np.argmax(order, axis=1), excess.shape[1:])
    return side, axis
