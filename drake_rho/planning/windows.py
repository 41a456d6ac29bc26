"""One window of a receding horizon: a new plan from where the vehicles are, or the old one's rest.

A new plan has a tube that begins anew, with what is unknown of the state at the window's start.
Where there is none, the previous plan is still valid, in its own tube: by induction no window is
without a plan as long as nothing new becomes known and the disturbance is as declared. Where that
does not hold, the window flies what breaks the scenario least.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from drake_rho.motion.margins import margins_of
from drake_rho.motion.plan import Plan, Window
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.keep_apart import decoupled
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.minimum_violation import minimum_breach, minimum_violation
from drake_rho.planning.room import lacks
from drake_rho.planning.solve import Solver
from drake_rho.planning.subproblem import Subproblem
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.records import Scenario


class Planner(Protocol):
    """What `plan_rho` asks of a planner: `plan_convex`, `plan_scp`, or another of this form."""

    def __call__(
        self, scenario: Scenario, *, reference: Plan | None, solver: Solver | None
    ) -> Plan:
        """A plan for `scenario`, found from `reference`."""
        ...


Reference = Callable[[Scenario, Plan | None, Solver | None], Plan | None]
"""What a window is linearised around: (its scenario, the rest of the previous prediction or None in
the first window, the solver) -> a motion of the same vehicles on the same grid, or None for the one
that planners make by themselves."""


def free_reference(scenario: Scenario, tail: Plan | None, solver: Solver | None) -> None:
    """The paper's reference: each window's own solution without the obstacles.

    Planners begin with that one when they are given none.
    """


def tail_reference(scenario: Scenario, tail: Plan | None, solver: Solver | None) -> Plan | None:
    """What is left of the previous prediction; in the first window, the paper's reference.

    The tail meets every constraint of the window, so there is always a plan, up to rounding.
    """
    return tail


_Failure = InfeasibleError | SolverError


@dataclasses.dataclass(frozen=True)
class WindowPlanner:
    """How windows are planned."""

    planner: Planner
    """plans one window"""
    fallback: Planner | None
    """plans a window for which `planner` has no solution; None for nothing but the tail"""
    reference: Reference
    """what `planner` linearises around"""
    solver: Solver | None
    """a Drake solver or `Daqp()`; Clarabel if None"""

    def first(self, scenario: Scenario) -> Window:
        """The first window, which begins at the start of a scenario.

        Raises:
            InfeasibleError: it has no plan.
            SolverError: the solvers fail numerically.
        """
        window = self._planned(scenario, 0, None)
        if not isinstance(window, Window):
            window = self._planned_again(self.fallback, scenario, 0, None, window)
        if not isinstance(window, Window):
            raise window
        return window

    def next(
        self,
        scenario: Scenario,
        first_knot: int,
        tail: Plan,
        *,
        on_plan: bool,
        nothing_new: bool = False,
    ) -> Window:
        """A later window, which has a plan in any case.

        Where vehicles are disturbed and the tail holds, the planner is asked a second time, around
        the tail, in place of the fallback, which may take long.

        Args:
            scenario: what is left of the flight, from where the vehicles are.
            first_knot: where in the whole flight the window starts, counted from 0.
            tail: what is left of the previous prediction.
            on_plan: whether the vehicles are in the tail's tube, so that it is valid as it is.
            nothing_new: whether it begins just as the window before has it, with the same obstacles
                and no tube, so that there is room at its start.
        """
        followed, reasons = _moved(tail, scenario), dict[str, tuple[str, ...]]()
        if not nothing_new:
            reasons = lacks(scenario, margins_of(scenario), under_way=True)
        window = (
            InfeasibleError(reasons) if reasons else self._planned(scenario, first_knot, followed)
        )
        if isinstance(window, Window):
            return window
        holds = on_plan and Subproblem(tail.scenario, decoupled, self.solver).holds(tail)
        if not reasons:
            quick = holds and scenario.disturbance is not None
            other = self.planner if quick else self.fallback
            window = self._planned_again(other, scenario, first_knot, followed, window)
            if isinstance(window, Window):
                return window
        if holds:
            plan = tail.with_statistics(window.statistics)
        else:
            plan = least_breach(followed, self.solver)
            plan = plan.with_statistics(window.statistics + plan.statistics)
        return Window(first_knot, plan, plan, infeasible=str(window), kept=holds)

    def _planned(self, scenario: Scenario, first_knot: int, tail: Plan | None) -> Window | _Failure:
        """The planner's window, or why it has none."""
        around = None
        try:
            if scenario.obstacles or scenario.separation is not None:
                around = self.reference(scenario, tail, self.solver)
            plan = self.planner(scenario, reference=around, solver=self.solver)
        except (InfeasibleError, SolverError) as error:
            return error
        return Window(first_knot, plan, around or plan.reference or plan)

    def _planned_again(
        self,
        planner: Planner | None,
        scenario: Scenario,
        first_knot: int,
        tail: Plan | None,
        failure: _Failure,
    ) -> Window | _Failure:
        """The window of another planner, around the tail, or why it has none either."""
        if planner is None:
            return failure
        try:
            plan = planner(scenario, reference=tail, solver=self.solver)
        except (InfeasibleError, SolverError) as error:
            error.statistics = failure.statistics + error.statistics
            return error
        plan = plan.with_statistics(failure.statistics + plan.statistics)
        return Window(first_knot, plan, plan.reference or plan)


def least_breach(reference: Plan, solver: Solver | None = None) -> Plan:
    """The plan that breaks least of its scenario, from wherever that begins.

    Goals and limits are kept if they can be, and then what is too close to something is so as
    little as can be. Else goals may be missed too, and if no solver finds a plan, the reference's
    accelerations are flown.

    Args:
        reference: a motion of the scenario's vehicles from its start to its goals.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.
    """
    scenario, spent = reference.scenario, Statistics()
    if scenario.known or scenario.separation is not None:  # else nothing can be too close
        try:
            return minimum_breach(reference, solver)
        except (InfeasibleError, SolverError) as error:
            spent = error.statistics
    try:
        plan = minimum_violation(scenario, solver)
    except SolverError as error:
        return reference.with_statistics(spent + error.statistics)
    return plan.with_statistics(spent + plan.statistics)


def _moved(tail: Plan, scenario: Scenario) -> Plan:
    """The rest of a plan, flown from another start to the same goals with the least change."""
    if scenario.fleet is tail.scenario.fleet:
        return unchecked(tail, scenario=scenario)
    there = MinimumEffort.of(scenario).motion.accelerations
    here = MinimumEffort.of(tail.scenario).motion.accelerations
    changed = np.asarray(tail.accelerations + there - here, dtype=np.float64)
    return Plan.from_accelerations(scenario, changed)
