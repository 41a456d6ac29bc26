"""Simple polygons in the plane: whether they cross themselves, and triangles that make them up."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


def turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return twice the area of triangles (..., 2), positive if they are counterclockwise."""
    one, other = b - a, c - a
    twice: FloatArray = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return twice


def crosses_itself(corners: FloatArray) -> bool:
    """Return whether two edges that are not neighbours touch, or neighbours fold back."""
    ends = np.roll(corners, -1, axis=0)
    a, b, c, d = corners[:, None], ends[:, None], corners[None], ends[None]
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    meets = (
        (turn(a, b, c) * turn(a, b, d) <= 0.0)
        & (turn(c, d, a) * turn(c, d, b) <= 0.0)
        & ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=-1)
    )
    apart = np.arange(len(corners))
    apart = (apart[:, None] - apart[None]) % len(corners)
    others: BoolArray = (apart > 1) & (apart < len(corners) - 1)
    before = np.roll(corners, 1, axis=0)
    forwards = np.einsum("ni,ni->n", corners - before, ends - corners)
    folded = (turn(before, corners, ends) == 0.0) & (forwards < 0.0)
    return bool((meets & others).any() or folded.any())


def triangulated(corners: FloatArray) -> IntArray:
    """Return triangles of a simple counterclockwise polygon, by cutting ears off.

    Raises:
        ValueError: rounding leaves no ear.
    """
    left, found = list(range(len(corners))), list[list[int]]()
    while len(left) > 3:
        ring = corners[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        turns = turn(before, ring, after)
        for k in np.argsort(-turns, kind="stable"):
            ear = (before[k], ring[k], after[k])
            others = np.delete(ring, [k - 1, k, (k + 1) % len(ring)], axis=0)
            inside = np.ones(len(others), dtype=bool)
            for one, other in zip(ear, (*ear[1:], ear[0]), strict=True):
                inside &= turn(one, other, others) >= 0.0
            if turns[k] > 0.0 and not inside.any():
                break
        else:
            raise ValueError("a polygon thinner than rounding, expected one with an area")
        found.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        del left[k]
    return np.array([*found, left])
