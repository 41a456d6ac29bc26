"""Exact distances and extremes in continuous time, without sampling.

In every step a motion is quadratic in time, so its squared distance from a point is a quartic and
the derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which
are those of a quadratic: in each of these at most three pieces of a step its root, if there is
one, is found to the last digit by Newton's steps, and by bisection where these lead outside.
Everything is vectorised over leading axes.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray, IntArray

_STEPS = 60
"""Bound on the steps to a root; bisections alone would be past the last digit of a double."""

_LAST_DIGIT = 1e-15
"""Relative change of a root below which it is found."""


@dataclasses.dataclass(frozen=True)
class Approach:
    """The closest approach in each step of a motion."""

    times: FloatArray
    """when, since the first knot [s], shape (..., K-1)"""
    distances: FloatArray
    """how close [m], shape (..., K-1)"""

    def nearest(self) -> tuple[FloatArray, FloatArray]:
        """Time [s] and distance [m] of the closest approach of the whole motion, shape (...)."""
        k = np.argmin(self.distances, axis=-1)[..., None]
        return (
            np.take_along_axis(self.times, k, axis=-1)[..., 0],
            np.take_along_axis(self.distances, k, axis=-1)[..., 0],
        )


@dataclasses.dataclass(frozen=True)
class Dips:
    """Closest approaches that are too close, one for each step that has one."""

    vehicles: IntArray
    """whose, as indices into the motions, shape (D,)"""
    times: FloatArray
    """when, since the first knot [s], shape (D,)"""
    distances: FloatArray
    """how close [m], shape (D,)"""


def closest_approach(motion: Motion, center: FloatArray) -> Approach:
    """The exact least distance of a motion from a point, in every step.

    Args:
        motion: of one vehicle or several.
        center: the point [m], shape (3,), or any shape that broadcasts against (..., K-1, 3).

    Returns:
        Times and distances, shape (..., K-1).
    """
    h = motion.step
    p, v, a = _steps_from(motion, center)
    s = nearest_moments(p, v, a, h)
    at = p + s[..., None] * (v + s[..., None] / 2 * a)
    times = h * np.arange(a.shape[-2]) + s
    return Approach(times, np.linalg.norm(at, axis=-1))


def dips(motion: Motion, center: FloatArray, radius: float) -> Dips:
    """The steps of several motions that come closer to a point than `radius`, and where.

    Only steps that begin close enough to get there are looked at.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        center: the point [m], shape (3,).
        radius: distance [m].
    """
    h = motion.step
    p, v, a = _steps_from(motion, center)
    reach = np.linalg.norm(p, axis=-1)
    reach -= h * (np.linalg.norm(v, axis=-1) + h / 2 * np.linalg.norm(a, axis=-1))
    vehicles, steps = np.nonzero(reach < radius)
    if len(steps) == 0:
        return Dips(vehicles, np.zeros(0), np.zeros(0))
    p, v, a = p[vehicles, steps], v[vehicles, steps], a[vehicles, steps]
    s = nearest_moments(p, v, a, h)[:, None]
    distances = np.linalg.norm(p + s * (v + s / 2 * a), axis=-1)
    close = distances < radius
    return Dips(vehicles[close], (h * steps + s[:, 0])[close], distances[close])


def _steps_from(motion: Motion, center: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position from `center`, velocity and acceleration at the beginning of each step."""
    return (
        motion.positions[..., :-1, :] - center,
        motion.velocities[..., :-1, :],
        motion.accelerations,
    )


def nearest_moments(p: FloatArray, v: FloatArray, a: FloatArray, h: float) -> FloatArray:
    """When in [0, h] the length of p + s v + s²/2 a is least; vectors of shape (..., 3)."""

    def dot(one: FloatArray, other: FloatArray) -> FloatArray:
        product: FloatArray = np.einsum("...i,...i->...", one, other)
        return product

    def distance(s: FloatArray) -> FloatArray:
        length: FloatArray = np.linalg.norm(p + s[..., None] * (v + s[..., None] / 2 * a), axis=-1)
        return length

    # half the derivative of the squared length: c0 + c1 s + c2 s² + c3 s³
    coefficients = dot(p, v), dot(v, v) + dot(p, a), 1.5 * dot(v, a), 0.5 * dot(a, a)
    first, second = _quadratic_roots(coefficients[1], 2 * coefficients[2], 3 * coefficients[3], h)
    zero = np.zeros_like(first)
    bounds = [zero, first, second, zero + h]
    moments = [zero, zero + h]
    moments += [_rising_root(coefficients, low, high) for low, high in pairwise(bounds)]
    candidates = np.stack(moments)
    lengths = np.stack([distance(s) for s in moments])
    best = np.argmin(lengths, axis=0)[None]
    nearest: FloatArray = np.take_along_axis(candidates, best, axis=0)[0]
    return nearest


def _quadratic_roots(
    c0: FloatArray, c1: FloatArray, c2: FloatArray, h: float
) -> tuple[FloatArray, FloatArray]:
    """Real roots of c0 + c1 s + c2 s², clipped to [0, h] and in order; 0 where there are none."""
    discriminant = c1 * c1 - 4 * c2 * c0
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (c1 + np.where(c1 < 0, -root, root))  # without cancellation
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = q / c2, c0 / q
    real = discriminant > 0
    one = np.where(real & np.isfinite(one), one, 0.0)
    other = np.where(real & np.isfinite(other), other, 0.0)
    low, high = np.minimum(one, other), np.maximum(one, other)
    return np.clip(low, 0.0, h), np.clip(high, 0.0, h)


def _rising_root(
    coefficients: tuple[FloatArray, ...], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Where the cubic goes from below to above zero between `low` and `high`, else `low`."""
    c0, c1, c2, c3 = coefficients
    rises = (c0 + low * (c1 + low * (c2 + low * c3)) < 0) & (
        c0 + high * (c1 + high * (c2 + high * c3)) > 0
    )
    if not np.any(rises):
        return low
    roots = np.array(low)
    c0, c1, c2, c3, low, high = (each[rises] for each in (c0, c1, c2, c3, low, high))
    s = (low + high) / 2
    for _ in range(_STEPS):
        value = c0 + s * (c1 + s * (c2 + s * c3))
        low, high = np.where(value < 0, s, low), np.where(value < 0, high, s)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - value / (c1 + s * (2 * c2 + s * 3 * c3))
        inside = (newton > low) & (newton < high)  # never with a NaN
        following = np.where(inside, newton, (low + high) / 2)
        moved = np.abs(following - s) > _LAST_DIGIT * high
        s = following
        if not np.any(moved):
            break
    roots[rises] = s
    return roots


def turning_points(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Where each coordinate turns round inside a step: its extremes between the knots.

    Args:
        motion: of one vehicle or several.

    Returns:
        Times [s] and positions [m], shape (..., K-1, 3), one for each axis; where an axis does
        not turn inside a step, the beginning of the step stands for it.
    """
    h, v, a = motion.step, motion.velocities[..., :-1, :], motion.accelerations
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -v / a
    s = np.where(np.isfinite(s) & (s > 0) & (s < h), s, 0.0)
    times = h * np.arange(a.shape[-2])[:, None] + s
    return times, motion.positions[..., :-1, :] + s * (v + s / 2 * a)
