"""Greatest value over time of a convex distance plus an error radius, by branch and bound.

Within a time w, a position with the acceleration a deviates from the chord between its ends by
norm(a) w²/8 at most. A convex, 1-Lipschitz distance d is at most the greater of its values at the
ends of the chord, and the error radius exceeds its own chord by κ w²/8 at most
(`drake_rho.verification.tubes`). So between two instants, d plus the radius is at most the greater
of its two end values plus (norm(a) + κ) w²/8. Intervals in which this bound exceeds the greatest
value found are halved until the difference is negligible.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.steps import powers_of

_LEVELS = 30
"""Largest number of successive halvings: an interval is then 1e-9 of a piece of time."""


@dataclasses.dataclass(eq=False)
class Highest:
    """Greatest distance plus error radius of each motion, and its time; (M,) each."""

    times: FloatArray
    """times since the first knot [s]"""
    values: FloatArray
    """signed distances, in the quantity's unit"""
    errors: FloatArray
    """error radii, in the quantity's unit"""

    def offer(
        self, motions: IntArray, times: FloatArray, values: FloatArray, errors: FloatArray
    ) -> None:
        """Keep the greatest value of each motion, NaN above all; arrays (S, P)."""
        totals = np.where(np.isnan(values), np.inf, values + errors)
        best, every = np.argmax(totals, axis=0), np.arange(len(motions))
        top = totals[best, every]
        order = np.argsort(top, kind="stable")  # the greatest of a motion is last, stays
        order = order[top[order] > self.values[motions[order]] + self.errors[motions[order]]]
        who, at = motions[order], (best[order], order)
        self.times[who], self.values[who], self.errors[who] = times[at], values[at], errors[at]


def highest_over_time(
    states: tuple[FloatArray, FloatArray, FloatArray],
    instants: FloatArray,
    pieces: IntArray,
    distance: Callable[[FloatArray, FloatArray], FloatArray],
    radius: Callable[[IntArray, FloatArray], FloatArray],
    curvatures: FloatArray,
    precision: FloatArray,
    known: Highest,
    higher: tuple[FloatArray, FloatArray] | None = None,
) -> Highest:
    """Return when each motion's distance plus error radius is greatest.

    Args:
        states: positions and velocities at the instants and accelerations between them, shapes
            (M, J + 1, 3), (M, J + 1, 3) and (M, J, 3).
        instants: ends of the pieces of time, since the first knot [s], shape (J + 1,).
        pieces: indices of the pieces to search.
        distance: function of positions (..., 3) and times (...), with values of shape (...).
        radius: function of pieces (P,) and times (S, P) that returns error radii, (S, P).
        curvatures: κ in each piece [m/s²], shape (J,).
        precision: amount by which a greater value may be missed, shape (M,).
        known: values at the ends of the pieces. Changed in place into the answer.
        higher: coefficients of the time from the third power up, (M, J, n, 3), and upper bounds of
            the accelerations' norms, (M, J), of smooth motions.
    """
    p, v, a = states
    count = len(p)
    rows, piece = np.repeat(np.arange(count), len(pieces)), np.tile(pieces, count)
    bend = (np.linalg.norm(a, axis=2) if higher is None else higher[1]) + curvatures
    low, width = np.zeros(len(piece)), 1.0
    for _ in range(_LEVELS):
        if len(piece) == 0:
            break
        h = np.diff(instants)[piece]
        s = h * np.stack([low, low + width / 2.0, low + width])
        times = instants[piece] + s
        turn = s[..., None] / 2.0 * a[rows, piece]
        x = p[rows, piece] + s[..., None] * (v[rows, piece] + turn)
        if higher is not None:
            x += powers_of(s[..., None, None], higher[0][rows, piece]).sum(axis=-2)
        values, errors = distance(x, times), radius(piece, times)
        known.offer(rows, times, values, errors)
        width /= 2.0
        at, rise = values + errors, bend[rows, piece] * (h * width) ** 2 / 8.0
        least = known.values[rows] + known.errors[rows] + precision[rows]
        first, second = (np.maximum(at[i], at[i + 1]) + rise > least for i in range(2))
        low = np.concatenate([low[first], low[second] + width])
        rows, piece = (np.concatenate([each[first], each[second]]) for each in (rows, piece))
    return known
