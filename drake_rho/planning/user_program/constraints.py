"""Costs and constraints of the paper, one function for each: (4)-(8), (12), (13), (15)."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
from pydrake.solvers import Binding, MathematicalProgram

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.boxes import KeepInBox
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.keep_out import EvaluationPoints
from drake_rho.planning.constraints.limits import norms_of, waypoints_of
from drake_rho.planning.constraints.separation import Coupling
from drake_rho.planning.problem import Problem
from drake_rho.planning.user_program.conic import Conic, conic_of
from drake_rho.planning.user_program.values import Affine, Values, on_every_axis
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.convex_sets import Each
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.times import Clock

GOAL, PENALTIES = "goal", "penalties"
"""Names of the terminal equalities, and of the cost of excesses."""


@dataclasses.dataclass(frozen=True, eq=False)
class Draft:
    """Program under construction, with its costs and constraints by name."""

    problem: Problem
    """problem to write out"""
    prog: MathematicalProgram
    """program, which has the accelerations as variables"""
    values: Values
    """motions as functions of the accelerations"""
    bindings: dict[str, list[Binding[Any]]] = dataclasses.field(default_factory=dict)
    """costs and constraints, by the names that reports use"""

    def note(
        self,
        name: str,
        vehicle: int,
        binding: Binding[Any],
        time: float | None = None,
        partner: int | None = None,
    ) -> None:
        """Describe a binding, as in 'separation: v0, v1 at knot 12', and store it by name."""
        names = self.problem.scenario.names
        who = names[vehicle] if partner is None else f"{names[vehicle]}, {names[partner]}"
        when = "" if time is None else f" {self._when(time)}"
        binding.evaluator().set_description(f"{name}: {who}{when}")
        self.bindings.setdefault(name, []).append(binding)

    def _when(self, time: float) -> str:
        """Return the knot, or the time on the scenario's clock between knots."""
        grid = self.problem.scenario.grid
        knot = round(time / grid.step)
        if Clock.of(grid.step).same(np.array(time), np.array(knot * grid.step)):
            return f"at knot {knot}"
        return f"at {clock_time(grid.start + time)}"


def add_cost(draft: Draft) -> None:
    """Add the cost of each vehicle, by default (13), one binding for each term with a weight."""
    scenario = draft.problem.scenario
    for term, weight in scenario.objective.weights._asdict().items():
        for vehicle, own in enumerate(scenario.fleet.weights if weight > 0.0 else ()):
            rows, offsets = draft.values.term(term, vehicle)
            A, b = on_every_axis(rows), offsets.reshape(-1)
            a = draft.values.accelerations[vehicle].reshape(-1)
            scale = weight * own  # Drake's quadratic costs have a factor of 1/2
            binding = draft.prog.AddQuadraticCost(
                2.0 * scale * A.T @ A, 2.0 * scale * A.T @ b, scale * b @ b, a, is_convex=True
            )
            draft.note(term, vehicle, binding)


def add_goals(draft: Draft) -> None:
    """Add the terminal equalities (12) of positions and velocities."""
    scenario = draft.problem.scenario
    fleet, T = scenario.fleet, scenario.grid.duration
    goals: dict[Quantity, Any] = {
        "position": (fleet.goal_positions, fleet.fixed_positions),
        "velocity": (fleet.goal_velocities, fleet.fixed_velocities),
    }
    for quantity, (values, fixed) in goals.items():
        for vehicle in np.flatnonzero(fixed).tolist():
            x, goal = draft.values.at(quantity, vehicle, T), values[vehicle]
            binding = draft.prog.AddLinearEqualityConstraint(x.matrix, goal - x.offset, x.variables)
            draft.note(GOAL, vehicle, binding, T)


def add_boxes(draft: Draft) -> None:
    """Add the boxes (4)-(7) of positions, velocities, accelerations and jerks."""
    for box in draft.problem.boxes:
        limited = np.flatnonzero(np.isfinite(box.bounds.lower).any(axis=1)).tolist()
        for vehicle, time in itertools.product(limited, box.times):
            if not _is_given(box, vehicle, time):
                add_box(draft, box, vehicle, time)


def _is_given(box: KeepInBox, vehicle: int, time: float) -> bool:
    """Return whether the goal of a vehicle gives the value that a box would limit."""
    own = np.array([vehicle])
    return box.given_end is not None and bool(box.given_end.includes(own, own, np.array([time]))[0])


def add_box(draft: Draft, box: KeepInBox, vehicle: int, time: float) -> None:
    """Add the box of one vehicle at one time; a jerk at a start or a goal in motion is free."""
    x = draft.values.at(box.quantity, vehicle, time)
    if np.isnan(x.offset).any():
        return
    lower, upper = box.bounds.lower[vehicle], box.bounds.upper[vehicle]
    if box.quantity == "acceleration":
        binding = draft.prog.AddBoundingBoxConstraint(lower, upper, x.variables)
    else:
        least, most = lower - x.offset, upper - x.offset
        binding = draft.prog.AddLinearConstraint(x.matrix, least, most, x.variables)
    draft.note(box.name, vehicle, binding, time)


def add_norms(draft: Draft) -> None:
    """Add the limits on norms, thrust and tilt, each a second-order cone at every knot."""
    for limit in norms_of(draft.problem.scenario, draft.problem.margins):
        add_sets(draft, limit)


def add_waypoints(draft: Draft) -> None:
    """Add the waypoints, points or balls of positions at their own times, of knots or not."""
    for waypoints in waypoints_of(draft.problem.scenario, draft.problem.margins):
        add_sets(draft, waypoints)


def add_requirements(draft: Draft) -> None:
    """Add the requirements (`KeepIn`) that a quantity, or a difference, stays in a convex set."""
    for requirement in draft.problem.requirements:
        add_sets(draft, requirement)


def add_obstacles(draft: Draft, reference: Motion) -> None:
    """Add the obstacles (8) known at the start, linearised around a motion (15)."""
    for obstacle in draft.problem.obstacles_around(reference):
        points = obstacle.inner_knots
        points = points.select(obstacle.holds_at(points.times))
        add_half_spaces(draft, obstacle.rows(points))


def add_separation(draft: Draft, reference: Motion, coupling: Coupling) -> None:
    """Add the separation of all pairs at all knots, linearised around a motion as in (15)."""
    scenario = draft.problem.scenario
    knots = np.arange(1, scenario.grid.knots - (not scenario.fleet.open_end))
    one, other = np.triu_indices(len(scenario.vehicles), 1)
    every, count = np.tile(knots, len(one)), len(knots)
    points = EvaluationPoints(
        np.repeat(one, count), np.repeat(other, count), scenario.grid.elapsed[every], every
    )
    add_half_spaces(draft, draft.problem.pairs_around(reference, coupling).rows(points))


def add_excesses(draft: Draft, constraint: Constraint, whose: IntArray) -> dict[int, np.ndarray]:
    """Add one variable for the largest excess of each vehicle, at its price; none for hard limits.

    Args:
        draft: the program.
        constraint: the constraint, soft or hard.
        whose: indices of the vehicles of its rows, shape (R,).

    Returns:
        The variable of each vehicle by index, shape (1,), at least 0 in the quantity's unit.
    """
    excesses = dict[int, np.ndarray]()
    prices = constraint.prices
    if prices is None:
        return excesses
    for vehicle in np.unique(whose).tolist():
        t = draft.prog.NewContinuousVariables(1, f"excess_{constraint.name}")
        draft.note(constraint.name, vehicle, draft.prog.AddBoundingBoxConstraint(0.0, np.inf, t))
        price = draft.prog.AddLinearCost(prices[[vehicle]], t)
        draft.note(PENALTIES, vehicle, price)
        excesses[vehicle] = t
    return excesses


def add_half_spaces(draft: Draft, rows: HalfSpaces) -> None:
    """Add rows n · x >= bound about single vehicles, or about differences of two."""
    form = rows.constraint
    if form.given_end is not None:
        rows = form.given_end.without(rows)
    excesses = add_excesses(draft, form, rows.vehicles)
    for vehicle, partner, time, normal, bound in zip(
        rows.vehicles, rows.partners, rows.times, rows.normals, rows.bounds, strict=True
    ):
        other = int(partner) if form.coupled else None
        x = draft.values.at(form.quantity, vehicle, time, other).mapped(normal[None])
        if (t := excesses.get(int(vehicle))) is not None:
            x = x - Affine(-np.eye(1), np.zeros(1), t)
        least, most = bound - x.offset, np.full(1, np.inf)
        binding = draft.prog.AddLinearConstraint(x.matrix, least, most, x.variables)
        draft.note(form.name, vehicle, binding, time, other)


def add_sets(draft: Draft, constraint: KeepInSets) -> None:
    """Add a constraint that keeps a quantity, or a difference, in convex sets."""
    everyone = np.arange(len(draft.problem))
    coasting = constraint.values(draft.values.coasting, everyone)  # less the places of the sets
    excesses = add_excesses(draft, constraint, coasting.vehicles)
    for vehicle, time, offset in zip(
        coasting.vehicles, coasting.times, coasting.values, strict=True
    ):
        x = draft.values.at(constraint.quantity, vehicle, time, constraint.partner)
        x = dataclasses.replace(x, offset=offset)
        inside, t = conic_in(constraint, vehicle), excesses.get(int(vehicle))
        added = (
            add_conic(draft.prog, x, inside) if t is None else add_near(draft.prog, x, inside, t)
        )
        for binding in added:
            draft.note(constraint.name, vehicle, binding, time, constraint.partner)


def add_near(
    prog: MathematicalProgram, x: Affine, inside: Conic, t: np.ndarray
) -> list[Binding[Any]]:
    """Add that x is no further than t from a convex set: from some y in the set."""
    y = Affine(np.eye(3), np.zeros(3), prog.NewContinuousVariables(3, "y"))
    ball = (x - y).mapped(np.vstack([np.zeros(3), np.eye(3)])) - Affine(
        -np.eye(4, 1), np.zeros(4), t
    )
    near = prog.AddLorentzConeConstraint(ball.matrix, ball.offset, ball.variables)
    return [*add_conic(prog, y, inside), near]


def add_conic(prog: MathematicalProgram, x: Affine, inside: Conic) -> list[Binding[Any]]:
    """Add a convex set of x: its rows, and its cone if there is one."""
    found: list[Binding[Any]] = []
    if len(inside.offsets) > 0:
        rows = x.mapped(inside.normals)
        least, most = np.full(len(rows.offset), -np.inf), inside.offsets - rows.offset
        found.append(prog.AddLinearConstraint(rows.matrix, least, most, x.variables))
    if len(inside.apex) == 0 or np.isinf(inside.apex[0]):
        return found
    cone = x.mapped(inside.cone, inside.apex)
    if inside.is_point:
        matrix, value = cone.matrix[1:], -cone.offset[1:]
        return [*found, prog.AddLinearEqualityConstraint(matrix, value, x.variables)]
    if inside.segment.any():
        t = prog.NewContinuousVariables(1, "t")
        found.append(prog.AddBoundingBoxConstraint(-1.0, 1.0, t))
        cone = cone - Affine((inside.cone @ inside.segment)[:, None], np.zeros(len(cone.offset)), t)
    return [*found, prog.AddLorentzConeConstraint(cone.matrix, cone.offset, cone.variables)]


def conic_in(constraint: KeepInSets, vehicle: int) -> Conic:
    """Return a vehicle's set in a constraint, by a moving point's deviation smaller."""
    sets = constraint.sets
    if isinstance(sets, Each):
        return conic_of(sets.set).tightened(sets.deviation)
    (matrix,), (offset,) = sets.cones(np.array([vehicle]))
    apex = np.append(offset, np.zeros(3)) - matrix @ sets.origins[vehicle]
    return Conic(np.zeros((0, 3)), np.zeros(0), matrix, apex)
