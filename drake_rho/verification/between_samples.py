"""Where a velocity and the error around it are largest together, at any time.

The velocity is linear in a step and its radius of errors convex in a sample of the feedback, so a
convex measure of the velocity plus the radius is largest at the end of a sample. Steps in which it
cannot be, by the largest measure at their ends and the largest radius in them, are left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.course import Course

_AT_ONCE = 1 << 20
"""Numbers in an array at once, so that what it takes of memory is bounded."""


@dataclasses.dataclass(frozen=True, eq=False)
class Greatest:
    """When measures are greatest, arrays of shape (N, ...)."""

    times: FloatArray
    """on the scenario's clock [s]"""
    values: FloatArray
    """measures then, in m/s"""
    errors: FloatArray
    """radii then [m/s]"""


def greatest_velocity(course: Course, measure: Callable[[FloatArray], FloatArray]) -> Greatest:
    """The velocities of all vehicles at which a measure and the errors' radius are greatest.

    Args:
        course: with tubes, on steps.
        measure: convex, of velocities (..., 3), with one or more values of each, shape (..., *D).
    """
    assert course.tubes is not None  # noqa: S101  # asked only then
    times = course.times
    at, radii = measure(course.velocities), course.tubes.at("velocity", times)
    found = _greatest(times, at, radii)
    over = course.tubes.over("velocity", times[:-1], times[1:])
    rest = (1,) * (at.ndim - 2)
    most = np.maximum(at[:, :-1], at[:, 1:]) + over.reshape(-1, *rest)
    higher = ~(most <= (found.values + found.errors)[:, None])  # what is no number too
    steps = np.flatnonzero(higher.any(axis=(0, *range(2, at.ndim))))
    inner = np.arange(1, _samples_per_step(course)) / _samples_per_step(course)
    if len(inner) == 0:
        return found
    count = max(1, _AT_ONCE // (at[:, 0].size * len(inner)))
    for some in (steps[first : first + count] for first in range(0, len(steps), count)):
        found = _later(found, _at_samples(course, measure, some, inner))
    return found


def _samples_per_step(course: Course) -> int:
    around = course.scenario.disturbance
    return 1 if around is None else around.samples_per_step(course.scenario.grid.step)


def _at_samples(
    course: Course,
    measure: Callable[[FloatArray], FloatArray],
    steps: IntArray,
    inner: FloatArray,
) -> Greatest:
    """The greatest at samples inside steps (S,), which are at parts (I,) of every step."""
    assert course.tubes is not None  # noqa: S101  # as above
    spent = course.durations[steps, None] * inner
    times = course.times[steps][:, None] + spent
    v, a = course.velocities[:, steps, None], course.accelerations[:, steps, None]
    at = measure(v + spent[..., None] * a)
    at = at.reshape(len(v), -1, *at.shape[3:])
    return _greatest(times.reshape(-1), at, course.tubes.at("velocity", times.reshape(-1)))


def _greatest(times: FloatArray, at: FloatArray, radii: FloatArray) -> Greatest:
    """Of measures at times (M,), shape (N, M, ...), with radii (M,)."""
    k = np.argmax(at + radii.reshape(-1, *(1,) * (at.ndim - 2)), axis=1)
    return Greatest(times[k], np.take_along_axis(at, k[:, None], axis=1)[:, 0], radii[k])


def _later(one: Greatest, other: Greatest) -> Greatest:
    """The greater of two, each by itself."""
    higher = other.values + other.errors > one.values + one.errors
    pairs = zip(dataclasses.astuple(one), dataclasses.astuple(other), strict=True)
    return Greatest(*(np.where(higher, b, a) for a, b in pairs))
