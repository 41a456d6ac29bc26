"""Balls and ellipsoids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray, Positive, Vector, record
from drake_rho.scenario.shapes import Quadric

_BISECTIONS = 64
"""Halvings of the bracket of a root's logarithm: past the last digit of a double."""

_NOTHING = 1e-30
"""Part of a shape's extent that no coordinate of a position in double precision can tell."""

_THINNEST = 1e-3 / LARGEST
"""Least semi-axis of an ellipsoid [m]: that of the closest separation with the least downwash."""


@record
class Sphere(Quadric):
    """A ball, the paper's obstacle (8)."""

    center: Vector
    """p_m [m]"""
    radius: Positive
    """R_m [m]"""

    if TYPE_CHECKING:  # what is made of lists too is read as arrays

        def __init__(self, center: npt.ArrayLike, radius: float) -> None: ...

    def __str__(self) -> str:
        """As in 'sphere of radius 1 m at [0.0, 0.0, 0.0]'."""
        return f"sphere of radius {self.radius:g} m at {self.center.tolist()}"

    @property
    def extent(self) -> FloatArray:
        """The radius, along every axis [m]."""
        return np.full(3, self.radius)

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """One for each axis."""
        return np.ones(3)

    def quadric_inside(self, kept: float) -> Sphere:
        """The whole set around it is a ball."""
        return Sphere(self.center, self.radius + kept)

    def support(self, n: FloatArray) -> FloatArray:
        """The radius, in every direction."""
        return np.full(n.shape[:-1], self.radius)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Distance from the centre less the radius."""
        distance: FloatArray = np.linalg.norm(x, axis=-1) - self.radius
        return distance

    def outward(self, x: FloatArray) -> FloatArray:
        """The direction of x from the centre; at the centre, that of the x axis."""
        normals = self.scaled_normal(x)
        return np.where(np.isnan(normals), np.array([1.0, 0.0, 0.0]), normals)


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
        if not np.all(self.semi_axes >= _THINNEST):
            expected = f"three numbers above 0, of at least {_THINNEST:g}"
            raise ScenarioError("semi_axes", self.semi_axes.tolist(), expected)
        return self

    def __str__(self) -> str:
        """As in 'ellipsoid of semi-axes [1.0, 1.0, 2.0] m at [0.0, 0.0, 0.0]'."""
        return f"ellipsoid of semi-axes {self.semi_axes.tolist()} m at {self.center.tolist()}"

    @property
    def extent(self) -> FloatArray:
        """The semi-axes [m]."""
        return self.semi_axes

    @property
    def radius(self) -> float:  # type: ignore[override]  # derived here
        """The first semi-axis [m]."""
        return float(self.semi_axes[0])

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """The first semi-axis over each."""
        scales: FloatArray = self.semi_axes[0] / self.semi_axes
        return scales

    def quadric_inside(self, kept: float) -> Ellipsoid:
        """With semi-axes that much longer: its support is no more than that of the set."""
        return Ellipsoid(self.center, self.semi_axes + kept)

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
        """The points y of the surface nearest to x, shape (..., 3).

        With m the shortest semi-axis they are y = a² x / (a² - m² + s), where s >= 0 and
        norm(y / a) = 1. That norm falls with s, so bisection finds it, in its logarithm, since
        near the plane through the centre across the shortest axis s is as small as the distance
        from it. Deep inside, on that plane, s is zero, and y lies above or below x.
        """
        a = self.semi_axes
        shortest = a == a.min()
        above = np.linalg.norm(x * shortest, axis=-1)  # the plane across the shortest axis
        high = np.maximum(np.linalg.norm(a * x, axis=-1), _NOTHING * a.min() ** 2)
        low = np.maximum(a.min() * above, _NOTHING * high)
        deep = self._length(x, low) < 1.0
        deep &= a.min() * above < low
        for _ in range(_BISECTIONS):
            s = np.sqrt(low * high)
            far = self._length(x, s) > 1.0
            low, high = np.where(far, s, low), np.where(far, high, s)
        y: FloatArray = a**2 * x / (self._differences + high[..., None])
        y[deep] = self._above(x[deep])
        return y

    @property
    def _differences(self) -> FloatArray:
        """a² - m², shape (3,)."""
        a = self.semi_axes
        differences: FloatArray = (a - a.min()) * (a + a.min())
        return differences

    def _length(self, x: FloatArray, s: FloatArray) -> FloatArray:
        """norm(y / a), shape (...)."""
        length: FloatArray = np.linalg.norm(
            self.semi_axes * x / (self._differences + s[..., None]), axis=-1
        )
        return length

    def _above(self, x: FloatArray) -> FloatArray:
        """The points nearest to x, shape (D, 3), deep inside on the plane across the shortest axis.

        Two are equally near: that on the side of x, or else that on the positive side.
        """
        a = self.semi_axes
        least = np.argmin(a)
        longer = a > a[least]
        y = np.zeros_like(x)
        y[:, longer] = a[longer] ** 2 * x[:, longer] / self._differences[longer]
        rest = 1.0 - np.sum((y / a) ** 2, axis=-1)
        y[:, least] = np.copysign(a[least] * np.sqrt(np.maximum(0.0, rest)), x[:, least])
        return y
