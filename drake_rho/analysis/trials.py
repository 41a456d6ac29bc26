"""Trials whether variants of a scenario have a plan, and the factors at which they begin to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell, within
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import first_plan, plan_near
from drake_rho.planning.planners.related import time_scaled_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario

LARGEST_FACTOR = 2.0**10
"""Largest factor that is tried on the duration and on acceleration limits."""


_MAX_RESTARTS = 3
"""Largest number of bisections, each begun beyond the boundary that local trials found before."""


SHORTER = 0.5**0.5
"""Ratio of successive shorter durations that are tried, where a shorter one may be feasible: not
far below 1, because the range of feasible durations may be narrow."""


class Trials:
    """Sequence of trials whether variants of a scenario have a plan.

    The plan of one trial is the initial guess for the next.

    Args:
        backend: solves their programs.
        progress: called with a short description of each trial.

    Attributes:
        plan: the last plan found.
        feasible: whether the original scenario has a plan; None if this is not known.
        cut: whether time was up; all later trials then fail.
    """

    def __init__(self, backend: Backend, progress: Progress | None) -> None:
        self.plan: Plan | None = None
        self.feasible: bool | None = None
        self.cut = False
        self._backend, self._progress = backend, progress

    def begin(self, plan: Plan | None) -> None:
        """Begin with the plan of the original scenario, or with the knowledge that it has none."""
        self.plan, self.feasible = plan, plan is not None

    def has_plan(self, make: Callable[[], Scenario], words: str, *, near: bool = False) -> bool:
        """Return whether a plan is found for a variant of the scenario.

        Args:
            make: function that returns the variant.
            words: description of the variant for progress.
            near: whether to search near the last plan only.
        """
        if self.cut:
            return False
        words = f"trying {words}"
        tell(self._progress, words)
        try:
            self.plan = self._found(make(), within(self._progress, words), near)
        except (InfeasibleError, SolverError, ScenarioError):
            return False
        except OutOfTimeError:
            self.cut = True
            return False
        return True

    def _found(self, scenario: Scenario, progress: Progress | None, near: bool) -> Plan:
        problem = Problem.of(scenario)
        if near and self.plan is not None:
            reference = time_scaled_plan(self.plan, scenario)
            return plan_near(problem, reference, backend=self._backend, progress=progress)
        return first_plan(problem, backend=self._backend, progress=progress)


class Trial(Protocol):
    """Trial whether there is a plan with a factor; `near` searches near the last plan only."""

    def __call__(self, factor: float, near: bool = False) -> bool:
        """Return whether there is a plan."""
        ...


def some_factor(has_plan: Trial, feasible: bool | None, *, shorter: bool) -> float | None:
    """Return a factor that has a plan; None if none does.

    Powers of two are tried and, if `shorter`, powers of `SHORTER`. Whether 1 has a plan may be
    known before (`feasible`).
    """
    if has_plan(1.0) if feasible is None else feasible:
        return 1.0
    longer, less = 2.0, SHORTER
    while longer <= LARGEST_FACTOR:
        if has_plan(longer):
            return longer
        while shorter and less >= 1.0 / longer:
            if has_plan(less):
                return less
            less *= SHORTER
        longer *= 2.0
    return None


def boundary(has_plan: Trial, one: float, other: float, precision: float) -> float:
    """Return the last factor with a plan between `one`, which has a plan, and `other`.

    The bisection searches near the plans found before, which takes a fraction of the time. At its
    end a full search is made just beyond the boundary; if it finds a plan, bisection goes on there.
    """
    without = other
    for _ in range(_MAX_RESTARTS):
        other = without
        while abs(one - other) > precision * max(one, other):
            middle = (one + other) / 2.0
            one, other = (middle, other) if has_plan(middle, near=True) else (one, middle)
        if other == without or not has_plan(other):
            break
        one = other
    return one


def least_factor(has_plan: Trial, feasible: bool | None, precision: float) -> float | None:
    """Return the least factor of at least 1 that has a plan, by doubling, then bisection.

    None if no factor up to the largest has a plan. Whether 1 has one may be known (`feasible`).
    """
    factor = some_factor(has_plan, feasible, shorter=False)
    if factor is None or factor == 1.0:
        return factor
    return boundary(has_plan, factor, factor / 2.0, precision)
