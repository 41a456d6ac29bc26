"""Collision avoidance with obstacles: convex shapes, and maps (`maps`)."""

from __future__ import annotations

import dataclasses
import sys
from functools import cached_property, partial

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import (
    VIOLATED,
    GivenEnd,
    HalfSpaces,
    Quadratic,
    with_neighbours,
)
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOutOfObstacle, side_of
from drake_rho.planning.constraints.maps import KeepOutOfMap
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.shapes_together import ShapesTogether
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Shape, Solid


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfShape(KeepOutOfObstacle):
    """Collision avoidance constraint of a convex shape, with rows at all inner knots."""

    shape: Shape
    """shape of the obstacle"""
    together: tuple[ShapesTogether, int] | None = None
    """obstacles that are searched together with this one, and its index; None if its motion has
    corners within steps"""

    def distances_at(self, points: EvaluationPoints, offsets: FloatArray) -> FloatArray:
        """Return signed distances from the shape [m], shape (R,)."""
        return self.shape.local_distance(offsets)

    def directions(self, points: EvaluationPoints) -> FloatArray:
        """Return unit vectors from the nearest point of the shape to the reference, shape (R, 3).

        If the reference is at the centre, the direction is orthogonal to its relative velocity.
        """
        shape, x = self.shape, self.offsets(self.reference, points)
        directions = shape.local_outward(x)
        squares = np.vecdot(x, x)
        for row in (squares <= shape.tolerance**2).nonzero()[0]:
            at = points.times[row : row + 1]
            velocity = self.reference.each_at("velocity", points.vehicles[row : row + 1], at)
            side = side_of(np.zeros(3), (velocity - self.obstacle.velocities(at))[0])
            if np.isfinite(shape.local_support(side)):  # not along an infinite cylinder's axis
                directions[row] = side
        return directions

    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return the rows n · p >= n · c + h(n) + r at points."""
        normals, shape = self.directions(points), self.shape
        centers = self.obstacle.centers(points.times)
        beyond = shape.local_support(normals) + self.radius(points)
        return HalfSpaces(
            self,
            points.vehicles,
            points.partners,
            sides=np.zeros(points.times.shape, dtype=int),
            times=points.times,
            normals=normals,
            bounds=beyond + np.vecdot(normals, centers),
            tolerances=self.tolerances[points.vehicles],
        )

    def penetrations(
        self, motion: Motion, vehicles: IntArray, *, beyond: float = -VIOLATED
    ) -> EvaluationPoints:
        """Return the deepest instant of each penetrating step, without duplicates."""
        if not self.every_instant:
            return self._penetrating_knots(motion, vehicles)
        if self.together is None:
            _, whose, times = self.deepest_instants(motion, vehicles, beyond)
        else:
            others, number = self.together
            whose, times = others.deepest_instants(number, motion, vehicles, beyond)
        if len(times) > 1:
            first = np.ones(len(times), dtype=bool)
            first[1:] = (whose[1:] != whose[:-1]) | (times[1:] != times[:-1])
            whose, times = whose[first], times[first]
        return EvaluationPoints(whose, whose, times)

    def _penetrating_knots(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return the points at inner knots that are inside."""
        points = self.inner_knots.select(np.isin(self.inner_knots.vehicles, vehicles))
        distances = self.shape.local_distance(self.offsets(motion, points))
        below = self.radius(points) - VIOLATED * self.tolerances[points.vehicles]
        return points.select((distances < below) & self.holds_at(points.times))

    def violated_at_knots(self, motion: Motion, vehicles: IntArray, neighbours: int) -> HalfSpaces:
        """Return violated rows at inner knots, together with the rows of neighbouring knots.

        The reference's margin to a row is its clearance beyond the required distance. A motion can
        violate the row only if its distance from the reference is larger.
        """
        checked = vehicles if len(vehicles) < len(self.required) else slice(None)
        inner = slice(1, 1 + self._clearances.shape[1])
        moved = motion.positions[checked, inner] - self.reference.positions[checked, inner]
        far = np.sqrt(np.vecdot(moved, moved)) >= self._clearances[checked]
        every: BoolArray = np.zeros(self._clearances.shape, dtype=bool)
        every[checked] = far
        which = every.reshape(-1).nonzero()[0]
        if len(which) == 0:
            return self.none
        rows, knots = self._knot_rows.select(which), 1 + which % every.shape[1]
        violated = rows.margins_at(motion, knots) < -VIOLATED * rows.tolerances
        if neighbours == 0 or not violated.any():
            return rows.select(violated)
        every[every] = violated
        selected = with_neighbours(every.reshape(-1), self._knot_rows.vehicles, neighbours)
        return self._knot_rows.select(selected & self.holds_at(self._knot_rows.times))

    @cached_property
    def _knot_rows(self) -> HalfSpaces:
        """Rows at all inner knots."""
        return self.rows(self.inner_knots)

    @cached_property
    def _clearances(self) -> FloatArray:
        """Distances of the reference beyond the required ones at inner knots [m], (N, K-2)."""
        offsets = self.offsets(self.reference, self.inner_knots)
        distances = self.shape.local_distance(offsets).reshape(len(self.required), -1)
        times = self.inner_knots.times[: distances.shape[1]]
        inside = self.margins.knots["position"][1 : 1 + len(times)]
        inside = inside + self.obstacle.uncertainty(times)
        clearances: FloatArray = distances - self.required[:, None] - inside
        if self.obstacle.active is not None:
            clearances[:, ~self.holds_at(times)] = np.inf
        return clearances

    def quadratics(self, rows: HalfSpaces) -> Quadratic:
        """Return bounds on scaled distances from the centre, or those of balls inside."""
        points = EvaluationPoints(rows.vehicles, rows.partners, rows.times)
        inside = [self.shape.quadric_inside(radius) for radius in self.radius(points)]
        quadrics = [each for each in inside if each is not None]
        if len(quadrics) < len(inside):
            return super().quadratics(rows)
        sizes = np.array([each.radius for each in quadrics])
        supports = [
            each.local_support(normal) for each, normal in zip(quadrics, rows.normals, strict=True)
        ]
        return Quadratic(
            centers=self.obstacle.centers(rows.times),
            scales=np.array([each.scales for each in quadrics]).reshape(-1, 3),
            sizes=sizes,
            lengths=sizes / np.array(supports),
        )


def obstacles_of(
    scenario: Scenario, margins: PlanMargins, reference: Motion, before: Motion | None = None
) -> list[KeepOutOfObstacle]:
    """Return constraints of the obstacles known at the start, linearised (15) around a motion.

    Args:
        scenario: the scenario to plan.
        margins: margins for errors.
        reference: the motion of all vehicles.
        before: the plan in force, whose instants at obstacles are tried first; None for none.
    """
    known = scenario.avoided
    if not known:
        return []
    reference = reference.subdivided(margins.inner.pieces)
    open_end = scenario.fleet.open_end
    inner_knots = EvaluationPoints.at_inner_knots(reference, open_end=open_end)
    together = dict[int, tuple[ShapesTogether, int]]()
    if scenario.between_knots:
        together = _searched_together(scenario, margins, reference)
    constraints: list[KeepOutOfObstacle] = []
    for number, obstacle in known:
        shape: Solid = obstacle.shape
        is_map = isinstance(shape, Parts)
        kind = KeepOutOfMap if is_map else partial(KeepOutOfShape, together=together.get(number))
        constraints.append(
            kind(
                shape=shape,  # type: ignore[arg-type]  # of that kind
                kind="obstacles",
                key=("obstacle", number),
                number=number,
                clock=scenario.grid.clock,
                before=None if obstacle.penalty else before,
                name=scenario.obstacle_name(number),
                quantity="position",
                reference=reference,
                searches=sys.maxsize * scenario.between_knots,
                every_instant=scenario.between_knots,
                obstacle=obstacle,
                inner_knots=inner_knots,
                open_end=open_end,
                given_end=GivenEnd.of(scenario, "position") if open_end else None,
                required=scenario.fleet.radii + obstacle.deviation,
                margins=margins.inner,
                tolerances=scenario.fleet.obstacle_tolerances(obstacle.shape),
                prices=obstacle.prices(scenario.fleet.weights) if obstacle.penalty else None,
            )
        )
    return constraints


def _searched_together(
    scenario: Scenario, margins: PlanMargins, reference: Motion
) -> dict[int, tuple[ShapesTogether, int]]:
    """Return the obstacles that each is searched with, and its index among them, by its number."""
    together = dict[int, tuple[ShapesTogether, int]]()
    fleet, obstacles = scenario.fleet, [each for _, each in scenario.avoided]
    for group in ShapesTogether.groups(obstacles, reference):
        members = [obstacles[index] for index in group]
        joint = ShapesTogether(
            members,
            [fleet.radii + each.deviation for each in members],
            [fleet.obstacle_tolerances(each.shape) for each in members],
            margins.inner,
            reference,
        )
        numbers = [scenario.avoided[index][0] for index in group]
        together |= {number: (joint, index) for index, number in enumerate(numbers)}
    return together
