"""Box constraints (4) to (7), verified at the knots and, for positions, at every instant.

A box is tightened on every side by the error radius: for positions and velocities the radius at the
time, for accelerations the radius of the feedback. The jerk is that of the plan, without errors.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.bounds import Bounds
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import UNITS
from drake_rho.scenario.records import Quantity, Scenario
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, MEASURED, PRECISION, Column
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.highest_over_time import Curves, Highest, Measure
from drake_rho.verification.keep_in import Constrained
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_position_box(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify the position box, if there is one, at the knots and at every instant."""
    box = trajectory.scenario.fleet.bounds("position")
    if box is not None:
        constrained = box_constrained(trajectory, "position", box)
        yield box_column(trajectory.scenario, "position", AT_KNOTS, box, constrained.at_knots())
        yield box_column(trajectory.scenario, "position", AT_ALL_TIMES, box, constrained.greatest())


def check_boxes(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Verify every box that the scenario has."""
    position, scenario = list(check_position_box(trajectory)), trajectory.scenario
    yield from position[:1]
    quantities: tuple[Quantity, ...] = ("velocity", "acceleration", "jerk")
    for quantity in quantities:
        if (box := scenario.fleet.bounds(quantity)) is not None:
            greatest = box_constrained(trajectory, quantity, box).greatest()
            yield box_column(scenario, quantity, AT_KNOTS, box, greatest)
    yield from position[1:]


def box_constrained(
    trajectory: PiecewiseTrajectory, quantity: Quantity, box: Bounds
) -> Constrained:
    """Return a quantity of all vehicles that has to stay in a box."""
    precision = PRECISION * box.tolerances
    return Constrained.by_all(trajectory, quantity, _sides, precision, _greatest_sides)


_SIDES = np.array([-1.0, 1.0])[:, None]
"""Signs of values towards the lower and the upper side of each axis, shape (2, 1)."""


def _sides(who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
    """Return values (R, 3) towards the lower and the upper sides, shape (R, 2, 3)."""
    return _SIDES * x[:, None]


def _greatest_sides(curves: Curves, measure: Measure, precision: FloatArray) -> Highest:
    """Return the greatest values over time towards each side of each vehicle's box.

    A side is flat, so its greatest value is found like the least distance from a wall, for which a
    parabola refines the least sample. It is exact where accelerations are constant.

    Args:
        curves: the curves.
        measure: `_sides`.
        precision: amount by which a greater value may be missed, shape (V, 3).
    """
    which, side, axis = _near_sides(curves, len(precision))
    signs, steps = -_SIDES[side], curves.steps
    p, v, a = (signs * each[which, axis, None] for each in (steps.p, steps.v, steps.a))
    walls = Steps(p, v, a, signs[..., None] * steps.higher[which, :, axis, None])
    owners, errors = curves.owners[which], curves.errors.select(which)
    least = least_over_time(
        walls,
        (6 * owners + 3 * side + axis)[:, None],
        lambda x: x[..., 0],
        precision[owners, axis],
        Least.unknown(np.full(6 * len(precision), np.inf)),
        errors,
    )
    at, radii = np.maximum(least.steps, 0), errors.radii(least.steps, least.moments[:, None])[:, 0]
    found = curves.times(which[at], least.moments), -(least.values + radii), radii
    return Highest(*(each.reshape(-1, 2, 3) for each in found))


def _near_sides(curves: Curves, vehicles: int) -> tuple[IntArray, IntArray, IntArray]:
    """Return curves, sides and axes whose greatest value may be that of the vehicle.

    The others are certainly less than a value at an end of a curve.
    """
    every, ends = np.arange(len(curves.owners)), np.array([[0.0, 1.0]])
    at = _SIDES * curves.steps.at(every, ends)[:, :, None]
    most = (at + curves.errors.radii(every, ends)[..., None, None]).max(axis=1)
    known = most.reshape(vehicles, -1, 2, 3).max(axis=1)
    bend = curves.steps.acceleration_norms + curves.errors.curvatures
    less = most + bend[:, None, None] / 8.0 < known[curves.owners]
    which, side, axis = (~less).nonzero()  # NaN is near too
    return which, side, axis


def box_column(
    scenario: Scenario, quantity: Quantity, when: str, bounds: Bounds, greatest: Highest
) -> Column:
    """Return the check of one box: each vehicle's most violated, or else closest, side."""
    values, errors = _SIDES * greatest.values, greatest.errors
    lower = np.where(errors[:, 0] > 0.0, bounds.lower + errors[:, 0], bounds.lower)
    upper = np.where(errors[:, 1] > 0.0, bounds.upper - errors[:, 1], bounds.upper)
    excess = np.array([lower - values[:, 0], values[:, 1] - upper]).swapaxes(0, 1)
    side, axis = _worst_side(excess, bounds.tolerances[:, None])
    i = np.arange(len(values))
    # every knot was skipped; of a vehicle at rest, rounding may swap the two values
    no_value = (values[:, 0, 0] == np.inf) & (values[:, 1, 0] == -np.inf)
    at = f" {when}" if quantity == "position" or when == MEASURED else ""
    return Column(
        kind=quantity,
        constraint=f"{quantity} box",
        parts=[f"{'xyz'[x]} {('lower', 'upper')[s]}{at}" for s, x in zip(side, axis, strict=True)],
        times=scenario.grid.start + greatest.times[i, side, axis],
        values=values[i, side, axis],
        limits=np.where(side == 0, lower[i, axis], upper[i, axis]),
        errors=errors[i, side, axis],
        excess=excess[i, side, axis],
        tolerances=bounds.tolerances[i, axis],
        unit=UNITS[quantity],
        asked=when != AT_ALL_TIMES or scenario.between_knots,
        concerned=np.isfinite(bounds.lower[:, 0]) & ~no_value,
    )


def _worst_side(excess: FloatArray, tolerances: FloatArray) -> tuple[IntArray, IntArray]:
    """Return side and axis of the largest excess; violated sides come first.

    Tolerances differ from axis to axis, so violated sides are compared by excess over tolerance.

    Args:
        excess: value beyond the limit, shape (N, 2, 3).
        tolerances: array that broadcasts to `excess`.

    Returns:
        Indices, each of shape (N,).
    """
    excess = np.where(np.isnan(excess), np.inf, excess)
    violated = (excess > tolerances).any(axis=(1, 2), keepdims=True)
    order = np.where(violated, excess / tolerances, excess).reshape(len(excess), -1)
    return np.divmod(order.argmax(axis=1), excess.shape[2])
