"""Limits on norms as convex sets that a quantity of every vehicle keeps in: balls and cones.

Each set is told by three functions of a value, as a shape to keep out of is
(`drake_rho.scenario.shapes`): how far outside it is, in which direction, and the support function
h(n) = max n · y over the set, so that n · value <= h(n) for everything in it.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import Literal, Self

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import GRAVITY, Quantity
from drake_rho.scenario.shapes import TOLERANCE

Norm = Literal["max_speed", "max_acceleration", "max_thrust", "max_tilt"]
"""The fields of `Limits` that limit a norm."""

_LEAST = 1e-3
"""Part of the motion's scale below which a set counts as no smaller, for its tolerance."""

_ROUNDING = 1e-6
"""Part of a set's origin below which no scale is, which is what its rounding leaves room for."""

_UP = np.array([0.0, 0.0, 1.0])

_GRID = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
_AROUND_BALL = _GRID[np.any(_GRID, axis=1)]
_AROUND_BALL /= np.linalg.norm(_AROUND_BALL, axis=1, keepdims=True)
"""Outward normals of a polyhedron around a ball, shape (26, 3)."""

_AZIMUTHS = np.arange(8) * (np.pi / 4.0)
_AROUND_CONE = np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS), np.zeros(8)], axis=1)
"""Level directions in which a pyramid around an upright cone has its sides, shape (8, 3)."""


@dataclasses.dataclass(frozen=True, eq=False)
class NormLimit(abc.ABC):
    """A limit on a norm of a quantity, of every vehicle: the convex sets of what is allowed.

    Values belong to the vehicles of the same place: the shapes (R, 3) and (R,) go together.
    """

    what: str
    """what is limited, in a word: speed, acceleration, thrust, tilt"""
    told_as: str
    """what a value has of it, in messages of what is expected"""
    quantity: Quantity
    """whose values are in the sets"""
    origin: FloatArray
    """center of the balls or apex of the cones, in the quantity's unit, shape (3,)"""
    most: FloatArray
    """the limit of each vehicle, infinite where it has none, shape (N,)"""
    tolerances: FloatArray
    """how far outside still counts as inside, in the quantity's unit, shape (N,)"""

    @classmethod
    def of(cls, kind: Kind, most: FloatArray, scale: FloatArray) -> Self:
        """The sets of all vehicles.

        The tolerance is `TOLERANCE` of a set's width, but no more than of the motion's scale, and
        no less than of a thousandth of it, which a solver can still tell.

        Args:
            kind: what is limited.
            most: the limit of each vehicle, infinite where it has none, shape (N,).
            scale: what is large for the quantity in each motion, in its unit, shape (N,).
        """
        scale = np.maximum(scale, _ROUNDING * float(np.linalg.norm(kind.origin)))
        tolerances = TOLERANCE * np.clip(cls._widths(most), _LEAST * scale, scale)
        return cls(kind.what, kind.told_as, kind.quantity, kind.origin, most, tolerances)

    @staticmethod
    @abc.abstractmethod
    def _widths(most: FloatArray) -> FloatArray:
        """How wide the sets are, in the quantity's unit, shape (N,)."""

    @property
    def name(self) -> str:
        """What the constraint is called in messages, as 'maximum speed'."""
        return f"maximum {self.what}"

    @abc.abstractmethod
    def measured(self, values: FloatArray) -> FloatArray:
        """What is limited of values (..., 3), in the limit's unit, shape (...)."""

    @abc.abstractmethod
    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Distance of values outside their sets, in the quantity's unit, shape (R,).

        Inside it is at most zero, as it always is of a vehicle without a limit.
        """

    @abc.abstractmethod
    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Unit vectors from the nearest point of the set, or of its surface, shape (R, 3).

        Zero where there is no such direction, or a value at the origin has all of them.
        """

    @abc.abstractmethod
    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """h(n) for outward normals n, shape (R, 3), in the quantity's unit, shape (R,)."""

    @abc.abstractmethod
    def around(self, vehicles: IntArray) -> FloatArray:
        """Outward normals of a polyhedron with F sides around each set, shape (F, R, 3)."""

    def check(self, where: str, values: FloatArray) -> None:
        """See that `values`, shape (N, 3), are inside; what is no number is not judged.

        Raises:
            ScenarioError: one is outside; `where` names it within its vehicle.
        """
        outside = self.excess(np.arange(len(values)), values) > self.tolerances
        if np.any(outside):
            i = int(np.argmax(outside))
            found = float(self.measured(values[i]))
            expected = f"a {self.told_as} of at most {self.most[i]:g}, not {found:.7g}"
            raise ScenarioError(f"vehicles[{i}].{where}", values[i].tolist(), expected)

    def nearest(self, values: FloatArray) -> FloatArray:
        """The values inside that are nearest to `values`, both of shape (N, 3)."""
        vehicles = np.arange(len(values))
        excess = self.excess(vehicles, values)
        outside = excess > 0.0  # nor what is no number
        moved = np.array(values)
        who = vehicles[outside]
        moved[outside] -= excess[outside, None] * self.outward(who, values[outside])
        return moved


@dataclasses.dataclass(frozen=True, eq=False)
class Ball(NormLimit):
    """norm(value - origin) is at most `most`."""

    @staticmethod
    def _widths(most: FloatArray) -> FloatArray:
        return most

    def measured(self, values: FloatArray) -> FloatArray:
        """Distances from the center."""
        x = values - self.origin
        lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", x, x))
        return lengths

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """How much longer than the radius."""
        return self.measured(values) - self.most[vehicles]

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Away from the center."""
        return _unit(values - self.origin)

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """What the center has along n, and the radius."""
        support: FloatArray = n @ self.origin + self.most[vehicles]
        return support

    def around(self, vehicles: IntArray) -> FloatArray:
        """Towards the sides, edges and corners of a cube."""
        return np.repeat(_AROUND_BALL[:, None], len(vehicles), axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class UprightCone(NormLimit):
    """The angle of value - origin to the upright is at most `most` [rad].

    It is less than a right angle or, of a vehicle without a limit, infinite, which is as good as
    pi.
    """

    @staticmethod
    def _widths(most: FloatArray) -> FloatArray:
        """The radius of the cone at the height of hovering."""
        widths: FloatArray = GRAVITY * np.tan(np.minimum(most, np.pi))
        return widths

    def measured(self, values: FloatArray) -> FloatArray:
        """Angles to the upright [rad], from 0 to pi."""
        x = values - self.origin
        angles: FloatArray = np.arctan2(np.hypot(x[..., 0], x[..., 1]), x[..., 2])
        return angles

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Distance from the cone, or at most zero inside."""
        x, angle = values - self.origin, self._angles(vehicles)
        level, up = np.hypot(x[:, 0], x[:, 1]), x[:, 2]
        beside = level * np.cos(angle) - up * np.sin(angle)
        return np.where(_below(angle, level, up), np.hypot(level, up), beside)

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Across the cone's surface; from the apex, where that is nearest."""
        x, angle = values - self.origin, self._angles(vehicles)
        level = x * [1.0, 1.0, 0.0]
        below = _below(angle, np.hypot(x[:, 0], x[:, 1]), x[:, 2])
        return np.where(below[:, None], _unit(x), _across(angle, _unit(level)))

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """What the apex has along n: it is on the boundary of every such half-space."""
        support: FloatArray = n @ self.origin
        return support

    def around(self, vehicles: IntArray) -> FloatArray:
        """The sides of a pyramid."""
        count, sides = len(vehicles), len(_AROUND_CONE)
        angle = np.tile(self._angles(vehicles), sides)
        normals = _across(angle, np.repeat(_AROUND_CONE, count, axis=0))
        return normals.reshape(sides, count, 3)

    def _angles(self, vehicles: IntArray) -> FloatArray:
        return np.minimum(self.most[vehicles], np.pi)


def _below(angle: FloatArray, level: FloatArray, up: FloatArray) -> BoolArray:
    """Where the apex of a cone is nearest to values.

    Args:
        angle: of the cone [rad].
        level: how far from its axis the values are.
        up: how far above its apex they are.
    """
    below: BoolArray = (up < 0.0) & (level * np.sin(angle) + up * np.cos(angle) <= 0.0)
    return below


def _across(angle: FloatArray, level: FloatArray) -> FloatArray:
    """Outward normals of a cone's surface in level directions (R, 3); zero where these are."""
    angle = angle[:, None]
    normals: FloatArray = np.cos(angle) * level - np.sin(angle) * _UP
    normals[~np.any(level, axis=1)] = 0.0
    return normals


@dataclasses.dataclass(frozen=True)
class Kind:
    """What one field of `Limits` limits, and how."""

    limit: type[NormLimit]
    """the kind of set"""
    what: str
    """in a word"""
    told_as: str
    """what a value has of it, in messages of what is expected"""
    quantity: Quantity
    """whose values are in the set"""
    origin: FloatArray
    """center or apex, in the quantity's unit, shape (3,)"""


_FREE_FALL = -GRAVITY * _UP
"""The acceleration without thrust [m/s²]."""

NORMS: dict[Norm, Kind] = {
    "max_speed": Kind(Ball, "speed", "norm", "velocity", np.zeros(3)),
    "max_acceleration": Kind(Ball, "acceleration", "norm", "acceleration", np.zeros(3)),
    "max_thrust": Kind(Ball, "thrust", "thrust", "acceleration", _FREE_FALL),
    "max_tilt": Kind(UprightCone, "tilt", "tilt", "acceleration", _FREE_FALL),
}
"""The limits on norms, in the order of their constraints' numbers."""


def _unit(x: FloatArray) -> FloatArray:
    """Vectors (R, 3) made of length one; zero stays zero."""
    lengths = np.linalg.norm(x, axis=1, keepdims=True)
    unit: FloatArray = np.divide(x, lengths, out=np.zeros_like(x), where=lengths > 0.0)
    return unit
