"""Convex shapes in another pose, and the union of all shapes that files can describe."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Discriminator, GetJsonSchemaHandler, Tag
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from drake_rho.scenario.fields import FloatArray, Vector, read_only, record, record_kind
from drake_rho.scenario.rotations import Rotation
from drake_rho.scenario.shapes.base import Quadric, Shape
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere

POSE = ("rotation", "translation")
"""Keys of a pose, which only `Posed` has among the shapes."""

KINDS = {
    "Polytope": ("vertices",),
    "Capsule": ("start", "end"),
    "Ellipsoid": ("semi_axes",),
    "Box": ("lower", "upper"),
    "Cylinder": ("height", "axis"),
    "Sphere": ("center", "radius"),
}
"""Keys that identify the shape that a mapping describes; of several, the first in this order."""


def _kind(value: object) -> str:
    return record_kind(value, {"Posed": ("shape", *POSE), **KINDS}, "Sphere")


_Basic = (
    Annotated[Sphere, Tag("Sphere")]
    | Annotated[Box, Tag("Box")]
    | Annotated[Ellipsoid, Tag("Ellipsoid")]
    | Annotated[Cylinder, Tag("Cylinder")]
    | Annotated[Capsule, Tag("Capsule")]
    | Annotated[Polytope, Tag("Polytope")]
)
ConvexShape = Annotated[_Basic | Annotated["Posed", Tag("Posed")], Discriminator(_kind)]
"""One of the shapes of `AnyConvex`, identified by its keys in a file. It is for fields of `Posed`:
defined before, so that pydantic does not complete the record later and undo what `record` adds."""


@record
class Posed(Shape):
    """Convex shape in another pose: rotated about the origin, then translated.

    Examples:
        >>> beam = rho.Posed(rho.Box([-2, -0.1, -0.1], [2, 0.1, 0.1]), rotation=[0, 0, np.pi / 2])
        >>> beam.extent.round(6).tolist()
        [0.1, 2.0, 0.1]
    """

    shape: ConvexShape
    """shape before rotation and translation"""
    rotation: Rotation = dataclasses.field(default_factory=lambda: read_only(np.eye(3)))
    """rotation about the origin: roll, pitch and yaw [rad], or a matrix; none if not given"""
    translation: Vector = dataclasses.field(default_factory=lambda: read_only(np.zeros(3)))
    """translation after the rotation [m]; none if not given"""

    if TYPE_CHECKING:  # the constructor also accepts lists and Drake's rotations

        def __init__(
            self, shape: Shape, rotation: object = ..., translation: npt.ArrayLike = ...
        ) -> None: ...

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema, which requires a field that distinguishes it from an obstacle."""
        own_schema = handler(schema)
        handler.resolve_ref_schema(own_schema)["anyOf"] = [{"required": [key]} for key in POSE]
        return own_schema

    def __str__(self) -> str:
        """Return a description: the shape's own, and the position of its centre."""
        return f"{self.shape}, posed around {np.round(self.center, 3).tolist()}"

    @cached_property
    def _box(self) -> tuple[FloatArray, FloatArray]:
        """Middle and half sides of the bounding box, relative to the posed centre of the shape."""
        upper = self.shape.local_support(self.rotation)  # rows: the axes in the shape's frame
        lower = self.shape.local_support(-self.rotation)
        finite = np.isfinite(upper) & np.isfinite(lower)
        difference = np.subtract(upper, lower, out=np.zeros(3), where=finite)
        return difference / 2.0, np.where(finite, (upper + lower) / 2.0, np.inf)

    @cached_property
    def center(self) -> FloatArray:  # type: ignore[override]  # derived here
        """Centre of the bounding box [m]; a point of the axis of an endless cylinder."""
        center: FloatArray = self.rotation @ self.shape.center + self.translation + self._box[0]
        return center

    @property
    def extent(self) -> FloatArray:
        """Half the sides of the bounding box [m]; infinite where it is endless."""
        return self._box[1]

    @property
    def size(self) -> float:
        """Size of the shape before it is posed [m], which no rotation changes."""
        return self.shape.size

    @property
    def thickness(self) -> float:
        """Thickness of the shape before it is posed [m]."""
        return self.shape.thickness

    @property
    def has_corners(self) -> bool:
        """Whether the shape has edges, in any pose."""
        return self.shape.has_corners

    def check_solid(self) -> None:
        """Check that the shape has an interior.

        Raises:
            ScenarioError: the shape is flat.
        """
        self.shape.check_solid()

    def quadric_inside(self, distance: float) -> Quadric | None:
        """Return the ball of all points within `distance` of a ball; None for other shapes."""
        if isinstance(self.shape, Sphere | Posed):
            inner = self.shape.quadric_inside(distance)
            return None if inner is None else Sphere(self.center, inner.radius)
        return None

    def local_support(self, n: FloatArray) -> FloatArray:
        """Return the support function, evaluated in the shape's own frame."""
        support: FloatArray = self.shape.local_support(n @ self.rotation) - n @ self._box[0]
        return support

    def local_distance(self, x: FloatArray) -> FloatArray:
        """Return distances, evaluated in the shape's own frame."""
        return self.shape.local_distance(self._seen(x))

    def local_outward(self, x: FloatArray) -> FloatArray:
        """Return directions of the shape, rotated back."""
        outward: FloatArray = self.shape.local_outward(self._seen(x)) @ self.rotation.T
        return outward

    def local_measured(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `local_distance` and `local_outward` of x, together where that is faster."""
        distances, normals = self.shape.local_measured(self._seen(x))
        return distances, normals @ self.rotation.T

    def _seen(self, x: FloatArray) -> FloatArray:
        """Return positions relative to the shape's own centre, along its own axes."""
        seen: FloatArray = (x + self._box[0]) @ self.rotation
        return seen


AnyConvex = _Basic | Annotated[Posed, Tag("Posed")]
"""One of the convex shapes that are at most endless along a line, by the name of its type."""
