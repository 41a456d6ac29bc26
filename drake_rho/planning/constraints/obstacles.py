"""Collision avoidance with obstacles (8), at rest or moving, linearised around a reference (15)."""

from __future__ import annotations

import abc
import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOut
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.times import END_MARGIN, Clock

_AROUND, _ZOOMS, _FINER = np.linspace(-1.0, 1.0, 17), 4, 8.0
"""Search for the most violated row: offsets from a worst instant in steps, number of refinements,
and the factor by which each refinement divides the offsets."""


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

    @abc.abstractmethod
    def distances(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return signed distances of a motion from the obstacle at points [m], shape (R,)."""

    def offsets(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return positions relative to the centre of the obstacle [m], shape (R, 3)."""
        position = points.position(motion, points.vehicles)
        offsets: FloatArray = position - self.obstacle.centers(points.times)
        return offsets

    def approaches(self, motion: Motion) -> CloseApproaches:
        """Return violating points of a motion, with their distances less r, below zero [m]."""
        motion = motion.subdivided(self.margins.pieces)
        points = self.penetrations(motion, np.arange(len(self.required)))
        distances = self.distances(motion, points) - self.radius(points)
        return CloseApproaches(points.vehicles, points.partners, points.times, distances)

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
        for finer in range(_ZOOMS):
            around = times[:, None] + h * _AROUND[None] / _FINER**finer
            around = np.clip(around, END_MARGIN * h, (steps - END_MARGIN) * h)
            points = EvaluationPoints(whose, others, around.reshape(-1), parts=parts)
            margins = self.rows(points).margins(motion)
            margins[~self.holds_at(around.reshape(-1))] = np.inf
            times = around[each, np.argmin(margins.reshape(around.shape), axis=1)]
        return self.rows(EvaluationPoints(rows.vehicles, rows.partners, times, parts=rows.sides))

    def softened_for(self, penalty: float, rounds: int) -> Self:
        """Return this constraint for one step of a restoration: soft, with few rounds."""
        return dataclasses.replace(self, penalty=penalty, rounds=rounds, searches=1)
