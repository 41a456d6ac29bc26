"""Balls and ellipsoids."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import LARGEST, FloatArray, Positive, Vector, record
from drake_rho.scenario.shapes.base import Quadric

_ROUNDS = 64
"""Bound on the steps to a root: halvings of the logarithm of its bracket alone would find it."""

_LAST_DIGIT = 4e-16
"""Relative change of a root below which it is found."""

_NOTHING = 1e-30
"""Part of a shape's extent that no coordinate of a position in double precision can tell."""

_THINNEST = 1e-3 / LARGEST
"""Least semi-axis of an ellipsoid [m]: that of the closest separation with the least downwash."""


@record
class Sphere(Quadric):
    """A ball, the paper's obstacle (8).

    Examples:
        >>> rho.Sphere([0, 0, 0], 2.0).signed_distance(np.array([3.0, 0.0, 0.0]))
        np.float64(1.0)
    """

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
        distance: FloatArray = _lengths(x) - self.radius
        return distance

    def outward(self, x: FloatArray) -> FloatArray:
        """The direction of x from the centre; at the centre, that of the x axis."""
        lengths = _lengths(x)[..., None]
        if np.all(lengths > 0.0):
            normals: FloatArray = x / lengths
            return normals
        return np.where(lengths > 0.0, x / np.where(lengths > 0.0, lengths, 1.0), np.eye(3)[0])


def _lengths(x: FloatArray) -> FloatArray:
    """Of vectors, shape (..., 3): in half the time of `np.linalg.norm`."""
    lengths: FloatArray = np.sqrt(np.vecdot(x, x))
    return lengths


@record
class Ellipsoid(Quadric):
    """An ellipsoid whose axes are those of the coordinates.

    Examples:
        >>> rho.Ellipsoid([0, 0, 0], [3, 2, 1]).support(np.array([0.0, 1.0, 0.0]))
        np.float64(2.0)
    """

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
        return self.measured(x)[0]

    def outward(self, x: FloatArray) -> FloatArray:
        """The surface's normal at the point nearest to x."""
        return self.measured(x)[1]

    def measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from, and normals at, the nearest points of the surface."""
        nearest = self._nearest(x)
        distance: FloatArray = np.linalg.norm(x - nearest, axis=-1)
        inside = np.linalg.norm(x / self.semi_axes, axis=-1) < 1.0
        n = nearest / self.semi_axes**2
        normals: FloatArray = n / np.linalg.norm(n, axis=-1)[..., None]
        return np.where(inside, -distance, distance), normals

    def _nearest(self, x: FloatArray) -> FloatArray:
        """The points y of the surface nearest to x, shape (..., 3).

        With m the shortest semi-axis they are y = a² x / (a² - m² + s), where s >= 0 and
        norm(y / a) = 1. The inverse of that norm is a concave function of s, so Newton's steps
        from below stay below. Near the plane through the centre across the shortest axis s is as
        small as the distance from it, and they are slow: its logarithm is bisected beside them.
        Deep inside, on that plane, s is zero, and y lies above or below x.
        """
        a, least, ax = self.semi_axes, self.semi_axes.min(), self.semi_axes * x
        above = least * np.linalg.norm(x * (a == least), axis=-1)  # the plane's distance
        high = np.maximum(np.linalg.norm(ax, axis=-1), _NOTHING * least**2)
        s = np.maximum(above, _NOTHING * high)
        tiny = np.finfo(float).tiny
        deep = (self._length(ax, s)[0] < 1.0) & (above < s)
        for _ in range(_ROUNDS):
            length, slope = self._length(ax, s)
            step = np.maximum((length - 1.0) * length**2 / np.maximum(slope, tiny), 0.0)
            middle = np.sqrt(s * high)
            far = self._length(ax, middle)[0] > 1.0
            high = np.where(far, high, middle)
            s = np.where(far, np.maximum(middle, s + step), s + step)
            if not np.any(step[~deep] > _LAST_DIGIT * s[~deep]):
                break
        y: FloatArray = a * ax / (self._differences + s[..., None])
        y[deep] = self._above(x[deep])
        return y

    @cached_property
    def _differences(self) -> FloatArray:
        """a² - m², shape (3,)."""
        a = self.semi_axes
        differences: FloatArray = (a - a.min()) * (a + a.min())
        return differences

    def _length(self, ax: FloatArray, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """norm(y / a), and how fast half its square falls with s, each of shape (...).

        Args:
            ax: positions times the semi-axes [m²], shape (..., 3).
            s: as in `_nearest` [m²], shape (...).
        """
        divisor = self._differences + s[..., None]
        squares = (ax / divisor) ** 2
        return np.sqrt(squares.sum(axis=-1)), (squares / divisor).sum(axis=-1)

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
