"""Extruded polygons, which SDF calls polylines, as closed meshes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.polygons import crosses_itself, triangulated, turn

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
    if turn(corners[0], corners, np.roll(corners, -1, axis=0)).sum() < 0.0:
        corners = corners[::-1]
    if crosses_itself(corners):
        raise ValueError("a polygon that touches or crosses itself, expected a simple one")
    top = np.column_stack([corners, np.full(count, height)])
    vertices = np.concatenate([top * [1.0, 1.0, 0.0], top])
    cap, here = triangulated(corners), np.arange(count)
    after = np.roll(here, -1)
    sides = [
        np.column_stack([here, after, after + count]),
        np.column_stack([here, after + count, here + count]),
    ]
    turns = turn(np.roll(corners, 1, axis=0), corners, np.roll(corners, -1, axis=0))
    triangles = np.concatenate([cap[:, ::-1], cap + count, *sides])
    return Prism(vertices, triangles, bool((turns >= 0.0).all()))
