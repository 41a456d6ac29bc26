"""Convex sets to keep out of, each by three functions of a position measured from its centre.

With the support function h(n) = max n · y over the set, the half-space n · x >= h(n) lies outside
the set for every unit vector n: that is all that a planner needs to know of a shape. The kinds are
`quadrics`, `polyhedra` and `cylinders`, in modules of these names.
"""

from __future__ import annotations

import abc
from functools import cached_property

import numpy as np

from drake_rho.scenario.errors import ScenarioError, Words
from drake_rho.scenario.fields import FloatArray

TOLERANCE = 1e-6
"""Relative tolerance to which a constraint counts as held, everywhere in the package: of a
shape's size, of the length scale of a vehicle's motion, of a box's side if that is less."""

THINNEST = 1e-4
"""Least extent of an obstacle, in parts of its greatest: thinner, it is a sheet or a thread, whose
inside is within the tolerance."""


class Shape(abc.ABC):
    """A convex set. Positions x are measured from its centre [m], shape (..., 3)."""

    center: FloatArray
    """the middle of its bounding box [m], shape (3,)"""

    @property
    @abc.abstractmethod
    def extent(self) -> FloatArray:
        """Half the sides of its bounding box [m], shape (3,); infinite where it has no end."""

    @cached_property
    def size(self) -> float:
        """What its tolerance is a part of: the greatest finite extent [m]."""
        return float(np.max(self.extent, where=np.isfinite(self.extent), initial=0.0))

    @cached_property
    def tolerance(self) -> float:
        """How deep inside still counts as outside: `TOLERANCE` of the size [m]."""
        return TOLERANCE * self.size

    @abc.abstractmethod
    def support(self, n: FloatArray) -> FloatArray:
        """h(n) [m], shape (...), for unit vectors n, shape (..., 3)."""

    @abc.abstractmethod
    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Distance of x from the surface [m], negative inside, shape (...)."""

    @abc.abstractmethod
    def outward(self, x: FloatArray) -> FloatArray:
        """Unit vectors from the nearest point of the set to x, shape (..., 3).

        Inside, towards the nearest point of the surface, or one of several that are as near.
        """

    def measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`signed_distance` and `outward` of x; together where that takes no longer than one."""
        return self.signed_distance(x), self.outward(x)

    def quadric_inside(self, kept: float) -> Quadric | None:  # of no use here
        """A ball or an ellipsoid, like itself, in the set that is up to `kept` [m] around it.

        For bounds that hold for the set because they hold for less; None where it has none.
        """
        return None

    @abc.abstractmethod
    def __str__(self) -> str:
        """Kind, place and measures, in words."""

    def check_solid(self) -> None:
        """See that the shape has an inside, as what is kept out of needs one.

        Raises:
            ScenarioError: it is flat.
        """
        if self.extent.min() < max(THINNEST * self.size, np.finfo(float).tiny):
            sides = Words(f"sides of {(2.0 * self.extent).tolist()} m")
            expected = f"none below {THINNEST:g} of the greatest: what is flat has no inside"
            raise ScenarioError("", sides, expected)


class Quadric(Shape):
    """A ball or an ellipsoid: norm(scales * x) <= radius.

    Attributes:
        radius: of the ball that it is in scaled coordinates [m].
        scales: of each axis, shape (3,).
    """

    radius: float
    scales: FloatArray

    def scaled(self, x: FloatArray) -> FloatArray:
        """Positions in coordinates in which the set is a ball of `radius`, shape (..., 3)."""
        scaled: FloatArray = x * self.scales
        return scaled

    def scaled_normal(self, x: FloatArray) -> FloatArray:
        """Unit normals, at x, of the scaled copy of the surface that goes through x.

        For an ellipsoid it is not `outward`, and cheaper. A point x outside the set is on the
        outer side of the half-space that has this normal, as it is with `outward`. NaN at the
        centre.
        """
        n = x * self.scales**2
        with np.errstate(invalid="ignore"):
            normals: FloatArray = n / np.sqrt(np.einsum("...i,...i->...", n, n))[..., None]
        return normals
