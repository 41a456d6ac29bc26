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
"""Bound on the iterations of root finding; bisection of the root's logarithm alone needs fewer."""

_LAST_DIGIT = 4e-16
"""Relative change of a root at which the iteration has converged."""

_NOTHING = 1e-30
"""Part of a shape's extent that is below the rounding of any position in double precision."""

_THINNEST = 1e-3 / LARGEST
"""Least semi-axis of an ellipsoid [m]: that of the least separation with the least downwash."""


@record
class Sphere(Quadric):
    """Ball, the paper's obstacle (8).

    Examples:
        >>> rho.Sphere([0, 0, 0], 2.0).signed_distance(np.array([3.0, 0.0, 0.0]))
        np.float64(1.0)
    """

    center: Vector
    """centre p_m [m]"""
    radius: Positive
    """radius R_m [m]"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

        def __init__(self, center: npt.ArrayLike, radius: float) -> None: ...

    def __str__(self) -> str:
        """Return a description: 'sphere of radius 1 m at [0.0, 0.0, 0.0]'."""
        return f"sphere of radius {self.radius:g} m at {self.center.tolist()}"

    @property
    def extent(self) -> FloatArray:
        """Radius, along every axis [m]."""
        return np.full(3, self.radius)

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Scaling of each axis, which is 1."""
        return np.ones(3)

    def quadric_inside(self, distance: float) -> Sphere:
        """Return the ball of all points within `distance`, which is the whole set."""
        return Sphere(self.center, self.radius + distance)

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return the radius for every direction."""
        return self.radius + np.zeros(n.shape[:-1])

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the centre less the radius."""
        distance: FloatArray = _lengths(x) - self.radius
        return distance

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return the directions of x from the centre; at the centre, that of the x axis."""
        lengths = _lengths(x)[..., None]
        if (lengths > 0.0).all():
            normals: FloatArray = x / lengths
            return normals
        return np.where(lengths > 0.0, x / np.where(lengths > 0.0, lengths, 1.0), np.eye(3)[0])


def _lengths(x: FloatArray) -> FloatArray:
    """Return the norms of vectors, shape (..., 3), in half the time of `np.linalg.norm`."""
    lengths: FloatArray = np.sqrt(np.vecdot(x, x))
    return lengths


def _sums(rows: FloatArray) -> FloatArray:
    """Return the sums of the coordinates, rows of shape (3, M)."""
    sums: FloatArray = np.add.reduce(rows, axis=0)
    return sums


def _lengths_of(rows: FloatArray) -> FloatArray:
    """Return the norms of vectors with coordinates in rows, shape (3, M)."""
    lengths: FloatArray = np.sqrt(_sums(rows * rows))
    return lengths


@record
class Ellipsoid(Quadric):
    """Axis-aligned ellipsoid.

    Examples:
        >>> rho.Ellipsoid([0, 0, 0], [3, 2, 1]).support(np.array([0.0, 1.0, 0.0]))
        np.float64(2.0)
    """

    center: Vector
    """centre [m]"""
    semi_axes: Vector
    """semi-axes along x, y and z [m]"""

    if TYPE_CHECKING:

        def __init__(self, center: npt.ArrayLike, semi_axes: npt.ArrayLike) -> None: ...

    @model_validator(mode="after")
    def _has_extent(self) -> Ellipsoid:
        if not np.all(self.semi_axes >= _THINNEST):
            expected = f"three numbers above 0, of at least {_THINNEST:g}"
            raise ScenarioError("semi_axes", self.semi_axes.tolist(), expected)
        return self

    def __str__(self) -> str:
        """Return a description: 'ellipsoid of semi-axes [1.0, 1.0, 2.0] m at [0.0, 0.0, 0.0]'."""
        return f"ellipsoid of semi-axes {self.semi_axes.tolist()} m at {self.center.tolist()}"

    @property
    def extent(self) -> FloatArray:
        """Semi-axes [m]."""
        return self.semi_axes

    @property
    def radius(self) -> float:  # type: ignore[override]  # derived here
        """First semi-axis [m], the radius in scaled coordinates."""
        return float(self.semi_axes[0])

    @property
    def scales(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Scaling of each axis: the first semi-axis over that of the axis."""
        scales: FloatArray = self.semi_axes[0] / self.semi_axes
        return scales

    def quadric_inside(self, distance: float) -> Ellipsoid:
        """Return the ellipsoid with semi-axes longer by `distance`.

        It lies in the set, since its support function is nowhere larger than that of the set.
        """
        return Ellipsoid(self.center, self.semi_axes + distance)

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return norm(A n), where A has the semi-axes on its diagonal."""
        support: FloatArray = np.linalg.norm(n * self.semi_axes, axis=-1)
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the nearest point of the surface, negative inside."""
        return self._distance(x, self._nearest(x))

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return the normals of the surface at the points nearest to x."""
        return self.local_measured(x)[1]

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distances from the nearest points of the surface, and normals there."""
        nearest = self._nearest(x)
        n = nearest / self.semi_axes**2
        normals: FloatArray = n / np.linalg.norm(n, axis=-1)[..., None]
        return self._distance(x, nearest), normals

    def _distance(self, x: FloatArray, nearest: FloatArray) -> FloatArray:
        """Return signed distances from the nearest points of the surface (..., 3)."""
        distance: FloatArray = np.linalg.norm(x - nearest, axis=-1)
        inside = np.linalg.norm(x / self.semi_axes, axis=-1) < 1.0
        return np.where(inside, -distance, distance)

    def _nearest(self, x: FloatArray) -> FloatArray:
        """Return the points y of the surface that are nearest to x, shape (..., 3).

        With the shortest semi-axis m, y = a² x / (a² - m² + s), where s >= 0 solves
        norm(y / a) = 1. The inverse of that norm is a concave function of s, so Newton's iteration
        from below stays below the root. Near the plane through the centre and normal to the
        shortest axis, s is as small as the distance from that plane and the iteration is slow, so
        that each iteration also bisects the logarithm of s. Deep inside, on that plane, s is zero
        and y lies above or below x.

        Arrays are of shape (3, M) here, a row for each coordinate: their sums are fast.
        """
        rows = x.reshape(-1, 3).T
        a, least = self.semi_axes[:, None], self.semi_axes.min()
        ax = a * rows
        above = least * _lengths_of(rows * (a == least))  # m times the plane's distance
        high = np.maximum(_lengths_of(ax), _NOTHING * least**2)
        s = np.maximum(above, _NOTHING * high)
        tiny = np.finfo(float).tiny
        deep = (_lengths_of(ax / (self._differences + s)) < 1.0) & (above < s)
        for _ in range(_ROUNDS):
            divisor = self._differences + s
            squares = (ax / divisor) ** 2
            length, slope = np.sqrt(_sums(squares)), _sums(squares / divisor)
            step = np.maximum((length - 1.0) * length**2 / np.maximum(slope, tiny), 0.0)
            middle = np.sqrt(s * high)
            far = _lengths_of(ax / (self._differences + middle)) > 1.0
            high = np.where(far, high, middle)
            s = np.where(far, np.maximum(middle, s + step), s + step)
            if not ((step > _LAST_DIGIT * s) & ~deep).any():
                break
        y: FloatArray = np.ascontiguousarray((a * ax / (self._differences + s)).T)
        if deep.any():
            y[deep] = self._nearest_on_plane(rows.T[deep])
        return y.reshape(x.shape)

    @cached_property
    def _differences(self) -> FloatArray:
        """a² - m², shape (3, 1)."""
        a = self.semi_axes[:, None]
        differences: FloatArray = (a - a.min()) * (a + a.min())
        return differences

    def _nearest_on_plane(self, x: FloatArray) -> FloatArray:
        """Return the points of the surface nearest to x, shape (D, 3), on the plane s = 0.

        These positions are deep inside, on the plane normal to the shortest axis (`_nearest`). Of
        the two nearest points, the one on the side of x is returned, by default the positive one.
        """
        a = self.semi_axes
        least = np.argmin(a)
        longer = a > a[least]
        y = np.zeros_like(x)
        y[:, longer] = a[longer] ** 2 * x[:, longer] / self._differences[longer, 0]
        rest = 1.0 - np.sum((y / a) ** 2, axis=-1)
        y[:, least] = np.copysign(a[least] * np.sqrt(np.maximum(0.0, rest)), x[:, least])
        return y
