"""Convex sets as linear rows and a second-order cone."""

from __future__ import annotations

import dataclasses
from functools import singledispatch

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.posed import Posed
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere
from drake_rho.scenario.shapes.unbounded import Cone, HalfSpace

_SAME = 9
"""Decimals up to which two unit normals count as one: a face of several triangles has one row."""


@dataclasses.dataclass(frozen=True, eq=False)
class Conic:
    """Set of all x with normals @ x <= offsets and norm(B (x - t s) + c) <= b · x + d.

    The scalar t is any number from -1 to 1, and s is zero but for capsules.
    """

    normals: FloatArray
    """outward unit normals, shape (F, 3)"""
    offsets: FloatArray
    """in the unit of x, shape (F,)"""
    cone: FloatArray
    """matrix with the row b above B, shape (M, 3); none if M is zero"""
    apex: FloatArray
    """d above c, shape (M,)"""
    segment: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    """vector s, shape (3,)"""
    rounded: bool = True
    """whether the set stays of its kind if its boundary moves inwards"""

    @classmethod
    def polyhedron(cls, normals: FloatArray, offsets: FloatArray) -> Conic:
        """Return the polyhedron of some rows."""
        return cls(normals, offsets, np.zeros((0, 3)), np.zeros(0))

    @classmethod
    def ball(cls, matrix: FloatArray, center: FloatArray, radius: float) -> Conic:
        """Return the set norm(matrix (x - center)) <= radius."""
        cone = np.vstack([np.zeros(3), matrix])
        apex = np.concatenate([[radius], -matrix @ center])
        return cls(np.zeros((0, 3)), np.zeros(0), cone, apex)

    @property
    def is_point(self) -> bool:
        """Whether it is a ball of radius zero."""
        return not self.cone[:1].any() and not self.apex[:1].any()

    def tightened(self, margin: float) -> Conic:
        """Return the values that are inside by a margin.

        Raises:
            ScenarioError: they are no such set.
        """
        if margin == 0.0:
            return self
        if not self.rounded:
            expected = "0 beside an ellipsoid: those inside by a distance are not in a cone"
            raise ScenarioError("relative_to.deviation", margin, expected)
        apex = self.apex.copy()
        apex[:1] -= margin
        return dataclasses.replace(self, offsets=self.offsets - margin, apex=apex)

    def posed(self, rotation: FloatArray, translation: FloatArray) -> Conic:
        """Return the set rotated about the origin, then translated."""
        normals, cone = self.normals @ rotation.T, self.cone @ rotation.T
        return dataclasses.replace(
            self,
            normals=normals,
            offsets=self.offsets + normals @ translation,
            cone=cone,
            apex=self.apex - cone @ translation,
            segment=rotation @ self.segment,
        )


@singledispatch
def conic_of(convex_set: object) -> Conic:
    """Return a convex set as rows and a cone.

    Raises:
        ScenarioError: it is a user's own set.
    """
    expected = "one of the package's sets: add the rows of one's own to `prog`"
    raise ScenarioError("set", convex_set, expected)


@conic_of.register
def _(half_space: HalfSpace) -> Conic:
    normal, offset = half_space.normal[None], np.array([half_space.offset])
    length = np.linalg.norm(normal)
    return Conic.polyhedron(normal / length, offset / length)


@conic_of.register
def _(box: Box) -> Conic:
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    return Conic.polyhedron(normals, np.concatenate([box.upper, -box.lower]))


@conic_of.register
def _(polytope: Polytope) -> Conic:
    corners = polytope.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals[np.unique(normals.round(_SAME), axis=0, return_index=True)[1]]
    return Conic.polyhedron(normals, polytope.support(normals))


@conic_of.register
def _(sphere: Sphere) -> Conic:
    return Conic.ball(np.eye(3), sphere.center, sphere.radius)


@conic_of.register
def _(ellipsoid: Ellipsoid) -> Conic:
    ball = Conic.ball(np.diag(ellipsoid.scales), ellipsoid.center, ellipsoid.radius)
    return dataclasses.replace(ball, rounded=False)


@conic_of.register
def _(capsule: Capsule) -> Conic:
    ball = Conic.ball(np.eye(3), capsule.center, capsule.radius)
    return dataclasses.replace(ball, segment=capsule.half)


@conic_of.register
def _(cylinder: Cylinder) -> Conic:
    along = "xyz".index(cylinder.axis)
    side = Conic.ball(np.delete(np.eye(3), along, axis=0), cylinder.center, cylinder.radius)
    if cylinder.height is None:
        return side
    normals = np.stack([np.eye(3)[along], -np.eye(3)[along]])
    ends = normals @ cylinder.center + cylinder.height / 2.0
    return dataclasses.replace(side, normals=normals, offsets=ends)


@conic_of.register
def _(cone: Cone) -> Conic:
    along = cone.axis / np.linalg.norm(cone.axis)
    across = np.linalg.svd(along[None])[2][1:]  # two unit vectors orthogonal to the axis
    matrix = np.vstack([np.sin(cone.half_angle) * along, np.cos(cone.half_angle) * across])
    return Conic(np.zeros((0, 3)), np.zeros(0), matrix, -matrix @ cone.apex)


@conic_of.register
def _(posed: Posed) -> Conic:
    return conic_of(posed.shape).posed(posed.rotation, posed.translation)
