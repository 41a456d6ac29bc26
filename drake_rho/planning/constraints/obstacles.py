"""Collision avoidance with obstacles (8), at rest or moving, linearised around a reference (15)."""

from __future__ import annotations

import abc
import dataclasses

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOut
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfObstacle(KeepOut):
    """Collision avoidance constraint (8) of one obstacle, linearised (15) around a reference."""

    obstacle: Obstacle
    """obstacle to avoid, on a clock that is 0 at the first knot"""
    inner_knots: EvaluationPoints
    """points of all vehicles at all inner knots"""
    required: FloatArray
    """required distance of each vehicle from the shape without a disturbance [m], shape (N,)"""
    margins: Margins
    """margins for the disturbance; r is the sum of required distance, margin and uncertainty"""
    tolerances: FloatArray
    """largest penetration that counts as outside, for each vehicle [m], shape (N,)"""

    def radius(self, points: EvaluationPoints) -> FloatArray:
        """Return the required distances r [m], shape (R,)."""
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
        motion = motion.subdivided(self.pieces)
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
