"""Convex sets to keep out of, each by three functions of a position measured from its centre.

With the support function h(n) = max n · y over the set, the half-space n · x >= h(n) lies outside
the set for every unit vector n: that is all that a planner needs to know of a shape.
"""

from __future__ import annotations

import abc
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, Positive, Vector, record

TOLERANCE = 1e-6
"""Relative tolerance to which a constraint counts as held, everywhere in the package: of a
shape's size, of the length scale of a vehicle's motion, of a box's side if that is less."""

_BISECTIONS = 100
"""Halvings of the bracket of a root: past the last digit of a double."""


class Shape(abc.ABC):
    """A convex set. Positions x are measured from its centre [m], shape (..., 3)."""

    size: float
    """what its tolerance is a part of [m]"""

    @property
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

        Inside, towards the nearest point of the surface; NaN where there is no nearest one.
        """


class Quadric(Shape):
    """A ball or an ellipsoid: norm(scales * x) <= size.

    Attributes:
        scales: of each axis, shape (3,).
    """

    scales: FloatArray

    def scaled(self, x: FloatArray) -> FloatArray:
        """Positions in coordinates in which the set is a ball of radius `size`, shape (..., 3)."""
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


@record
class Sphere(Quadric):
    """A ball; as an obstacle (8) it stands still."""

    center: Vector
    """p_m [m]"""
    radius: Positive
    """R_m [m]"""

    if TYPE_CHECKING:  # what is made of lists too is read as arrays

        def __init__(self, center: npt.ArrayLike, radius: float) -> None: ...

    @property
    def size(self) -> float:  # type: ignore[override]  # derived here
        """The radius [m]."""
        return self.radius

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """One for each axis."""
        return np.ones(3)

    def support(self, n: FloatArray) -> FloatArray:
        """The radius, in every direction."""
        return np.full(n.shape[:-1], self.radius)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Distance from the centre less the radius."""
        distance: FloatArray = np.linalg.norm(x, axis=-1) - self.radius
        return distance

    def outward(self, x: FloatArray) -> FloatArray:
        """The direction of x from the centre."""
        return self.scaled_normal(x)


@record
class Ellipsoid(Quadric):
    """An ellipsoid whose axes are those of the coordinates."""

    center: Vector
    """its middle [m]"""
    semi_axes: Vector
    """half its extent along x, y and z [m]"""

    if TYPE_CHECKING:

        def __init__(self, center: npt.ArrayLike, semi_axes: npt.ArrayLike) -> None: ...

    @model_validator(mode="after")
    def _has_extent(self) -> Ellipsoid:
        if not np.all(self.semi_axes > 0.0):
            raise ScenarioError("semi_axes", self.semi_axes.tolist(), "three numbers above 0")
        return self

    @property
    def size(self) -> float:  # type: ignore[override]  # derived here
        """The first semi-axis [m]."""
        return float(self.semi_axes[0])

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """The first semi-axis over each."""
        scales: FloatArray = self.semi_axes[0] / self.semi_axes
        return scales

    def support(self, n: FloatArray) -> FloatArray:
        """norm(A n) with the semi-axes on the diagonal of A."""
        support: FloatArray = np.linalg.norm(n * self.semi_axes, axis=-1)
        return support

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Distance from the nearest point of the surface, negative inside."""
        distance: FloatArray = np.linalg.norm(x - self._nearest(x), axis=-1)
        return np.where(np.linalg.norm(x / self.semi_axes, axis=-1) < 1.0, -distance, distance)

    def outward(self, x: FloatArray) -> FloatArray:
        """The surface's normal at the point nearest to x."""
        n = self._nearest(x) / self.semi_axes**2
        normals: FloatArray = n / np.linalg.norm(n, axis=-1)[..., None]
        return normals

    def _nearest(self, x: FloatArray) -> FloatArray:
        """The points of the surface nearest to x, shape (..., 3).

        They are y = a² x / (a² + t), where norm(y / a) = 1: t lies above minus the least a² and
        the norm falls with t, so bisection finds it. Where x has no component along the shortest
        axis and lies deep inside, t stays at its end and that component is what is missing.
        """
        a = self.semi_axes
        least = np.argmin(a)
        low = np.full(x.shape[:-1], -(a[least] ** 2))
        high = a.max() * np.linalg.norm(x, axis=-1)  # where the norm is at most one
        for _ in range(_BISECTIONS):
            t = (low + high) / 2.0
            with np.errstate(divide="ignore", invalid="ignore"):
                far = np.nansum((a * x / (a**2 + t[..., None])) ** 2, axis=-1) > 1.0
            low, high = np.where(far, t, low), np.where(far, high, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            y: FloatArray = np.nan_to_num(a**2 * x / (a**2 + high[..., None]))
        missing = np.sqrt(np.maximum(0.0, 1.0 - np.sum((y / a) ** 2, axis=-1)))
        y[..., least] += np.where(x[..., least] < 0.0, -1.0, 1.0) * a[least] * missing
        return y
