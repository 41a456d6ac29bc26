"""Capsules: all points within a radius of a segment."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, Positive, Vector, record
from drake_rho.scenario.shapes.base import Shape, unit_across


@record
class Capsule(Shape):
    """Cylinder with half a ball on each end, in any direction.

    Examples:
        >>> branch = rho.Capsule([0, 0, 0], [3, 0, 4], 0.5)
        >>> branch.signed_distance(np.array([3.0, 0.0, 6.0]))
        np.float64(1.5)
    """

    start: Vector
    """one end of the segment [m]"""
    end: Vector
    """other end of the segment [m]"""
    radius: Positive
    """distance from the segment within which all points belong to it [m]"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

        def __init__(self, start: npt.ArrayLike, end: npt.ArrayLike, radius: float) -> None: ...

    def __str__(self) -> str:
        """Return a description: 'capsule of radius 1 m from [0.0, 0.0, 0.0] to [...]'."""
        ends = f"from {self.start.tolist()} to {self.end.tolist()}"
        return f"capsule of radius {self.radius:g} m {ends}"

    @cached_property
    def center(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Centre [m]."""
        center: FloatArray = (self.start + self.end) / 2.0
        return center

    @cached_property
    def half(self) -> FloatArray:
        """Vector from the centre to the end of the segment [m], shape (3,)."""
        half: FloatArray = (self.end - self.start) / 2.0
        return half

    @property
    def extent(self) -> FloatArray:
        """Half the sides of the bounding box [m]."""
        extent: FloatArray = np.abs(self.half) + self.radius
        return extent

    @property
    def thickness(self) -> float:
        """Radius, half the width that a motion has to go around [m]."""
        return self.radius

    @property
    def has_corners(self) -> bool:
        """Whether its surface has edges: it has none, normals turn steadily."""
        return False

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return |n · half| plus the radius."""
        support: FloatArray = np.abs(n @ self.half) + self.radius
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the segment less the radius."""
        distance: FloatArray = np.linalg.norm(self._away(x), axis=-1) - self.radius
        return distance

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return directions from the nearest point of the segment.

        On the segment, the direction is an arbitrary one across it.
        """
        away = self._away(x)
        lengths = np.linalg.norm(away, axis=-1, keepdims=True)
        off = lengths > 0.0
        outward: FloatArray = np.where(off, away / np.where(off, lengths, 1.0), self._across)
        return outward

    def _away(self, x: FloatArray) -> FloatArray:
        """Return vectors to x from the nearest point of the segment [m], shape (..., 3)."""
        squared = float(self.half @ self.half)
        along: FloatArray = np.clip(x @ self.half / (squared or 1.0), -1.0, 1.0)
        away: FloatArray = x - along[..., None] * self.half
        return away

    @cached_property
    def _across(self) -> FloatArray:
        """A unit vector across the segment, shape (3,)."""
        return unit_across(self.half) if self.half.any() else np.array([1.0, 0.0, 0.0])
