"""`diagnose`: why a scenario has no plan, its least violation, and changes that give one.

For a plan of least time: the sensitivity of that time to the limits.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from functools import partial
from typing import overload

from drake_rho.analysis.adjustable import Adjustable, adjustable_numbers
from drake_rho.analysis.changes import (
    Change,
    Sufficient,
    least_change,
    least_duration,
    new_duration,
    sufficient_change,
    without,
)
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.infeasible_subset import infeasible_subset
from drake_rho.analysis.least_violation import least_violations
from drake_rho.analysis.sensitivity import TimeSensitivity
from drake_rho.analysis.time_sensitivity import SensitivityAnalysis
from drake_rho.analysis.trials import Trials, boundary, durations, precision_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.work_limit import within_work, work_left
from drake_rho.planning.errors import InfeasibleError, Names, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.planners.related import can_be_slower
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas
from drake_rho.verification.check import Check

_WORK = 500.0
"""Work of a diagnosis without a time limit [rounds], a few seconds for a vehicle or two."""

_TO_FIND = 0.7
"""Part of the work left after the conflicts for finding sufficient changes; the rest is for the
least ones."""

_PENALTIES = 8
"""Largest number of penalties in a trial of a change; trials begin near a plan."""

_LONGEST = 8.0
"""Largest multiple of a duration that is tried where motions cannot be flown more slowly."""


@overload
def diagnose(
    scenario: Scenario | InfeasibleError,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Diagnosis: ...


@overload
def diagnose(
    scenario: Plan,
    *,
    planned: Scenario | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> TimeSensitivity: ...


@checked
@with_time_limit
@single_threaded_blas()
def diagnose(
    scenario: Scenario | Plan | InfeasibleError,
    *,
    planned: Scenario | None = None,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Diagnosis | TimeSensitivity:
    """Find out why a scenario has no plan, or which limits determine a plan's least time.

    For a scenario without a plan, it finds the least violations, the constraints that cannot be
    met together, and for each limit in every conflict the least change that gives a plan, by
    bisection between the present number and the one that a plan without the limit needs. If none
    suffices alone, all limits in the conflicts are changed together. For a plan of
    `plan_minimum_time`, it finds the fall of the final time when each limit in turn is relaxed
    slightly, in a program with a free final time around the plan. Where limits are curved, this is
    the change to first order.

    Conflicts with obstacles are those of the first linearisation, around the plan without
    obstacles. Trials of changes begin near the plan found before: with obstacles or other vehicles,
    a smaller change may suffice. Where a longer duration is not always possible (`can_be_slower`),
    shorter ones are tried as well.

    Without a `time_limit`, a scenario without a plan gets a bounded amount of work, a few seconds
    for a vehicle or two. It is counted, so that the answer does not depend on the speed of the
    machine. Violations and conflicts come first, then a change of each limit that suffices, then
    the bisections. Limits that did not fit in are named (`Diagnosis.cut`, `Diagnosis.untried`).

    Args:
        scenario: scenario to diagnose; or a planner's error about one, which saves another search
            if infeasibility is proved or paths were searched; or a plan of least time.
        planned: for a plan, the scenario that it was planned for, whose waypoint times stay fixed.
            If not given, all waypoint times are free.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given. Plans
            are diagnosed with Clarabel.
        progress: called with a short description of the current step, such as a trial.
        time_limit: seconds, above 0, after which the findings so far are returned (`cut`). It
            replaces the bound on the work, so that a long one lets more be tried.

    Returns:
        A `Diagnosis` of a scenario, the `TimeSensitivity` of a plan.

    Raises:
        OutOfTimeError: time was up before a plan, or a proof that there is none, was found.
        ScenarioError: a waypoint of the scenario has no time, or no limit bounds a plan's time.
        SolverError: the solvers fail numerically.
        ValueError: the plan is not of least time, or not a plan of the scenario `planned`.

    Examples:
        >>> scenario = rho.Scenario(
        ...     "hurry",
        ...     rho.Grid.lasting(10.0, step=0.25),
        ...     [rho.Vehicle("scout", rho.State([0, 0, 2]), rho.State([20, 0, 2]))],
        ...     limits=rho.Limits(max_acceleration=0.7),
        ... )
        >>> diagnosis = rho.diagnose(scenario)
        >>> diagnosis.conflicts
        {'scout': ('goal x', 'maximum acceleration from 0 s to 9.75 s')}
        >>> for change in diagnosis.changes:
        ...     print(change)
        duration: 10.691 s instead of 10 s
        max_acceleration: 0.80011 m/s² instead of 0.7 m/s²
        >>> print(rho.diagnose(rho.plan_minimum_time(scenario)))
        hurry: 10.69 s; what makes it so long
        limit             change    vehicles  less time
        max_acceleration  1 % more  scout         0.5 %
    """
    if isinstance(scenario, Plan):
        return SensitivityAnalysis(scenario, planned, progress).result()
    if planned is not None:
        raise ValueError("planned: got a scenario beside a scenario, expected it beside a plan")
    backend = Backend.of(solver)
    work = _WORK if time_limit is None else math.inf
    search = _Search(Trials(backend, progress, _PENALTIES), backend, progress, work)
    if isinstance(scenario, InfeasibleError):
        error = scenario
        if error.scenario is None:
            raise ValueError("scenario: got an error about no scenario, expected a planner's error")
        if error.is_proved or error.statistics.searched is not None:
            return search.infeasible(error.scenario, error)
        scenario = error.scenario
    try:
        plan = first_plan(Problem.of(scenario), backend=backend, progress=progress)
    except InfeasibleError as error:
        return search.infeasible(scenario, error)
    return search.feasible(scenario, plan)


@dataclasses.dataclass(frozen=True)
class _Search:
    """Search for conflicts, violations and changes."""

    trials: Trials
    backend: Backend
    progress: Progress | None
    work: float

    def feasible(self, scenario: Scenario, plan: Plan) -> Diagnosis:
        """Return the diagnosis of a scenario that has a plan: its shortest duration."""
        self.trials.begin(plan)
        shortest, longest = durations(scenario, self.trials)
        return Diagnosis(
            scenario=scenario,
            conflicts={},
            violations=(),
            changes=(),
            shortest_duration=shortest,
            longest_duration=longest,
            is_monotone=is_monotone(scenario),
            cut=self.trials.cut,
        )

    def infeasible(self, scenario: Scenario, error: InfeasibleError) -> Diagnosis:
        """Return the diagnosis of a scenario without a plan, within its work."""
        with within_work(self.work):
            return self._infeasible(scenario, error)

    def _infeasible(self, scenario: Scenario, error: InfeasibleError) -> Diagnosis:
        trials = self.trials
        trials.begin(None)
        is_windy = _has_plan_in_calm(scenario, trials)
        if not is_windy and scenario.disturbance is not None:
            error = _undisturbed(error, scenario, self.backend)
        violations = self._violations(scenario, error)
        conflicts = self._conflicts(error)
        with within_work(_TO_FIND * work_left()):
            enough, untried = self._sufficient(scenario, error, conflicts)
        with within_work(work_left() / (1 + len(enough) + is_windy)):
            shortest, longest = self._durations(scenario, error)
        changes = list[Change]()
        for remaining in range(len(enough), 0, -1):  # each gets an equal part of what is left
            with within_work(work_left() / (remaining + is_windy)):
                changes.append(least_change(enough[-remaining]))
        tolerable = _largest_tolerable_wind(scenario, trials) if is_windy else None
        if (other := longest or shortest) is not None:
            changes = [new_duration(scenario, other), *changes]
        if tolerable is not None:  # without it there is a plan, so it is part of every conflict
            conflicts = {name: (*why, "disturbance") for name, why in conflicts.items()}
        return Diagnosis(
            scenario=scenario,
            conflicts=conflicts,
            violations=violations,
            changes=tuple(changes),
            shortest_duration=shortest,
            longest_duration=longest,
            is_monotone=is_monotone(scenario),
            premise=error.premise,
            bearable_wind=tolerable,
            cut=trials.cut,
            untried=untried,
        )

    def _violations(self, scenario: Scenario, error: InfeasibleError) -> tuple[Check, ...]:
        """Return the least violations; none if they are not found."""
        tell(self.progress, "looking for the least violation")
        try:
            return least_violations(scenario, error, self.backend)
        except SolverError:
            return ()
        except OutOfTimeError:
            self.trials.stop()
            return ()

    def _conflicts(self, error: InfeasibleError) -> dict[str, Names]:
        """Return the conflicts, reduced as far as half of the work left allows."""
        tell(self.progress, "looking for constraints that cannot be met together")
        try:
            with within_work(work_left() / 2.0):
                return infeasible_subset(error, solver=self.backend.solver)
        except SolverError:
            return error.conflicts
        except OutOfTimeError:
            self.trials.unfinished += 1
            return error.conflicts

    def _sufficient(
        self, scenario: Scenario, error: InfeasibleError, conflicts: Mapping[str, Names]
    ) -> tuple[list[Sufficient], Names]:
        """Return changes that give a plan, and the names of limits that were not tried to the end.

        Each change is of one limit; if there is none, the change is of several together.
        """
        numbers, untried = adjustable_numbers(scenario, list(conflicts)), list[str]()

        def enough(together: list[Adjustable]) -> Sufficient | None:
            before = self.trials.unfinished
            found = sufficient_change(scenario, together, self.trials)
            if found is None and self.trials.unfinished > before:
                untried.extend(each.limit for each in together)
            return found

        alone = [each for each in numbers if _may_help(each, error, conflicts)]
        named = [each for each in alone if _is_named(each, conflicts)]
        others = [each for each in alone if each not in named]
        found = [enough([each]) for each in named]
        before = self.trials.unfinished
        if len(others) < 2 or self.trials.has_plan(
            partial(without, scenario, others), _names(others)
        ):
            found += [enough([each]) for each in others]
        elif self.trials.unfinished > before:
            untried += [each.limit for each in others]
        changes = [each for each in found if each is not None]
        if not changes and len(numbers) > 1:
            others_first = sorted(numbers, key=lambda each: _is_named(each, conflicts))
            together = enough(self._needed(scenario, others_first))
            changes = [] if together is None else [together]
        changes.sort(key=lambda each: numbers.index(each.adjustables[0]))
        return changes, tuple(dict.fromkeys(untried))

    def _needed(self, scenario: Scenario, numbers: list[Adjustable]) -> list[Adjustable]:
        """Return the limits that have to change together for a plan."""
        for each in list(numbers):
            others = [other for other in numbers if other is not each]
            if others and self.trials.has_plan(partial(without, scenario, others), _names(others)):
                numbers = others
        return numbers

    def _durations(
        self, scenario: Scenario, error: InfeasibleError
    ) -> tuple[float | None, float | None]:
        """Return the least feasible duration; the greatest too, if only shorter ones are."""
        if _has_no_path(error):
            return None, None
        if can_be_slower(scenario):
            return least_duration(scenario, self.trials), None
        return durations(scenario, self.trials, largest=_LONGEST)


def _names(numbers: list[Adjustable]) -> str:
    return f"no limit on {' and '.join(each.limit for each in numbers)}"


def _has_no_path(error: InfeasibleError) -> bool:
    """Return whether a path search has shown that there is no path, at any speed."""
    searched = error.statistics.searched
    return searched is not None and searched.ways == 0 and searched.layers == 0


def _may_help(each: Adjustable, error: InfeasibleError, conflicts: Mapping[str, Names]) -> bool:
    """Return whether a limit is in every conflict, so that changing it alone may give a plan."""
    if _has_no_path(error) and each.name not in ("obstacle", "position box"):
        return False
    return all(_is_in(each, vehicle, error, conflicts) for vehicle in conflicts)


def _is_in(
    each: Adjustable, vehicle: str, error: InfeasibleError, conflicts: Mapping[str, Names]
) -> bool:
    """Return whether a limit is part of a vehicle's conflict.

    A conflict with linearised obstacles or pairs names only some of the limits that may help.
    """
    if vehicle not in each.vehicles:
        return False
    if error.obstacles.get(vehicle):
        pairs = 0 in error.obstacles[vehicle]
        return pairs if each.name == "separation" else True
    return _is_named(each, {vehicle: conflicts[vehicle]})


def _is_named(each: Adjustable, conflicts: Mapping[str, Names]) -> bool:
    """Return whether a limit is named in a conflict."""
    named = re.compile(re.escape(each.name) + r"(?!\d)")
    return any(named.match(name) for names in conflicts.values() for name in names)


def is_monotone(scenario: Scenario) -> bool:
    """Return whether planning succeeds for all durations longer than a feasible one.

    With obstacles or a separation this is False even where it is true of the problem
    (`can_be_slower`), because the planner may find a plan for one duration and miss it for
    another.
    """
    return can_be_slower(scenario) and not scenario.obstacles and scenario.separation is None


def _undisturbed(error: InfeasibleError, scenario: Scenario, backend: Backend) -> InfeasibleError:
    """Return the error without the disturbance, if any, since it is more informative."""
    try:
        with within_work(work_left() / 2.0):
            first_plan(Problem.of(scenario.with_disturbance(None)), backend=backend)
    except InfeasibleError as other:
        return other
    except (SolverError, OutOfTimeError):
        pass
    return error


def _has_plan_in_calm(scenario: Scenario, trials: Trials) -> bool:
    """Return whether a plan is found without the disturbance, for a scenario with one."""
    if scenario.disturbance is None:
        return False
    return trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=None), "no wind")


def _largest_tolerable_wind(scenario: Scenario, trials: Trials) -> float | None:
    """Return the largest wind with a plan [m/s²], for a scenario with a plan in calm.

    None if it is not known whether there is a plan with the errors of estimates alone.
    """
    disturbance = scenario.disturbance
    assert disturbance is not None  # noqa: S101  # there is a plan in calm only

    def tolerates(factor: float, near: bool = False) -> bool:
        weaker = dataclasses.replace(disturbance, acceleration=factor * disturbance.acceleration)
        words = f"wind up to {weaker.acceleration:.4g} m/s²"
        make = partial(dataclasses.replace, scenario, disturbance=weaker)
        return trials.has_plan(make, words, near=near)

    before = trials.unfinished
    if disturbance.acceleration == 0.0 or not tolerates(0.0):
        return 0.0 if trials.unfinished == before else None
    return boundary(tolerates, 0.0, 1.0, precision_of(scenario)) * disturbance.acceleration
