"""Base class of collision avoidance: vehicles keep out of a convex set, which may move.

S is an obstacle (8) with a known trajectory c(t) of its centre, or a set around another vehicle.
Let x be the position relative to the centre c, h the support function of S, and n a unit vector
from S towards a reference. The half-space n · x >= h(n) + r keeps the distance r from S; for a
sphere at rest it is (15). The row for a vehicle at p whose reference is q = c + x_q is

    n · p >= n · (q - s x_q) + s (h(n) + r)

with the responsibility s = 1 if c is given, and s = 1/2 if the other vehicle of a pair has such a
row as well (decoupled). A single row about the difference of both vehicles is
n · (p - c) >= h(n) + r (coupled). A reference with the required distance satisfies its own rows:
if n points from the nearest point of S to x_q, n · x_q - h(n) is the distance of x_q from S.
"""

from __future__ import annotations

import abc
import dataclasses
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.penetration import Course, deepest, pieces_near_course
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces, Quadratic
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.times import END_MARGIN, Clock
from drake_rho.system.table import Table

_MANY_NEIGHBOURS = 16
"""Number of requested neighbours from which on the most violated rows are searched for as well.
Where normals along a reference turn abruptly, as at a box's edge, the worst instants of the motion
are not those of the most violated rows. They approach these each round without reaching them."""


@dataclasses.dataclass(frozen=True)
class EvaluationPoints(Table):
    """Points at which rows are evaluated: vehicles, their partners and times."""

    vehicles: IntArray
    """indices of the vehicles, shape (R,)"""
    partners: IntArray
    """indices of the vehicles to avoid; the vehicles themselves for obstacles, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    knots: IntArray | None = None
    """indices of the knots, shape (R,); None if some times are not those of knots"""
    parts: IntArray | None = None
    """numbers of the parts of a map to avoid, shape (R,); None for any other set"""

    @classmethod
    def at_inner_knots(cls, motion: Motion, *, open_end: bool = False) -> EvaluationPoints:
        """Return the points of all vehicles at all inner knots, sorted by vehicle.

        Args:
            motion: the motion of all vehicles.
            open_end: whether the last knot counts as an inner one.
        """
        count, steps, _ = motion.accelerations.shape
        inner = steps - 1 + open_end
        whose, knots = np.divmod(np.arange(count * inner), inner)
        knots += 1
        return cls(whose, whose, motion.step * knots, knots)

    def position(self, motion: Motion, vehicles: IntArray) -> FloatArray:
        """Return positions of vehicles at the times of the points [m], shape (R, 3)."""
        if self.knots is None:
            return motion.each_at("position", vehicles, self.times)
        at: FloatArray = motion.positions[vehicles, self.knots]
        return at


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOut(Constraint):
    """Collision avoidance constraint of one set S, linearised around a reference."""

    reference: Motion
    """reference motion q of all vehicles, with steps subdivided as those of `margins`"""
    every_instant: bool
    """true if it holds at every instant, false if at the knots only"""

    margins: Margins
    """margins of single vehicles, on the grid of `reference`"""
    before: Motion | None = None
    """plan in force; a window's plan touches S at almost the same instants, which count as knots"""

    @property
    def linearised(self) -> bool:
        """Whether rows are valid around one reference only: always."""
        return True

    @abc.abstractmethod
    def penetrations(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return the points of a motion inside S, at the worst instants or at the knots."""

    @abc.abstractmethod
    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return the half-spaces at points, sorted by vehicle and time."""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return violated rows at the knots or, if `between`, where the motion is inside S."""
        if self.margins.pieces > 1:
            motion = motion.subdivided(self.margins.pieces)
        if not between:
            rows = self.violated_at_knots(motion, vehicles, neighbours)
            if self.before is not None and len(rows) > 0:
                rows = rows.union(self._violated_touched(motion, rows.vehicles))
            return rows if self.given_end is None else self.given_end.without(rows)
        points = self.penetrations(motion, vehicles)
        first, last = END_MARGIN, motion.accelerations.shape[1] - END_MARGIN
        k = points.times / motion.step
        # start and goal are given
        points = points.select((k > first) & (self.open_end | (k < last)))
        if len(points) == 0:
            return self.none
        rows = self.rows(points)  # one vehicle of a violating pair may satisfy its own row
        if self.given_end is not None:
            rows = self.given_end.without(rows)
        violated = rows.select(rows.margins(motion) < -VIOLATED * rows.tolerances)
        if neighbours < _MANY_NEIGHBOURS or len(violated) == 0:
            return violated
        nearby = self.worst_nearby(motion, violated)
        return violated.union(nearby) if len(nearby) > 0 else violated

    def _violated_touched(self, motion: Motion, vehicles: IntArray) -> HalfSpaces:
        """Return the violated rows of some vehicles at the instants at which `before` touches S."""
        rows = self.touched.select(np.isin(self.touched.vehicles, vehicles))
        if len(rows) == 0:
            return rows
        return rows.select(rows.margins(motion) < -VIOLATED * rows.tolerances)

    @cached_property
    def touched(self) -> HalfSpaces:
        """Rows at the instants between knots at which `before` touches S; none by default."""
        return self.none

    def worst_nearby(self, motion: Motion, rows: HalfSpaces) -> HalfSpaces:
        """Return the most violated row within a step of each row; empty if those are the worst."""
        return self.none

    @abc.abstractmethod
    def violated_at_knots(self, motion: Motion, vehicles: IntArray, neighbours: int) -> HalfSpaces:
        """Return violated rows at the knots, together with the rows of neighbouring knots."""


def across(directions: FloatArray) -> FloatArray:
    """Return unit vectors orthogonal to directions (..., 3), by a deterministic choice."""
    least = np.eye(3)[np.argmin(np.abs(directions), axis=-1)]
    normals = np.cross(directions, least)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    some = lengths > 0.0
    found: FloatArray = np.where(some, normals / np.where(some, lengths, 1.0), [0.0, 0.0, 1.0])
    return found


def side_of(offsets: FloatArray, velocities: FloatArray) -> FloatArray:
    """Return unit vectors orthogonal to velocities, towards offsets if possible, (..., 3)."""
    speeds = np.linalg.norm(velocities, axis=-1, keepdims=True)
    ahead = np.where(speeds > 0.0, velocities / np.where(speeds > 0.0, speeds, 1.0), 0.0)
    sides = offsets - np.vecdot(offsets, ahead)[..., None] * ahead
    lengths = np.linalg.norm(sides, axis=-1, keepdims=True)
    defined = lengths > 1e-3 * np.linalg.norm(offsets, axis=-1, keepdims=True)
    if defined.all():
        return np.asarray(sides / lengths)
    return np.where(defined, sides / np.where(defined, lengths, 1.0), across(ahead))


_TOUCHES = 100.0
"""Distance beyond the required one, in tolerances, up to which a motion touches an obstacle."""

_AROUND, _ZOOMS = np.linspace(-1.0, 1.0, 17), 4
"""Search for the most violated row: offsets from a worst instant, in steps and then in intervals
between the last offsets, and the number of searches."""

_HALVINGS = 60
"""Number of halvings that find the largest ball inside an obstacle."""

_DEEPEST = 1e3
"""Largest radius of such a ball beyond the required distance, in sizes of the obstacle."""

_SMALLEST = 1e-3
"""Radius of such a ball, in sizes of the obstacle, below which it counts as none: at an edge."""

_TANGENT = 1e-12
"""Distance of such a ball from its row, in sizes of the obstacle."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfObstacle(KeepOut):
    """Collision avoidance constraint (8) of one obstacle, linearised (15) around a reference."""

    number: int
    """number of the obstacle, from 1"""
    obstacle: Obstacle
    """obstacle to avoid, on a clock that is 0 at the first knot"""
    inner_knots: EvaluationPoints
    """points of all vehicles at all inner knots"""
    required: FloatArray
    """required distance of each vehicle from the shape without a disturbance [m], shape (N,)"""
    tolerances: FloatArray
    """largest penetration that counts as outside, for each vehicle [m], shape (N,)"""
    clock: Clock
    """clock by which instants are compared with the obstacle's active interval"""

    @cached_property
    def touched(self) -> HalfSpaces:
        """Rows at the instants between knots at which `before` touches the obstacle."""
        assert self.before is not None  # noqa: S101  # callers check this
        motion = self.before.subdivided(self.margins.pieces)
        points = self.penetrations(motion, np.arange(len(self.required)), beyond=_TOUCHES)
        k = points.times / motion.step
        points = points.select(np.abs(k - np.rint(k)) > END_MARGIN)
        return self.rows(points) if len(points) > 0 else self.none

    @property
    def obstacles(self) -> frozenset[int]:
        """Number of the obstacle."""
        return frozenset({self.number})

    def holds_at(self, times: FloatArray) -> BoolArray:
        """Return whether the obstacle is active at times since the first knot [s], shape (R,)."""
        if self.obstacle.active is None:
            return np.ones(len(times), dtype=bool)
        return self.clock.within(times, self.obstacle.active)

    def radius(self, points: EvaluationPoints) -> FloatArray:
        """Return r [m], the sum of required distance, margin and uncertainty, shape (R,)."""
        margins = self.margins.at("position", points.times)
        errors = self.obstacle.uncertainty(points.times)
        radii: FloatArray = self.required[points.vehicles] + margins + errors
        return radii

    def distances(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return signed distances of a motion from the obstacle at points [m], shape (R,)."""
        return self.distances_at(points, self.offsets(motion, points))

    @abc.abstractmethod
    def distances_at(self, points: EvaluationPoints, offsets: FloatArray) -> FloatArray:
        """Return signed distances from the obstacle, or the points' own parts of it [m], (R,).

        Args:
            points: points of vehicles.
            offsets: positions relative to the centre of the obstacle [m], shape (R, 3).
        """

    def quadratics(self, rows: HalfSpaces) -> Quadratic:
        """Return balls inside the set to keep out of, each tangent to its row; radius 0 for none.

        A distance from a convex set changes by at most the way moved, so the ball around c with
        radius r - d(c) is too close everywhere. The largest one whose centre is on the normal
        through the reference's nearest point is found by bisection.
        """
        points = EvaluationPoints(rows.vehicles, rows.partners, rows.times, parts=rows.sides)
        normals, required = rows.normals, self.radius(points)
        centers, x = self.obstacle.centers(points.times), self.offsets(self.reference, points)
        beyond = np.vecdot(normals, centers + x) - rows.bounds
        nearest = x - beyond[:, None] * normals
        low, high = np.zeros(len(rows)), np.full(len(rows), _DEEPEST * self.obstacle.shape.size)
        high += required
        for _ in range(_HALVINGS):
            depths = (low + high) / 2.0
            inside = required - self.distances_at(points, nearest - depths[:, None] * normals)
            tangent = inside >= depths - _TANGENT * self.obstacle.shape.size
            low, high = np.where(tangent, depths, low), np.where(tangent, high, depths)
        within = nearest - low[:, None] * normals
        sizes = required - self.distances_at(points, within)
        sizes[sizes < _SMALLEST * self.obstacle.shape.size] = 0.0
        ones = np.ones((len(rows), 3))
        return Quadratic(centers + within, ones, sizes, np.ones(len(rows)))

    def offsets(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return positions relative to the centre of the obstacle [m], shape (R, 3)."""
        position = points.position(motion, points.vehicles)
        offsets: FloatArray = position - self.obstacle.centers(points.times)
        return offsets

    def approaches(self, motion: Motion) -> CloseApproaches:
        """Return the violating points of a motion; their distances are less r, so negative [m]."""
        motion = motion.subdivided(self.margins.pieces)
        points = self.penetrations(motion, np.arange(len(self.required)))
        distances = self.distances(motion, points) - self.radius(points)
        return CloseApproaches(points.vehicles, points.partners, points.times, distances)

    @abc.abstractmethod
    def penetrations(
        self, motion: Motion, vehicles: IntArray, *, beyond: float = -VIOLATED
    ) -> EvaluationPoints:
        """Return the points of a motion closer than required.

        Args:
            motion: the motion of all vehicles.
            vehicles: the vehicles to check, as increasing indices.
            beyond: distance beyond the required one that counts as closer, in tolerances.
        """

    def deepest_instants(
        self, motion: Motion, vehicles: IntArray, beyond: float
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Return the parts, vehicles and times [s] of the deepest instants inside, (R,) each."""
        below = self.required[vehicles] + beyond * self.tolerances[vehicles]
        within = np.maximum(below + self.margins.largest, 0.0)
        pieces = pieces_near_course(motion.of(vehicles), self._course, within)
        steps = step_at(pieces.times, motion.step)
        below = below[pieces.owners] + self.margins.steps["position"][steps]
        tolerances = self.tolerances[vehicles[pieces.owners]]
        which, times = deepest(self.obstacle.shape, pieces, below, tolerances)
        return pieces.parts[which], vehicles[pieces.owners[which]], times

    @cached_property
    def _course(self) -> Course:
        """Motion of the obstacle in the steps of the reference, which all motions share."""
        return Course.of(self.obstacle, self.reference.step, self.reference.accelerations.shape[1])

    def bounds_at(self, rows: HalfSpaces, times: FloatArray) -> FloatArray:
        """Return bounds with the obstacle's position at other times."""
        if not self.obstacle.changes:
            return rows.bounds
        moved = self.obstacle.centers(times) - self.obstacle.centers(rows.times)
        grown = self.obstacle.uncertainty(times) - self.obstacle.uncertainty(rows.times)
        bounds: FloatArray = rows.bounds + np.vecdot(rows.normals, moved) + grown
        return bounds

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows around this reference at the same instants."""
        points = EvaluationPoints(rows.vehicles, rows.partners, rows.times, parts=rows.sides)
        return self.rows(points)

    def worst_nearby(self, motion: Motion, rows: HalfSpaces) -> HalfSpaces:
        """Return the most violated row about the same pair and part within a step of each row."""
        h, steps = motion.step, motion.accelerations.shape[1]
        whose, others, parts = (
            np.repeat(each, len(_AROUND)) for each in (rows.vehicles, rows.partners, rows.sides)
        )
        times, each = rows.times, np.arange(len(rows))
        for zoom in range(_ZOOMS):
            around = times[:, None] + h * _AROUND[None] * (_AROUND[1] - _AROUND[0]) ** zoom
            around = np.clip(around, END_MARGIN * h, (steps - END_MARGIN * (not self.open_end)) * h)
            points = EvaluationPoints(whose, others, around.reshape(-1), parts=parts)
            margins = self.rows(points).margins(motion)
            margins[~self.holds_at(around.reshape(-1))] = np.inf
            times = around[each, np.argmin(margins.reshape(around.shape), axis=1)]
        return self.rows(EvaluationPoints(rows.vehicles, rows.partners, times, parts=rows.sides))

    def softened_for(self, penalty: float, rounds: int) -> Self:
        """Return this constraint for one step of a restoration: soft, with few rounds."""
        return dataclasses.replace(self, penalty=penalty, rounds=rounds, searches=1)
