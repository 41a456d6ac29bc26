"""Boxes (4) to (7), judged at the knots, and for positions at every instant.

What errors take is taken off a box on every side: of positions and velocities the radius at the
time, of accelerations that of the feedback. Jerk is that of the plan alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Bounds
from drake_rho.scenario.records import Quantity, Scenario
from drake_rho.verification.between_samples import greatest_velocity
from drake_rho.verification.continuous_time import lowest_over_time
from drake_rho.verification.course import Course
from drake_rho.verification.report import AT_ALL_TIMES, AT_KNOTS, PRECISION, UNITS, Column


def check_position_box(course: Course) -> Iterator[Column]:
    """Judge the box of positions, if there is one: at the knots, and at every instant."""
    scenario, box = course.scenario, course.scenario.fleet.bounds("position")
    if box is None:
        return
    values, errors = course.positions[:, course.knots], course.errors(course.knots)
    found = _extremes_at(course.times[course.knots], values, errors)
    yield _check_box(scenario, "position", AT_KNOTS, box, found)
    always = _extremes_at_all_times(course, box)
    yield _check_box(scenario, "position", AT_ALL_TIMES, box, always)


def check_boxes(course: Course, jerks: FloatArray) -> Iterator[Column]:
    """The checks of every box that the scenario has.

    Args:
        course: what is judged.
        jerks: of the plan, at the knots that begin a step [m/s³], shape (N, K-1, 3).
    """
    scenario, bounds = course.scenario, course.scenario.fleet.bounds
    position = list(check_position_box(course))
    yield from position[:1]
    if (box := bounds("velocity")) is not None:
        yield _check_box(scenario, "velocity", AT_KNOTS, box, _extremes_of_velocity(course))
    if (box := bounds("acceleration")) is not None:
        times, errors = course.times[:-1], course.feedback
        found = _extremes_at(times, course.commands, errors)
        yield _check_box(scenario, "acceleration", AT_KNOTS, box, found)
    if (box := bounds("jerk")) is not None:
        # the first jerk has no limit where no acceleration is given before
        skipped = np.isnan(scenario.fleet.accelerations_before[:, 0])
        times = scenario.grid.times[:-1]
        found = _extremes_at(times, jerks, np.zeros(len(times)), skipped)
        yield _check_box(scenario, "jerk", AT_KNOTS, box, found)
    yield from position[1:]


@dataclasses.dataclass(frozen=True)
class _Extremes:
    """Least and greatest value on each axis, errors counted, arrays of shape (N, 2, 3)."""

    times: FloatArray
    """on the scenario's clock [s]"""
    values: FloatArray
    """without the errors, in the quantity's unit"""
    errors: FloatArray
    """radii then, in the quantity's unit"""


def _extremes_at(
    times: FloatArray, values: FloatArray, errors: FloatArray, skipped: BoolArray | None = None
) -> _Extremes:
    """Extremes of values at times (M,), shape (N, M, 3), with errors of radii (M,) around them.

    Where a vehicle is among those `skipped`, (N,), its first value is not looked at.
    """
    low, high = np.array(values), np.array(values)
    if skipped is not None:
        low[skipped, 0], high[skipped, 0] = np.inf, -np.inf
    radii = errors[:, None]
    least, most = np.argmin(low - radii, axis=1), np.argmax(high + radii, axis=1)
    both = [
        np.take_along_axis(each, k[:, None], axis=1)[:, 0]
        for each, k in ((low, least), (high, most))
    ]
    k = np.stack([least, most], axis=1)
    return _Extremes(times[k], np.stack(both, axis=1), errors[k])


def _extremes_of_velocity(course: Course) -> _Extremes:
    """Extremes at the instants; with errors around velocities, those at any time."""
    if course.tubes is None:
        return _extremes_at(course.times, course.velocities, np.zeros(len(course.times)))
    signs = np.array([-1.0, 1.0])[:, None]
    found = greatest_velocity(course, lambda v: signs * v[..., None, :])
    return _Extremes(found.times, signs * found.values, found.errors)


def _extremes_at_all_times(course: Course, bounds: Bounds) -> _Extremes:
    """Extremes of positions: the least of x, y, z and of -x, -y, -z, as distances from a wall."""
    signs = np.array([1.0, -1.0])[:, None, None, None]
    states = (course.positions, course.velocities, course.accelerations)
    p, v, a = (signs * np.moveaxis(each, 1, 2)[:, None, ..., None] for each in states)
    precision, shape = PRECISION * bounds.tolerances[:, None], p.shape[:3]
    around = course.around(np.tile(np.arange(a.shape[3]), int(np.prod(shape))))
    steps = course.steps_of(p, v, a)
    least = lowest_over_time(steps, shape, lambda x: x[..., 0], precision, around)
    times = course.scenario.grid.start + course.moments(least.steps, least.moments)
    return _Extremes(times, signs[..., 0, 0] * (least.values + least.radii), least.radii)


def _check_box(
    scenario: Scenario, quantity: Quantity, when: str, bounds: Bounds, extremes: _Extremes
) -> Column:
    """One box: the side that is most exceeded, or closest to it, of each vehicle."""
    values = extremes.values
    errors = extremes.errors
    lower = np.where(errors[:, 0] > 0.0, bounds.lower + errors[:, 0], bounds.lower)
    upper = np.where(errors[:, 1] > 0.0, bounds.upper - errors[:, 1], bounds.upper)
    excess = np.stack([lower - values[:, 0], values[:, 1] - upper], axis=1)
    side, axis = _worst_side(excess, bounds.tolerances[:, None])
    i = np.arange(len(values))
    nothing = values[:, 0, 0] > values[:, 1, 0]  # all knots were skipped
    at = f" {when}" if quantity == "position" else ""
    return Column(
        kind=quantity,
        constraint=f"{quantity} box",
        parts=[f"{'xyz'[x]} {('lower', 'upper')[s]}{at}" for s, x in zip(side, axis, strict=True)],
        times=extremes.times[i, side, axis],
        values=values[i, side, axis],
        limits=np.where(side == 0, lower[i, axis], upper[i, axis]),
        errors=errors[i, side, axis],
        excess=excess[i, side, axis],
        tolerances=bounds.tolerances[i, axis],
        unit=UNITS[quantity],
        asked=when == AT_KNOTS or scenario.between_knots,
        always=when == AT_ALL_TIMES,
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
