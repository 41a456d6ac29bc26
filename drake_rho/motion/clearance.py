"""Exact distances and extremes in continuous time, without sampling.

In every step a motion is quadratic in time, so its squared distance from a point is a quartic and
the derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which
are those of a quadratic: in each of these at most three pieces of a step its root, if there is
one, is found by bisection to the last digit. Everything is vectorised over leading axes.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray

_HALVINGS = 60
"""Bisections of a piece: past the last digit of a double."""


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


def closest_approach(motion: Motion, center: FloatArray) -> Approach:
    """The exact least distance of a motion from a point, in every step.

    Args:
        motion: of one vehicle or several.
        center: the point [m], shape (3,), or any shape that broadcasts against (..., K-1, 3).

    Returns:
        Times and distances, shape (..., K-1).
    """
    h = motion.step
    p, v, a = (
        motion.positions[..., :-1, :] - center,
        motion.velocities[..., :-1, :],
        motion.accelerations,
    )
    s = _nearest_moments(p, v, a, h)
    at = p + s[..., None] * (v + s[..., None] / 2 * a)
    times = h * np.arange(a.shape[-2]) + s
    return Approach(times, np.linalg.norm(at, axis=-1))


def _nearest_moments(p: FloatArray, v: FloatArray, a: FloatArray, h: float) -> FloatArray:
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

    def slope(s: FloatArray) -> FloatArray:
        return c0 + s * (c1 + s * (c2 + s * c3))

    rises = (slope(low) < 0) & (slope(high) > 0)
    if not np.any(rises):
        return low
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        below = slope(middle) < 0
        low = np.where(rises & below, middle, low)
        high = np.where(rises & ~below, middle, high)
    return low


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
