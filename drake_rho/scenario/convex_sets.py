"""Convex sets that values of every vehicle keep in: balls and upright cones.

Each set is told by three functions of a value, as a shape to keep out of is
(`drake_rho.scenario.shapes.base`): how far outside it is, in which direction, and the support
function h(n) = max n · y over the set, so that n · value <= h(n) for everything in it.
"""

from __future__ import annotations

import abc
import dataclasses

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.shapes.base import TOLERANCE

_LEAST = 1e-3
"""Part of the motion's scale below which a set counts as no smaller, for its tolerance."""

_ROUNDING = 1e-6
"""Part of a set's place below which no scale is, which is what its rounding leaves room for."""

_UP = np.array([0.0, 0.0, 1.0])

_GRID = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
_AROUND_BALL = _GRID[np.any(_GRID, axis=1)]
_AROUND_BALL /= np.linalg.norm(_AROUND_BALL, axis=1, keepdims=True)
"""Outward normals of a polyhedron around a ball, shape (26, 3)."""

_AZIMUTHS = np.arange(8) * (np.pi / 4.0)
_AROUND_CONE = np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS), np.zeros(8)], axis=1)
"""Level directions in which a pyramid around an upright cone has its sides, shape (8, 3)."""


@dataclasses.dataclass(frozen=True, eq=False)
class ConvexSets(abc.ABC):
    """A convex set for every vehicle.

    Values belong to the vehicles of the same place: the shapes (R, 3) and (R,) go together.
    """

    places: FloatArray
    """where the sets are, in the quantity's unit, shape (N, 3)"""
    tolerances: FloatArray
    """how far outside still counts as inside, in the quantity's unit, shape (N,)"""

    @abc.abstractmethod
    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Distance of values outside their sets, in the quantity's unit, shape (R,).

        Inside it is at most zero, as it always is of a vehicle without a limit.
        """

    @abc.abstractmethod
    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Unit vectors from the nearest point of the set, or of its surface, shape (R, 3).

        Zero where there is no such direction, or all are.
        """

    @abc.abstractmethod
    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """h(n) for outward normals n, shape (R, 3), in the quantity's unit, shape (R,)."""

    @abc.abstractmethod
    def around(self, vehicles: IntArray) -> FloatArray:
        """Outward normals of a polyhedron with F sides around each set, shape (F, R, 3)."""

    @abc.abstractmethod
    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return matrices (a above B) and reaches with norm(B y) <= a · y + reach inside.

        Here y is a value less the set's place, and moving the boundary outwards by d adds d to the
        reach, which is infinite where there is no limit.

        Returns:
            Shapes (R, 4, 3) and, in the quantity's unit, (R,).
        """

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
class Balls(ConvexSets):
    """Balls around their places."""

    radii: FloatArray
    """in the quantity's unit, infinite where a vehicle has no limit, shape (N,)"""

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """How much further from the place than the radius."""
        x = values - self.places[vehicles]
        excess: FloatArray = np.sqrt(np.einsum("ri,ri->r", x, x)) - self.radii[vehicles]
        return excess

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Away from the place."""
        return _unit(values - self.places[vehicles])

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """What the place has along n, and the radius."""
        support: FloatArray = np.sum(n * self.places[vehicles], axis=1) + self.radii[vehicles]
        return support

    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return norm(y) <= radius."""
        return np.tile(np.eye(4, 3, -1), (len(vehicles), 1, 1)), self.radii[vehicles]

    def around(self, vehicles: IntArray) -> FloatArray:
        """Towards the sides, edges and corners of a cube."""
        return np.repeat(_AROUND_BALL[:, None], len(vehicles), axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class UprightCones(ConvexSets):
    """Cones with their apexes at their places that open upwards."""

    angles: FloatArray
    """to the upright [rad], less than a right angle or, where a vehicle has no limit, pi; (N,)"""

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Distance from the cone, or at most zero inside."""
        level, up, angle = self._seen_from_apex(vehicles, values)
        beside = level * np.cos(angle) - up * np.sin(angle)
        return np.where(_below(angle, level, up), np.hypot(level, up), beside)

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Across the cone's surface; from the apex, where that is nearest."""
        x = values - self.places[vehicles]
        level, up, angle = self._seen_from_apex(vehicles, values)
        across = _across(angle, _unit(x * [1.0, 1.0, 0.0]))
        return np.where(_below(angle, level, up)[:, None], _unit(x), across)

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """What the apex has along n: it is on the boundary of every such half-space."""
        support: FloatArray = np.sum(n * self.places[vehicles], axis=1)
        return support

    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return norm(what is level of y) cos(angle) <= (what is up of y) sin(angle)."""
        angles, matrices = self.angles[vehicles], np.zeros((len(vehicles), 4, 3))
        matrices[:, 0, 2] = np.sin(angles)
        matrices[:, 1, 0] = matrices[:, 2, 1] = np.cos(angles)
        return matrices, np.where(angles < np.pi / 2.0, 0.0, np.inf)

    def around(self, vehicles: IntArray) -> FloatArray:
        """The sides of a pyramid."""
        count, sides = len(vehicles), len(_AROUND_CONE)
        angle = np.tile(self.angles[vehicles], sides)
        normals = _across(angle, np.repeat(_AROUND_CONE, count, axis=0))
        return normals.reshape(sides, count, 3)

    def _seen_from_apex(
        self, vehicles: IntArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How far values are from the axis, how far above the apex, and the cone's angle."""
        x = values - self.places[vehicles]
        return np.hypot(x[:, 0], x[:, 1]), x[:, 2], self.angles[vehicles]


def tolerances_of(widths: FloatArray, places: FloatArray, scale: FloatArray) -> FloatArray:
    """Tolerances of sets, in the quantity's unit, shape (N,).

    `TOLERANCE` of a set's width, but no more than of the motion's scale, and no less than of a
    thousandth of it, which a solver can still tell.

    Args:
        widths: of the sets, in the quantity's unit, shape (N,).
        places: where they are, in the quantity's unit, shape (N, 3).
        scale: what is large for the quantity in each motion, in its unit, shape (N,).
    """
    scale = np.maximum(scale, _ROUNDING * np.linalg.norm(places, axis=1))
    tolerances: FloatArray = TOLERANCE * np.clip(widths, _LEAST * scale, scale)
    return tolerances


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


def _unit(x: FloatArray) -> FloatArray:
    """Vectors (R, 3) made of length one; zero stays zero."""
    lengths = np.linalg.norm(x, axis=1, keepdims=True)
    unit: FloatArray = np.divide(x, lengths, out=np.zeros_like(x), where=lengths > 0.0)
    return unit
