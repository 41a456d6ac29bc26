"""Stretches of successive rows: their neighbours, and the worst rows of their pieces."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


def with_neighbours(marked: BoolArray, runs: IntArray, neighbours: int) -> BoolArray:
    """Return a mask of the marked rows and of their neighbours in the same run, shape (R,).

    Args:
        marked: the mask of the marked rows, shape (R,).
        runs: the increasing number of each row's run, shape (R,).
        neighbours: the number of neighbours before and after each marked row, at least 0.
    """
    if neighbours == 0:
        return marked
    count = len(marked)
    neighbours = min(neighbours, count)
    first, last = np.searchsorted(runs, runs), np.searchsorted(runs, runs, side="right")
    before = np.concatenate([[0], np.cumsum(marked)])
    place = np.arange(count)
    ends = before[np.minimum(place + neighbours + 1, last)]
    found: BoolArray = ends > before[np.maximum(place - neighbours, first)]
    return found


def worst_of_pieces(follows: BoolArray, margins: FloatArray, pieces: int) -> IntArray:
    """Return the index of the worst row in each piece of every stretch of violated rows.

    Args:
        follows: mask of the rows, except the first, that continue the stretch of the row before,
            shape (R-1,).
        margins: the margins of all violated rows, sorted by stretch, shape (R,).
        pieces: the number of pieces of each stretch.
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
