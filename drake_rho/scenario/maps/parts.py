"""Unions of convex parts, boxes or triangles, with a tree that finds the parts near a motion.

Positions are relative to the centre of the bounding box. A union may be rotated; its parts and
their numbers are in its own frame, into which `in_frame` turns positions.
"""

from __future__ import annotations

import abc
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.maps.box_tree import BoxTree
from drake_rho.scenario.shapes.base import TOLERANCE, Solid

SIZE = 0.1
"""Length to which the tolerance of a map refers, as a part of half its longest side: obstacles in a
map are smaller than the map."""

_AT_ONCE = 1 << 14
"""Number of positions whose distances are computed at once, which bounds the memory."""


class Parts(Solid):
    """Union of convex parts.

    Args:
        lower: lower corners of the parts' bounding boxes, in a frame of their own [m], (B, 3).
        upper: upper corners [m], shape (B, 3).
        frame: rotation from that frame to the world's, shape (3, 3); none if not given.
        origin: position of that frame's origin [m], shape (3,).

    Attributes:
        tree: of the parts' bounding boxes, relative to the centre.
        solid: solid of which the union is the parts or the cover; None for a union by itself.
    """

    solid: Solid | None = None

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        frame: FloatArray | None = None,
        origin: FloatArray | None = None,
    ) -> None:
        self._middle: FloatArray = (lower.min(axis=0) + upper.max(axis=0)) / 2.0
        self._frame = frame
        self.center = self._middle if frame is None else frame @ self._middle
        if origin is not None:
            self.center = self.center + origin
        self._half: FloatArray = (
            np.ptp(np.stack([lower.min(axis=0), upper.max(axis=0)]), axis=0) / 2
        )
        self.tree = BoxTree(lower - self._middle, upper - self._middle)
        self._count = len(lower)

    def of(self, solid: Solid) -> Self:
        """Return the union as the parts, or the cover, of a solid."""
        self.solid = solid
        return self

    def __len__(self) -> int:
        """Return the number of parts."""
        return self._count

    @cached_property
    def extent(self) -> FloatArray:
        """Half the sides of its bounding box [m]."""
        return self._half if self._frame is None else np.abs(self._frame) @ self._half

    @cached_property
    def size(self) -> float:
        """Length to which the tolerance refers [m]."""
        return SIZE * float(self._half.max())

    def in_frame(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (..., 3) of the world in the frame of the parts."""
        return vectors if self._frame is None else vectors @ self._frame

    def in_world(self, vectors: FloatArray) -> FloatArray:
        """Return vectors (..., 3) of the frame of the parts in the world's."""
        return vectors if self._frame is None else vectors @ self._frame.T

    @abc.abstractmethod
    def measured(self, parts: IntArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances from parts (P,) and unit vectors from their nearest points.

        Args:
            parts: numbers of the parts.
            x: positions in their frame, relative to the centre [m], shape (P, 3).

        Returns:
            Signed distances [m], shape (P,), and vectors in the same frame, shape (P, 3).
        """

    @abc.abstractmethod
    def supports(self, parts: IntArray, n: FloatArray) -> FloatArray:
        """Return the largest n · x of all x in parts (P,) for vectors n of their frame (P, 3)."""

    def distances_of(self, parts: IntArray, x: FloatArray) -> FloatArray:
        """Return the signed distances of `measured` alone."""
        return self.measured(parts, x)[0]

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the nearest part, negative inside of one."""
        return self._nearest(x)[1]

    def distance_up_to(self, x: FloatArray, most: float) -> FloatArray:
        """Return distances from the nearest part, or `most` where they are larger: faster."""
        return self._nearest(x, most)[1]

    def nearest(self, x: FloatArray) -> IntArray:
        """Return the number of the nearest part for positions (..., 3) relative to the centre."""
        return self._nearest(x)[0]

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors from the nearest point of the nearest part."""
        return self.local_measured(x)[1]

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances from the nearest part, and unit vectors from its nearest point."""
        parts, distances = self._nearest(x)
        flat = self.in_frame(x).reshape(-1, 3)
        outward = self.in_world(self.measured(parts.reshape(-1), flat)[1])
        return distances, outward.reshape(x.shape)

    def _nearest(self, x: FloatArray, most: float = np.inf) -> tuple[IntArray, FloatArray]:
        """Return the nearest part of each position (..., 3) and the distance from it."""
        flat = self.in_frame(x).reshape(-1, 3)
        parts, distances = np.zeros(len(flat), dtype=np.int64), np.full(len(flat), most)
        for first in range(0, len(flat), _AT_ONCE):
            here = slice(first, first + _AT_ONCE)
            self._nearest_of_block(flat[here], parts[here], distances[here])
        return parts.reshape(x.shape[:-1]), distances.reshape(x.shape[:-1])

    def _nearest_of_block(self, x: FloatArray, parts: IntArray, distances: FloatArray) -> None:
        """Change the nearest parts and distances of some positions in place."""
        finite = np.flatnonzero(np.isfinite(x).all(axis=1))
        distances[~np.isfinite(x).all(axis=1)] = np.nan
        likely = self.tree.likely_nearest(x[finite])
        near = self.distances_of(likely, x[finite])
        closer = near < distances[finite]
        parts[finite[closer]], distances[finite[closer]] = likely[closer], near[closer]
        within = np.maximum(distances[finite], 0.0)
        queries, others = self.tree.pairs(x[finite], x[finite], within)
        queries = finite[queries]
        d = self.distances_of(others, x[queries])
        order = np.argsort(-d, kind="stable")  # the nearest is assigned last
        order = order[d[order] < distances[queries[order]]]
        parts[queries[order]], distances[queries[order]] = others[order], d[order]

    def __str__(self) -> str:
        """Return a description: '120 parts'."""
        return f"{len(self)} parts"


class Boxes(Parts):
    """Union of boxes aligned with the axes of one frame."""

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        frame: FloatArray | None = None,
        origin: FloatArray | None = None,
    ) -> None:
        super().__init__(lower, upper, frame, origin)
        self.centers: FloatArray = (lower + upper) / 2.0 - self._middle
        self.halves: FloatArray = (upper - lower) / 2.0

    @cached_property
    def thickness(self) -> float:
        """Half the least side of a box [m]."""
        return float(self.halves.min())

    def distances_of(self, parts: IntArray, x: FloatArray) -> FloatArray:
        """Return signed distances of positions from boxes."""
        beyond = np.abs(x - self.centers[parts]) - self.halves[parts]
        outside = np.maximum(beyond, 0.0)
        distances: FloatArray = np.sqrt(np.einsum("pi,pi->p", outside, outside))
        return np.asarray(distances + np.minimum(beyond.max(axis=1), 0.0))

    def measured(self, parts: IntArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distances from boxes, and unit vectors from the nearest points."""
        off = x - self.centers[parts]
        beyond = np.abs(off) - self.halves[parts]
        n = np.maximum(beyond, 0.0)
        length = np.sqrt(np.einsum("pi,pi->p", n, n))
        inside = length == 0.0
        face = np.argmax(beyond[inside], axis=1)
        n[inside] = np.eye(3)[face]
        distances = np.where(inside, np.minimum(beyond.max(axis=1), 0.0), length)
        n = np.copysign(n, off) / np.where(inside, 1.0, length)[:, None]
        return distances, n

    def supports(self, parts: IntArray, n: FloatArray) -> FloatArray:
        """Return the support functions of boxes, relative to the centre of all."""
        supports: FloatArray = np.einsum("pi,pi->p", n, self.centers[parts])
        return np.asarray(supports + np.einsum("pi,pi->p", np.abs(n), self.halves[parts]))


class Triangles(Parts):
    """Union of triangles.

    Args:
        corners: of the triangles [m], shape (B, 3, 3).
    """

    def __init__(self, corners: FloatArray) -> None:
        super().__init__(corners.min(axis=1), corners.max(axis=1))
        self.corners: FloatArray = corners - self._middle

    @property
    def thickness(self) -> float:
        """Thickness of a surface: the tolerance, since it has no inside [m]."""
        return TOLERANCE * self.size

    def measured(self, parts: IntArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances from triangles, and unit vectors from the nearest points.

        On a triangle the vector is its normal.
        """
        corners = self.corners[parts]
        off = x - nearest_on_triangles(corners, x)
        distances: FloatArray = np.sqrt(np.einsum("pi,pi->p", off, off))
        on = distances == 0.0
        off[on] = np.cross(corners[on, 1] - corners[on, 0], corners[on, 2] - corners[on, 0])
        lengths = np.linalg.norm(off, axis=1, keepdims=True)
        return distances, off / np.where(lengths > 0.0, lengths, 1.0)

    def supports(self, parts: IntArray, n: FloatArray) -> FloatArray:
        """Return the largest component of the corners of triangles."""
        supports: FloatArray = np.einsum("pci,pi->pc", self.corners[parts], n).max(axis=1)
        return supports


def nearest_on_triangles(corners: FloatArray, x: FloatArray) -> FloatArray:
    """Return the points of triangles that are nearest to positions, shape (P, 3).

    The nearest point is the foot of the perpendicular if that is in the triangle, else the nearest
    point of one of the three edges.

    Args:
        corners: of the triangles [m], shape (P, 3, 3); a triangle may be a segment or a point.
        x: positions [m], shape (P, 3).
    """
    edges = np.roll(corners, -1, axis=1) - corners
    off = x[:, None] - corners
    squares = np.einsum("pei,pei->pe", edges, edges)
    parts = np.einsum("pei,pei->pe", off, edges) / np.where(squares > 0.0, squares, 1.0)
    feet = corners + np.clip(parts, 0.0, 1.0)[..., None] * edges
    lengths = np.einsum("pei,pei->pe", x[:, None] - feet, x[:, None] - feet)
    nearest: FloatArray = feet[np.arange(len(x)), np.argmin(lengths, axis=1)]
    normals = np.cross(edges[:, 0], -edges[:, 2])
    areas = np.einsum("pi,pi->p", normals, normals)
    inside = np.einsum("pei,pei->pe", np.cross(normals[:, None], edges), off) >= 0.0
    over = inside.all(axis=1) & (areas > 0.0)
    heights = np.einsum("pi,pi->p", off[:, 0], normals) / np.where(areas > 0.0, areas, 1.0)
    nearest[over] = x[over] - heights[over, None] * normals[over]
    return nearest
