"""Faces and edges of shapes for drawing, relative to the shape's centre [m]."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import singledispatch

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.posed import Posed

_AROUND = 40
"""Number of points around a circle; the first and last coincide."""
_BISECTIONS = 40
"""Number of bisections along a ray."""
_FLAT = 1e-6
"""Tolerance for triangles of one facet: normals' angle, and relative offset."""


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """Faces and edges of a shape."""

    faces: list[FloatArray]
    """convex polygons, each of shape (n, 3), counter-clockwise as seen from outside"""
    edges: list[FloatArray]
    """polylines where faces meet at an angle, each of shape (n, 3); none on smooth surfaces"""

    def moved(self, by: FloatArray) -> Surface:
        """Return the surface, displaced [m], shape (3,)."""
        return Surface([each + by for each in self.faces], [each + by for each in self.edges])


@singledispatch
def surface(shape: Solid) -> Surface:
    """Approximate the surface of a bounded shape by flat faces with their corners on it.

    A shape without a drawing function of its own must contain its centre, and is drawn as smooth.
    """
    return around(shape, 0.0)


def around(shape: Solid, distance: float) -> Surface:
    """Approximate the surface at a distance [m] from a bounded shape that contains its centre."""
    reach = shape.extent + distance
    return from_inside(lambda x: shape.local_distance(x) - distance, np.zeros(3), 2.0 * reach)


def from_inside(
    distances: Callable[[FloatArray], FloatArray], inside: FloatArray, reach: FloatArray
) -> Surface:
    """Approximate the zero level set of a function of positions (..., 3).

    Corners are on rays from a point inside, found by bisection.

    Args:
        distances: function, negative inside, positive outside.
        inside: a point inside the surface [m], shape (3,).
        reach: length of rays along each axis [m], shape (3,), beyond the surface.
    """
    rays = reach * unit_sphere()
    near, beyond = np.zeros(rays.shape[:-1]), np.ones(rays.shape[:-1])
    for _ in range(_BISECTIONS):
        middle = 0.5 * (near + beyond)
        within = distances(inside + middle[..., None] * rays) < 0.0
        near, beyond = np.where(within, middle, near), np.where(within, beyond, middle)
    return Surface(list(inside + near[..., None] * rays), [])


@surface.register
def _(shape: Box) -> Surface:
    faces = []
    for axis, side in np.ndindex(3, 2):
        ring = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=np.float64)
        ring = np.roll(
            ring, axis + 1, axis=1
        )  # rotate the face normal to z so that it is normal to this axis
        faces.append(shape.extent * (ring if side else -ring[::-1]))
    return Surface(faces, _sides(faces))


@surface.register
def _(shape: Cylinder) -> Surface:
    if shape.height is None:
        raise ValueError("shape: got an infinite cylinder, expected one with a height")
    angles = np.linspace(0.0, 2.0 * np.pi, _AROUND)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(_AROUND)], axis=1)
    half = np.array([0.0, 0.0, shape.height / 2.0])
    turn = "xyz".index(shape.axis) + 1
    low, high = (np.roll(shape.radius * ring + end, turn, axis=1) for end in (-half, half))
    sides = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    return Surface([*sides, high[:-1], low[:0:-1]], [low, high])


@surface.register
def _(shape: Polytope) -> Surface:
    triangles = shape.triangles - shape.center
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces, left = [], np.ones(len(triangles), dtype=np.bool_)
    while np.any(left):
        normal, corner = (each[np.argmax(left)] for each in (normals, triangles[:, 0]))
        above = np.abs((triangles - corner) @ normal).max(axis=1)
        facet = left & (normals @ normal > 1.0 - _FLAT) & (above <= _FLAT * shape.size)
        faces.append(_ring(triangles[facet].reshape(-1, 3), normal))
        left &= ~facet
    return Surface(faces, _sides(faces))


@surface.register
def _(shape: Capsule) -> Surface:
    along = shape.half if shape.half.any() else np.eye(3)[2]
    up = along / np.linalg.norm(along)
    axes = np.stack([*across(up), up])  # of a ball whose poles are the capsule's
    # around its middle the faces of a ball with an odd number of rings reach from end to end
    ball = unit_sphere()
    ends = np.where(ball[..., 2:] > 0.0, shape.half, -shape.half)
    return Surface(list(shape.radius * ball @ axes + ends), [])


@surface.register
def _(shape: Posed) -> Surface:
    inner = surface(shape.shape)
    shift = shape.rotation @ shape.shape.center + shape.translation - shape.center
    faces, edges = ([each @ shape.rotation.T for each in x] for x in (inner.faces, inner.edges))
    return Surface(faces, edges).moved(shift)


def unit_sphere() -> FloatArray:
    """Return the faces of the unit sphere between meridians and parallels, shape (F, 4, 3)."""
    u, v = np.mgrid[0 : 2 * np.pi : _AROUND * 1j, 0 : np.pi : _AROUND // 2 * 1j]
    points = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    corners = (points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def fan(face: FloatArray) -> FloatArray:
    """Split a convex polygon (n, 3) into triangles, shape (n - 2, 3, 3)."""
    return np.stack([face[[0, k, k + 1]] for k in range(1, len(face) - 1)])


def across(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors that are orthogonal to a unit vector and to each other."""
    one = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    one /= np.linalg.norm(one)
    return one, np.cross(normal, one)


def clipped(face: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the part of a convex polygon (n, 3) inside a box, of the same orientation."""
    for axis in range(3):
        for sign, bound in ((-1.0, -lower[axis]), (1.0, upper[axis])):
            beyond = sign * face[:, axis] - bound
            if np.all(beyond <= 0.0):
                continue
            corners = []
            for k, excess in enumerate(beyond):
                if (before := beyond[k - 1]) * excess < 0.0:
                    part = before / (before - excess)
                    corners.append(face[k - 1] + part * (face[k] - face[k - 1]))
                if excess <= 0.0:
                    corners.append(face[k])
            face = np.reshape(corners, (-1, 3))
    return face


def _ring(points: FloatArray, normal: FloatArray) -> FloatArray:
    """Order the corners of a planar convex polygon counter-clockwise, without duplicates."""
    corners = np.unique(points, axis=0)
    offsets = corners - corners.mean(axis=0)
    across = np.cross(normal, offsets[0])
    return corners[np.argsort(np.arctan2(offsets @ across, offsets @ offsets[0]))]


def _sides(faces: list[FloatArray]) -> list[FloatArray]:
    """Return the sides shared by polygons, each once, of shape (2, 3)."""
    ends = [np.stack([face, np.roll(face, -1, axis=0)], axis=1) for face in faces]
    every = np.concatenate(ends)
    return [side for side in every if tuple(side[0]) < tuple(side[1])]
