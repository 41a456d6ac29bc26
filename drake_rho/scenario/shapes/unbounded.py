"""Unbounded convex sets: half-spaces and cones. They cannot be obstacles: nothing encloses them.

Their three functions are in absolute coordinates, in the unit of the quantity that they contain.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, Tag, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import NOT_BOOLEAN, BoolArray, Finite, FloatArray, Vector, record
from drake_rho.scenario.shapes.base import unit_across

_PARALLEL = 1e-9
"""Angle [rad] up to which a direction counts as one in which a set is bounded: that of a normal of
its surface, to within rounding."""


@record
class HalfSpace:
    """Half-space normal · x <= offset, such as everything above a floor.

    Examples:
        >>> floor = rho.HalfSpace([0, 0, -1], -2.0)  # z >= 2
        >>> floor.signed_distance(np.array([0.0, 0.0, 5.0]))
        np.float64(-3.0)
    """

    normal: Vector
    """outward normal, of any length above 0; the offset refers to this length"""
    offset: Finite
    """largest normal · x"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

        def __init__(self, normal: npt.ArrayLike, offset: float) -> None: ...

    @model_validator(mode="after")
    def _has_a_normal(self) -> Self:
        if not np.any(self.normal):
            raise ScenarioError("normal", self.normal.tolist(), "a vector other than zero")
        return self

    def __str__(self) -> str:
        """Return a description: 'half-space [0.0, 0.0, -1.0] · x <= -2'."""
        return f"half-space {self.normal.tolist()} · x <= {self.offset:g}"

    @cached_property
    def _unit(self) -> FloatArray:
        """Unit normal, shape (3,)."""
        unit: FloatArray = self.normal / np.linalg.norm(self.normal)
        return unit

    @cached_property
    def _bound(self) -> float:
        """Largest component along the unit normal."""
        return self.offset / float(np.linalg.norm(self.normal))

    def support(self, n: FloatArray) -> FloatArray:
        """Return the largest n · x, shape (...): infinite unless n is the outward normal."""
        off = np.linalg.norm(n - self._unit, axis=-1)
        return np.where(off <= _PARALLEL, self._bound, np.inf)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances of x (..., 3) from the boundary plane, negative inside, (...)."""
        distance: FloatArray = x @ self._unit - self._bound
        return distance

    def outward(self, x: FloatArray) -> FloatArray:
        """Return the outward unit normal for every x, shape (..., 3)."""
        return np.broadcast_to(self._unit, np.shape(x))


@record
class Cone:
    """Circular cone that opens from its apex along an axis.

    Examples:
        >>> forwards = rho.Cone([0, 0, 0], [1, 0, 0], 0.5)  # of velocities, say
        >>> forwards.signed_distance(np.array([2.0, 0.0, 0.0])) < 0.0
        np.True_
    """

    apex: Vector
    """point of the cone from which it opens"""
    axis: Vector
    """direction in which it opens, of any length above 0"""
    half_angle: Annotated[float, Field(gt=1e-6, lt=np.pi / 2.0, allow_inf_nan=False), NOT_BOOLEAN]
    """angle between the axis and the surface [rad], less than a right angle"""

    if TYPE_CHECKING:

        def __init__(self, apex: npt.ArrayLike, axis: npt.ArrayLike, half_angle: float) -> None: ...

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if not np.any(self.axis):
            raise ScenarioError("axis", self.axis.tolist(), "a vector other than zero")
        return self

    def __str__(self) -> str:
        """Return a description: 'cone of half-angle 0.5 rad along [1.0, 0.0, 0.0] from [...]'."""
        along = f"along {self.axis.tolist()} from {self.apex.tolist()}"
        return f"cone of half-angle {self.half_angle:g} rad {along}"

    @cached_property
    def _along(self) -> FloatArray:
        """Unit vector of the axis, shape (3,)."""
        along: FloatArray = self.axis / np.linalg.norm(self.axis)
        return along

    @cached_property
    def _across(self) -> FloatArray:
        """A unit vector orthogonal to the axis, shape (3,)."""
        return unit_across(self._along)

    @property
    def matrix(self) -> FloatArray:
        """Matrix with a row a above B, such that norm(B (x - apex)) <= a · (x - apex), (4, 3)."""
        onto = np.eye(3) - np.outer(self._along, self._along)
        up, beside = np.sin(self.half_angle) * self._along, np.cos(self.half_angle) * onto
        return np.vstack([up, beside])

    def support(self, n: FloatArray) -> FloatArray:
        """Return n · apex where n points away from the cone, else infinity, shape (...).

        The cone is bounded in the directions whose angle to the axis is a right angle and the
        half-angle or more.
        """
        up = n @ self._along
        beside = np.linalg.norm(n - up[..., None] * self._along, axis=-1)
        angle = np.arctan2(beside, up)
        bounded = angle >= np.pi / 2.0 + self.half_angle - _PARALLEL
        return np.where(bounded, n @ self.apex, np.inf)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances of x (..., 3) from the surface, negative inside, shape (...)."""
        beside, up, _ = self._parts(x)
        return distance_from_cone(beside, up, self.half_angle)

    def outward(self, x: FloatArray) -> FloatArray:
        """Return normals of the surface; directions from the apex where that is nearest, (..., 3).

        On the axis, the normal is one of several that are as near.
        """
        beside, up, sideways = self._parts(x)
        level, along = outward_of_cone(beside, up, self.half_angle)
        outward: FloatArray = level[..., None] * sideways + along[..., None] * self._along
        return outward

    def _parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distances from the axis, heights above the apex, and directions off the axis."""
        y = x - self.apex
        up = y @ self._along
        off = y - up[..., None] * self._along
        beside = np.linalg.norm(off, axis=-1)
        away = beside > 0.0
        sideways = np.where(
            away[..., None], off / np.where(away, beside, 1.0)[..., None], self._across
        )
        return beside, up, sideways


def distance_from_cone(beside: FloatArray, up: FloatArray, angle: npt.ArrayLike) -> FloatArray:
    """Return distances from the surfaces of cones, negative inside, shape (...).

    Args:
        beside: distances of points from the axis, shape (...).
        up: their heights above the apex, along the axis, shape (...).
        angle: half-angles of the cones [rad], broadcast to (...).
    """
    from_side = beside * np.cos(angle) - up * np.sin(angle)
    return np.where(_is_nearest_to_apex(beside, up, angle), np.hypot(beside, up), from_side)


def outward_of_cone(
    beside: FloatArray, up: FloatArray, angle: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the parts across and along the axis of outward unit vectors, of shape (...) each.

    Args:
        beside: distances of points from the axis, shape (...).
        up: their heights above the apex, along the axis, shape (...).
        angle: half-angles of the cones [rad], broadcast to (...).
    """
    length = np.hypot(beside, up)
    from_apex = _is_nearest_to_apex(beside, up, angle) & (length > 0.0)
    scale = np.where(length > 0.0, length, 1.0)
    across = np.where(from_apex, beside / scale, np.cos(angle))
    return across, np.where(from_apex, up / scale, -np.sin(angle))


def _is_nearest_to_apex(beside: FloatArray, up: FloatArray, angle: npt.ArrayLike) -> BoolArray:
    """Return for which points the apex is the nearest point of the cone."""
    behind: BoolArray = (up < 0.0) & (beside * np.sin(angle) + up * np.cos(angle) <= 0.0)
    return behind


Unbounded = Cone | HalfSpace
"""Any of these sets."""

AnyUnbounded = Annotated[Cone, Tag("Cone")] | Annotated[HalfSpace, Tag("HalfSpace")]
"""One of these sets, identified by its keys in a file."""

KINDS = {"HalfSpace": ("normal", "offset"), "Cone": ("apex", "half_angle")}
"""Keys that identify the set that a mapping describes; of several, the first in this order."""
