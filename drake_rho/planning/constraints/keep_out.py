"""Keep out of a convex set S that may move: obstacles (8), and vehicles of each other.

With x the position from the set's middle c and n a unit vector that points from S to a reference,
the half-space n · x >= h(n) + r keeps the distance r from S, h being its support function: (15) for
a sphere at rest. What is avoided is an obstacle, whose way c(t) is known, or another vehicle.
Vehicles of a pair share what the reference leaves between them: the row about a vehicle at p, whose
reference q is at x_q from c, is

    n · p >= n · (q - s x_q) + s (h(n) + r)

with the share s = 1 where c is given and s = 1/2 where the other has such a row too (decoupled).
Where one row is about the difference of the two, it is n · (p - c) >= h(n) + r (coupled). A
reference that keeps its distance keeps its own rows, since n · x_q - h(n) is the distance of x_q
from S where n points from the nearest point of S to it.
"""

from __future__ import annotations

import abc
import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import AT_ONCE, VIOLATED, Constraint, HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_CREEPING = 16
"""Reach from which on the worst instants of a motion creep. Where the normals of a reference turn
at once, as at a box's edge, these instants are not those of the rows that are broken most, and come
nearer to them each round without getting there."""


@dataclasses.dataclass(frozen=True)
class EvaluationPoints:
    """Vehicles at times, and the partners that they keep out of the way of then."""

    vehicles: IntArray
    """indices, shape (R,)"""
    partners: IntArray
    """indices of the others; the vehicles themselves where an obstacle is meant, shape (R,)"""
    times: FloatArray
    """[s], shape (R,)"""
    knots: IntArray | None = None
    """at which knots, if all are at knots, shape (R,)"""

    @classmethod
    def at_inner_knots(cls, motion: Motion) -> EvaluationPoints:
        """Return all vehicles of a motion at all inner knots, one vehicle after the other."""
        count, steps, _ = motion.accelerations.shape
        whose, knots = np.divmod(np.arange(count * (steps - 1)), steps - 1)
        knots += 1
        return cls(whose, whose, motion.step * knots, knots)

    def position(self, motion: Motion, vehicles: IntArray) -> FloatArray:
        """Return positions of vehicles at these times [m], shape (R, 3)."""
        if self.knots is None:
            return motion.each_at("position", vehicles, self.times)
        at: FloatArray = motion.positions[vehicles, self.knots]
        return at

    def __len__(self) -> int:
        """Return the number of points, R."""
        return len(self.times)

    def select(self, which: BoolArray | IntArray) -> EvaluationPoints:
        """Return some of them."""
        knots = None if self.knots is None else self.knots[which]
        return EvaluationPoints(
            self.vehicles[which], self.partners[which], self.times[which], knots
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOut(Constraint):
    """One set that vehicles keep out of, linearised around a reference."""

    reference: Motion
    """q, of all vehicles, its steps cut into pieces"""
    every_instant: bool
    """whether it holds at every instant, or at the knots only"""
    linearised: bool = True

    @abc.abstractmethod
    def penetrations(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return points where a motion is inside S: worst instants, or knots if these suffice."""

    @abc.abstractmethod
    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return the half-spaces at some points, in the order of vehicle and time."""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Return violated rows at the knots or, if `between`, where the motion is inside S."""
        motion = motion.subdivided(self.pieces)
        if not between:
            return self.violated_at_knots(motion, vehicles, reach)
        points = self.penetrations(motion, vehicles)
        first, last = AT_ONCE, motion.accelerations.shape[1] - AT_ONCE
        k = points.times / motion.step
        points = points.select((k > first) & (k < last))  # start and goal are not to be changed
        if len(points) == 0:
            return self.none
        rows = self.rows(points)  # of two that are too close, one may keep its own half
        broken = rows.select(rows.margins(motion) < -VIOLATED * rows.tolerances)
        if reach < _CREEPING or len(broken) == 0:
            return broken
        beside = self.worst_beside(motion, broken)
        return broken.union(beside) if len(beside) > 0 else broken

    def worst_beside(self, motion: Motion, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows that are broken most within a step of some rows, where that differs."""
        return self.none

    @abc.abstractmethod
    def violated_at_knots(self, motion: Motion, vehicles: IntArray, reach: int) -> HalfSpaces:
        """Return violated rows at the knots, and their neighbours up to `reach` knots away."""


def across(directions: FloatArray) -> FloatArray:
    """Return unit vectors orthogonal to directions (..., 3), always the same ones."""
    least = np.eye(3)[np.argmin(np.abs(directions), axis=-1)]
    normals = np.cross(directions, least)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    some = lengths > 0.0
    found: FloatArray = np.where(some, normals / np.where(some, lengths, 1.0), [0.0, 0.0, 1.0])
    return found


def side_of(offsets: FloatArray, ways: FloatArray) -> FloatArray:
    """Return unit vectors orthogonal to `ways`, towards `offsets` if possible, (..., 3)."""
    speeds = np.linalg.norm(ways, axis=-1, keepdims=True)
    ahead = np.where(speeds > 0.0, ways / np.where(speeds > 0.0, speeds, 1.0), 0.0)
    sides = offsets - np.vecdot(offsets, ahead)[..., None] * ahead
    lengths = np.linalg.norm(sides, axis=-1, keepdims=True)
    has_one = lengths > 1e-3 * np.linalg.norm(offsets, axis=-1, keepdims=True)
    found: FloatArray = np.where(has_one, sides / np.where(has_one, lengths, 1.0), across(ahead))
    return found
