"""Complements of convex sets as unions of polyhedra, for bounds valid on all sides of obstacles.

A cone of directions from the centre of a convex set meets its surface in a triangle or beyond. For
the gauge g of the set, g(p) >= 1 outside, and g is convex: if p = Σ λ_i q_i with λ >= 0 for the
points q_i at which the three edges of the cone meet the surface, g(p) <= Σ λ_i. So every point
outside in the cone has Σ λ_i >= 1: it is beyond the plane through these points. The octants cover
all directions, as do cones through the sides of a box, which are better planes for one. A cone is
the union of its halves, whose planes are closer to the surface.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from itertools import product

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.parts import Boxes, Parts, Triangles
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.polyhedra import Box

_FARTHEST = 1e4
"""Largest distance of a surface from the centre, in sizes of the set; truncates unbounded sets."""

_HALVINGS = 60
"""Number of halvings of a ray that find the surface."""


def _right_handed(cones: Iterable[FloatArray]) -> tuple[FloatArray, ...]:
    """Return cones whose edges have a positive determinant, in the order of a closed surface."""
    return tuple(each if np.linalg.det(each) > 0.0 else each[[0, 2, 1]] for each in cones)


OCTANTS = _right_handed(np.diag(each) for each in product([1.0, -1.0], repeat=3))
"""Cones between the axes."""

_SIDES = _right_handed(
    np.roll([[side, *one], [side, *other], [side, *third]], axis, axis=1)
    for axis in range(3)
    for side in (1.0, -1.0)
    for one, other, third in [((1, 1), (1, -1), (-1, -1)), ((1, 1), (-1, 1), (-1, -1))]
)
"""Cones through the halves of a cube's sides."""


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
    cones: tuple[FloatArray, ...] = OCTANTS
    """cones that cover all directions, each as the directions of its edges, of shape (3, 3)"""

    @property
    def has_middle(self) -> bool:
        """Whether the middle of the set is closer to the obstacle than required."""
        return bool(self.distance(np.zeros(3)) < self.required)

    def half_spaces(self, cones: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return half-spaces n · p >= b that contain the outside within cones.

        Args:
            cones: directions of their edges, of shape (..., 3, 3), in units of the scales.

        Returns:
            Unit vectors n, shape (..., 4, 3), and b [m], (..., 4), relative to the middle.
        """
        edges = cones * self.scales
        edges = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
        across = np.cross(edges[..., [1, 2, 0], :], edges[..., [2, 0, 1], :])
        across *= np.sign(np.linalg.det(edges))[..., None, None]
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        depths = self._depths(edges.reshape(-1, 3)).reshape(*edges.shape[:-1], 1)
        beyond = np.linalg.solve(edges, 1.0 / depths).swapaxes(-1, -2)
        length = np.linalg.norm(beyond, axis=-1)
        bounds = np.concatenate([np.zeros(edges.shape[:-1]), 1.0 / length], axis=-1)
        return np.concatenate([across, beyond / length[..., None]], axis=-2), bounds

    def _depths(self, directions: FloatArray) -> FloatArray:
        """Return the lengths of rays from the middle to the surface [m], shape (R,)."""
        low = np.zeros(len(directions))
        high = np.full(len(directions), _FARTHEST * float(self.scales.max()))
        for _ in range(_HALVINGS):
            half = (low + high) / 2.0
            inside = self.distance(half[:, None] * directions) < self.required
            low, high = np.where(inside, half, low), np.where(inside, high, half)
        return low


def halves_of(cone: FloatArray) -> list[FloatArray]:
    """Return the halves of a cone, across its widest side."""
    following = np.roll(cone, -1, axis=0)
    first = int(np.argmin(np.vecdot(cone, following)))
    middle = cone[first] + cone[(first + 1) % 3]
    middle /= np.linalg.norm(middle)
    halves = [cone.copy(), cone.copy()]
    halves[0][first], halves[1][(first + 1) % 3] = middle, middle
    return halves


def forbidden_by(solid: Solid, part: int, required: float) -> Forbidden:
    """Return the convex set to keep out of: a shape, or a part of a map.

    Args:
        solid: shape, or the cover of a map.
        part: number of the part, 0 for a shape.
        required: required distance from it [m].
    """
    if not isinstance(solid, Parts):
        extent = np.where(np.isfinite(solid.extent), solid.extent, solid.size)
        cones = _past_sides(extent, required) if isinstance(solid, Box) else OCTANTS
        return Forbidden(solid.local_distance, required, np.zeros(3), extent + required, cones)
    middle, half, cones = _placed(solid, part, required)

    def distance(x: FloatArray) -> FloatArray:
        at = solid.in_frame(x).reshape(-1, 3) + middle
        return solid.distances_of(np.full(len(at), part), at).reshape(x.shape[:-1])

    return Forbidden(distance, required, solid.in_world(middle), half + required, cones)


def _placed(
    solid: Parts, part: int, required: float
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, ...]]:
    """Return the middle of a part of a map in its frame, half its extents [m], and its cones."""
    if isinstance(solid, Boxes):
        half = solid.halves[part]
        return solid.centers[part], half, _past_sides(half, required)
    assert isinstance(solid, Triangles)  # noqa: S101  # there are no other parts
    corners = solid.corners[part]
    return corners.mean(axis=0), np.ptp(corners, axis=0) / 2.0, OCTANTS


def _past_sides(half: FloatArray, required: float) -> tuple[FloatArray, ...]:
    """Return cones through the sides of a box with rounded corners, in units of its extents.

    Args:
        half: half the sides of the box without its radius [m], shape (3,).
        required: radius of the corners [m].
    """
    corner = (half + required / np.sqrt(3.0)) / (half + required)
    return tuple(each * corner for each in _SIDES)
