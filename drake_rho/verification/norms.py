"""Limits on norms, verified at the knots, which covers every instant.

The velocity is linear in a step, so its norm, which is convex, is largest at a knot. Accelerations,
thrust and tilt are constant in a step, and jerks are their changes at the knots. With velocity
errors the largest speed occurs at a sample of the feedback.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.norms import NormLimit
from drake_rho.scenario.parts import UNITS
from drake_rho.verification.between_samples import Maximum, greatest_velocity
from drake_rho.verification.check import PRECISION, Column
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.smooth_extremes import greatest_of_smooth
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_norms(trajectory: PiecewiseTrajectory, jerks: Jerks) -> Iterator[Column]:
    """Yield the check of every limit on a norm that the scenario has.

    Args:
        trajectory: trajectory of all vehicles.
        jerks: jerks of the plan.
    """
    limits, times, errors = trajectory.scenario.fleet.norms, trajectory.times, trajectory.feedback
    thrusts = trajectory.commands + np.array([0.0, 0.0, GRAVITY])
    if "max_speed" in limits:
        yield _check_norm(limits["max_speed"], _greatest_speed(trajectory), UNITS["velocity"])
    unit = UNITS["acceleration"]
    if trajectory.higher is not None:
        yield from _norms_of_smooth(trajectory)
        return
    if "max_acceleration" in limits:
        found = _greatest_norm(times, trajectory.commands, errors)
        yield _check_norm(limits["max_acceleration"], found, unit)
    if "max_jerk" in limits:
        knots = trajectory.scenario.grid.times
        found = _greatest_norm(knots, jerks.limited, np.zeros(len(knots)))
        yield _check_norm(limits["max_jerk"], found, UNITS["jerk"])
    if "max_thrust" in limits:
        yield _check_norm(limits["max_thrust"], _greatest_norm(times, thrusts, errors), unit)
    if "max_tilt" in limits and trajectory.tubes is None:
        yield _check_tilt(limits["max_tilt"], times, thrusts)
    elif "max_tilt" in limits:
        yield _check_inside_cone(limits["max_tilt"], times, thrusts, errors)


def _norms_of_smooth(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Yield the checks of accelerations and jerks of smooth motions, at every instant."""
    for field, limit in trajectory.scenario.fleet.norms.items():
        if limit.kind.quantity == "velocity":
            continue
        precision, vertical = PRECISION * limit.sets.tolerances, np.array([0.0, 0.0, GRAVITY])
        if field == "max_tilt":
            yield _inside_cone_of_smooth(trajectory, limit, precision)
            continue
        offset = vertical if field == "max_thrust" else np.zeros(3)
        order = 3 if limit.kind.quantity == "jerk" else 2
        found = greatest_of_smooth(trajectory, order, partial(_length_beyond, offset), precision)
        yield _check_norm(limit, found, UNITS[limit.kind.quantity])


def _length_beyond(offset: FloatArray, x: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(x + offset, axis=-1))


def _inside_cone_of_smooth(
    trajectory: PiecewiseTrajectory, limit: NormLimit, precision: FloatArray
) -> Column:
    """Return the check of smooth thrusts' least distance inside the tilt cone."""
    upright, found = np.array([0.0, 0.0, GRAVITY]), list[Maximum]()
    for i, angle in enumerate(limit.limits):

        def outside(a: FloatArray, angle: FloatArray = angle) -> FloatArray:
            return -_inside(angle, a + upright)

        found.append(greatest_of_smooth(trajectory.only(i), 2, outside, precision[i : i + 1]))
    times = np.concatenate([each.times for each in found])
    least = -np.concatenate([each.values for each in found])
    return _cone_column(limit, times, least, np.concatenate([each.errors for each in found]))


def _greatest_speed(trajectory: PiecewiseTrajectory) -> Maximum:
    if trajectory.higher is not None:
        precision = PRECISION * trajectory.scenario.fleet.norms["max_speed"].sets.tolerances
        return greatest_of_smooth(trajectory, 1, partial(_length_beyond, np.zeros(3)), precision)
    if trajectory.tubes is None:
        times, velocities = trajectory.all_velocities
        return _greatest_norm(times, velocities, np.zeros(len(times)))
    return greatest_velocity(trajectory, lambda v: np.linalg.norm(v, axis=-1))


def _greatest_norm(times: FloatArray, vectors: FloatArray, errors: FloatArray) -> Maximum:
    """Return the maximum over times (M,) of norms of vectors (N, M, 3) plus error radii (M,)."""
    norms = np.linalg.norm(vectors, axis=2)
    k = np.argmax(norms + errors, axis=1)  # the first NaN, if there is one
    return Maximum(times[k], _pick(norms, k), errors[k])


def _check_norm(limit: NormLimit, found: Maximum, unit: str) -> Column:
    """Return the check of the largest norm of each vehicle."""
    tolerances = limit.sets.tolerances
    most = np.where(found.errors > 0.0, limit.limits - found.errors, limit.limits)
    return _column(limit, found, most, tolerances, unit)


def _check_tilt(limit: NormLimit, times: FloatArray, thrusts: FloatArray) -> Column:
    """Return the check of the largest tilt of each vehicle's thrusts, shape (N, M, 3).

    The tolerance is that of an acceleration. As an angle it grows as the thrust falls; it is π at
    most, since zero thrust has no direction. Where the limit is violated, the check is of the angle
    with the largest excess over tolerance.
    """
    angles = np.arctan2(np.linalg.norm(thrusts[..., :2], axis=2), thrusts[..., 2])
    sizes = np.linalg.norm(thrusts, axis=2)
    least = limit.sets.tolerances[:, None] / np.pi
    tolerances = limit.sets.tolerances[:, None] / np.maximum(sizes, least)  # π at most
    excess = angles - limit.limits[:, None]
    violated = np.any(excess > tolerances, axis=1, keepdims=True)
    k = np.argmax(np.where(violated, excess / tolerances, angles), axis=1)
    found = Maximum(times[k], _pick(angles, k), np.zeros(len(k)))
    return _column(limit, found, limit.limits, _pick(tolerances, k), "rad")


def _check_inside_cone(
    limit: NormLimit, times: FloatArray, thrusts: FloatArray, errors: FloatArray
) -> Column:
    """Return the check of each vehicle's least distance of thrusts (N, M, 3) inside the tilt cone.

    An error ball around a thrust is inside the cone if its centre is inside and further from the
    surface than its radius. So the checked value is the distance from the surface, an acceleration:
    as an angle the same error would grow as the thrust falls.
    """
    inside = _inside(limit.limits[:, None], thrusts)
    k = np.argmin(inside - errors, axis=1)
    return _cone_column(limit, times[k], _pick(inside, k), errors[k])


def _inside(angles: FloatArray, thrusts: FloatArray) -> FloatArray:
    """Return the distance of thrusts (..., 3) inside cones of angles [rad], of shape (...)."""
    angle = np.minimum(angles, np.pi)
    level, up = np.linalg.norm(thrusts[..., :2], axis=-1), thrusts[..., 2]
    inside = up * np.sin(angle) - level * np.cos(angle)
    below = (up < 0.0) & (level * np.sin(angle) + up * np.cos(angle) <= 0.0)
    # below the apex, the apex is nearest
    return np.asarray(np.where(below, -np.linalg.norm(thrusts, axis=-1), inside))


def _cone_column(
    limit: NormLimit, times: FloatArray, found: FloatArray, least: FloatArray
) -> Column:
    """Return the checks of least distances inside the tilt cone, which must exceed the errors."""
    return Column(
        kind=limit.field,
        constraint=limit.kind.name,
        parts=["(thrust from the cone)"] * len(found),
        times=times,
        values=found,
        limits=least,
        excess=least - found,
        tolerances=limit.sets.tolerances,
        errors=least,
        unit=UNITS["acceleration"],
        due=np.isfinite(limit.limits),
    )


def _column(
    limit: NormLimit, found: Maximum, most: FloatArray, tolerances: FloatArray, unit: str
) -> Column:
    return Column(
        kind=limit.field,
        constraint=limit.kind.name,
        parts=[""] * len(found.values),
        times=found.times,
        values=found.values,
        limits=most,
        excess=found.values - most,
        tolerances=tolerances,
        errors=found.errors,
        unit=unit,
        due=np.isfinite(limit.limits),
    )


def _pick(values: FloatArray, k: IntArray) -> FloatArray:
    """Return the k[i]-th value of each row i."""
    picked: FloatArray = np.take_along_axis(values, k[:, None], axis=1)[:, 0]
    return picked
