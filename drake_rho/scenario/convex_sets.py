"""Convex sets of keep-in constraints, one for every vehicle: balls and upright cones.

Each set is defined by three functions, like the shapes of obstacles
(`drake_rho.scenario.shapes.base`): the distance of a value outside the set, the direction of that
distance, and the support function h(n) = max n · y over the set, with n · value <= h(n) for every
value in it.
"""

from __future__ import annotations

import abc
import dataclasses

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.shapes.base import TOLERANCE

_LEAST = 1e-3
"""Least width of a set, as a part of the motion's scale, from which its tolerance is computed."""

_ROUNDING = 1e-6
"""Least scale of a motion, as a part of the distance of a set from zero: tolerances have to exceed
the rounding of values at that distance."""

_UP = np.array([0.0, 0.0, 1.0])

_GRID = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
AROUND_BALL = _GRID[np.any(_GRID, axis=1)]
AROUND_BALL /= np.linalg.norm(AROUND_BALL, axis=1, keepdims=True)
"""Outward normals of a polyhedron around a ball, shape (26, 3)."""

_AZIMUTHS = np.arange(8) * (np.pi / 4.0)
_AROUND_CONE = np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS), np.zeros(8)], axis=1)
"""Horizontal directions of the side normals of a pyramid around an upright cone, shape (8, 3)."""


@dataclasses.dataclass(frozen=True, eq=False)
class ConvexSets(abc.ABC):
    """One convex set for every vehicle.

    Methods take R values, shape (R, 3), and the R indices of the vehicles to which they belong.
    """

    origins: FloatArray
    """centres or apexes of the sets, in the quantity's unit, shape (N, 3)"""
    tolerances: FloatArray
    """distance outside a set that still counts as inside, in the quantity's unit, shape (N,)"""

    @abc.abstractmethod
    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return the distances of values outside their sets, in the quantity's unit, shape (R,).

        They are at most zero inside, and always for a vehicle without a limit.
        """

    @abc.abstractmethod
    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return outward unit vectors at the nearest point of the set, shape (R, 3).

        They are zero where the direction is not unique, such as at the centre of a ball.
        """

    @abc.abstractmethod
    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """Return h(n) for outward normals n, shape (R, 3), in the quantity's unit, shape (R,)."""

    @abc.abstractmethod
    def around(self, vehicles: IntArray) -> FloatArray:
        """Return the outward normals of a polyhedron with F sides around each set, (F, R, 3)."""

    @abc.abstractmethod
    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return each set as a second-order cone constraint norm(B y) <= a · y + offset.

        Here y is a value less the set's place. Moving the boundary outwards by d adds d to the
        offset.

        Returns:
            Matrices with the row a above B, shape (R, 4, 3), and offsets in the quantity's unit,
            infinite where there is no limit, shape (R,).
        """

    def nearest(self, values: FloatArray) -> FloatArray:
        """Return the nearest values inside the sets, one for each vehicle, shape (N, 3)."""
        vehicles = np.arange(len(values))
        excess = self.excess(vehicles, values)
        outside = excess > 0.0  # false for NaN
        moved = np.array(values)
        violating = vehicles[outside]
        moved[outside] -= excess[outside, None] * self.outward(violating, values[outside])
        return moved


@dataclasses.dataclass(frozen=True, eq=False)
class Balls(ConvexSets):
    """Balls with their centres at `origins`."""

    radii: FloatArray
    """radii in the quantity's unit, infinite where a vehicle has no limit, shape (N,)"""

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return the distances from the centres less the radii."""
        x = values - self.origins[vehicles]
        excess: FloatArray = np.sqrt(np.einsum("ri,ri->r", x, x)) - self.radii[vehicles]
        return excess

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return the directions away from the centres."""
        return _unit(values - self.origins[vehicles])

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """Return n · centre + radius."""
        support: FloatArray = np.sum(n * self.origins[vehicles], axis=1) + self.radii[vehicles]
        return support

    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the balls as norm(y) <= radius."""
        return np.tile(np.eye(4, 3, -1), (len(vehicles), 1, 1)), self.radii[vehicles]

    def around(self, vehicles: IntArray) -> FloatArray:
        """Return the directions of the sides, edges and corners of a cube."""
        return np.repeat(AROUND_BALL[:, None], len(vehicles), axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class UprightCones(ConvexSets):
    """Cones that open upwards, with their apexes at `origins`."""

    angles: FloatArray
    """half-angles of the cones [rad], less than a right angle; pi where a vehicle has no limit;
    shape (N,)"""

    def excess(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return the distances from the cones, at most zero inside."""
        level, up, angle = self._relative_to_apex(vehicles, values)
        beside = level * np.cos(angle) - up * np.sin(angle)
        return np.where(_nearest_to_apex(angle, level, up), np.hypot(level, up), beside)

    def outward(self, vehicles: IntArray, values: FloatArray) -> FloatArray:
        """Return the cones' surface normals, or the direction from the apex if that is nearest."""
        x = values - self.origins[vehicles]
        level, up, angle = self._relative_to_apex(vehicles, values)
        normals = _surface_normals(angle, _unit(x * [1.0, 1.0, 0.0]))
        return np.where(_nearest_to_apex(angle, level, up)[:, None], _unit(x), normals)

    def support(self, vehicles: IntArray, n: FloatArray) -> FloatArray:
        """Return n · apex: the boundary of every supporting half-space contains the apex."""
        support: FloatArray = np.sum(n * self.origins[vehicles], axis=1)
        return support

    def cones(self, vehicles: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the cones as norm(y_x, y_y) cos(angle) <= y_z sin(angle)."""
        angles, matrices = self.angles[vehicles], np.zeros((len(vehicles), 4, 3))
        matrices[:, 0, 2] = np.sin(angles)
        matrices[:, 1, 0] = matrices[:, 2, 1] = np.cos(angles)
        return matrices, np.where(angles < np.pi / 2.0, 0.0, np.inf)

    def around(self, vehicles: IntArray) -> FloatArray:
        """Return the side normals of pyramids."""
        count, sides = len(vehicles), len(_AROUND_CONE)
        angle = np.tile(self.angles[vehicles], sides)
        normals = _surface_normals(angle, np.repeat(_AROUND_CONE, count, axis=0))
        return normals.reshape(sides, count, 3)

    def _relative_to_apex(
        self, vehicles: IntArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distances of values from the axis, heights above the apex, and the half-angles."""
        x = values - self.origins[vehicles]
        return np.hypot(x[:, 0], x[:, 1]), x[:, 2], self.angles[vehicles]


def tolerances_of(widths: FloatArray, origins: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the tolerances of sets, in the quantity's unit, shape (N,).

    A tolerance is `TOLERANCE` times the set's width. The width is taken as at most the motion's
    scale, and at least a thousandth of it, which a solver can still resolve.

    Args:
        widths: of the sets, in the quantity's unit, shape (N,).
        origins: centres or apexes of the sets, in the quantity's unit, shape (N, 3).
        scale: characteristic magnitude of the quantity in each motion, in its unit, shape (N,).
    """
    scale = np.maximum(scale, _ROUNDING * np.linalg.norm(origins, axis=1))
    tolerances: FloatArray = TOLERANCE * np.clip(widths, _LEAST * scale, scale)
    return tolerances


def _nearest_to_apex(angle: FloatArray, level: FloatArray, up: FloatArray) -> BoolArray:
    """Return for which values the apex is the nearest point of the cone.

    Args:
        angle: half-angle of the cone [rad].
        level: distance of the values from its axis.
        up: height of the values above its apex.
    """
    nearest: BoolArray = (up < 0.0) & (level * np.sin(angle) + up * np.cos(angle) <= 0.0)
    return nearest


def _surface_normals(angle: FloatArray, level: FloatArray) -> FloatArray:
    """Return outward normals of cones in horizontal directions (R, 3); zero where these are."""
    angle = angle[:, None]
    normals: FloatArray = np.cos(angle) * level - np.sin(angle) * _UP
    normals[~np.any(level, axis=1)] = 0.0
    return normals


def _unit(x: FloatArray) -> FloatArray:
    """Return vectors (R, 3) scaled to length one; zero remains zero."""
    lengths = np.linalg.norm(x, axis=1, keepdims=True)
    unit: FloatArray = np.divide(x, lengths, out=np.zeros_like(x), where=lengths > 0.0)
    return unit
