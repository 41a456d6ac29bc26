"""The convex problem around one reference after the other."""

from __future__ import annotations

import dataclasses
from copy import copy
from typing import Self

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.catalogue import convex_constraints
from drake_rho.planning.constraints.obstacles import obstacles_of
from drake_rho.planning.constraints.separation import (
    Coupling,
    coupled,
    decoupled,
    grouped,
    pairs_of,
)
from drake_rho.planning.constraints.violations import Breaches, breaches_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.options import DEFAULTS, Options
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.planning.programs.parallel import OnWorkers
from drake_rho.planning.programs.solve import Solver
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_ROUNDS_AMONG_OBSTACLES = 4
"""Rounds of rows in the first steps of a restoration that has to bring vehicles round obstacles:
with fewer they come out inside of some, and on the wrong side of others."""

_AGAIN = 0.5
"""Part of a breach that was too large for hard rows, from which on these are tried again."""


def constraints_around(scenario: Scenario, reference: Plan | None) -> list[Constraint]:
    """The keep-in constraints, and the obstacles linearised (15) around a reference, if any.

    Raises:
        ValueError: the reference has other vehicles or another grid.
    """
    constraints = convex_constraints(scenario)
    if reference is not None:
        _check_fits(reference, scenario)
        constraints += obstacles_of(scenario, reference.motion())
    return constraints


def plan_around(scenario: Scenario, reference: Plan | None, solver: Solver | None = None) -> Plan:
    """The plan of least cost with obstacles linearised (15) around `reference`.

    Args:
        scenario: what is asked; its separation is not looked at.
        reference: a motion of the same vehicles on the same grid; None ignores the obstacles.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Raises:
        InfeasibleError: the linearised program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
        ValueError: the reference has other vehicles or another grid.
    """
    planes = CuttingPlanes(scenario, solver)
    planes.keep_to(constraints_around(scenario, reference), reference=reference)
    return planes.plan(reference)


def coupling_for(scenario: Scenario, options: Options = DEFAULTS) -> Coupling:
    """How a fleet is kept apart if nothing else is asked: the larger, the less together."""
    count = len(scenario.vehicles)
    if count <= options.max_coupled:
        return coupled
    return grouped if count <= options.max_grouped else decoupled


class Subproblem:
    """A scenario's convex problems; rows active in one solution are in the next from the start.

    Args:
        scenario: what is asked.
        coupling: how pairs are kept apart, if the scenario asks for it.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.

    Attributes:
        scenario: as given.
        planes: the programs that were solved last.
        steepest: times the first penalty up to which penalties of a restoration grow.
        begun: how many steps of a restoration count as taken before the first.
        settled: whether it is known that a further iteration would change the cost by less than
            the tolerance.
        labels: vehicles whose iterations stop together have the same one, shape (N,).
    """

    steepest = 1e5
    begun = 0

    def __init__(
        self,
        scenario: Scenario,
        coupling: Coupling = coupled,
        solver: Solver | OnWorkers | None = None,
    ) -> None:
        count = len(scenario.vehicles)
        self.scenario = scenario
        self.planes: CuttingPlanes | None = None
        self.settled = False
        apart = scenario.separation is not None
        self.labels: IntArray = np.zeros(count, dtype=int) if apart else np.arange(count)
        self._coupling, self._solver = coupling, solver
        self._effort, self._warm = MinimumEffort.of(scenario), list[HalfSpaces]()
        self._cones = ConicPrograms(self._effort)
        self._too_much = np.inf
        self._looked: tuple[Plan, Breaches] | None = None

    def afresh(self) -> Self:
        """Return this subproblem without rows of solutions, to begin from somewhere else.

        What it found of limits goes on to hold: whose curved sets come to no end as tangent planes.
        """
        fresh = copy(self)
        fresh.settled, fresh._warm, fresh._looked, fresh._too_much = False, [], None, np.inf
        return fresh

    @property
    def least_cost(self) -> float:
        """Of all motions that reach the goals, with nothing else asked [m²/s⁴]."""
        return float(np.sum(self._effort.motion.accelerations**2))

    def around(self, reference: Plan, vehicles: IntArray | None = None) -> Plan:
        """The plan of least cost with obstacles and pairs linearised around `reference`.

        Where a coupled fleet has none, it has none decoupled either, and then each vehicle's
        reasons can be told.

        Args:
            reference: a motion of the same vehicles on the same grid.
            vehicles: which of them are planned, rising indices; the others fly the reference.

        Raises:
            InfeasibleError: there is none.
            SolverError: the solvers fail numerically.
        """
        constraints = constraints_around(self.scenario, reference)
        if self.scenario.separation is None:
            return self._solve(reference, constraints, vehicles)
        pairs = pairs_of(self.scenario, reference.motion(), self._coupling, of=vehicles)
        try:
            return self._solve(reference, [*constraints, pairs], vehicles)
        except InfeasibleError:
            if not self._coupling.together:
                raise
        other = Subproblem(self.scenario, decoupled, self._solver)
        plan = other.around(reference)
        self.planes = other.planes
        return plan

    def improved(self, plan: Plan, vehicles: IntArray, tolerance: float) -> Plan:
        """A plan that costs no more, with obstacles and pairs linearised around a plan.

        Args:
            plan: keeps every constraint.
            vehicles: which of them are planned, rising indices; the others fly the plan.
            tolerance: relative fall of the cost that is small enough.

        Raises:
            InfeasibleError: there is none.
            SolverError: the solvers fail numerically.
        """
        return self.around(plan, vehicles)

    def restored(self, reference: Plan, penalty: float, number: int) -> Plan:
        """A plan closer to keeping out: what is too close may stay so, at a penalty.

        As soon as it almost keeps out, the rows are tried as hard ones. Vehicles that fly the
        reference, and are in nobody's way, go on flying it. Obstacles are soft only where the
        reference breaks more than the separation of pairs.

        Args:
            reference: positions of the same vehicles at the same knots.
            penalty: cost of each metre by which a vehicle is too close.
            number: how many such steps have gone before: the first gives each encounter one
                direction, and later ones are solved more exactly.

        Raises:
            InfeasibleError: the constraints without any obstacle or pair cannot be met.
            SolverError: the solvers fail numerically.
        """
        found = self._look_at(reference)
        worst = found.worst(self.scenario)
        if found.is_almost_out(self.scenario) and worst < _AGAIN * self._too_much:
            try:
                return self.around(reference)
            except (InfeasibleError, SolverError):  # not yet
                self._too_much = worst
        motion, rounds = reference.motion(), number // 2
        rounds += 1 if found.is_of_pairs_only else _ROUNDS_AMONG_OBSTACLES
        constraints = self._limits(penalty)
        for each in obstacles_of(self.scenario, motion):
            soft = dataclasses.replace(each.softened(penalty), rounds=rounds, searches=1)
            constraints.append(each if found.is_of_pairs_only else soft)
        if self.scenario.separation is not None:
            constraints.append(
                pairs_of(
                    self.scenario,
                    motion,
                    self._coupling,
                    penalty=penalty,
                    aside=number == 0,
                    rounds=rounds,
                    of=found.vehicles,
                )
            )
        return self._solve(reference, constraints, found.vehicles)

    def _limits(self, penalty: float) -> list[Constraint]:
        """What vehicles keep in while they are restored."""
        return convex_constraints(self.scenario)

    def is_flown(self, plan: Plan) -> bool:
        """Whether a plan's positions are those that its accelerations lead to."""
        return len(self._look_at(plan).unflyable) == 0

    def keeps_apart(self, plan: Plan) -> bool:
        """Whether all pairs keep apart, if the scenario asks for it."""
        return len(self._look_at(plan).pairs) == 0

    def holds(self, plan: Plan) -> bool:
        """Whether a plan can be flown within limits, keeps apart and out of obstacles."""
        found = self._look_at(plan)
        return len(found.pairs) == 0 and found.is_of_pairs_only

    def almost_holds(self, plan: Plan) -> bool:
        """Whether a plan can be flown and is too close to nothing by more than a little."""
        return self._look_at(plan).is_almost_out(self.scenario)

    def in_trouble(self, plan: Plan) -> IntArray:
        """The vehicles that break something, rising."""
        return self._look_at(plan).vehicles

    def worst_breach(self, plan: Plan) -> float:
        """By how much a plan is too close to something at most [m]; 0 if it is to nothing."""
        return self._look_at(plan).worst(self.scenario)

    def _look_at(self, plan: Plan) -> Breaches:
        """What a plan breaks; looked for once."""
        if self._looked is None or self._looked[0] is not plan:
            _check_fits(plan, self.scenario)
            self._looked = plan, breaches_of(self.scenario, plan, self._looked)
        return self._looked[1]

    def failure(self, plan: Plan, spent: Statistics) -> InfeasibleError | SolverError | None:
        """What a plan does not keep out of, and when; None if it keeps out of everything."""
        return None if self.holds(plan) else self._look_at(plan).error(self.scenario, spent)

    def _solve(
        self, reference: Plan, constraints: list[Constraint], vehicles: IntArray | None
    ) -> Plan:
        by_key = {constraint.key: constraint for constraint in constraints}
        planes = CuttingPlanes(
            self.scenario,
            self._solver,
            effort=self._effort,
            vehicles=vehicles,
            accelerations=reference.accelerations,
            cones=self._cones,
        )
        warm = [by_key[rows.constraint.key].renewed(rows) for rows in self._warm]
        planes.keep_to(constraints, warm=warm, reference=reference)
        self._warm = planes.working.active(planes.motion)
        self.planes = planes
        return planes.plan(reference)


def _check_fits(reference: Plan, scenario: Scenario) -> None:
    theirs, ours = (
        (len(asked.vehicles), asked.grid.knots, asked.grid.step)
        for asked in (reference.scenario, scenario)
    )
    if theirs != ours:
        words = "{} vehicles on {} knots, {:g} s apart"
        got, expected = words.format(*theirs), words.format(*ours)
        raise ValueError(f"reference: got {got}, expected {expected}")
