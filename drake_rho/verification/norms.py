"""Limits on norms, verified at the knots, which covers every instant.

The velocity is linear in a step, so its norm, which is convex, is largest at a knot. Accelerations,
thrust and tilt are constant in a step, and jerks are their changes at the knots. With velocity
errors the largest speed occurs at a sample of the feedback.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import Length, NormLimit
from drake_rho.scenario.parts import UNITS
from drake_rho.verification.check import PRECISION, Column
from drake_rho.verification.highest_over_time import Highest
from drake_rho.verification.keep_in import Constrained
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_norms(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Yield the check of every limit on a norm that the scenario has."""
    for limit in trajectory.scenario.fleet.norms.values():
        if isinstance(limit.kind, Length):
            yield _check_length(trajectory, limit)
        elif trajectory.is_smooth or trajectory.has_errors:
            yield _check_inside_cone(trajectory, limit)
        else:
            yield _check_tilt(limit, trajectory.times[:-1], trajectory.commands)


def length_constrained(trajectory: PiecewiseTrajectory, limit: NormLimit) -> Constrained:
    """Return a quantity of all vehicles whose norm is limited."""

    def length(who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
        return limit.kind.measured(x)

    precision, quantity = PRECISION * limit.sets.tolerances, limit.kind.quantity
    return Constrained.by_all(trajectory, quantity, length, precision)


def _check_length(trajectory: PiecewiseTrajectory, limit: NormLimit) -> Column:
    """Return the check of the largest norm of each vehicle."""
    found = length_constrained(trajectory, limit).greatest()
    times, values = trajectory.scenario.grid.start + found.times, found.values
    values = np.where(np.isneginf(values), 0.0, values)  # every jerk is unknown
    most = np.where(found.errors > 0.0, limit.limits - found.errors, limit.limits)
    return norm_column(limit, Highest(times, values, found.errors), most, limit.sets.tolerances)


def _check_tilt(limit: NormLimit, times: FloatArray, commands: FloatArray) -> Column:
    """Return the check of the largest tilt of each vehicle at its commands, shape (N, M, 3).

    The tolerance is that of an acceleration. As an angle it grows as the thrust falls; it is π at
    most, since zero thrust has no direction. Where the limit is violated, the check is of the angle
    with the largest excess over tolerance.
    """
    angles = limit.kind.measured(commands)
    thrusts = commands - limit.kind.origin
    sizes = np.hypot(np.hypot(thrusts[..., 0], thrusts[..., 1]), thrusts[..., 2])
    least = limit.sets.tolerances[:, None] / np.pi
    tolerances = limit.sets.tolerances[:, None] / np.maximum(sizes, least)  # π at most
    tolerances = np.maximum(tolerances, np.finfo(float).tiny)  # 0 for an infinite thrust
    excess = angles - limit.limits[:, None]
    violated = np.any(excess > tolerances, axis=1, keepdims=True)
    k = np.argmax(np.where(violated, excess / tolerances, angles), axis=1)
    found = Highest(times[k], _pick(angles, k), np.zeros(len(k)))
    return norm_column(limit, found, limit.limits, _pick(tolerances, k))


def _check_inside_cone(trajectory: PiecewiseTrajectory, limit: NormLimit) -> Column:
    """Return the check of each vehicle's least distance of thrusts inside the tilt cone.

    An error ball around a thrust is inside the cone if its centre is inside and further from the
    surface than its radius. So the checked value is the distance from the surface, an acceleration:
    as an angle the same error would grow as the thrust falls.
    """

    def outside(who: IntArray, x: FloatArray, times: FloatArray) -> FloatArray:
        return limit.sets.signed_distance(who, x)

    precision = PRECISION * limit.sets.tolerances
    found = Constrained.by_all(trajectory, "acceleration", outside, precision).greatest()
    return Column(
        kind=limit.field,
        constraint=limit.kind.name,
        parts=["(thrust from the cone)"] * len(found.values),
        times=trajectory.scenario.grid.start + found.times,
        values=-found.values,
        limits=found.errors,
        excess=found.errors + found.values,
        tolerances=limit.sets.tolerances,
        errors=found.errors,
        unit=UNITS["acceleration"],
        concerned=np.isfinite(limit.limits),
    )


def norm_column(
    limit: NormLimit, found: Highest, most: FloatArray, tolerances: FloatArray, part: str = ""
) -> Column:
    """Return the check of each vehicle's largest norm, at times on the scenario's clock."""
    return Column(
        kind=limit.field,
        constraint=limit.kind.name,
        parts=[part] * len(found.values),
        times=found.times,
        values=found.values,
        limits=most,
        excess=found.values - most,
        tolerances=tolerances,
        errors=found.errors,
        unit=limit.kind.unit,
        concerned=np.isfinite(limit.limits),
    )


def _pick(values: FloatArray, k: IntArray) -> FloatArray:
    """Return the k[i]-th value of each row i."""
    picked: FloatArray = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
    return picked
