"""Complements of convex sets as unions of polyhedra, for bounds valid on all sides of obstacles.

A cone of directions from a point inside a convex set meets its surface in a triangle or beyond. For
the gauge g of the set, g(p) >= 1 outside, and g is convex: if p = Σ λ_i q_i with λ >= 0 for the
points q_i at which the three edges of the cone meet the surface, g(p) <= Σ λ_i. So every point
outside in the cone has Σ λ_i >= 1: it is beyond the plane through these points. The octants cover
all directions, as do the cones through the facets of a polytope, which are better planes for one.

What is at a distance from a box is beside a side, an edge or a corner of it. From the nearest point
of the box, it is at p = Σ λ_i e_i with λ >= 0 for unit vectors e_i along one to three axes, and
norm(p) <= Σ λ_i. So every point at a distance of at least R has Σ λ_i >= R, and beside a side that
is all there is to say.

A region is the union of its halves, whose planes are closer to the surface.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.parts import Boxes, Parts, Triangles
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.polyhedra import Box, Polytope

_FARTHEST = 1e4
"""Largest distance of a surface from the centre, in sizes of the set; truncates unbounded sets."""

_HALVINGS = 60
"""Number of halvings of a ray that find the surface."""

_SHALLOW, _MOST_FACETS = 0.05, 32
"""Least depth of a polytope's middle, in sizes, and most facets for cones through its facets."""


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Cone of directions, from the middle of a convex set or from the nearest point of a box."""

    edges: FloatArray
    """directions of its edges, shape (3, 3), in units of the set's scales; from a box unit vectors
    that span the axes along which positions are beyond it, shape (1 to 3, 3)"""
    signs: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    """for each axis of a box 1 beyond its upper side, -1 beyond its lower one, 0 between, and zero
    for a cone from the middle, shape (3,)"""

    @property
    def is_beside_box(self) -> bool:
        """Whether it is a cone from the nearest point of a box."""
        return bool(np.any(self.signs))

    @property
    def bulge(self) -> float:
        """How far a surface of size one may be above the plane."""
        unit = self.edges / np.linalg.norm(self.edges, axis=1, keepdims=True)
        return 1.0 - float(np.min(np.vecdot(unit, np.roll(unit, -1, axis=0))))

    def halves(self) -> list[Region]:
        """Return the halves, across the widest side; none beside a box's side, which is flat."""
        edges, count = self.edges, len(self.edges)
        if count == 1:
            return []
        first = int(np.argmin(np.vecdot(edges, np.roll(edges, -1, axis=0))))
        middle = edges[first] + edges[(first + 1) % count]
        one, other = edges.copy(), edges.copy()
        one[first] = other[(first + 1) % count] = middle / np.linalg.norm(middle)
        return [Region(one, self.signs), Region(other, self.signs)]


def _right_handed(cone: FloatArray) -> FloatArray:
    """Return a cone whose edges have a positive determinant, in the order of a closed surface."""
    return cone if np.linalg.det(cone) > 0.0 else cone[[0, 2, 1]]


OCTANTS = tuple(Region(_right_handed(np.diag(each))) for each in product([1.0, -1.0], repeat=3))
"""Cones between the axes."""

BESIDE_BOX = tuple(
    Region(np.diag(signs)[np.flatnonzero(signs)], np.array(signs))
    for signs in product([-1.0, 0.0, 1.0], repeat=3)
    if any(signs)
)
"""Regions beside the sides, edges and corners of a box."""


@dataclasses.dataclass(frozen=True, eq=False)
class Forbidden:
    """Convex set to keep out of, with the required distance."""

    distance: Callable[[FloatArray], FloatArray]
    """signed distances [m], (...), of positions relative to the middle, (..., 3)"""
    required: float
    """required distance [m]"""
    middle: FloatArray
    """point inside, relative to the centre of the obstacle [m], shape (3,)"""
    scales: FloatArray
    """extents, in units of which directions are [m], shape (3,)"""
    regions: tuple[Region, ...] = OCTANTS
    """regions that cover everything outside"""
    half: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    """half the sides of the box that regions are beside [m], shape (3,)"""
    in_world: Callable[[FloatArray], FloatArray] = lambda vectors: vectors
    """function that turns vectors (..., 3) from the axes of that box to those of the world"""

    @property
    def has_middle(self) -> bool:
        """Whether the middle of the set is closer to the obstacle than required."""
        return bool(self.distance(np.zeros(3)) < self.required)

    def bulge(self, region: Region) -> float:
        """Return how far the surface may be above the plane in a region [m]."""
        size = self.required if region.is_beside_box else float(self.scales.max())
        return region.bulge * size

    def half_spaces(self, regions: Sequence[Region]) -> list[tuple[FloatArray, FloatArray]]:
        """Return half-spaces n · p >= b that contain the outside within each of some regions.

        Args:
            regions: regions of one kind.

        Returns:
            Unit vectors n, shape (H, 3), and b [m], (H,), relative to the middle.
        """
        if regions[0].is_beside_box:
            return [self._beside_box(each) for each in regions]
        edges = np.array([each.edges for each in regions]) * self.scales
        edges = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
        across = np.cross(edges[:, [1, 2, 0]], edges[:, [2, 0, 1]])
        across *= np.sign(np.linalg.det(edges))[:, None, None]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        depths = self._depths(edges.reshape(-1, 3)).reshape(*edges.shape[:-1], 1)
        beyond = np.linalg.solve(edges, 1.0 / depths).swapaxes(-1, -2)
        length = np.linalg.norm(beyond, axis=-1)
        bounds = np.concatenate([np.zeros(edges.shape[:-1]), 1.0 / length], axis=-1)
        normals = np.concatenate([across, beyond / length[..., None]], axis=-2)
        return list(zip(normals, bounds, strict=True))

    def _beside_box(self, region: Region) -> tuple[FloatArray, FloatArray]:
        """Return the half-spaces of a region beside the box."""
        beyond, count = region.signs != 0.0, len(region.edges)
        parts = np.zeros((count, 3))  # λ_i = parts_i · (p - nearest point)
        parts[:, beyond] = np.linalg.inv(region.edges[:, beyond]).T
        across = parts if count > 1 else parts[:0]
        rows = np.vstack([across, parts.sum(axis=0)])
        bounds = rows @ (region.signs * self.half)
        bounds[-1] += self.required
        between = np.eye(3)[~beyond]
        lengths = np.linalg.norm(rows, axis=1)
        normals = np.vstack([between, -between, rows / lengths[:, None]])
        slabs = -np.tile(self.half[~beyond], 2)
        return self.in_world(normals), np.concatenate([slabs, bounds / lengths])

    def _depths(self, directions: FloatArray) -> FloatArray:
        """Return the lengths of rays from the middle to the surface [m], shape (R,)."""
        low = np.zeros(len(directions))
        high = np.full(len(directions), _FARTHEST * float(self.scales.max()))
        for _ in range(_HALVINGS):
            half = (low + high) / 2.0
            inside = self.distance(half[:, None] * directions) < self.required
            low, high = np.where(inside, half, low), np.where(inside, high, half)
        return low


def forbidden_by(solid: Solid, part: int, required: float) -> Forbidden:
    """Return the convex set to keep out of: a shape, or a part of a map.

    Args:
        solid: shape, or the cover of a map.
        part: number of the part, 0 for a shape.
        required: required distance from it [m].
    """
    if isinstance(solid, Parts):
        return _part(solid, part, required)
    extent = np.where(np.isfinite(solid.extent), solid.extent, solid.size)
    scales, regions = extent + required, OCTANTS
    if isinstance(solid, Box) and np.all(np.isfinite(solid.extent)):
        regions = BESIDE_BOX
    elif isinstance(solid, Polytope):
        regions = _through_facets(solid, scales)
    return Forbidden(solid.local_distance, required, np.zeros(3), scales, regions, extent)


def _part(solid: Parts, part: int, required: float) -> Forbidden:
    """Return a part of a map, with a required distance, as a set to keep out of."""
    if isinstance(solid, Boxes):
        middle, half, regions = solid.centers[part], solid.halves[part], BESIDE_BOX
    else:
        assert isinstance(solid, Triangles)  # noqa: S101  # there are no other parts
        corners = solid.corners[part]
        middle, half, regions = corners.mean(axis=0), np.ptp(corners, axis=0) / 2.0, OCTANTS

    def distance(x: FloatArray) -> FloatArray:
        at = solid.in_frame(x).reshape(-1, 3) + middle
        return solid.distances_of(np.full(len(at), part), at).reshape(x.shape[:-1])

    at, scales, turned = solid.in_world(middle), half + required, solid.in_world
    return Forbidden(distance, required, at, scales, regions, half, turned)


def _through_facets(solid: Polytope, scales: FloatArray) -> tuple[Region, ...]:
    """Return the cones through the facets of a polytope; octants if they are many, or flat."""
    triangles = (solid.triangles - solid.center) / scales
    flat = solid.local_distance(np.zeros(3)) > -_SHALLOW * solid.size
    if flat or len(triangles) > _MOST_FACETS:
        return OCTANTS
    edges = triangles / np.linalg.norm(triangles, axis=-1, keepdims=True)
    return tuple(Region(each) for each in edges)
