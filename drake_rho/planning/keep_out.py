"""Keep out of a convex set S that may move: obstacles (8), and vehicles of each other.

With x the position from the set's centre c and n a unit vector that points from S to a reference,
the half-space n · x >= h(n) lies outside of S, h being its support function: (15) for a sphere at
rest. What is avoided is a constant, or another vehicle. Vehicles of a pair share what the
reference leaves between them: the row about a vehicle at p, whose reference q is at x_q from c, is

    n · p >= n · (q - s x_q) + s h(n)

with the share s = 1 where c is given and s = 1/2 where the other has such a row too (decoupled).
Where one row is about the difference of the two, it is n · (p - c) >= h(n) (coupled). A reference
outside of S keeps its own rows.
"""

from __future__ import annotations

import abc
import dataclasses
import sys
from functools import cached_property

import numpy as np

from drake_rho.motion.clearance import penetrations
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.half_spaces import BROKEN, Constraint, HalfSpaces, Quadratic, near
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.quadrics import Quadric
from drake_rho.scenario.records import TOLERANCE, Scenario, Sphere

FIRST = 32
"""Number of the pairs' constraint; those of obstacles follow, those of keep-in sets come before."""


@dataclasses.dataclass(frozen=True)
class Places:
    """Vehicles at times, and the partners that they keep out of the way of then."""

    vehicles: IntArray
    """indices, shape (R,)"""
    partners: IntArray
    """indices of the others; the vehicles themselves where an obstacle is meant, shape (R,)"""
    times: FloatArray
    """[s], shape (R,)"""
    knots: IntArray | None = None
    """at which knots, if all are at knots, shape (R,)"""

    def position(self, motion: Motion, vehicles: IntArray) -> FloatArray:
        """Positions of vehicles at these times [m], shape (R, 3)."""
        if self.knots is None:
            return motion.each_at("position", vehicles, self.times)
        at: FloatArray = motion.positions[vehicles, self.knots]
        return at

    def __len__(self) -> int:
        """R."""
        return len(self.times)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOut(Constraint):
    """One set that vehicles keep out of, linearised around a reference."""

    shape: Quadric
    """S"""
    reference: Motion
    """q, of all vehicles"""
    places: Places
    """where its rows are asked for in any case, each vehicle's neighbours in time together"""
    every_instant: bool
    """whether it holds at every instant, or at the knots only"""
    linearised: bool = True

    @abc.abstractmethod
    def offsets(self, motion: Motion, places: Places) -> FloatArray:
        """The positions x from the centre of S [m], shape (R, 3)."""

    @abc.abstractmethod
    def penetrations(self, motion: Motion, vehicles: IntArray) -> Places:
        """Places where a motion is inside S: worst instants, or knots if only they are asked."""

    @abc.abstractmethod
    def rows(self, places: Places) -> HalfSpaces:
        """The half-spaces at some places."""

    def directions(self, places: Places) -> FloatArray:
        """From S towards the reference, where S is a ball: unit vectors, shape (R, 3).

        Where the reference is at the centre itself, they point across its way.
        """
        x = self.shape.scaled(self.offsets(self.reference, places))
        distances = np.sqrt(np.einsum("ri,ri->r", x, x))
        at_centre = np.flatnonzero(distances <= self.shape.tolerance)
        directions: FloatArray = x / np.maximum(distances, 1e-300)[:, None]
        if len(at_centre) > 0:
            ways = self.shape.scaled(self.ways(places))
            for row in at_centre:
                directions[row] = side_of(np.zeros(3), ways[row])
        return directions

    def ways(self, places: Places) -> FloatArray:
        """The velocity of the reference from that of S [m/s], shape (R, 3)."""
        return self.reference.each_at("velocity", places.vehicles, places.times)

    def write(
        self, places: Places, directions: FloatArray, share: float, anchors: FloatArray | None
    ) -> HalfSpaces:
        """Rows with given directions.

        Args:
            places: where.
            directions: as from `directions`, shape (R, 3).
            share: s.
            anchors: q - s x_q [m], shape (R, 3) or (3,); None for rows about a difference.
        """
        normals = directions * self.shape.scales
        normals /= np.sqrt(np.einsum("ri,ri->r", normals, normals))[:, None]
        supports = share * self.shape.support(normals)
        bounds = supports
        if anchors is not None:
            bounds = supports + np.sum(normals * anchors, axis=1)
        return HalfSpaces(
            self,
            places.vehicles,
            places.partners,
            sides=np.zeros(len(places), dtype=int),
            times=places.times,
            normals=normals,
            bounds=bounds,
            tolerances=TOLERANCE * supports,
        )

    def violated(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """The broken rows at `places` or, if `between`, where the motion is inside of S."""
        if between:
            places = self.penetrations(motion, vehicles)
            if len(places) == 0:
                return self.none
            rows = self.rows(places)  # of two that are too close, one may keep its own half
            return rows.select(rows.margins(motion) < -BROKEN * rows.tolerances)
        rows, knots = self._asked, self.places.knots
        if len(rows) == 0:
            return rows
        if len(vehicles) < len(motion.positions):
            asked = np.zeros(len(motion.positions), dtype=bool)
            asked[vehicles] = True
            due = asked[rows.vehicles]
            if self.coupled:
                due |= asked[rows.partners]
            rows, knots = rows.select(due), None if knots is None else knots[due]
        margins = rows.margins(motion) if knots is None else rows.margins_at(motion, knots)
        broken = margins < -BROKEN * rows.tolerances
        if not broken.any():
            return self.none
        return rows.select(near(broken, rows.vehicles, reach))

    @cached_property
    def _asked(self) -> HalfSpaces:
        """The rows at `places`."""
        return self.rows(self.places)

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Norms of scaled offsets, at least the size of the shape."""
        return Quadratic(
            centers=np.zeros((len(rows), 3)),
            scales=np.tile(self.shape.scales, (len(rows), 1)),
            sizes=np.full(len(rows), self.shape.radius),
            lengths=self.shape.radius / self.shape.support(rows.normals),
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfSphere(KeepOut):
    """An obstacle (8) at rest, linearised (15)."""

    shape: Sphere

    def offsets(self, motion: Motion, places: Places) -> FloatArray:
        """Positions from the sphere's centre."""
        return places.position(motion, places.vehicles) - self.shape.center

    def penetrations(self, motion: Motion, vehicles: IntArray) -> Places:
        """The closest approaches inside, once where two steps share the instant."""
        sphere = self.shape
        if not self.every_instant:
            return self._penetrating_knots(motion, vehicles)
        least = sphere.radius - BROKEN * sphere.tolerance
        found = penetrations(motion.of(vehicles), sphere.center, least)
        whose, times = vehicles[found.one], found.times
        again = (np.diff(whose, prepend=-1) == 0) & (np.diff(times, prepend=-1.0) == 0.0)
        return Places(whose[~again], whose[~again], times[~again])

    def _penetrating_knots(self, motion: Motion, vehicles: IntArray) -> Places:
        """Inner knots inside the sphere."""
        x = motion.positions[vehicles, 1:-1] - self.shape.center
        inside = self.shape.signed_distance(x) < -BROKEN * self.shape.tolerance
        which, knots = np.nonzero(inside)
        times = (motion.step * (knots + 1.0)).astype(np.float64)
        return Places(vehicles[which], vehicles[which], times)

    def rows(self, places: Places) -> HalfSpaces:
        """Tangent planes of the sphere."""
        return self.write(places, self.directions(places), 1.0, self.shape.center)

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """The tangent planes at the same instants."""
        return self.rows(Places(rows.vehicles, rows.partners, rows.times))

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Distances from the centre, at least the radius."""
        found = super().quadratics(rows)
        assert found is not None  # noqa: S101  # as it always is of a set that is kept out of
        return dataclasses.replace(found, centers=np.tile(self.shape.center, (len(rows), 1)))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PassOnOneSide(KeepOutOfSphere):
    """A sphere that is to be passed on one side, wherever a vehicle would be inside it."""

    side: FloatArray
    """from the centre towards that side, a unit vector, shape (3,)"""

    def directions(self, places: Places) -> FloatArray:
        """The given side, at all places."""
        return np.tile(self.side, (len(places), 1))


def obstacles_of(scenario: Scenario, reference: Motion) -> list[Constraint]:
    """The obstacles linearised (15) around a motion of the same vehicles, at all inner knots."""
    count, times = len(scenario.vehicles), scenario.grid.elapsed[1:-1]
    every = np.repeat(np.arange(count), len(times))
    knots = np.tile(np.arange(1, len(times) + 1), count)
    places = Places(every, every, np.tile(times, count), knots)
    return [
        KeepOutOfSphere(
            number=FIRST + number,
            name=f"obstacle {number}",
            quantity="position",
            shape=sphere,
            reference=reference,
            places=places,
            searches=sys.maxsize * scenario.between_knots,
            every_instant=scenario.between_knots,
        )
        for number, sphere in enumerate(scenario.obstacles, start=1)
    ]


def sides_of(scenario: Scenario, reference: Motion, sides: list[FloatArray]) -> list[Constraint]:
    """The obstacles, each to be passed on one of `sides`, unit vectors of shape (3,)."""
    none = np.zeros(0, dtype=int)
    return [
        PassOnOneSide(
            number=FIRST + number,
            name=f"obstacle {number}",
            quantity="position",
            shape=sphere,
            reference=reference,
            places=Places(none, none, np.zeros(0)),
            searches=sys.maxsize,
            every_instant=scenario.between_knots,
            side=side,
        )
        for number, (sphere, side) in enumerate(
            zip(scenario.obstacles, sides, strict=True), start=1
        )
    ]


def across(direction: FloatArray) -> FloatArray:
    """A unit vector orthogonal to `direction`, shape (3,): the same one every time."""
    least = np.eye(3)[np.argmin(np.abs(direction))]
    across = np.cross(direction, least)
    length = float(np.linalg.norm(across))
    return across / length if length else np.array([0.0, 0.0, 1.0])


def side_of(offset: FloatArray, way: FloatArray) -> FloatArray:
    """A unit vector orthogonal to `way`, on the side of `offset` if it has one; both (3,)."""
    speed = float(np.linalg.norm(way))
    ahead = way / speed if speed > 0.0 else np.zeros(3)
    side = offset - (offset @ ahead) * ahead
    length = float(np.linalg.norm(side))
    return side / length if length > 1e-3 * np.linalg.norm(offset) else across(ahead)
