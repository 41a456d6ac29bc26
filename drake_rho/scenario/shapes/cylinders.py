"""Cylinders along a coordinate axis, finite or endless."""

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
"""Component along the axis up to which a unit vector counts as normal to an endless cylinder."""


@record
class Cylinder(Shape):
    """Circular cylinder along one of the coordinate axes.

    Examples:
        >>> pole = rho.Cylinder([0, 0, 1], 0.5, 2.0)
        >>> pole.signed_distance(np.array([2.0, 0.0, 1.0]))
        np.float64(1.5)
    """

    center: Vector
    """centre, at half the height [m]; any point of the axis of an endless cylinder"""
    radius: Positive
    """radius [m]"""
    height: Positive | None = None
    """length from end to end [m]; endless if not given"""
    axis: Literal["x", "y", "z"] = "z"
    """coordinate axis to which it is parallel"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

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
        """Return the schema, which requires a field that distinguishes a cylinder from a sphere."""
        own_schema = handler(schema)
        distinguishing = [{"required": ["height"]}, {"required": ["axis"]}]
        handler.resolve_ref_schema(own_schema)["anyOf"] = distinguishing
        return own_schema

    def __str__(self) -> str:
        """Return a description: 'cylinder of radius 1 m, height 2 m, at [0.0, 0.0, 0.0]'."""
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
        """Radius, and half the height along the axis [m]."""
        extent = np.full(3, self.radius)
        extent[self._along] = self._half
        return extent

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return R norm(n across) + H/2 |n along|; infinite where the shape is unbounded."""
        along, across = self._parts(n)
        length = np.abs(along)
        round_part = self.radius * np.linalg.norm(across, axis=-1)
        if self.height is None:
            return np.where(length > _LEVEL, np.inf, round_part)
        support: FloatArray = round_part + self._half * length
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the side, an end or a rim; inside, from the side or nearest end."""
        beside, above = self._beyond(x)
        outside = np.hypot(np.maximum(beside, 0.0), np.maximum(above, 0.0))
        distance: FloatArray = outside + np.minimum(np.maximum(beside, above), 0.0)
        return distance

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return directions from the nearest side, end or rim.

        On the axis of an endless cylinder, the direction is an arbitrary one across it.
        """
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
        """Return components along the axis, shape (...), and the vectors across it, (..., 3)."""
        across = np.array(x, dtype=np.float64)
        across[..., self._along] = 0.0
        return x[..., self._along], across

    def _beyond(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances beyond the side and beyond the ends [m], negative within them."""
        along, across = self._parts(x)
        return np.linalg.norm(across, axis=-1) - self.radius, np.abs(along) - self._half
