"""Exact maximum over time of a convex measure of the velocity plus the velocity's error radius.

The velocity is linear within a step, and its error radius is convex within a feedback sample. So a
convex measure of the velocity plus that radius is largest at an end of a feedback sample. A step is
skipped if the largest measure at its ends plus the largest radius in it cannot be the maximum.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.trajectory import PiecewiseTrajectory

_AT_ONCE = 1 << 20
"""Largest number of array entries computed at once, which bounds the memory."""


@dataclasses.dataclass(frozen=True, eq=False)
class Maximum:
    """Maximum of a measure plus its error radius, and when it occurs; arrays of shape (N, ...)."""

    times: FloatArray
    """times on the scenario's clock [s]"""
    values: FloatArray
    """measure at that time, without the error radius, in the unit of the measured quantity"""
    errors: FloatArray
    """error radius at that time, in the same unit"""


def greatest_velocity(
    trajectory: PiecewiseTrajectory, measure: Callable[[FloatArray], FloatArray]
) -> Maximum:
    """Return when a measure of each vehicle's velocity plus the error radius is greatest.

    Args:
        trajectory: a trajectory with error tubes, whose pieces are the steps of the grid.
        measure: convex function of velocities (..., 3) with values of shape (..., *D): one or more
            for each velocity.
    """
    assert trajectory.tubes is not None  # noqa: S101  # callers check this
    times = trajectory.times
    at, radii = measure(trajectory.velocities), trajectory.tubes.at("velocity", times)
    found, ends = _greatest(times, at, radii), at[:, 1:]
    if len(k := trajectory.last_before_jumps) > 0:
        ends = measure(trajectory.ends[1])
        radii = trajectory.tubes.before("velocity", times[k + 1])
        found = _greater(found, _greatest(times[k + 1], ends[:, k], radii))
    over = trajectory.tubes.over("velocity", times[:-1], times[1:])
    rest = (1,) * (at.ndim - 2)
    most = np.maximum(at[:, :-1], ends) + over.reshape(-1, *rest)
    higher = ~(most <= (found.values + found.errors)[:, None])  # true for NaN as well
    steps = np.flatnonzero(higher.any(axis=(0, *range(2, at.ndim))))
    inner = np.arange(1, _samples_per_step(trajectory)) / _samples_per_step(trajectory)
    if len(inner) == 0:
        return found
    count = max(1, _AT_ONCE // (at[:, 0].size * len(inner)))
    for block in (steps[first : first + count] for first in range(0, len(steps), count)):
        found = _greater(found, _at_samples(trajectory, measure, block, inner))
    return found


def _samples_per_step(trajectory: PiecewiseTrajectory) -> int:
    disturbance = trajectory.scenario.disturbance
    return 1 if disturbance is None else disturbance.samples_per_step(trajectory.scenario.grid.step)


def _at_samples(
    trajectory: PiecewiseTrajectory,
    measure: Callable[[FloatArray], FloatArray],
    steps: IntArray,
    inner: FloatArray,
) -> Maximum:
    """Return the maximum over the samples inside steps (S,), at fractions (I,) of each step."""
    assert trajectory.tubes is not None  # noqa: S101  # callers check this
    spent = trajectory.durations[steps, None] * inner
    times = trajectory.times[steps][:, None] + spent
    v, a = trajectory.velocities[:, steps, None], trajectory.accelerations[:, steps, None]
    at = measure(v + spent[..., None] * a)
    at = at.reshape(len(v), -1, *at.shape[3:])
    return _greatest(times.reshape(-1), at, trajectory.tubes.at("velocity", times.reshape(-1)))


def _greatest(times: FloatArray, at: FloatArray, radii: FloatArray) -> Maximum:
    """Return the maximum over times (M,) of measures (N, M, ...) plus error radii (M,)."""
    k = np.argmax(at + radii.reshape(-1, *(1,) * (at.ndim - 2)), axis=1)
    return Maximum(times[k], np.take_along_axis(at, k[:, None], axis=1)[:, 0], radii[k])


def _greater(one: Maximum, other: Maximum) -> Maximum:
    """Return the elementwise greater of two maxima."""
    higher = other.values + other.errors > one.values + one.errors
    pairs = zip(dataclasses.astuple(one), dataclasses.astuple(other), strict=True)
    return Maximum(*(np.where(higher, b, a) for a, b in pairs))
