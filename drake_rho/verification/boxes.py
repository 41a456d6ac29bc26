"""Box constraints (4) to (7), verified at the knots and, for positions, at every instant.

A box is tightened on every side by the error radius: for positions and velocities the radius at the
time, for accelerations the radius of the feedback. The jerk is that of the plan, without errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.bounds import Bounds
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import UNITS
from drake_rho.scenario.records import Quantity, Scenario
from drake_rho.verification.between_samples import greatest_velocity
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.continuous_time import lowest_over_time
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii


def check_position_box(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify the position box, if there is one, at the knots and at every instant."""
    scenario, box = trajectory.scenario, trajectory.scenario.fleet.bounds("position")
    if box is None:
        return
    values, errors = trajectory.positions[:, trajectory.knots], trajectory.errors(trajectory.knots)
    found = _extremes_at(trajectory.times[trajectory.knots], values, errors)
    yield _check_box(scenario, "position", AT_KNOTS, box, found)
    always = _extremes_at_all_times(trajectory, box)
    yield _check_box(scenario, "position", AT_ALL_TIMES, box, always)


def check_boxes(trajectory: PiecewiseTrajectory, jerks: Jerks) -> Iterator[Column]:
    """Verify every box that the scenario has.

    Args:
        trajectory: the trajectory to verify.
        jerks: jerks of the plan.
    """
    scenario, bounds = trajectory.scenario, trajectory.scenario.fleet.bounds
    position = list(check_position_box(trajectory))
    yield from position[:1]
    if (box := bounds("velocity")) is not None:
        yield _check_box(
            scenario, "velocity", AT_KNOTS, box, _extremes_of_velocity(trajectory, box)
        )
    if (box := bounds("acceleration")) is not None:
        times, errors = trajectory.times[:-1], trajectory.feedback
        found = _extremes_at(times, trajectory.commands, errors)
        if trajectory.higher is not None:
            found = _extremes_at_all_times(trajectory, box, 2)
        yield _check_box(scenario, "acceleration", AT_KNOTS, box, found)
    if (box := bounds("jerk")) is not None and trajectory.higher is not None:
        found = _extremes_at_all_times(trajectory, box, 3)
        yield _check_box(scenario, "jerk", AT_KNOTS, box, found)
    elif box is not None:
        knots = scenario.grid.times
        found = _extremes_at(knots, jerks.values, np.zeros(len(knots)), jerks.free)
        yield _check_box(scenario, "jerk", AT_KNOTS, box, found)
    yield from position[1:]


@dataclasses.dataclass(frozen=True)
class _Extremes:
    """Least and greatest value on each axis, error radii included; arrays of shape (N, 2, 3)."""

    times: FloatArray
    """times on the scenario's clock [s]"""
    values: FloatArray
    """values at these times without the error radii, in the quantity's unit"""
    errors: FloatArray
    """error radii at these times, in the quantity's unit"""


def _extremes_at(
    times: FloatArray, values: FloatArray, errors: FloatArray, skipped: BoolArray | None = None
) -> _Extremes:
    """Return the extremes of values (N, M, 3) at times (M,), widened by error radii (M,).

    Values marked in `skipped`, shape (N, M), are ignored.
    """
    low, high = np.array(values), np.array(values)
    if skipped is not None:
        low[skipped], high[skipped] = np.inf, -np.inf
    radii = errors[:, None]
    least, most = np.argmin(low - radii, axis=1), np.argmax(high + radii, axis=1)
    both = [
        np.take_along_axis(each, k[:, None], axis=1)[:, 0]
        for each, k in ((low, least), (high, most))
    ]
    k = np.stack([least, most], axis=1)
    return _Extremes(times[k], np.stack(both, axis=1), errors[k])


def _extremes_of_velocity(trajectory: PiecewiseTrajectory, bounds: Bounds) -> _Extremes:
    """Return the extremes of the velocity: at the instants or, with errors, at any time."""
    if trajectory.higher is not None:
        return _extremes_at_all_times(trajectory, bounds, 1)
    if trajectory.tubes is None:
        times, velocities = trajectory.all_velocities
        return _extremes_at(times, velocities, np.zeros(len(times)))
    signs = np.array([-1.0, 1.0])[:, None]
    found = greatest_velocity(trajectory, lambda v: signs * v[..., None, :])
    return _Extremes(found.times, signs * found.values, found.errors)


def _extremes_at_all_times(
    trajectory: PiecewiseTrajectory, bounds: Bounds, order: int = 0
) -> _Extremes:
    """Return the extremes of positions, or of a derivative of smooth motions, over all times.

    They are the least values of x, y, z and of -x, -y, -z, found like distances from a wall.

    Args:
        trajectory: the trajectory to verify.
        bounds: the box whose tolerances the precision follows.
        order: order of the derivative.
    """
    steps = trajectory.steps if order == 0 else trajectory.derivatives(order)
    signs = np.array([1.0, -1.0])[:, None, None]
    count, pieces = len(bounds.lower), len(trajectory.durations)
    shape = (count, 2, 3)

    def along_axes(values: FloatArray) -> FloatArray:
        """Return values (N J, 3) along and against each axis, one curve after another."""
        axes = np.moveaxis(values.reshape(count, pieces, 3), 1, 2)
        return (signs * axes[:, None]).reshape(-1, 1)

    higher = None
    if steps.higher is not None:
        powers = np.moveaxis(steps.higher, 1, 0)
        higher = np.stack([along_axes(each) for each in powers], axis=1)
    p, v, a = (along_axes(each) for each in (steps.p, steps.v, steps.a))
    precision = PRECISION * bounds.tolerances[:, None]
    which = np.tile(np.arange(pieces), int(np.prod(shape)))
    error_radii = trajectory.error_radii(which)
    if error_radii is not None and order > 0:
        error_radii = ErrorRadii.constant(trajectory.errors_of(order)[which])
    walls = Steps(p, v, a, higher)
    least = lowest_over_time(walls, shape, lambda x: x[..., 0], precision, error_radii)
    times = trajectory.scenario.grid.start + trajectory.moments(least.steps, least.moments)
    return _Extremes(times, signs[..., 0] * (least.values + least.radii), least.radii)


def _check_box(
    scenario: Scenario, quantity: Quantity, when: str, bounds: Bounds, extremes: _Extremes
) -> Column:
    """Return the check of one box: each vehicle's most violated, or else closest, side."""
    values = extremes.values
    errors = extremes.errors
    lower = np.where(errors[:, 0] > 0.0, bounds.lower + errors[:, 0], bounds.lower)
    upper = np.where(errors[:, 1] > 0.0, bounds.upper - errors[:, 1], bounds.upper)
    excess = np.stack([lower - values[:, 0], values[:, 1] - upper], axis=1)
    side, axis = _worst_side(excess, bounds.tolerances[:, None])
    i = np.arange(len(values))
    # every knot was skipped; of a vehicle at rest, rounding may swap the two values
    no_value = np.isposinf(values[:, 0, 0]) & np.isneginf(values[:, 1, 0])
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
        due=np.isfinite(bounds.lower[:, 0]) & ~no_value,
    )


def _worst_side(excess: FloatArray, tolerances: FloatArray) -> tuple[IntArray, IntArray]:
    """Return side and axis of the largest excess; violated sides precede those that hold.

    Tolerances differ from axis to axis, so violated sides are compared by excess over tolerance.

    Args:
        excess: value beyond the limit, shape (N, 2, 3).
        tolerances: array that broadcasts to `excess`.

    Returns:
        Indices, each of shape (N,).
    """
    excess = np.where(np.isnan(excess), np.inf, excess)
    violated = np.any(excess > tolerances, axis=(1, 2), keepdims=True)
    order = np.where(violated, excess / tolerances, excess).reshape(len(excess), -1)
    side, axis = np.unravel_index(np.argmax(order, axis=1), excess.shape[1:])
    return side, axis
