"""Shells of a mesh: triangles that share edges, and which of them enclose an inside."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True, eq=False)
class Shells:
    """Triangles with coincident vertices joined."""

    vertices: FloatArray
    """positions [m], shape (V, 3)"""
    triangles: IntArray
    """numbers of the vertices of each triangle, shape (F, 3)"""
    enclosing: BoolArray
    """mask of the triangles that bound an inside, each once, shape (F,)"""
    are_closed: bool
    """whether every triangle with an area belongs to a closed shell"""
    moved: int = 0
    """number of vertices joined with others at another place"""

    @classmethod
    def of(cls, vertices: FloatArray, triangles: IntArray, *tolerances: float) -> Self:
        """Return the shells of a mesh.

        Coincident vertices are joined; those within a tolerance only where shells would otherwise
        be open, and within a larger one only if they are then closed.

        Args:
            vertices: positions [m], shape (V, 3).
            triangles: numbers of the vertices of each triangle, shape (F, 3).
            tolerances: distances along each axis within which vertices are joined, ascending [m].
        """
        found = exact = cls._joined(vertices, triangles, vertices)
        for number, tolerance in enumerate(tolerances):
            if found.are_closed:
                break
            near = cls._joined(vertices, triangles, _clusters(vertices, tolerance))
            if near.are_closed or number == 0:
                moved = len(exact.vertices) - len(near.vertices)
                found = dataclasses.replace(near, moved=moved)
        return found

    @classmethod
    def _joined(cls, vertices: FloatArray, triangles: IntArray, places: np.ndarray) -> Self:
        """Return the shells, with vertices of equal places (V, 3) joined."""
        _, first, numbers = np.unique(places, axis=0, return_index=True, return_inverse=True)
        triangles = numbers.reshape(-1)[triangles]
        has_area: BoolArray = (triangles != np.roll(triangles, -1, axis=1)).all(axis=1)
        # the same triangle again, facing the same way, encloses nothing more
        has_area &= _first_of_equal(_turned(triangles))
        edges = _edges(triangles, len(first))
        if has_area.any() and not _odd(edges, has_area).any():
            return cls(vertices[first], triangles, has_area, True)
        shells = _shells(edges, has_area)
        once = has_area & _first_of_equal(np.sort(triangles, axis=1))
        is_open = _open(edges, shells, has_area)
        stays_open = is_open & _open(edges, shells, once)
        counted = np.where(is_open[shells], once, has_area)
        closed = has_area.any() and not stays_open[shells[has_area]].any()
        return cls(vertices[first], triangles, counted & ~stays_open[shells], bool(closed))


def _clusters(vertices: FloatArray, tolerance: float) -> IntArray:
    """Return the clusters of coordinates along each axis, separated by gaps, shape (V, 3)."""
    numbers = np.empty(vertices.shape, dtype=np.int64)
    for axis, values in enumerate(vertices.T):
        order = np.argsort(values, kind="stable")
        gaps = np.diff(values[order], prepend=values[order[:1]]) > tolerance
        numbers[order, axis] = np.cumsum(gaps)
    return numbers


def _edges(triangles: IntArray, vertices: int) -> IntArray:
    """Return the numbers of the three edges of each triangle, from 0, shape (F, 3)."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    pairs = ends[..., 0] * vertices + ends[..., 1]
    numbers: IntArray = np.unique(pairs, return_inverse=True)[1].reshape(triangles.shape)
    return numbers


def _shells(edges: IntArray, has_area: BoolArray) -> IntArray:
    """Return the number of each triangle's edge-connected shell, shape (F,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # slow to load, so only where needed

    count, most = len(edges), int(edges.max()) + 1
    joining = edges[has_area]
    rows = np.repeat(np.flatnonzero(has_area), 3)
    shape = (count + most, count + most)
    graph = coo_array((np.ones(joining.size, bool), (rows, count + joining.ravel())), shape=shape)
    numbers: IntArray = connected_components(graph, directed=False)[1][:count]
    return numbers


def _turned(triangles: IntArray) -> IntArray:
    """Return triangles with the least vertex number first and the same orientation, (F, 3)."""
    columns = (np.argmin(triangles, axis=1)[:, None] + np.arange(3)) % 3
    turned: IntArray = np.take_along_axis(triangles, columns, axis=1)
    return turned


def _first_of_equal(triangles: IntArray) -> BoolArray:
    """Return a mask of the first of all equal rows, shape (F,)."""
    first = np.unique(triangles, axis=0, return_index=True)[1]
    found: BoolArray = np.isin(np.arange(len(triangles)), first)
    return found


def _open(edges: IntArray, shells: IntArray, counted: BoolArray) -> BoolArray:
    """Return a mask of the shells with an edge of an odd number of counted triangles."""
    found = np.zeros(int(shells.max()) + 1, dtype=bool)
    found[shells[counted & _odd(edges, counted)]] = True
    return found


def _odd(edges: IntArray, counted: BoolArray) -> BoolArray:
    """Return the triangles with an edge of an odd number of counted triangles, shape (F,)."""
    counts = np.bincount(edges[counted].ravel(), minlength=int(edges.max()) + 1)
    odd: BoolArray = (counts[edges] % 2 == 1).any(axis=1)
    return odd
