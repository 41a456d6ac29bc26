"""Feasibility trials of variants of a scenario, and bisection of factors with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Protocol

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.progress import Progress, tell, within
from drake_rho.planning.call.time_limit import seconds_left
from drake_rho.planning.call.work_limit import count_work, within_work, work_left
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import FirstPlan, plan_near
from drake_rho.planning.planners.related import can_be_slower, rescaled, time_scaled_plan
from drake_rho.planning.problem import Problem, finest, with_finer_margins
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.restoration import MAX_RESTORATIONS
from drake_rho.planning.scp.subproblem import plan_around
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario
from drake_rho.system.bisection import bisected

PRECISION = 1e-4
"""Relative precision of the shortest duration and of the smallest relaxation."""

PRECISION_WITH_OBSTACLES = 1e-3
"""Relative precision with obstacles, where a trial may have to search for paths around them."""

PRECISION_WITH_SEPARATION = 1e-2
"""Relative precision for fleets with a separation, where a trial that fails is a long search."""

LARGEST_FACTOR = 2.0**10
"""Largest factor that is tried on the duration and on acceleration limits."""

QUICK = Options(max_ways=2, max_memory=3e7)
"""Bounds of quick searches: coarse grids, since a fine one takes longer than all other trials."""

_SHARE = 0.5
"""Largest part of the work left that one quick trial may take."""

_PER_TRIAL, _WITH_GAINS = 1.0, 6.0
"""Least work of a trial [rounds], so that a bound on the work bounds their number; and with a
disturbance, for which gains of the feedback are sought."""

_LEAST_WORK = 20.0
"""Work of a usual trial [rounds]; with less no further one is begun."""

_MAX_RESTARTS = 3
"""Largest number of bisections; each begins beyond the boundary that local trials found last."""


SHORTER = 0.5**0.5
"""Ratio of successive shorter durations that are tried, where a shorter one may be feasible: not
far below 1, because the range of feasible durations may be narrow."""


class Trials:
    """Sequence of feasibility trials of variants of a scenario.

    The plan of one trial is the initial guess for the next.

    Args:
        backend: solves their programs.
        progress: called with a short description of each trial.
        most: the largest number of penalties in one restoration of a trial. Where it is given,
            trials are quick: motions are first sought without obstacles and pairs, paths on one
            coarse grid, and no trial takes more than a part of the work left (`within_work`).

    Attributes:
        plan: the last plan found.
        feasible: whether the original scenario has a plan; None if this is not known.
        unfinished: the number of trials that time or work ended, so that they may have missed a
            plan.
    """

    def __init__(
        self, backend: Backend, progress: Progress | None, most: int = MAX_RESTORATIONS
    ) -> None:
        self._most = most
        self.plan: Plan | None = None
        self.feasible: bool | None = None
        self.unfinished, self._stopped = 0, False
        self._backend, self._progress = backend, progress

    def begin(self, plan: Plan | None) -> None:
        """Begin with the plan of the original scenario; None if it has none."""
        self.plan, self.feasible = plan, plan is not None

    def go_back_to(self, plan: Plan | None) -> None:
        """Make an earlier plan the initial guess of the next trial."""
        self.plan = plan

    @property
    def cut(self) -> bool:
        """Whether time or work ended any trial."""
        return self.unfinished > 0

    @property
    def are_quick(self) -> bool:
        """Whether trials are quick ones."""
        return self._most < MAX_RESTORATIONS

    def stop(self) -> None:
        """Let all later trials fail, as time or work is up."""
        self._stopped = True
        self.unfinished += 1

    def has_plan(self, make: Callable[[], Scenario], words: str, *, near: bool = False) -> bool:
        """Return whether a plan is found for a variant of the scenario.

        Args:
            make: function that returns the variant.
            words: description of the variant for progress.
            near: whether to search near the last plan only.
        """
        if self._stopped or seconds_left() <= 0.0 or work_left() < _LEAST_WORK:
            self.unfinished += 1
            return False
        words = f"trying {words}"
        tell(self._progress, words)
        share = _SHARE * work_left() if self.are_quick else math.inf
        try:
            with within_work(share):
                scenario = make()
                count_work(_PER_TRIAL if scenario.disturbance is None else _WITH_GAINS)
                self.plan = self._found(scenario, within(self._progress, words), near)
        except (InfeasibleError, SolverError, ScenarioError):
            return False
        except OutOfTimeError:
            self.unfinished += 1
            return False
        return True

    def _found(self, scenario: Scenario, progress: Progress | None, near: bool) -> Plan:
        problem, quick = Problem.of(scenario), self.are_quick
        if near and self.plan is not None:
            if quick and (scenario.avoided or scenario.separation is not None):
                plan_around(finest(scenario), None, self._backend)  # proves that there is none
            reference = time_scaled_plan(self.plan, scenario)
            backend, most = self._backend, self._most
            return plan_near(problem, reference, backend=backend, progress=progress, most=most)
        options = QUICK if quick else DEFAULTS
        search = FirstPlan(self._backend, progress, options, most=self._most, thorough=not quick)
        return with_finer_margins(search.of, problem)


class Trial(Protocol):
    """Feasibility trial of a factor; `near` searches near the last plan only."""

    def __call__(self, factor: float, near: bool = False) -> bool:
        """Return whether there is a plan."""
        ...


def some_factor(
    has_plan: Trial, feasible: bool | None, *, shorter: bool, largest: float = LARGEST_FACTOR
) -> float | None:
    """Return a factor that has a plan; None if none up to the largest does.

    Powers of two are tried and, if `shorter`, powers of `SHORTER`. Whether 1 has a plan may be
    known before (`feasible`).
    """
    if has_plan(1.0) if feasible is None else feasible:
        return 1.0
    longer, less = 2.0, SHORTER
    while longer <= largest:
        if has_plan(longer):
            return longer
        while shorter and less >= 1.0 / longer:
            if has_plan(less):
                return less
            less *= SHORTER
        longer *= 2.0
    return None


def boundary(has_plan: Trial, one: float, other: float, precision: float) -> float:
    """Return the last feasible factor between `one`, which is feasible, and `other`.

    The bisection searches near the plans found before, which takes a fraction of the time. At its
    end a full search is made just beyond the boundary; if it finds a plan, bisection goes on there.
    """
    without = other
    for _ in range(_MAX_RESTARTS):
        one, other = _bisected_near(has_plan, one, without, precision)
        if other == without or not has_plan(other):
            break
        one = other
    return one


def _bisected_near(
    has_plan: Trial, one: float, other: float, precision: float
) -> tuple[float, float]:
    """Bisect a factor by searches near the last plan; return a feasible and an infeasible one."""

    def are_close(one: float, other: float) -> bool:
        return abs(one - other) <= precision * max(one, other)

    return bisected(partial(has_plan, near=True), one, other, are_close)


def durations(
    scenario: Scenario,
    trials: Trials,
    variant: Callable[[float], Scenario] | None = None,
    largest: float = LARGEST_FACTOR,
) -> tuple[float | None, float | None]:
    """Return the least feasible duration, and the greatest if below the scenario's [s].

    Both are None if no plan is found. The greatest is also None if the scenario's own duration or
    a longer one has a plan.

    Args:
        scenario: the scenario, whose duration is multiplied by factors.
        trials: makes the trials; in the end its plan is one of the least duration.
        variant: returns the scenario with a multiple of its duration; `rescaled` if not given.
        largest: largest multiple that is tried.
    """
    duration, precision = scenario.grid.duration, precision_of(scenario)

    def lasting(factor: float, near: bool = False) -> bool:
        words = f"a duration of {factor * duration:.5g} s"
        make = partial(rescaled, scenario) if variant is None else variant
        return trials.has_plan(lambda: make(factor), words, near=near)

    def last(one: float, other: float) -> float:
        if trials.are_quick:
            return _bisected_near(lasting, one, other, precision)[0]
        return boundary(lasting, one, other, precision)

    slower = can_be_slower(scenario)
    high = some_factor(lasting, trials.feasible, shorter=not slower, largest=largest)
    if high is None:
        return None, None
    longest = None
    if high < 1.0:
        found = trials.plan
        longest = duration * last(high, high / SHORTER)
        trials.go_back_to(found)
    while 1.0 >= high > 1.0 / LARGEST_FACTOR and lasting(high / 2.0):
        high /= 2.0
    if high > 1.0 / LARGEST_FACTOR:
        high = last(high, high / 2.0)
    return duration * high, longest


def precision_of(scenario: Scenario) -> float:
    """Return the relative precision of bisected factors of a scenario."""
    precision = PRECISION_WITH_OBSTACLES if scenario.obstacles else PRECISION
    return PRECISION_WITH_SEPARATION if scenario.separation is not None else precision


def is_monotone(scenario: Scenario) -> bool:
    """Return whether planning succeeds for all durations longer than a feasible one.

    With obstacles or a separation this is False even where it is true of the problem
    (`can_be_slower`), because the planner may find a plan for one duration and miss it for
    another.
    """
    return can_be_slower(scenario) and not scenario.obstacles and scenario.separation is None
