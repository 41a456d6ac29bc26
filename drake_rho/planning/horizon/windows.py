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

from drake_rho.motion.plan import Plan, Window
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.constraints.tightening import NO_ROOM, lacks
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver
from drake_rho.planning.scp.minimum_violation import minimum_breach, minimum_violation
from drake_rho.planning.scp.violations import violations_of
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.records import Scenario
from drake_rho.verification.holds import first_violation


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


@checked
def free_reference(scenario: Scenario, tail: Plan | None, solver: Solver | None) -> None:
    """The paper's reference: each window's own solution without the obstacles.

    Planners begin with that one when they are given none.
    """


@checked
def tail_reference(scenario: Scenario, tail: Plan | None, solver: Solver | None) -> Plan | None:
    """What is left of the previous prediction; in the first window, the paper's reference.

    The tail meets every constraint of the window, so there is always a plan, up to rounding.
    """
    return tail


_Failure = InfeasibleError | SolverError | OutOfTimeError

_FAILURES = InfeasibleError, SolverError, OutOfTimeError, MemoryError
"""What planners raise: none of it ends a flight."""


def _failure(error: Exception) -> _Failure:
    """Return what a planner raised as what a window tells of it."""
    if isinstance(error, InfeasibleError | SolverError | OutOfTimeError):
        return error
    return SolverError("the planner ran out of memory")


@dataclasses.dataclass(frozen=True)
class WindowPlanner:
    """How windows are planned.

    With a disturbance every new plan is judged by the verifier's own mathematics, with all of its
    tube and up to its end, before it is accepted. Without one the planner's last check counts.
    """

    planner: Planner
    """plans one window"""
    fallback: Planner | None
    """plans a window for which `planner` has no solution; None for nothing but the tail"""
    reference: Reference
    """what `planner` linearises around"""
    solver: Solver | None
    """a Drake solver or `Daqp()`; Clarabel if None"""

    def first(self, scenario: Scenario, measured: Scenario) -> Window:
        """Return the first window, which begins where the vehicles are measured to be.

        Args:
            scenario: as it is asked.
            measured: the same from measured states; the very scenario if they are at their starts.

        Raises:
            InfeasibleError: the scenario has no plan from its own starts.
            SolverError: the solvers fail numerically.
        """
        if measured is scenario:
            return self._first(scenario)
        failure: _Failure
        if reasons := _lacks(measured):
            failure = _no_room(measured, reasons)
        else:
            try:
                return self._first(measured)
            except (InfeasibleError, SolverError, OutOfTimeError) as error:
                failure = error
        own = self._first(scenario)
        plan = least_breach(_moved(own.plan, measured), self.solver)
        spent = failure.statistics + own.statistics + plan.statistics
        plan = plan.with_statistics(spent)
        return Window(0, plan, plan, infeasible=str(failure))

    def _first(self, scenario: Scenario) -> Window:
        """Return a window from the start of a scenario, or raise why there is none."""
        window = self._planned(scenario, 0, None)
        if not isinstance(window, Window):
            window = self._planned_again(self.fallback, scenario, 0, None, window)
        if not isinstance(window, Window):
            raise window
        return window

    def next(
        self, scenario: Scenario, first_knot: int, tail: Plan, *, last: Window, on_plan: bool
    ) -> Window:
        """Return a later window, which has a plan in any case.

        Where vehicles are disturbed and the tail holds, the planner is asked a second time, around
        the tail, in place of the fallback, which may take long.

        Args:
            scenario: what is left of the flight, from where the vehicles are.
            first_knot: where in the whole flight the window starts, counted from 0.
            tail: what is left of the previous prediction.
            last: the window before, whose prediction that is.
            on_plan: whether the vehicles are in the tail's tube, so that it is valid as it is.
        """
        followed = _moved(tail, scenario)
        window: Window | _Failure | None = self._without_room(scenario, tail, last)
        window = window or self._planned(scenario, first_knot, followed)
        if isinstance(window, Window):
            return window
        holds = on_plan and self._still_holds(tail, last)
        if not _lacks(scenario):  # else no other plan has room either
            quick = holds and scenario.disturbance is not None
            other = self.planner if quick else self.fallback
            window = self._planned_again(other, scenario, first_knot, followed, window)
            if isinstance(window, Window):
                return window
        cut = isinstance(window, OutOfTimeError)
        spent = dataclasses.replace(window.statistics, cut=window.statistics.cut or cut)
        if holds:
            plan = tail.with_statistics(spent)
        else:
            plan = least_breach(followed, self.solver)
            plan = plan.with_statistics(spent + plan.statistics)
        return Window(first_knot, plan, plan, infeasible=str(window), kept=holds)

    def _without_room(self, scenario: Scenario, tail: Plan, last: Window) -> _Failure | None:
        """Return what leaves a window no room, if that is likely or would not be seen later.

        With a disturbance the judge sees it, so that it is asked first only where the last window
        had none. Without one there is room where the window begins as the last one has it, and
        nothing new is known.
        """
        if scenario.disturbance is not None:
            has_room = not last.kept
        else:
            same = scenario is tail.scenario and not last.infeasible
            has_room = same and not _news(tail, last)
        if has_room:
            return None
        reasons = _lacks(scenario)
        return _no_room(scenario, reasons) if reasons else None

    def _still_holds(self, tail: Plan, last: Window) -> bool:
        """Return whether the rest of the previous plan keeps every constraint.

        What was judged when it was accepted needs no second look, by which it could only be lost to
        rounding: the shorter the rest, the smaller its tolerances.
        """
        if tail.scenario.disturbance is None:
            return violations_of(Problem.of(tail.scenario), tail).none
        accepted = last.kept or not last.infeasible
        return first_violation(tail, _news(tail, last) if accepted else None) is None

    def _planned(self, scenario: Scenario, first_knot: int, tail: Plan | None) -> Window | _Failure:
        """Return the planner's window, or why it has none."""
        around = None
        try:
            if scenario.obstacles or scenario.separation is not None:
                around = self.reference(scenario, tail, self.solver)
            plan = _judged(scenario, self.planner(scenario, reference=around, solver=self.solver))
        except _FAILURES as error:
            return _failure(error)
        return Window(first_knot, plan, around or plan.reference or plan)

    def _planned_again(
        self,
        planner: Planner | None,
        scenario: Scenario,
        first_knot: int,
        tail: Plan | None,
        failure: _Failure,
    ) -> Window | _Failure:
        """Return the window of another planner, around the tail, or why it has none either."""
        if planner is None:
            return failure
        try:
            plan = _judged(scenario, planner(scenario, reference=tail, solver=self.solver))
        except _FAILURES as error:
            again = _failure(error)
            again.statistics = failure.statistics + again.statistics
            return again
        plan = plan.with_statistics(failure.statistics + plan.statistics)
        return Window(first_knot, plan, plan.reference or plan)


def _lacks(scenario: Scenario) -> dict[str, tuple[str, ...]]:
    """Return for each vehicle of a window without room what leaves it none."""
    return lacks(scenario, Problem.of(scenario).margins, under_way=True)


def _no_room(scenario: Scenario, reasons: dict[str, tuple[str, ...]]) -> InfeasibleError:
    """Return why a window has no plan that has no room."""
    because = "no room" if scenario.disturbance is None else NO_ROOM
    return InfeasibleError(reasons, scenario=scenario, because=because)


def _judged(scenario: Scenario, plan: Plan) -> Plan:
    """Return a plan that the verifier accepts with all of its tube, if it has one.

    Args:
        scenario: as it was asked of the planner, whatever the plan says of it.
        plan: the planner's.

    Raises:
        InfeasibleError: the verifier does not; it says what the plan breaks.
    """
    if scenario.disturbance is None:
        return plan
    asked = plan
    if plan.scenario is not scenario:
        asked = Plan.from_accelerations(scenario, plan.accelerations, plan.statistics)
    if (broken := first_violation(asked)) is None:
        return asked
    what = f"{broken.what} by {broken.excess:.3g} {broken.unit} at {clock_time(broken.time)}"
    raise InfeasibleError(
        {broken.vehicle: (what,)},
        statistics=plan.statistics,
        scenario=scenario,
        because="the plan that was found does not hold",
    )


def _news(tail: Plan, last: Window) -> list[int]:
    """Return the numbers of the obstacles that are known now and were not in the last window."""
    before = {number for number, _ in last.plan.scenario.known}
    return [number for number, _ in tail.scenario.known if number not in before]


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
            return minimum_breach(reference, Backend(solver))
        except (InfeasibleError, SolverError, OutOfTimeError) as error:
            spent = error.statistics
    try:
        plan = minimum_violation(Problem.of(scenario), Backend(solver))
    except (SolverError, OutOfTimeError) as error:
        return reference.with_statistics(spent + error.statistics)
    return plan.with_statistics(spent + plan.statistics)


def _moved(tail: Plan, scenario: Scenario) -> Plan:
    """The rest of a plan, flown from another start to the same goals with the least change."""
    if scenario.fleet is tail.scenario.fleet:
        return unchecked(tail, scenario=scenario)
    there, here = (
        Problem.of(each).effort.motion.accelerations for each in (scenario, tail.scenario)
    )
    changed = np.asarray(tail.accelerations + there - here, dtype=np.float64)
    return Plan.from_accelerations(scenario, changed)
