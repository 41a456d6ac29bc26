"""Search for the conflicts of a scenario without a plan, and for changes that give one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial

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
from drake_rho.analysis.conflicting_limits import has_no_path, is_named, may_help
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.infeasible_subset import infeasible_subset
from drake_rho.analysis.least_violation import least_violations
from drake_rho.analysis.tolerable_wind import (
    has_plan_in_calm,
    largest_tolerable_wind,
    undisturbed,
)
from drake_rho.analysis.trials import Trials, durations, is_monotone
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.work_limit import within_work, work_left
from drake_rho.planning.errors import InfeasibleError, Names, OutOfTimeError, SolverError
from drake_rho.planning.planners.related import can_be_slower
from drake_rho.planning.programs.backend import Backend
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Check

_TO_FIND = 0.7
"""Part of the work left after the conflicts for finding sufficient changes; the rest is for the
least ones."""

_LONGEST = 8.0
"""Largest multiple of a duration that is tried where motions cannot be flown more slowly."""


@dataclasses.dataclass(frozen=True)
class ConflictSearch:
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
        is_windy = has_plan_in_calm(scenario, trials)
        if not is_windy and scenario.disturbance is not None:
            error = undisturbed(error, scenario, self.backend)
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
        tolerable = largest_tolerable_wind(scenario, trials) if is_windy else None
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
        """Return changes that give a plan, and the names of limits whose trials were cut short.

        Each change is of one limit; if there is none, the change is of several together.
        """
        numbers, untried = adjustable_numbers(scenario, list(conflicts)), list[str]()

        def enough(together: list[Adjustable]) -> Sufficient | None:
            before = self.trials.unfinished
            found = sufficient_change(scenario, together, self.trials)
            if found is None and self.trials.unfinished > before:
                untried.extend(each.limit for each in together)
            return found

        alone = [each for each in numbers if may_help(each, error, conflicts)]
        named = [each for each in alone if is_named(each, conflicts)]
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
            others_first = sorted(numbers, key=lambda each: is_named(each, conflicts))
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
        if has_no_path(error):
            return None, None
        if can_be_slower(scenario):
            return least_duration(scenario, self.trials), None
        return durations(scenario, self.trials, largest=_LONGEST)


def _names(numbers: list[Adjustable]) -> str:
    return f"no limit on {' and '.join(each.limit for each in numbers)}"
