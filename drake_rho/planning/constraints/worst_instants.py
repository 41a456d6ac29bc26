"""Worst instants of a convex distance along motions, between the knots.

Where a position is quadratic in time with acceleration a, a distance d that is convex and
1-Lipschitz exceeds, within a time w, the greater of its values at both ends by norm(a) w²/8 at
most. Pieces that this bound does not clear are sampled, and the greatest sample is refined by
golden-section search.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray

_SAMPLES = 9
"""Number of samples of a piece among which the greatest value is sought first."""

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_ROUNDS = 24
"""Golden-section steps: they narrow a sampling interval to 1e-5 of it, and the value, which is flat
at its greatest, to 1e-10 of its change."""


def worst_instants(
    states: tuple[FloatArray, FloatArray, FloatArray],
    step: float,
    pieces: FloatArray,
    distance: Callable[[FloatArray, FloatArray], FloatArray],
    margins: FloatArray,
    thresholds: FloatArray,
    vehicles: IntArray,
) -> tuple[IntArray, FloatArray]:
    """Return vehicles and instants at which a distance plus a margin exceeds a threshold most.

    Args:
        states: positions and velocities at the beginnings of steps and accelerations in them, each
            of shape (M, K-1, 3), in SI units.
        step: duration of a step [s].
        pieces: beginnings and ends of pieces of time, each in one step [s], shape (J, 2).
        distance: function of positions (..., 3) and times (...), with values of shape (...).
        margins: margin in each piece, shape (J,).
        thresholds: largest value that is no violation, of each motion, shape (M,).
        vehicles: index of the vehicle of each motion, ascending, shape (M,).

    Returns:
        A vehicle and a time [s] for every piece with a violation, sorted by both; arrays (R,).
    """
    p, v, a = states
    steps = np.minimum(((pieces[:, 0] + pieces[:, 1]) / 2.0 / step).astype(int), p.shape[1] - 1)

    def value(which: IntArray, piece: IntArray, times: FloatArray) -> FloatArray:
        """Return the distances of motions in pieces (P,) at times (P, S), plus margins."""
        k = steps[piece]
        s = (times - (step * k)[:, None])[..., None]
        x = p[which, k, None] + s * (v[which, k, None] + s / 2.0 * a[which, k, None])
        found: FloatArray = np.asarray(distance(x, times)) + margins[piece, None]
        return found

    count = len(pieces)
    which, piece = np.divmod(np.arange(len(p) * count), count)
    ends = value(which, piece, pieces[piece])
    width = (pieces[:, 1] - pieces[:, 0])[piece]
    rise = np.linalg.norm(a[which, steps[piece]], axis=1) * width**2 / 8.0
    unclear = np.max(ends, axis=1) + rise > thresholds[which]
    which, piece = which[unclear], piece[unclear]
    if len(which) == 0:
        return vehicles[:0], np.zeros(0)
    begins, lasts = pieces[piece].T
    times = np.linspace(begins, lasts, _SAMPLES, axis=1)
    best = np.argmax(value(which, piece, times), axis=1)
    rows = np.arange(len(which))
    low, high = times[rows, np.maximum(best - 1, 0)], times[rows, np.minimum(best + 1, 8)]
    at = _golden(lambda each: value(which, piece, each[:, None])[:, 0], low, high)
    candidates = np.stack([times[rows, best], at], axis=1)
    values = value(which, piece, candidates)
    better = np.argmax(values, axis=1)
    violated = values[rows, better] > thresholds[which]
    return vehicles[which[violated]], candidates[rows, better][violated]


def _golden(
    value: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return where values are greatest in intervals, arrays of one shape, by golden sections."""
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = value(left), value(right)
    for _ in range(_ROUNDS):
        rising = at_right > at_left
        low, high = np.where(rising, left, low), np.where(rising, high, right)
        fresh = np.where(rising, low + _GOLDEN * (high - low), high - _GOLDEN * (high - low))
        at_fresh = value(fresh)
        left, at_left, right, at_right = (
            np.where(rising, right, fresh),
            np.where(rising, at_right, at_fresh),
            np.where(rising, fresh, left),
            np.where(rising, at_fresh, at_left),
        )
    return (low + high) / 2.0
