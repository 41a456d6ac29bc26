"""Convex shapes, each defined by three functions of a position relative to its centre.

With the support function h(n) = max n · y over the set, the half-space n · x >= h(n) lies outside
the set for every unit vector n; a planner uses nothing else of a shape. The modules `quadrics`,
`polyhedra` and `cylinders` define the shapes.

A shape that stays where it is has the same functions in absolute coordinates. With these it is a
convex set like any other (`drake_rho.scenario.sets`). The local functions serve obstacles, whose
centres move.
"""

from __future__ import annotations

import abc
from functools import cached_property

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray

TOLERANCE = 1e-6
"""Relative tolerance of all constraints in the package. It refers to a shape's size, the length
scale of a vehicle's motion, or a box's side if that is less."""

THINNEST = 1e-4
"""Least extent of an obstacle as a part of its greatest. A thinner obstacle is a sheet or a thread,
whose inside is within the tolerance."""


class Solid(abc.ABC):
    """Set to keep clear of, convex (`Shape`) or not (`drake_rho.scenario.maps`).

    In the local functions, positions are relative to its centre; in `signed_distance` and `outward`
    they are absolute.
    """

    center: FloatArray
    """centre of its bounding box [m], shape (3,)"""

    @property
    @abc.abstractmethod
    def extent(self) -> FloatArray:
        """Half the sides of its bounding box [m], shape (3,); infinite where it is endless."""

    @cached_property
    def size(self) -> float:
        """Maximum finite extent [m], to which the tolerance refers."""
        return float(np.max(self.extent, where=np.isfinite(self.extent), initial=0.0))

    @cached_property
    def tolerance(self) -> float:
        """Depth inside that still counts as outside: `TOLERANCE` times the size [m]."""
        return TOLERANCE * self.size

    @property
    def thickness(self) -> float:
        """Least extent that a motion has to go around or through [m]."""
        return float(self.extent.min())

    @property
    def has_corners(self) -> bool:
        """Whether its surface has edges, where normals along a reference turn abruptly."""
        return True

    @property
    def cover(self) -> Solid:
        """Set that planners keep clear of in its place; it contains the solid."""
        return self

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances of positions (..., 3) from the surface [m], negative inside, (...)."""
        return self.local_distance(x - self.center)

    def outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors from the nearest points of the shape to positions, (..., 3) each.

        Inside, they point to the nearest point of the surface, or to any of several such points.
        """
        return self.local_outward(x - self.center)

    @abc.abstractmethod
    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return the distance of x from the surface [m], negative inside, shape (...)."""

    def distance_up_to(self, x: FloatArray, most: float) -> FloatArray:
        """Return `local_distance` of x, or any distance from `most` on where that is larger."""
        return self.local_distance(x)

    @abc.abstractmethod
    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors from the nearest point of the shape to x, shape (..., 3).

        Inside, they point to the nearest point of the surface, or to any of several such points.
        """

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `local_distance` and `local_outward` of x, together where that is faster."""
        return self.local_distance(x), self.local_outward(x)

    def described_near(self, x: FloatArray) -> str:
        """Return a description that names the part nearest to a position relative to the centre."""
        return str(self)

    @abc.abstractmethod
    def __str__(self) -> str:
        """Return a description: kind, position and dimensions."""

    def check_solid(self) -> None:
        """Check that the shape has an interior, which obstacles need.

        Raises:
            ScenarioError: the shape is flat.
        """
        if self.extent.min() < max(THINNEST * self.size, np.finfo(float).tiny):
            sides = Description(f"sides of {(2.0 * self.extent).tolist()} m")
            expected = f"none below {THINNEST:g} of the greatest: a flat shape has no interior"
            raise ScenarioError("", sides, expected)


def unit_across(vector: FloatArray) -> FloatArray:
    """Return a unit vector orthogonal to a vector that is not zero, shape (3,)."""
    across = np.cross(vector, np.eye(3)[np.argmin(np.abs(vector))])
    unit: FloatArray = across / np.linalg.norm(across)
    return unit


class Shape(Solid):
    """Convex shape.

    As a set of velocities, accelerations or jerks, a shape has their units in place of metres.
    """

    def support(self, n: FloatArray) -> FloatArray:
        """Return the largest n · x of all x in the shape [m], shape (...), for n of (..., 3)."""
        support: FloatArray = self.local_support(n) + n @ self.center
        return support

    @abc.abstractmethod
    def local_support(self, n: FloatArray) -> FloatArray:
        """Return h(n) [m], shape (...), for unit vectors n, shape (..., 3)."""

    @property
    def has_corners(self) -> bool:
        """Whether its surface has edges, where normals along a reference turn abruptly."""
        return self.quadric_inside(0.0) is None

    def quadric_inside(self, distance: float) -> Quadric | None:  # arguments are for subclasses
        """Return a quadric of the same kind inside the set within `distance` [m] of the shape.

        A bound that holds for the quadric also holds for the larger set. None if there is none.
        """
        return None


class Quadric(Shape):
    """Ball or ellipsoid, norm(scales * x) <= radius.

    Attributes:
        radius: radius of the ball that the shape is in scaled coordinates [m].
        scales: scaling of each axis, shape (3,).
    """

    radius: float
    scales: FloatArray

    def scaled(self, x: FloatArray) -> FloatArray:
        """Return positions scaled so that the shape is a ball of `radius`, (..., 3)."""
        scaled: FloatArray = x * self.scales
        return scaled
