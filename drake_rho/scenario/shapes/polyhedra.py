"""Axis-aligned boxes and convex polytopes."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray, Points, Vector, record
from drake_rho.scenario.shapes.base import THINNEST, Shape

_BLOCK = 1 << 15
"""Number of pairs of a position and an edge's coordinate per block: a block fits a cache."""

_ON_PLANE = 1e-13
"""Height above a plane, as a part of a polytope's size, that may be due to rounding."""


@record
class Box(Shape):
    """Axis-aligned box: bounds on a quantity, or an obstacle.

    Examples:
        >>> rho.Box([0, 0, 0], [2, 2, 1]).center.tolist()
        [1.0, 1.0, 0.5]
    """

    lower: Vector
    """least x, y and z"""
    upper: Vector
    """greatest x, y and z"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

        def __init__(self, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None: ...

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not np.all(self.lower <= self.upper):
            expected = f"no component above upper {self.upper.tolist()}"
            raise ScenarioError("lower", self.lower.tolist(), expected)
        return self

    def __str__(self) -> str:
        """Return a description: 'box from [0.0, 0.0, 0.0] to [1.0, 1.0, 1.0]'."""
        return f"box from {self.lower.tolist()} to {self.upper.tolist()}"

    @cached_property
    def center(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Centre [m]."""
        center: FloatArray = (self.lower + self.upper) / 2.0
        return center

    @cached_property
    def extent(self) -> FloatArray:
        """Half the sides [m]."""
        extent: FloatArray = (self.upper - self.lower) / 2.0
        return extent

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return the sum of s_i |n_i| with half the sides s."""
        support: FloatArray = np.abs(n) @ self.extent
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the nearest corner, edge or side; inside, from the nearest side."""
        beyond = np.abs(x) - self.extent
        outside = np.sqrt(np.sum(np.maximum(beyond, 0.0) ** 2, axis=-1))
        distance: FloatArray = outside + np.minimum(beyond.max(axis=-1), 0.0)
        return distance

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return directions from the nearest point; inside, the normal of the nearest side."""
        beyond = np.abs(x) - self.extent
        nearest = np.eye(3)[np.argmax(beyond, axis=-1)]
        outside = np.maximum(beyond, 0.0)
        lengths = np.linalg.norm(outside, axis=-1, keepdims=True)
        apart = lengths > 0.0
        normals = np.where(apart, outside / np.where(apart, lengths, 1.0), nearest)
        return np.copysign(normals, x)


@record
class Polytope(Shape):
    """Convex polytope, the convex hull of its vertices.

    Examples:
        >>> tetrahedron = rho.Polytope([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        >>> tetrahedron.extent.tolist()
        [0.5, 0.5, 0.5]
    """

    vertices: Points
    """corners [m], shape (V, 3), V >= 4; points inside the hull have no effect"""

    if TYPE_CHECKING:

        def __init__(self, vertices: npt.ArrayLike) -> None: ...

    @model_validator(mode="after")
    def _has_an_inside(self) -> Self:
        if len(self.vertices) < 4:
            raise ScenarioError("vertices", self.vertices.tolist(), "at least four positions")
        try:
            self.check_solid()
        except ScenarioError as error:
            raise error.inside("vertices") from None
        self._hull  # noqa: B018  # raises if the points lie in a plane
        return self

    def __str__(self) -> str:
        """Return a description: 'polytope of 8 vertices around [0.0, 0.0, 0.0]'."""
        return f"polytope of {len(self.vertices)} vertices around {self.center.tolist()}"

    @cached_property
    def center(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Centre of the bounding box [m]."""
        center: FloatArray = (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2.0
        return center

    @cached_property
    def extent(self) -> FloatArray:
        """Half the sides of the bounding box [m]."""
        extent: FloatArray = (self.vertices.max(axis=0) - self.vertices.min(axis=0)) / 2.0
        return extent

    @cached_property
    def _corners(self) -> FloatArray:
        """Vertices relative to the centre [m], shape (V, 3)."""
        corners: FloatArray = self.vertices - self.center
        return corners

    @cached_property
    def _hull(self) -> tuple[FloatArray, FloatArray, IntArray]:
        """Outward normals (F, 3) and offsets (F,) of the facets' planes; vertex indices (F, 3)."""
        from scipy.spatial import ConvexHull, QhullError  # imported here: slow to load

        expected = "corners of a solid: these lie in a plane, or nearly so"
        try:
            hull = ConvexHull(self._corners)
        except QhullError:
            raise ScenarioError("vertices", self.vertices.tolist(), expected) from None
        # for a box with half sides s, volume / area = 1 / (1/s_1 + 1/s_2 + 1/s_3) >= min s / 3
        if hull.volume < THINNEST / 3.0 * hull.area * self.size:
            raise ScenarioError("vertices", self.vertices.tolist(), expected)
        return hull.equations[:, :3], -hull.equations[:, 3], hull.simplices

    @cached_property
    def triangles(self) -> FloatArray:
        """Triangles of the surface [m], shape (F, 3, 3), counter-clockwise seen from outside."""
        normals, _, corners = self._hull
        triangles = self.vertices[corners]
        turned = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        inwards = np.sum(turned * normals, axis=1) < 0.0
        triangles[inwards] = triangles[inwards][:, ::-1]
        return triangles

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray]:
        """First points of the edges, and vectors to their second points [m], each (E, 3)."""
        triangles = self._hull[2]
        sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        one, other = np.unique(np.sort(sides, axis=1), axis=0).T
        return self._corners[one], self._corners[other] - self._corners[one]

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return the greatest n · v over all vertices v."""
        support: FloatArray = np.max(n @ self._corners.T, axis=-1)
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the nearest corner, edge or facet; inside, from a facet."""
        return self.local_measured(x)[0]

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return directions from the nearest point; inside, the normal of the nearest facet."""
        return self.local_measured(x)[1]

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distances, shape (...), and outward directions, shape (..., 3)."""
        flat = x.reshape(-1, 3)
        many = max(1, _BLOCK // (len(self._edges[0]) * 3))
        blocks = [flat[first : first + many] for first in range(0, max(len(flat), 1), many)]
        found = [self._nearest_of_block(block) for block in blocks]
        distances, normals = (np.concatenate(each) for each in zip(*found, strict=True))
        return distances.reshape(x.shape[:-1]), normals.reshape(x.shape)

    def _nearest_of_block(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `local_measured` of positions of shape (P, 3).

        A lower bound of a position's distance is its height above the facet plane it is farthest
        above. If its projection to that plane lies in the polytope, that is the nearest point;
        otherwise the nearest point lies on an edge or is a corner.
        """
        planes, offsets, _ = self._hull
        above = x @ planes.T - offsets
        facet = np.argmax(above, axis=1)
        distances, normals = above[np.arange(len(x)), facet], planes[facet]
        feet = x - distances[:, None] * normals
        outside = np.max(feet @ planes.T - offsets, axis=1) > _ON_PLANE * self.size
        rows = np.flatnonzero(outside & (distances > 0.0))
        if len(rows) > 0:
            away = x[rows] - self._nearest_on_edges(x[rows])
            distances[rows] = np.linalg.norm(away, axis=1)
            normals[rows] = away / distances[rows, None]
        return distances, normals

    def _nearest_on_edges(self, x: FloatArray) -> FloatArray:
        """Return the points of the edges that are nearest to positions, shape (P, 3)."""
        starts, edges = self._edges
        offsets = x[:, None] - starts
        along = np.einsum("pei,ei->pe", offsets, edges) / np.einsum("ei,ei->e", edges, edges)
        feet = starts + np.clip(along, 0.0, 1.0)[:, :, None] * edges
        nearest = np.argmin(np.sum((x[:, None] - feet) ** 2, axis=2), axis=1)
        points: FloatArray = feet[np.arange(len(x)), nearest]
        return points
