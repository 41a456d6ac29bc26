"""Cylinders along an axis, with ends or endless."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from drake_rho.scenario.fields import FloatArray, Positive, Vector, record
from drake_rho.scenario.shapes.base import Shape

_LEVEL = 1e-12
"""Part along the axis up to which a direction counts as across an endless cylinder."""


@record
class Cylinder(Shape):
    """A circular cylinder along one of the axes of the coordinates.

    Examples:
        >>> pole = rho.Cylinder([0, 0, 1], 0.5, 2.0)
        >>> pole.signed_distance(np.array([2.0, 0.0, 1.0]))
        np.float64(1.5)
    """

    center: Vector
    """its middle, halfway up [m]; where it has no ends, any point of its axis"""
    radius: Positive
    """of its circle [m]"""
    height: Positive | None = None
    """from end to end [m]; endless if not given"""
    axis: Literal["x", "y", "z"] = "z"
    """along which it lies or stands"""

    if TYPE_CHECKING:  # what is made of lists too is read as arrays

        def __init__(
            self,
            center: npt.ArrayLike,
            radius: float,
            height: float | None = None,
            axis: Literal["x", "y", "z"] = "z",
        ) -> None: ...

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """As its fields have it, with one of those that tell it from a sphere."""
        described = handler(schema)
        told = [{"required": ["height"]}, {"required": ["axis"]}]
        handler.resolve_ref_schema(described)["anyOf"] = told
        return described

    def __str__(self) -> str:
        """As in 'cylinder of radius 1 m and height 2 m at [0.0, 0.0, 0.0]'."""
        height = "endless" if self.height is None else f"height {self.height:g} m"
        return f"cylinder of radius {self.radius:g} m, {height}, at {self.center.tolist()}"

    @property
    def _along(self) -> int:
        return "xyz".index(self.axis)

    @property
    def _half(self) -> float:
        """Half the height [m]."""
        return np.inf if self.height is None else self.height / 2.0

    @property
    def extent(self) -> FloatArray:
        """The radius, and half the height along the axis [m]."""
        extent = np.full(3, self.radius)
        extent[self._along] = self._half
        return extent

    def support(self, n: FloatArray) -> FloatArray:
        """R norm(n across) + H/2 |n along|; infinite where an endless one has no support."""
        along, across = self._parts(n)
        length = np.abs(along)
        round_part = self.radius * np.linalg.norm(across, axis=-1)
        if self.height is None:
            return np.where(length > _LEVEL, np.inf, round_part)
        support: FloatArray = round_part + self._half * length
        return support

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Distance from the side, an end or a rim; inside, from the nearest side or end."""
        beside, above = self._beyond(x)
        outside = np.hypot(np.maximum(beside, 0.0), np.maximum(above, 0.0))
        distance: FloatArray = outside + np.minimum(np.maximum(beside, above), 0.0)
        return distance

    def outward(self, x: FloatArray) -> FloatArray:
        """From the nearest side, end or rim; on the axis of an endless one, across it."""
        beside, above = self._beyond(x)
        along, across = self._parts(x)
        lengths = np.linalg.norm(across, axis=-1, keepdims=True)
        default = np.eye(3)[(self._along + 1) % 3]
        sideways = np.where(lengths > 0.0, across / np.where(lengths > 0.0, lengths, 1.0), default)
        upwards = np.eye(3)[self._along] * np.copysign(1.0, along)[..., None]
        inside = np.maximum(beside, above) <= 0.0
        weights = np.stack(
            [
                np.where(inside, beside >= above, np.maximum(beside, 0.0)),
                np.where(inside, beside < above, np.maximum(above, 0.0)),
            ]
        )
        weights /= np.linalg.norm(weights, axis=0)
        normals: FloatArray = weights[0][..., None] * sideways + weights[1][..., None] * upwards
        return normals

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Vectors' components along the axis, shape (...), and parts across it, (..., 3)."""
        across = np.array(x, dtype=np.float64)
        across[..., self._along] = 0.0
        return x[..., self._along], across

    def _beyond(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far beyond the side and beyond the ends positions are [m], negative within."""
        along, across = self._parts(x)
        return np.linalg.norm(across, axis=-1) - self.radius, np.abs(along) - self._half
