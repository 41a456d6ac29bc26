"""Obstacles (8), at rest or moving, linearised around a reference (15)."""

from __future__ import annotations

import dataclasses
import sys
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.penetration import deepest, pieces_near
from drake_rho.planning.constraints.base import AT_ONCE, VIOLATED, HalfSpaces, Quadratic
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOut, side_of
from drake_rho.planning.constraints.margins import Margins, PlanMargins
from drake_rho.planning.constraints.stretches import near
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario

_AROUND, _ZOOMS, _FINER = np.linspace(-1.0, 1.0, 17), 4, 8.0
"""Where the row that is broken most is looked for, in steps from a worst instant; how often, and
how much closer to the worst of them each time."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfObstacle(KeepOut):
    """An obstacle (8), linearised (15) at all inner knots, kept at every vehicle's distance."""

    obstacle: Obstacle
    """what is avoided, on a clock that is 0 at the first knot"""
    inner_knots: EvaluationPoints
    """where rows are asked for at knots: all vehicles at all inner ones"""
    kept: FloatArray
    """the distance that each vehicle keeps from the shape when nothing disturbs it [m], (N,)"""
    margins: Margins
    """what is added to it: r is the sum of both"""
    tolerances: FloatArray
    """how deep inside still counts as outside, for each vehicle [m], (N,)"""

    def radius(self, points: EvaluationPoints) -> FloatArray:
        """Return the required distances r [m], shape (R,)."""
        margins = self.margins.at("position", points.times)
        radii: FloatArray = self.kept[points.vehicles] + margins
        return radii

    def offsets(self, motion: Motion, points: EvaluationPoints) -> FloatArray:
        """Return positions from the middle of the obstacle [m], shape (R, 3)."""
        position = points.position(motion, points.vehicles)
        offsets: FloatArray = position - self.obstacle.centers(points.times)
        return offsets

    def directions(self, points: EvaluationPoints) -> FloatArray:
        """Return unit vectors from the nearest point of the shape to the reference, shape (R, 3).

        Where the reference is in the very middle, across its way relative to the obstacle.
        """
        shape, x = self.obstacle.shape, self.offsets(self.reference, points)
        directions = shape.outward(x)
        squares = np.vecdot(x, x)
        for row in (squares <= shape.tolerance**2).nonzero()[0]:
            at = points.times[row : row + 1]
            way = self.reference.each_at("velocity", points.vehicles[row : row + 1], at)
            side = side_of(np.zeros(3), (way - self.obstacle.velocities(at))[0])
            if np.isfinite(shape.support(side)):  # an endless cylinder has no end to go round
                directions[row] = side
        return directions

    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return the rows n · p >= n · c + h(n) + r."""
        normals, shape = self.directions(points), self.obstacle.shape
        centers = self.obstacle.centers(points.times)
        beyond = shape.support(normals) + self.radius(points)
        return HalfSpaces(
            self,
            points.vehicles,
            points.partners,
            sides=np.zeros(len(points), dtype=int),
            times=points.times,
            normals=normals,
            bounds=beyond + np.vecdot(normals, centers),
            tolerances=self.tolerances[points.vehicles],
        )

    def worst_beside(self, motion: Motion, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows that are broken most within a step of some rows."""
        h, steps = motion.step, motion.accelerations.shape[1]
        whose = np.repeat(rows.vehicles, len(_AROUND))
        times, each = rows.times, np.arange(len(rows))
        for finer in range(_ZOOMS):
            around = times[:, None] + h * _AROUND[None] / _FINER**finer
            around = np.clip(around, AT_ONCE * h, (steps - AT_ONCE) * h)
            margins = self.rows(EvaluationPoints(whose, whose, around.reshape(-1))).margins(motion)
            margins[~self.holds_at(around.reshape(-1))] = np.inf
            times = around[each, np.argmin(margins.reshape(around.shape), axis=1)]
        return self.rows(EvaluationPoints(rows.vehicles, rows.partners, times))

    def penetrations(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return the deepest instants of steps that lead inside, once where two share one."""
        if not self.every_instant:
            return self._penetrating_knots(motion, vehicles)
        below = self.kept[vehicles] - VIOLATED * self.tolerances[vehicles]
        within = np.maximum(below + self.margins.most, 0.0)
        pieces = pieces_near(motion.of(vehicles), self.obstacle, within)
        steps = step_at(pieces.times, motion.step)
        below = below[pieces.owners] + self.margins.steps["position"][steps]
        tolerances = self.tolerances[vehicles[pieces.owners]]
        which, times = deepest(self.obstacle.shape, pieces, below, tolerances)
        whose = vehicles[pieces.owners[which]]
        again = (np.diff(whose, prepend=-1) == 0) & (np.diff(times, prepend=-1.0) == 0.0)
        return EvaluationPoints(whose[~again], whose[~again], times[~again])

    def approaches(self, motion: Motion) -> CloseApproaches:
        """Return where a motion is too close, and by how much: distances below zero [m]."""
        motion = motion.subdivided(self.pieces)
        points = self.penetrations(motion, np.arange(len(self.kept)))
        distances = self.obstacle.shape.signed_distance(self.offsets(motion, points))
        distances = distances - self.radius(points)
        return CloseApproaches(points.vehicles, points.partners, points.times, distances)

    def _penetrating_knots(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return the inner knots that are inside."""
        points = self.inner_knots.select(np.isin(self.inner_knots.vehicles, vehicles))
        distances = self.obstacle.shape.signed_distance(self.offsets(motion, points))
        below = self.radius(points) - VIOLATED * self.tolerances[points.vehicles]
        return points.select((distances < below) & self.holds_at(points.times))

    def violated_at_knots(self, motion: Motion, vehicles: IntArray, reach: int) -> HalfSpaces:
        """Return rows at inner knots.

        A row is as far from its bound as the reference is from the obstacle, so a motion can break
        it only if it is further than that from the reference.
        """
        asked = vehicles if len(vehicles) < len(self.kept) else slice(None)
        moved = motion.positions[asked, 1:-1] - self.reference.positions[asked, 1:-1]
        far = np.sqrt(np.vecdot(moved, moved)) >= self._room[asked]
        if not far.any():
            return self.none
        every = np.zeros_like(self._room, dtype=bool)
        every[asked] = far
        which = every.reshape(-1).nonzero()[0]
        rows, knots = self._asked.select(which), 1 + which % every.shape[1]
        broken = rows.margins_at(motion, knots) < -VIOLATED * rows.tolerances
        if reach == 0 or not broken.any():
            return rows.select(broken)
        every[every] = broken
        wanted = near(every.reshape(-1), self._asked.vehicles, reach)
        return self._asked.select(wanted & self.holds_at(self._asked.times))

    @cached_property
    def _asked(self) -> HalfSpaces:
        """Rows at all inner knots."""
        return self.rows(self.inner_knots)

    @cached_property
    def _room(self) -> FloatArray:
        """Distances of the reference at inner knots beyond what is required [m], shape (N, K-2)."""
        offsets = self.offsets(self.reference, self.inner_knots)
        distances = self.obstacle.shape.signed_distance(offsets).reshape(len(self.kept), -1)
        inside = self.margins.knots["position"][1:-1]
        room: FloatArray = distances - self.kept[:, None] - inside
        room[:, ~self.holds_at(self.inner_knots.times[: room.shape[1]])] = np.inf
        return room

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows at the same instants."""
        return self.rows(EvaluationPoints(rows.vehicles, rows.partners, rows.times))

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Return scaled distances from the middle, where the shape is a ball or an ellipsoid."""
        radii = self.kept[rows.vehicles] + self.margins.at("position", rows.times)
        inside = [self.obstacle.shape.quadric_inside(radius) for radius in radii]
        quadrics = [each for each in inside if each is not None]
        if len(quadrics) < len(inside):
            return None
        sizes = np.array([each.radius for each in quadrics])
        supports = [
            each.support(normal) for each, normal in zip(quadrics, rows.normals, strict=True)
        ]
        return Quadratic(
            centers=self.obstacle.centers(rows.times),
            scales=np.array([each.scales for each in quadrics]).reshape(-1, 3),
            sizes=sizes,
            lengths=sizes / np.array(supports),
        )


def obstacles_of(
    scenario: Scenario, margins: PlanMargins, reference: Motion
) -> list[KeepOutOfObstacle]:
    """Return the obstacles known at the start, linearised (15) around a motion."""
    known = scenario.known
    if not known:
        return []
    reference = reference.subdivided(margins.pieces)
    inner_knots = EvaluationPoints.at_inner_knots(reference)
    return [
        KeepOutOfObstacle(
            kind="obstacles",
            key=("obstacle", number),
            obstacle_number=number,
            active=obstacle.active,
            clock_rounding=scenario.grid.rounding,
            name=scenario.obstacle_name(number),
            quantity="position",
            reference=reference,
            searches=sys.maxsize * scenario.between_knots,
            every_instant=scenario.between_knots,
            obstacle=obstacle,
            inner_knots=inner_knots,
            kept=scenario.fleet.radii + obstacle.deviation,
            margins=margins.inner,
            pieces=margins.pieces,
            tolerances=scenario.fleet.obstacle_tolerances(obstacle.shape),
        )
        for number, obstacle in known
    ]
