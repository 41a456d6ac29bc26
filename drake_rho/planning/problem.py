"""A scenario, compiled for planning: made once, passed on."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.catalogue import convex_constraints
from drake_rho.planning.constraints.coupling import Coupling
from drake_rho.planning.constraints.margins import PlanMargins, margins_of
from drake_rho.planning.constraints.obstacles import KeepOutOfObstacle, obstacles_of
from drake_rho.planning.constraints.separation import KeepApart, pairs_of
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_PIECES = 16
"""Pieces of a step that finer margins are constant over, at least."""

_LESS = 0.02
"""Part by which finer margins are smaller, for another search to be worth its time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """The least cost of a scenario's motions, subject to its constraints.

    All that planners derive from the scenario is derived here, when it is first used.
    """

    scenario: Scenario
    """to be planned"""
    pieces: int = 1
    """equal pieces of a step over which margins of positions and velocities are constant"""
    elastic: bool = False
    """whether only violations cost anything, and goals may be missed"""

    @classmethod
    def of(cls, scenario: Scenario) -> Problem:
        """Return the problem of a scenario, with margins that are constant over steps."""
        return cls(scenario)

    def __len__(self) -> int:
        """Return the number of vehicles, N."""
        return len(self.scenario.vehicles)

    @cached_property
    def margins(self) -> PlanMargins:
        """Distances that plans keep inside their limits, for the errors of disturbed flights."""
        return margins_of(self.scenario, self.pieces)

    @cached_property
    def effort(self) -> MinimumEffort:
        """Minimum effort, which programs are about changes of."""
        effort = MinimumEffort.of(self.scenario)
        return effort.without_goals() if self.elastic else effort

    @cached_property
    def convex(self) -> tuple[Constraint, ...]:
        """Convex constraints, which hold whatever the reference: boxes, norms and waypoints."""
        return tuple(convex_constraints(self.scenario, self.margins))

    def obstacles_around(self, reference: Motion) -> list[KeepOutOfObstacle]:
        """Return the known obstacles, linearised (15) around a motion of the same vehicles."""
        return obstacles_of(self.scenario, self.margins, reference)

    def pairs_around(
        self,
        reference: Motion,
        coupling: Coupling,
        *,
        penalty: float = np.inf,
        one_normal: bool = False,
        of: IntArray | None = None,
        close: CloseApproaches | None = None,
    ) -> KeepApart:
        """Return the separation of all pairs, linearised around a motion.

        Args and errors are those of `pairs_of`.
        """
        return pairs_of(
            self.scenario,
            self.margins,
            reference,
            coupling,
            penalty=penalty,
            one_normal=one_normal,
            of=of,
            close=close,
        )

    def linearized(
        self,
        reference: Plan | None,
        coupling: Coupling | None = None,
        *,
        vehicles: IntArray | None = None,
    ) -> list[Constraint]:
        """Return all constraints, obstacles and pairs linearised around a reference.

        Args:
            reference: None leaves obstacles and pairs out.
            coupling: how rows of pairs are written; None leaves pairs out.
            vehicles: of which each pair has one or two, rising indices; all if not given.

        Raises:
            ValueError: the reference has other vehicles or another grid.
        """
        constraints = list(self.convex)
        if reference is None:
            return constraints
        self.check_fits(reference)
        motion = reference.motion()
        constraints += self.obstacles_around(motion)
        if coupling is not None and self.scenario.separation is not None:
            constraints.append(self.pairs_around(motion, coupling, of=vehicles))
        return constraints

    def check_fits(self, reference: Plan) -> None:
        """See that a reference is of as many vehicles on the same grid.

        Raises:
            ValueError: it is not.
        """
        theirs, ours = (
            (len(each.vehicles), each.grid.knots, each.grid.step)
            for each in (reference.scenario, self.scenario)
        )
        if theirs != ours:
            words = "{} vehicles on {} knots, {:g} s apart"
            got, expected = words.format(*theirs), words.format(*ours)
            raise ValueError(f"reference: got {got}, expected {expected}")

    def without_obstacles(self) -> Problem:
        """Return this problem with nothing in the way."""
        return dataclasses.replace(self, scenario=self.scenario.without_obstacles())

    def without_separation(self) -> Problem:
        """Return this problem with vehicles that are independent of each other."""
        return dataclasses.replace(self, scenario=self.scenario.without_separation())

    def of_violations(self) -> Problem:
        """Return the problem in which only violations cost anything, and goals may be missed."""
        return dataclasses.replace(self, elastic=True)

    def with_finer_margins(self) -> Problem | None:
        """Return this problem with margins over pieces of steps; None where they are no smaller.

        Nor is there time for them in a flight, in which the previous plan goes on.
        """
        scenario = self.scenario
        if scenario.disturbance is None or self.pieces > 1 or scenario.under_way:
            return None
        samples = scenario.disturbance.samples_per_step(scenario.grid.step)
        # whole parts of samples where these are few
        pieces = samples * math.ceil(_PIECES / samples) if samples < _PIECES else _PIECES
        finer = dataclasses.replace(self, pieces=pieces)
        return finer if finer._has_smaller_margins() else None

    def _has_smaller_margins(self) -> bool:
        """Return whether margins over pieces are smaller than over steps, by a part that counts."""
        inner, steps = self.margins.inner, self.margins.steps
        return any(
            np.any(inner.knots[each][:: self.pieces] < (1.0 - _LESS) * steps.knots[each])
            for each in ("position", "velocity")
        )


def with_finer_margins(find: Callable[[Problem], Plan], problem: Problem) -> Plan:
    """Return what is found with margins over steps or, before refusing, over pieces of them.

    Args:
        find: a plan of a problem; it may raise `InfeasibleError` and `SolverError`.
        problem: with margins over steps.

    Raises:
        InfeasibleError: there is none with either.
        SolverError: the solvers fail numerically.
    """
    try:
        return find(problem)
    except InfeasibleError as error:
        if (finer := problem.with_finer_margins()) is None:
            raise
        try:
            plan = find(finer)
        except InfeasibleError as again:  # which says how much slack there is, to the last piece
            spent = error.statistics + again.statistics
            raise again.after(error.steps_tried, spent) from None
        except SolverError as again:
            raise error.after(error.steps_tried, error.statistics + again.statistics) from None
        return plan.with_statistics(error.statistics + plan.statistics)


def finest(scenario: Scenario) -> Problem:
    """Return the problem of a scenario with finer margins, where these are smaller."""
    problem = Problem.of(scenario)
    return problem.with_finer_margins() or problem
