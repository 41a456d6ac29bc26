"""Exact extremes of a motion in every step, in closed form.

In every step a relative motion is quadratic in time, so its squared length is a quartic and the
derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which is
quadratic. In each of these at most three intervals of a step, Newton's iteration, safeguarded by
bisection, finds the root, if there is one, to the last digit. Everything is vectorised.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray

_STEPS = 60
"""Bound on the iterations of root finding; bisection alone reaches the last digit of a double."""


_LAST_DIGIT = 1e-15
"""Relative change of a root at which the iteration has converged."""


def lengths_of(vectors: FloatArray) -> FloatArray:
    """Return the norms of vectors (..., 3), three times as fast as `np.linalg.norm`."""
    lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return lengths


def nearest_moments(
    p: FloatArray, v: FloatArray, a: FloatArray, h: float | FloatArray
) -> FloatArray:
    """Return the s in [0, h] at which the length of p + s v + s²/2 a is least, shape (...).

    Args:
        p: relative positions [m], shape (..., 3).
        v: relative velocities [m/s], shape (..., 3).
        a: relative accelerations [m/s²], shape (..., 3).
        h: durations [s], shape (...), or one for all.
    """

    def dot(one: FloatArray, other: FloatArray) -> FloatArray:
        product: FloatArray = np.einsum("...i,...i->...", one, other)
        return product

    def distance(s: FloatArray) -> FloatArray:
        return lengths_of(p + s[..., None] * (v + s[..., None] / 2 * a))

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
    c0: FloatArray, c1: FloatArray, c2: FloatArray, h: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the real roots of c0 + c1 s + c2 s², sorted and clipped to [0, h]; 0 without any."""
    discriminant = c1 * c1 - 4 * c2 * c0
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (c1 + np.where(c1 < 0, -root, root))  # this form avoids cancellation
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
    """Return the point between `low` and `high` where a cubic rises through zero, or `low`."""
    c0, c1, c2, c3 = coefficients
    rises = (c0 + low * (c1 + low * (c2 + low * c3)) < 0) & (
        c0 + high * (c1 + high * (c2 + high * c3)) > 0
    )
    if not np.any(rises):
        return low
    roots, here = np.array(low), np.nonzero(rises)
    work = np.stack([each[here] for each in (*coefficients, low, high)])
    s = (work[4] + work[5]) / 2
    for _ in range(_STEPS):
        c0, c1, c2, c3, low, high = work
        value = c0 + s * (c1 + s * (c2 + s * c3))
        np.copyto(low, s, where=value < 0)
        np.copyto(high, s, where=value >= 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - value / (c1 + s * (2 * c2 + s * 3 * c3))
        inside = (newton >= low) & (newton <= high)  # false for NaN; at an end once converged
        following = np.where(inside, newton, (low + high) / 2)
        moved = np.abs(following - s) > _LAST_DIGIT * high
        roots[here] = s = following
        going = np.count_nonzero(moved)
        if going == 0:
            break
        if 2 * going < len(s):  # a few roots that are nearly double take all rounds
            here = tuple(each[moved] for each in here)
            work, s = work[:, moved], s[moved]
    return roots


def turning_points(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return the extremes of each coordinate between the knots.

    Args:
        motion: of one vehicle or several.

    Returns:
        Times since the first knot [s] and positions [m], shape (..., K-1, 3), one per step and
        axis; those of the beginning of the step where a coordinate has no extreme inside.
    """
    h, v, a = motion.step, motion.velocities[..., :-1, :], motion.accelerations
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -v / a
    s = np.where(np.isfinite(s) & (s > 0) & (s < h), s, 0.0)
    times = h * np.arange(a.shape[-2])[:, None] + s
    return times, motion.positions[..., :-1, :] + s * (v + s / 2 * a)
