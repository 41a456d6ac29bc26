"""Convex sets of keep-in constraints, one for every vehicle: balls, upright cones, any other set.

Sets speak the vocabulary of `drake_rho.scenario.sets.ConvexSet` with a vehicle's index beside each
value: the signed distance of a value, the direction of that distance, and the support function
h(n) = max n · y over the set, with n · value <= h(n) for every value in it.
"""

from __future__ import annotations

import abc
import dataclasses
from typing import TYPE_CHECKING, Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.shapes.unbounded import distance_from_cone, outward_of_cone
from drake_rho.scenario.times import EXACT, Clock

if TYPE_CHECKING:
    from drake_rho.scenario.sets import ConvexSet

_LEAST = 1e-3
"""Least width of a set, as a part of the motion's scale, from which its tolerance is computed."""

_ROUNDING = 1e-6
"""Least scale of a motion, as a part of the distance of a set from zero: tolerances have to exceed
the rounding of values at that distance."""

_UP = np.array([0.0, 0.0, 1.0])

_GRID = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
_AROUND = _GRID[np.any(_GRID, axis=1)]
_AROUND /= np.linalg.norm(_AROUND, axis=1, keepdims=True)
"""Outward normals of a polyhedron around a ball: towards a cube's sides, edges and corners."""

_AZIMUTHS = np.arange(8) * (np.pi / 4.0)
_AROUND_CONE = np.stack([np.cos(_AZIMUTHS), np.sin(_AZIMUTHS), np.zeros(8)], axis=1)
"""Horizontal directions of the side normals of a pyramid around an upright cone, shape (8, 3)."""


@dataclasses.dataclass(frozen=True, eq=False)
class ConvexSets(abc.ABC):
    """One convex set for every vehicle.

    Methods take the indices of R vehicles, shape (R,), and one value or direction of each, (R, 3).
    """

    origins: FloatArray
    """centres or apexes of the sets, zero if they have none, in the quantity's unit, (N, 3)"""
    tolerances: FloatArray
    """distance outside a set that still counts as inside, in the quantity's unit, shape (N,)"""

    @abc.abstractmethod
    def signed_distance(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the distances of values outside their sets, in the quantity's unit, shape (R,).

        They are at most zero inside, and always for a vehicle without a limit.
        """

    @abc.abstractmethod
    def outward(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return unit vectors from the nearest points of the boundaries outwards, shape (R, 3).

        Where several points are as near, such as at the centre of a ball, it is one of them.
        """

    @abc.abstractmethod
    def support(self, who: IntArray, n: FloatArray) -> FloatArray:
        """Return h(n) for outward unit normals n, in the quantity's unit, shape (R,)."""

    @abc.abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return the sets of all values times a factor above 0."""

    @abc.abstractmethod
    def cones(self, who: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return each set as a second-order cone constraint norm(B y) <= a · y + offset.

        Here y is a value less the set's origin. Moving the boundary outwards by d adds d to the
        offset.

        Returns:
            Matrices with the row a above B, shape (R, 4, 3), and offsets in the quantity's unit,
            infinite where there is no limit or the set is no such cone, shape (R,).
        """

    def nearest(self, values: FloatArray) -> FloatArray:
        """Return the nearest values inside the sets, one for each vehicle, shape (N, 3)."""
        who = np.arange(len(values))
        outside = np.maximum(self.signed_distance(who, values), 0.0)
        return np.asarray(values - outside[:, None] * self.outward(who, values))

    def around(self, who: IntArray) -> FloatArray:
        """Return the outward normals of a polyhedron with F sides around each set, (F, R, 3).

        On some sides a set may be unbounded.
        """
        return np.repeat(_AROUND[:, None], len(who), axis=1)

    def offset(
        self, times: FloatArray, *, before: bool = False, clock: Clock = EXACT
    ) -> FloatArray:
        """Return the place of the sets at times since the first knot [s], shape (R, 3).

        The other functions take values less this place. Sets that do not move are at zero.

        Args:
            times: since the first knot [s], shape (R,).
            before: whether the place is that just before the times, where it jumps.
            clock: by which times are compared with those of jumps.
        """
        return np.broadcast_to(0.0, (len(times), 3))

    @property
    def corners(self) -> FloatArray:
        """Times since the first knot at which the places turn or jump [s], ascending."""
        return np.zeros(0)

    @property
    def jumps(self) -> bool:
        """Whether the places jump at the corners."""
        return False

    @property
    def deviation(self) -> float:
        """Largest distance of the sets from their places, by which values keep inside [m]."""
        return 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Balls(ConvexSets):
    """Balls around their origins."""

    radii: FloatArray
    """radii in the quantity's unit, infinite where a vehicle has no limit, shape (N,)"""

    def signed_distance(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the distances from the centres less the radii."""
        y = x - self.origins[who]
        distance: FloatArray = np.sqrt(np.einsum("ri,ri->r", y, y)) - self.radii[who]
        return distance

    def outward(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the directions away from the centres."""
        y = x - self.origins[who]
        lengths = np.linalg.norm(y, axis=1, keepdims=True)
        upwards = np.broadcast_to(_UP, y.shape)
        return np.where(lengths > 0.0, y / np.where(lengths > 0.0, lengths, 1.0), upwards)

    def support(self, who: IntArray, n: FloatArray) -> FloatArray:
        """Return n · centre + radius."""
        support: FloatArray = np.sum(n * self.origins[who], axis=1) + self.radii[who]
        return support

    def scaled(self, factor: float) -> Balls:
        """Return the balls of all values times a factor."""
        return Balls(factor * self.origins, factor * self.tolerances, factor * self.radii)

    def cones(self, who: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the balls as norm(y) <= radius."""
        return np.tile(np.eye(4, 3, -1), (len(who), 1, 1)), self.radii[who]


@dataclasses.dataclass(frozen=True, eq=False)
class Cones(ConvexSets):
    """Cones that open upwards from their origins."""

    angles: FloatArray
    """half-angles of the cones [rad], less than a right angle; pi where a vehicle has no limit;
    shape (N,)"""

    def signed_distance(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the distances from the cones' surfaces."""
        y = x - self.origins[who]
        return distance_from_cone(np.hypot(y[:, 0], y[:, 1]), y[:, 2], self.angles[who])

    def outward(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the surface normals, or the directions from the apexes if these are nearest."""
        y = x - self.origins[who]
        beside = np.hypot(y[:, 0], y[:, 1])
        sideways = np.where(beside > 0.0, y[:, :2].T / np.where(beside > 0.0, beside, 1.0), 0.0)
        sideways[0, beside == 0.0] = 1.0
        level, along = outward_of_cone(beside, y[:, 2], self.angles[who])
        return np.stack([*(level * sideways), along], axis=1)

    def support(self, who: IntArray, n: FloatArray) -> FloatArray:
        """Return n · apex: the boundary of every supporting half-space contains the apex."""
        support: FloatArray = np.sum(n * self.origins[who], axis=1)
        return support

    def scaled(self, factor: float) -> Cones:
        """Return the cones of all values times a factor."""
        return Cones(factor * self.origins, factor * self.tolerances, self.angles)

    def cones(self, who: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the cones as norm(y_x, y_y) cos(angle) <= y_z sin(angle)."""
        angles, matrices = self.angles[who], np.zeros((len(who), 4, 3))
        matrices[:, 0, 2] = np.sin(angles)
        matrices[:, 1, 0] = matrices[:, 2, 1] = np.cos(angles)
        return matrices, np.where(angles < np.pi / 2.0, 0.0, np.inf)

    def around(self, who: IntArray) -> FloatArray:
        """Return the side normals of pyramids."""
        angles = self.angles[who][:, None]
        return np.asarray(np.cos(angles) * _AROUND_CONE[:, None] - np.sin(angles) * _UP)


@dataclasses.dataclass(frozen=True, eq=False)
class Each(ConvexSets):
    """The same set for every vehicle, at a constant place."""

    set: ConvexSet
    """the set, one of the package's or a user's own"""
    factor: float = 1.0
    """factor of its values"""

    def signed_distance(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the set's own distances."""
        return np.asarray(self.factor * self.set.signed_distance(x / self.factor))

    def outward(self, who: IntArray, x: FloatArray) -> FloatArray:
        """Return the set's own directions."""
        return np.asarray(self.set.outward(x / self.factor))

    def support(self, who: IntArray, n: FloatArray) -> FloatArray:
        """Return the set's own support function, infinite where the set is unbounded."""
        return np.asarray(self.factor * self.set.support(n))

    def scaled(self, factor: float) -> Self:
        """Return the sets of all values times a factor."""
        tolerances = factor * self.tolerances
        return dataclasses.replace(self, tolerances=tolerances, factor=factor * self.factor)

    def cones(self, who: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return no cones: the set is enclosed by its supporting half-spaces."""
        return np.zeros((len(who), 4, 3)), np.full(len(who), np.inf)


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
