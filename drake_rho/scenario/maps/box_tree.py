"""Tree of axis-aligned boxes: a broad phase that finds the boxes near a position or another box.

Boxes are sorted along a Morton curve, and eight consecutive ones share a node; eight nodes share a
node of the next level. A query descends all levels at once, in arrays.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_FAN = 8
"""Number of children of a node."""

_BITS = 20
"""Bits of each coordinate on the Morton curve."""

_AT_ONCE = 4096
"""Number of queries answered at once, which bounds the memory."""

_PAIRS = 1024
"""Number of pairs of a query and a node up to which all are compared: a descent begins below the
root."""


class BoxTree:
    """Static tree of boxes.

    Args:
        lower: lower corners [m], shape (B, 3), with B of at least 1.
        upper: upper corners [m], shape (B, 3).

    Attributes:
        lower: lower corner of the bounding box of all [m], shape (3,).
        upper: upper corner of the bounding box of all [m], shape (3,).
    """

    def __init__(self, lower: FloatArray, upper: FloatArray) -> None:
        self._boxes = lower, upper
        self._order = _along_curve((lower + upper) / 2.0)
        low, high = lower[self._order], upper[self._order]
        self._levels = [(_siblings(low), _siblings(high))]
        while len(low) > _FAN:
            firsts = np.arange(0, len(low), _FAN)
            low, high = np.minimum.reduceat(low, firsts), np.maximum.reduceat(high, firsts)
            self._levels.append((_siblings(low), _siblings(high)))
        self.lower: FloatArray = low.min(axis=0)
        self.upper: FloatArray = high.max(axis=0)

    def pairs(
        self, lower: FloatArray, upper: FloatArray, within: FloatArray
    ) -> tuple[IntArray, IntArray]:
        """Return the boxes of the tree that are near given boxes.

        Args:
            lower: lower corners of Q boxes, or positions [m], shape (Q, 3).
            upper: upper corners, or the same positions [m], shape (Q, 3).
            within: the largest distance that counts as near [m], shape (Q,).

        Returns:
            Numbers of the given box and of the tree's box of each pair, shape (P,) each, sorted by
            the first.
        """
        found = [
            self._pairs(lower[part], upper[part], within[part], part.start)
            for part in (slice(k, k + _AT_ONCE) for k in range(0, len(lower), _AT_ONCE))
        ]
        if not found:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        queries, boxes = (np.concatenate(each) for each in zip(*found, strict=True))
        return queries, boxes

    def _pairs(
        self, lower: FloatArray, upper: FloatArray, within: FloatArray, first: int
    ) -> tuple[IntArray, IntArray]:
        squares, top = within**2, self._first_level(len(lower))
        parents = np.arange(len(self._levels[top][0]))
        queries = np.repeat(np.arange(len(lower)), len(parents))
        nodes = np.tile(parents, len(lower))
        for low, high in self._levels[top::-1]:
            gaps = low.take(nodes, axis=0) - upper.take(queries, axis=0)[..., None]
            beyond = lower.take(queries, axis=0)[..., None] - high.take(nodes, axis=0)
            np.maximum(np.maximum(gaps, beyond, out=gaps), 0.0, out=gaps)
            near = np.einsum("pik,pik->pk", gaps, gaps) <= squares[queries][:, None]
            parents, children = np.nonzero(near)
            queries, nodes = queries[parents], nodes[parents] * _FAN + children
        return first + queries, self._order[nodes]

    def _first_level(self, queries: int) -> int:
        """Return the level at which some queries begin: the finest with few pairs, or the root."""
        few = (k for k, (low, _) in enumerate(self._levels) if len(low) * queries <= _PAIRS // _FAN)
        return next(few, len(self._levels) - 1)

    def likely_nearest(self, x: FloatArray) -> IntArray:
        """Return the box with the nearest centre for each position (Q, 3), often the nearest."""
        nearest: IntArray = self._centers.query(x)[1]
        return nearest

    @cached_property
    def _centers(self) -> KDTree:
        """Tree of the centres of the boxes."""
        from scipy.spatial import KDTree  # slow to load, so only where needed

        lower, upper = self._boxes
        return KDTree((lower + upper) / 2.0)


def _siblings(corners: FloatArray) -> FloatArray:
    """Return corners (M, 3) by parents, shape (ceil(M / 8), 3, 8), of which the last are filled up.

    They are filled with NaN, which is near nothing. Eight siblings lie together in memory, which
    makes a descent several times as fast as an index for each of them.
    """
    filled = np.full((-(-len(corners) // _FAN) * _FAN, 3), np.nan)
    filled[: len(corners)] = corners
    return np.ascontiguousarray(filled.reshape(-1, _FAN, 3).swapaxes(1, 2))


def _along_curve(x: FloatArray) -> IntArray:
    """Return an order of positions (B, 3) that keeps neighbours together: a Morton curve."""
    lower, size = x.min(axis=0), max(float(np.ptp(x, axis=0).max()), np.finfo(float).tiny)
    cells = np.minimum((x - lower) / size * 2.0**_BITS, 2.0**_BITS - 1.0).astype(np.uint64)
    codes = np.zeros(len(x), dtype=np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            here = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            codes |= here << np.uint64(3 * bit + axis)
    return np.argsort(codes, kind="stable")
