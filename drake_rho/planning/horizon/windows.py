"""A window of a receding horizon: a new plan from the current states, or the remaining one.

A new plan has a new error tube, which begins with the errors of the state estimate. If there is no
new plan, the previous one is still valid in its own tube. Windows are therefore recursively
feasible as long as nothing new becomes known and the disturbance is within the declared one.
Otherwise the window flies the plan of minimum violation.
"""

from __future__ import annotations

import dataclasses

from drake_rho.motion.flight import Window
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.plan_in_force import in_force
from drake_rho.planning.constraints.tightening import NO_SLACK, missing_slack
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.horizon.contingencies import as_part_of, contingency
from drake_rho.planning.horizon.fallbacks import (
    FAILURES,
    Failure,
    failure_of,
    least_violation,
    moved,
)
from drake_rho.planning.horizon.interfaces import Planner, Reference
from drake_rho.planning.horizon.situation import WindowStart
from drake_rho.planning.horizon.waypoints_ahead import with_waypoints
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Solver
from drake_rho.planning.scp.violations import violations_of
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.records import Scenario
from drake_rho.verification.holds import first_violation

ROUNDED = 1e-9
"""Relative difference below which two costs are equal: where nothing is active, a new plan is the
moved rest of the previous one but for rounding, and is accepted whatever the last digits."""

_BEFORE = "it is violated before vehicles could brake"
"""Reason why a window whose plan violates constraints has no contingency."""


@dataclasses.dataclass(frozen=True)
class WindowPlanner:
    """Planner of single windows.

    With a disturbance the verifier checks every new plan, with its whole tube and up to its end,
    before it is accepted. Without one the planner's last check suffices.
    """

    planner: Planner
    """planner of a window"""
    fallback: Planner | None
    """planner of a window for which `planner` has no solution; None to continue the last plan"""
    reference: Reference
    """function for the motion around which `planner` linearises"""
    solver: Solver | None
    """Drake solver or `Daqp()`; Clarabel if None"""
    retimed: bool = False
    """whether planners may change the times of waypoints"""
    braking_after: int | None = None
    """number of steps after which contingencies brake; None for windows without contingencies"""
    brakes: bool = False
    """whether windows without a plan brake to rest, if they can, rather than violate least"""
    bounded_cost: bool = False
    """whether to reject plans that cost more than the rest of the previous one, moved"""

    def first(self, scenario: Scenario, measured: Scenario) -> Window:
        """Return the first window, which begins at the measured states.

        Args:
            scenario: to be flown.
            measured: the scenario from measured states; the same object if these are the starts.

        Raises:
            InfeasibleError: the scenario has no plan from its own starts.
            SolverError: the solvers fail numerically.
        """
        if measured is scenario:
            return self._first(scenario)
        failure: Failure
        if reasons := _lacks(measured):
            failure = _no_slack(measured, reasons)
        else:
            try:
                return self._first(measured)
            except (InfeasibleError, SolverError, OutOfTimeError) as error:
                failure = error
        own = self._first(scenario)
        plan = least_violation(moved(own.plan, measured), self.solver)
        spent = failure.statistics + own.statistics + plan.statistics
        plan = plan.with_statistics(spent)
        return Window(0, plan, plan, infeasible=str(failure))

    def _first(self, scenario: Scenario) -> Window:
        """Return a window from the starts of a scenario, or raise the planner's error."""
        window = self._planned(scenario, 0, None)
        if not isinstance(window, Window):
            window = self._planned_again(self.fallback, scenario, 0, None, window)
        if not isinstance(window, Window):
            raise window
        return window

    def next(self, start: WindowStart) -> Window:
        """Return a window after the first, which always has a motion to fly.

        If there is a disturbance and the remaining plan is valid, the planner is called a second
        time, around that plan, instead of the fallback, which may take long. If contingencies are
        enabled, one is flown rather than a motion of minimum violation.

        Args:
            start: rest of the flight and of the plan in force.
        """
        scenario, previous = start.scenario, start.reference
        window: Window | Failure | None = self._lack_of_slack(start)
        with in_force(start.remaining):
            window = window or self._planned(scenario, start.knot, previous)
        if isinstance(window, Window):
            free = start.has_new_orders or self._is_cheap(window.plan, previous)
            if free or not self.still_holds(start):
                return window
            window = _too_costly(window.plan, previous)
        holds = self.still_holds(start)
        if not _lacks(scenario):  # otherwise no planner can find a plan
            quick = holds and scenario.disturbance is not None
            other = self.planner if quick else self.fallback
            window = self._planned_again(other, scenario, start.knot, previous, window)
            if isinstance(window, Window):
                if self._is_cheap(window.plan, previous) or not holds:
                    return window
                window = _too_costly(window.plan, previous)
        cut = isinstance(window, OutOfTimeError)
        spent = dataclasses.replace(window.statistics, cut=window.statistics.cut or cut)
        reason = str(window)
        if holds:
            plan = start.remaining.with_statistics(spent)
            return Window(start.knot, plan, plan, infeasible=reason, kept=True)
        without = Window(start.knot, previous.with_statistics(spent), previous, reason)
        return self._without_plan(without, start)

    def _without_plan(self, window: Window, start: WindowStart) -> Window:
        """Return a window that flies a contingency or, if there is none, the least violation.

        Args:
            window: with the rest of the previous prediction, moved, and the reason for having no
                plan.
            start: rest of the flight and of the plan in force.
        """
        previous, spent, none_found = window.reference, window.plan.statistics, ""
        if self.brakes:
            flown = previous
            try:
                stop = start.stop
                if start.on_plan and stop is not None and first_violation(stop) is None:
                    found, flown = stop, start.remaining
                else:
                    found = contingency(previous, 0, self.solver)
            except FAILURES as error:
                none_found = str(error)
            else:
                plan = as_part_of(found, flown.scenario).with_statistics(spent)
                return dataclasses.replace(
                    window, plan=plan, reference=plan, contingency=found, stopping=True
                )
        plan = least_violation(previous, self.solver)
        plan = plan.with_statistics(spent + plan.statistics)
        return dataclasses.replace(window, plan=plan, reference=plan, no_contingency=none_found)

    def with_contingency(self, window: Window) -> Window:
        """Return a window with a contingency, or with the reason why there is none.

        It brakes where the next window begins, or from the last step if there is no next window.
        """
        if self.braking_after is None or window.stopping or window.no_contingency:
            return window
        knot = min(self.braking_after, window.plan.accelerations.shape[1] - 1)
        try:
            found = contingency(window.plan, knot, self.solver)
            violates = window.infeasible and not window.kept
            if violates and (first := first_violation(found)) is not None:
                raise InfeasibleError(  # one place that records reasons
                    {first.vehicle: (first.what,)}, scenario=found.scenario, because=_BEFORE
                )
        except FAILURES as error:
            return dataclasses.replace(window, no_contingency=str(error))
        return dataclasses.replace(window, contingency=found)

    def _lack_of_slack(self, start: WindowStart) -> Failure | None:
        """Return the error for constraints without tightening slack; None if there is slack.

        The slack is computed only if it is likely to be missing, or if the lack would go unnoticed.
        With a disturbance the verifier notices it, so the slack is computed only if the last window
        had no plan of its own. Without a disturbance no constraint is violated if the window begins
        as planned by the last one and nothing new became known; if it begins elsewhere, only
        constraints at the start can be.
        """
        scenario, last, only_start = start.scenario, start.last, False
        if scenario.disturbance is not None:
            has_slack = not last.kept
        else:
            only_start = not (last.infeasible or start.is_new or _new_obstacles(start))
            has_slack = only_start and start.begins_as_planned
        if has_slack:
            return None
        reasons = _lacks(scenario, of_start=only_start)
        return _no_slack(scenario, reasons) if reasons else None

    def _is_cheap(self, plan: Plan, previous: Plan) -> bool:
        """Return whether a plan costs no more than the rest of the previous one, moved."""
        return not self.bounded_cost or plan.cost <= previous.cost * (1.0 + ROUNDED)

    def still_holds(self, start: WindowStart) -> bool:
        """Return whether the rest of the plan in force meets every constraint.

        It does not if a vehicle is off its tube. Constraints that were verified when the plan was
        accepted are not verified again. Since the tolerances shrink with the rest, a second check
        could only reject the plan by rounding.
        """
        rest, last = start.remaining, start.last
        if not start.on_plan:
            return False
        if rest.scenario.disturbance is None:
            return violations_of(Problem.of(rest.scenario), rest).none
        accepted = (last.kept or not last.infeasible) and not start.is_new
        return first_violation(rest, _new_obstacles(start) if accepted else None) is None

    def _planned(
        self, scenario: Scenario, first_knot: int, remaining: Plan | None
    ) -> Window | Failure:
        """Return the planner's window, or its error."""
        reference = None
        try:
            if scenario.obstacles or scenario.separation is not None:
                reference = self.reference(scenario, remaining, self.solver)
            plan = self.planner(scenario, reference=reference, solver=self.solver)
            plan = self._verified(scenario, plan)
        except _expected(remaining) as error:
            return failure_of(error)
        return Window(first_knot, plan, reference or plan.reference or plan)

    def _planned_again(
        self,
        planner: Planner | None,
        scenario: Scenario,
        first_knot: int,
        remaining: Plan | None,
        failure: Failure,
    ) -> Window | Failure:
        """Return the window of another planner, around the remaining plan, or its error."""
        if planner is None:
            return failure
        try:
            plan = self._verified(
                scenario, planner(scenario, reference=remaining, solver=self.solver)
            )
        except _expected(remaining) as error:
            again = failure_of(error)
            return again.replaced(statistics=failure.statistics + again.statistics)
        plan = plan.with_statistics(failure.statistics + plan.statistics)
        return Window(first_knot, plan, plan.reference or plan)

    def _verified(self, scenario: Scenario, plan: Plan) -> Plan:
        """Return a plan that the verifier accepts, with its whole tube if there is a disturbance.

        Args:
            scenario: given to the planner; that of the plan may differ.
            plan: found by the planner.

        Raises:
            InfeasibleError: the plan violates a constraint, which the error names.
        """
        if scenario.disturbance is None:
            return plan
        candidate = plan
        if plan.scenario is not scenario:
            if self.retimed:
                scenario = with_waypoints(scenario, plan.scenario.vehicles)
            candidate = Plan.from_accelerations(scenario, plan.accelerations, plan.statistics)
        if (found := first_violation(candidate)) is None:
            return candidate
        what = f"{found.what} by {found.excess:.3g} {found.unit} at {clock_time(found.time)}"
        raise InfeasibleError(
            {found.vehicle: (what,)},
            statistics=plan.statistics,
            scenario=scenario,
            because="the plan found violates constraints",
        )


def _expected(remaining: Plan | None) -> type[Exception] | tuple[type[Exception], ...]:
    """Return the types of planner errors after which a flight continues without a new plan.

    If there is a previous plan, these are all exceptions: none ends a flight.
    """
    return FAILURES if remaining is None else Exception


def _too_costly(plan: Plan, previous: Plan) -> InfeasibleError:
    """Return the error of a plan that costs more than the rest of the previous one, moved."""
    costs = f"{plan.cost:.6g} m²/s⁴, more than {previous.cost:.6g} m²/s⁴"
    because = "a new plan costs more than the rest of the previous one, moved to the states"
    conflicts = {"all vehicles": (costs,)}
    return InfeasibleError(
        conflicts, statistics=plan.statistics, scenario=plan.scenario, because=because
    )


def _lacks(scenario: Scenario, *, of_start: bool = False) -> dict[str, tuple[str, ...]]:
    """Return the constraints of a window, or of its start, without tightening slack, by vehicle."""
    margins = Problem.of(scenario).margins
    return missing_slack(scenario, margins, under_way=True, of_start=of_start)


def _no_slack(scenario: Scenario, reasons: dict[str, tuple[str, ...]]) -> InfeasibleError:
    """Return the error of a window whose constraints leave no tightening slack."""
    violated = "constraints are violated at the start or the goal"
    because = violated if scenario.disturbance is None else NO_SLACK
    return InfeasibleError(reasons, scenario=scenario, because=because)


def _new_obstacles(start: WindowStart) -> list[int]:
    """Return the numbers of the obstacles that became known since the last window."""
    before = {number for number, _ in start.last.plan.scenario.known}
    return [number for number, _ in start.remaining.scenario.known if number not in before]
