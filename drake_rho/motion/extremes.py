"""Exact extremes of a motion in every step, in closed form.

In every step a relative motion is quadratic in time, so its squared length is a quartic and the
derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which is
quadratic. In each of these at most three intervals of a step, Newton's iteration, safeguarded by
bisection, finds the root, if there is one, to the last digit. Everything is vectorised.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray

_STEPS = 60
"""Bound on the iterations of root finding; bisection alone reaches the last digit of a double."""


_LAST_DIGIT = 1e-15
"""Relative change of a root at which the iteration has converged."""


_FEW = 1000
"""Number of coordinates below which a product takes a third of the time by `vecdot`; beyond some
thousands, `einsum` takes less."""


def lengths_of(vectors: FloatArray) -> FloatArray:
    """Return the norms of vectors (..., 3), three times as fast as `np.linalg.norm`."""
    lengths: FloatArray = np.sqrt(dots(vectors, vectors))
    return lengths


def dots(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the scalar products of vectors (..., 3)."""
    if one.size < _FEW:
        return np.asarray(np.vecdot(one, other))
    products: FloatArray = np.einsum("...i,...i->...", one, other)
    return products


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
    # half the derivative of the squared length: c0 + c1 s + c2 s² + c3 s³
    c0, c1 = dots(p, v), dots(v, v) + dots(p, a)
    c2, c3 = 1.5 * dots(v, a), 0.5 * dots(a, a)
    bounds = np.zeros((4, *c0.shape))
    bounds[3] = h
    with np.errstate(divide="ignore", invalid="ignore"):
        bounds[1], bounds[2] = _quadratic_roots(c1, 2 * c2, 3 * c3, h)
        roots = _rising_roots((c0, c1, c2, c3), bounds[:-1], bounds[1:])
    moments = np.concatenate([bounds[::3], roots])
    s = moments[..., None]
    best = np.argmin(lengths_of(p + s * (v + s / 2 * a)), axis=0)[None]
    nearest: FloatArray = np.take_along_axis(moments, best, axis=0)[0]
    return nearest


def _quadratic_roots(
    c0: FloatArray, c1: FloatArray, c2: FloatArray, h: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the real roots of c0 + c1 s + c2 s², sorted and clipped to [0, h]; 0 without any."""
    discriminant = c1 * c1 - 4 * c2 * c0
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (c1 + np.where(c1 < 0, -root, root))  # this form avoids cancellation
    one, other = q / c2, c0 / q
    real = discriminant > 0
    one = np.where(real & np.isfinite(one), one, 0.0)
    other = np.where(real & np.isfinite(other), other, 0.0)
    low, high = np.minimum(one, other), np.maximum(one, other)
    return np.clip(low, 0.0, h), np.clip(high, 0.0, h)


def _rising_roots(
    coefficients: tuple[FloatArray, ...], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the points where cubics rise through zero between ends, or the lower end.

    Args:
        coefficients: c0 to c3 of the cubics, shape (M,) each.
        low: lower ends of intervals in which they are monotone, shape (J, M).
        high: upper ends, shape (J, M).
    """
    c0, c1, c2, c3 = coefficients
    rises = (c0 + low * (c1 + low * (c2 + low * c3)) < 0) & (
        c0 + high * (c1 + high * (c2 + high * c3)) > 0
    )
    roots, here = np.array(low), rises.nonzero()
    if len(here[0]) == 0:
        return roots
    own = here[1:]
    work = np.stack([c0[own], c1[own], c2[own], c3[own], low[here], high[here]])
    s = (work[4] + work[5]) / 2
    for _ in range(_STEPS):
        c0, c1, c2, c3, low, high = work
        value = c0 + s * (c1 + s * (c2 + s * c3))
        np.copyto(low, s, where=value < 0)
        np.copyto(high, s, where=value >= 0)
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
