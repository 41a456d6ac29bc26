"""Worst instants of a convex distance along motions, between the knots, by branch and bound.

In an interval of duration w with constant acceleration a, a position deviates from its chord by
norm(a) s (w - s) / 2 at the time s after the beginning. A convex, 1-Lipschitz distance exceeds its
own chord by no more. So the parabola through its values at both ends with this curvature is an
upper bound, and intervals in which the bound exceeds the greatest value found are halved until the
difference is negligible: no maximum between samples is missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray

_PRECISION = 0.05
"""Precision of the greatest value, relative to it or to the threshold, the larger of both."""


def worst_instants(
    states: tuple[FloatArray, FloatArray, FloatArray],
    step: float,
    pieces: FloatArray,
    distance: Callable[[IntArray, FloatArray, FloatArray], FloatArray],
    margins: FloatArray,
    thresholds: FloatArray,
    vehicles: IntArray,
    *,
    exactly: bool = False,
) -> tuple[IntArray, FloatArray]:
    """Return the instants of the largest violations of a threshold by distance plus margin.

    Args:
        states: positions and velocities at the beginnings of steps and accelerations in them, each
            of shape (M, K-1, 3), in SI units.
        step: duration of a step [s].
        pieces: beginnings and ends of pieces of time, each in one step [s], shape (J, 2).
        distance: convex and 1-Lipschitz function of positions (P, S, 3), with values of shape
            (P, S), of P vehicles at times (P, S), between which it moves linearly in each piece.
        margins: margin in each piece, shape (J,).
        thresholds: largest allowed value of each motion, above 0, shape (M,).
        vehicles: index of the vehicle of each motion, ascending, shape (M,).
        exactly: whether the precision is relative to the threshold even of large values.

    Returns:
        A vehicle and a time [s] for every piece with a violation, sorted by both; arrays (R,).
    """
    p, v, a = states
    steps = np.minimum(((pieces[:, 0] + pieces[:, 1]) / 2.0 / step).astype(int), p.shape[1] - 1)
    which, piece = np.divmod(np.arange(len(p) * len(pieces)), len(pieces))

    def value(each: IntArray, times: FloatArray) -> FloatArray:
        """Return distances plus margins of motions in pieces, (P,), at times (P, S)."""
        m, j = which[each], piece[each]
        k = steps[j]
        s = (times - (step * k)[:, None])[..., None]
        x = p[m, k, None] + s * (v[m, k, None] + s / 2.0 * a[m, k, None])
        return distance(vehicles[m], x, times) + margins[j, None]

    each, ends = np.arange(len(piece)), pieces[piece]
    bends, least = np.linalg.norm(a[which, steps[piece]], axis=1), thresholds[which]
    at = value(each, ends)
    later = np.argmax(at, axis=1)
    times, most = ends[each, later], at[each, later]
    for _ in range(30):  # halvings: the last intervals are 1e-9 of a piece of time
        allowed = (1.0 + _PRECISION) * np.maximum(most, least)[each]
        if exactly:
            allowed = (np.maximum(most, least) + _PRECISION * least)[each]
        unclear = _bounds(at, bends[each] * (ends[:, 1] - ends[:, 0]) ** 2 / 8.0) > allowed
        if not unclear.any():
            break
        each, ends, at = each[unclear], ends[unclear], at[unclear]
        middles = ends.mean(axis=1, keepdims=True)
        between = value(each, middles)
        _keep_greatest(most, times, each, between[:, 0], middles[:, 0])
        ends, at = _halves(ends, middles), _halves(at, between)
        each = np.concatenate([each, each])
    violated = most > least
    return vehicles[which[violated]], times[violated]


def _bounds(at: FloatArray, rises: FloatArray) -> FloatArray:
    """Return the greatest values of parabolas through two values.

    Args:
        at: values at both ends, shape (P, 2).
        rises: heights above the chord in the middle, shape (P,).
    """
    apart = np.abs(at[:, 1] - at[:, 0])
    ends: FloatArray = at.max(axis=1)
    inside = apart < 4.0 * rises
    peaks = at.mean(axis=1) + rises + apart**2 / (16.0 * np.where(inside, rises, 1.0))
    return np.where(inside, peaks, ends)


def _halves(ends: FloatArray, middles: FloatArray) -> FloatArray:
    """Return both halves of intervals (P, 2) with middles (P, 1), shape (2 P, 2)."""
    first = np.concatenate([ends[:, :1], middles], axis=1)
    return np.concatenate([first, np.concatenate([middles, ends[:, 1:]], axis=1)])


def _keep_greatest(
    most: FloatArray, times: FloatArray, each: IntArray, values: FloatArray, at: FloatArray
) -> None:
    """Change the greatest values and their times, in place, where one of `each` is greater."""
    order = np.argsort(values, kind="stable")  # the last assignment, the greatest, wins
    order = order[values[order] > most[each[order]]]
    most[each[order]], times[each[order]] = values[order], at[order]
