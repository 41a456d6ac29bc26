"""Stretches of neighbouring rows: their neighbours, and the worst rows of their pieces."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


def near(marked: BoolArray, runs: IntArray, reach: int) -> BoolArray:
    """Return which rows are marked, or up to `reach` from a marked row of the same run, (R,).

    Args:
        marked: shape (R,).
        runs: the number of the run that each belongs to, one run after the other, shape (R,).
        reach: at least 0.
    """
    if reach == 0:
        return marked
    count = len(marked)
    reach = min(reach, count)
    first, last = np.searchsorted(runs, runs), np.searchsorted(runs, runs, side="right")
    before = np.concatenate([[0], np.cumsum(marked)])
    place = np.arange(count)
    above: BoolArray = (
        before[np.minimum(place + reach + 1, last)] > before[np.maximum(place - reach, first)]
    )
    return above


def worst_of_pieces(follows: BoolArray, margins: FloatArray, pieces: int) -> IntArray:
    """Return the index of the worst row in each piece of every stretch of violated rows.

    Args:
        follows: whether each row but the first belongs to the same stretch as that before it.
        margins: of all broken rows, stretch by stretch, shape (R,).
        pieces: into how many each stretch is cut.
    """
    begins = np.ones(len(margins), dtype=bool)
    begins[1:] = ~follows
    stretch = np.cumsum(begins) - 1
    place = np.arange(len(margins)) - begins.nonzero()[0][stretch]
    piece = stretch * pieces + place * pieces // np.maximum(np.bincount(stretch)[stretch], pieces)
    order = np.lexsort((margins, piece))
    piece = piece[order]
    begins[1:] = piece[1:] != piece[:-1]
    worst: IntArray = order[begins]
    return worst
