"""Extruded polygons, which SDF calls polylines, as closed meshes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_MOST = 500
"""Largest number of corners; the work grows with its square."""


class Prism(NamedTuple):
    """Closed mesh of an extruded polygon."""

    vertices: FloatArray
    """corners below and, after them, above [m], shape (2 N, 3)"""
    triangles: IntArray
    """numbers of the vertices of each triangle, from outside counterclockwise, shape (F, 3)"""
    is_convex: bool
    """whether the polygon is convex"""


def extruded(corners: FloatArray, height: float) -> Prism:
    """Return the polygon extruded from z = 0 upwards.

    Args:
        corners: of the polygon in order [m], shape (N, 2); the last may repeat the first.
        height: of the prism [m].

    Raises:
        ValueError: the corners enclose no area, or the polygon crosses itself.
    """
    corners = corners[(corners != np.roll(corners, 1, axis=0)).any(axis=1)]
    count = len(corners)
    if not 3 <= count <= _MOST:
        raise ValueError(f"{count} different corners, expected a polygon of 3 to {_MOST}")
    if _turn(corners[0], corners, np.roll(corners, -1, axis=0)).sum() < 0.0:
        corners = corners[::-1]
    if _crosses_itself(corners):
        raise ValueError("a polygon that touches or crosses itself, expected a simple one")
    top = np.column_stack([corners, np.full(count, height)])
    vertices = np.concatenate([top * [1.0, 1.0, 0.0], top])
    cap, here = _triangulated(corners), np.arange(count)
    after = np.roll(here, -1)
    sides = [
        np.column_stack([here, after, after + count]),
        np.column_stack([here, after + count, here + count]),
    ]
    turns = _turn(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0))
    triangles = np.concatenate([cap[:, ::-1], cap + count, *sides])
    return Prism(vertices, triangles, bool((turns >= 0.0).all()))


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return twice the area of triangles (..., 2), positive if they are counterclockwise."""
    one, other = b - a, c - a
    twice: FloatArray = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return twice


def _crosses_itself(corners: FloatArray) -> bool:
    """Return whether two edges that are not neighbours touch, or neighbours fold back."""
    ends = np.roll(corners, -1, axis=0)
    a, b, c, d = corners[:, None], ends[:, None], corners[None], ends[None]
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    meets = (
        (_turn(a, b, c) * _turn(a, b, d) <= 0.0)
        & (_turn(c, d, a) * _turn(c, d, b) <= 0.0)
        & ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=-1)
    )
    apart = np.arange(len(corners))
    apart = (apart[:, None] - apart[None]) % len(corners)
    others: BoolArray = (apart > 1) & (apart < len(corners) - 1)
    before = np.roll(corners, 1, axis=0)
    forwards = np.einsum("ni,ni->n", corners - before, ends - corners)
    folded = (_turn(before, corners, ends) == 0.0) & (forwards < 0.0)
    return bool((meets & others).any() or folded.any())


def _triangulated(corners: FloatArray) -> IntArray:
    """Return triangles of a simple counterclockwise polygon, by cutting ears off.

    Raises:
        ValueError: rounding leaves no ear.
    """
    left, found = list(range(len(corners))), list[list[int]]()
    while len(left) > 3:
        ring = corners[left]
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        turns = _turn(before, ring, after)
        for k in np.argsort(-turns, kind="stable"):
            ear = (before[k], ring[k], after[k])
            others = np.delete(ring, [k - 1, k, (k + 1) % len(ring)], axis=0)
            inside = np.ones(len(others), dtype=bool)
            for one, other in zip(ear, (*ear[1:], ear[0]), strict=True):
                inside &= _turn(one, other, others) >= 0.0
            if turns[k] > 0.0 and not inside.any():
                break
        else:
            raise ValueError("a polygon thinner than rounding, expected one with an area")
        found.append([left[k - 1], left[k], left[(k + 1) % len(left)]])
        del left[k]
    return np.array([*found, left])
