"""Minimum-time search: first motions, and local optimisation around each of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from itertools import islice

from drake_rho.analysis.early_arrivals import as_soon_as_each_can
from drake_rho.analysis.own_final_time import is_too_short, planned_in
from drake_rho.analysis.time_alone import TimesAlone, in_no_time
from drake_rho.analysis.timed_plans import TimedPlans
from drake_rho.analysis.trials import Trials, durations
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import seconds_left
from drake_rho.planning.call.work_limit import within_work
from drake_rho.planning.constraints.tightening import enlarged_by_margins
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.path_search.initial_guesses import paths_on_grids
from drake_rho.planning.planners.first_plan import FirstPlan, plan_near
from drake_rho.planning.planners.related import changes_with_time, is_steady, of_each_alone
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.least_time import ROUGH, LeastTime
from drake_rho.planning.scp.timed import Timed, latest
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.gates import Gates, is_scale_free
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import AllWaypoints

_LONGER = 1.3, 2.0, 4.0, 8.0
"""Durations of first plans, as multiples of the least time without obstacles and other vehicles;
obstacles and pairs are linearised around these plans."""

_LITTLE_LONGER = 1.05, 1.15
"""Multiples tried before these, for motions near those of vehicles alone."""

_LESS = 0.02, 0.005
"""Relative reductions of the time of a local optimum, for another plan near it."""

_LESS_WITH_OTHER_TIMES, _WORK = (0.02, 0.002), 200.0
"""Relative reductions of the time of a plan, for another one with other times of waypoints, and the
largest work of each search [rounds]; a few seconds."""

_SEARCHES = 2
"""Largest number of searches for plans faster than a local optimum, of each kind."""

_ROUGHLY = 3e-3
"""Convergence tolerance on the final time when motions along different paths are compared."""

_EXCESS = 1e-3
"""Relative excess of the first duration tried over the least time of a vehicle alone: at the least
time there is at most one motion, around which programs take very long."""

_SAME = 1e-6
"""Relative difference of final times that counts as none."""

_WORTHWHILE = 0.01
"""Smallest possible gain, as a part of the final time, that is worth another search."""


class TimeSearch:
    """Minimum-time search for one scenario.

    Args:
        scenario: scenario to plan for.
        grid: grid of the first motion, with the knots of the plan.
        backend: solver of first plans.
        progress: called with a description of the current step.
        options: bounds of the searches.
        each: whether every vehicle arrives as early as it can, not all together.
    """

    def __init__(
        self,
        scenario: Scenario,
        grid: Grid,
        backend: Backend,
        progress: Progress | None,
        options: Options,
        *,
        each: bool = False,
    ) -> None:
        self._given, self._each = scenario, each
        self._bound: float | None = None
        self._waypoints = AllWaypoints.of(scenario.vehicles)
        self._gates = Gates.of(scenario.requirements, scenario.vehicles)
        self._scenario = scenario.without_waypoints().ending_with(grid)
        self._backend, self._progress, self._options = backend, progress, options
        scale_free = self._gates is None or is_scale_free(scenario.vehicles)
        self._steady = is_steady(self._scenario) and not self._waypoints.given.any() and scale_free
        self._least = LeastTime(ROUGH, progress, steady=self._steady)
        self._plans = TimedPlans(scenario, self._waypoints, progress, steady=self._steady)

    def plan(self) -> Plan:
        """Return the plan of least time.

        Where solvers are too inexact for the limits, or a place is taken at the time found, this is
        the plan found by bisection, or that for the scenario's own final time.

        Raises:
            InfeasibleError: no plan was found, or vehicles cannot hold at their goals, as required.
            SolverError: the solvers fail numerically, or every motion found violates a constraint.
        """
        scenario = self._scenario
        alone = TimesAlone(scenario, self._waypoints, self._gates, self._backend, self._progress)
        free = self._steady and not self._binds_more
        each: Timed | None = None
        best: Timed | None = None
        failure: Exception | None = None
        try:
            each = alone.motion(reduce_effort=free and not self._each)
            best = each if free else self._together(each)
        except (InfeasibleError, SolverError) as error:
            failure = error
        self._least.count(alone.statistics)
        self._bound = alone.bound
        best = self._no_later_than_known(best, each, failure)
        try:
            plan = self._finished(best, alone.durations)
        except SolverError:
            own = partial(self._planned_in, scenario.grid.duration)
            known: list[Callable[[], Timed | None]] = [own]
            if each is not None:
                known.append(partial(self._by_bisection, each, coupled=False))
            if (slower := self._shortest(known)) is None:
                raise
            slower = dataclasses.replace(slower, converged=False)
            plan = self._finished(slower, alone.durations)
        if not self._waypoints.given.all() and changes_with_time(scenario):
            with self._least.or_cut():
                for faster in self._with_other_times(plan, alone.durations):
                    plan = faster
        spent = self._least.statistics + self._plans.statistics
        converged = plan.statistics.converged
        found = dataclasses.replace(
            spent, converged=converged, minimised="time", time_bound=self._bound
        )
        return plan.with_statistics(found)

    def _with_other_times(self, best: Plan, alone: FloatArray) -> Iterator[Plan]:
        """Yield ever faster plans with other times of free waypoints, if `rho.plan` finds any.

        A search around a motion moves these times a little. Where places are allowed for a while
        only, `rho.plan` for a slightly shorter final time finds others.

        Args:
            best: plan of least time so far.
            alone: least time of each vehicle alone [s], shape (N,).
        """
        for part in _LESS_WITH_OTHER_TIMES:
            for _ in range(_SEARCHES):
                known = self._shortest([partial(self._planned_in_less, best, part)])
                faster = None if known is None else self._finished_around(known, alone)
                if faster is None:
                    break
                best = faster
                yield best

    def _planned_in_less(self, best: Plan, part: float) -> Timed | None:
        """Return the motion that `rho.plan` finds in less time, by a part; None if it takes long.

        Raises:
            OutOfTimeError: time was up.
        """
        duration = (1.0 - part) * best.scenario.grid.duration
        try:
            with within_work(_WORK):
                return self._planned_in(duration)
        except OutOfTimeError:
            if seconds_left() <= 0.0:
                raise
            return None

    def _finished_around(self, known: Timed, alone: FloatArray) -> Plan | None:
        """Return the plan of least time around a motion, or the motion's own; None if none holds.

        Args:
            known: motion that `rho.plan` found.
            alone: least time of each vehicle alone [s], shape (N,).
        """
        fastest = self._shortest([partial(self._least.around, known)], known) or known
        for found in (fastest, known):
            with suppress(InfeasibleError, SolverError):
                return self._finished(found, alone)
        return None

    @property
    def _apart(self) -> bool:
        """Whether the scenario has a separation or links."""
        return self._scenario.separation is not None or Problem.of(self._scenario).has_links

    @property
    def _binds_more(self) -> bool:
        """Whether obstacles, other vehicles, links or a smoothing may add to the least time."""
        scenario = self._scenario
        own = of_each_alone(scenario).requirements
        more = scenario.smoothing is not None or len(own) < len(scenario.requirements)
        return bool(self._apart or more or scenario.avoided)

    def _no_later_than_known(
        self, best: Timed | None, alone: Timed | None, failure: Exception | None
    ) -> Timed:
        """Return a motion no slower than the scenario's own final time, if `rho.plan` has a plan.

        Args:
            best: motion found so far, if any.
            alone: motion in the least time of each vehicle alone, if known.
            failure: error to raise if there is no motion at all.
        """
        scenario, given = self._scenario, bool(self._waypoints.given.any())
        if best is not None and (
            best.duration <= scenario.grid.duration * (1.0 + _SAME)
            or is_too_short(scenario, alone, given=given)
        ):
            return best
        found = self._shortest([self._from_own_final_time], best)
        if found is None:
            raise failure or SolverError("no motion was found around the first plans")
        return found

    def _from_own_final_time(self) -> Timed | None:
        """Return a motion in the least time around the plan for the scenario's own final time."""
        known = self._planned_in(self._scenario.grid.duration)
        return self._shortest([partial(self._least.around, known)], known)

    def _planned_in(self, duration: float) -> Timed:
        """Return the motion that `rho.plan` finds for a final time [s]."""
        parts = self._given, self._scenario, self._backend, self._options, self._progress
        return planned_in(duration, *parts)

    def _arriving(self, best: Timed, alone: FloatArray) -> Timed:
        """Return a motion with the earliest arrival of each vehicle, if the search is for one.

        Args:
            best: motion in which all arrive at the last knot.
            alone: time that each vehicle takes at least [s], shape (N,).
        """
        if not self._each:
            return best
        least = LeastTime(ROUGH, self._progress, final_time=False)
        best = as_soon_as_each_can(best, alone, least, self._progress)
        self._least.count(least.statistics)
        return best

    def _together(self, alone: Timed) -> Timed:
        """Return the least-time motion with a common arrival of all vehicles.

        Args:
            alone: motion of each vehicle alone.
        """
        scenario, options, count = self._scenario, self._options, len(self._scenario.vehicles)
        best = None
        if self._apart and count > options.max_coupled:
            best = self._by_bisection(alone, coupled=False)
        elif self._steady and count == 1:
            best = self._along_paths(alone)
        elif changes_with_time(scenario):
            best = self._around_alone(alone)
            if best is None or best.duration > (1.0 + _WORTHWHILE) * self._least_of(alone):
                best = self._shortest([partial(self._by_bisection, alone)], best)
            if best is not None:
                best = self._shorter(self._least_of(alone), best)
        if best is None:
            best = self._shorter(self._least_of(alone), self._from_first_plans(alone))
        return best

    def _least_of(self, alone: Timed) -> float:
        """Return a near lower bound of the final time, by a motion of vehicles alone [s]."""
        given = self._waypoints.given.any()
        return latest(self._scenario, alone.passing) if given else alone.duration

    def _along_paths(self, alone: Timed) -> Timed | None:
        """Return the least-time motion of one vehicle near paths around the obstacles."""
        tell(self._progress, "looking for paths around the obstacles")
        timed = self._lasting(alone, _LONGER[0] * alone.duration)
        problem = self._problem(timed)
        larger = enlarged_by_margins(problem.scenario, problem.margins)
        options, found = self._options, [timed]
        for grid in islice(paths_on_grids(larger, options.max_ways, options.max_memory), 1):
            found += [dataclasses.replace(timed, reference=each) for each in grid.references]
        best = self._shortest(partial(self._least.around, each, _ROUGHLY) for each in found)
        return best and self._shortest([partial(self._least.around, best)], best)

    def _by_bisection(self, alone: Timed, *, coupled: bool = True) -> Timed | None:
        """Return the least-time motion near the plan found by bisection of the final time.

        Args:
            alone: motion whose waypoint times are scaled with the final time.
            coupled: whether one program of all vehicles is solved afterwards.
        """
        trials = Trials(self._backend, self._progress)
        once = self._lasting(alone, (1.0 + _EXCESS) * alone.duration)

        def variant(factor: float) -> Scenario:
            return self._problem(self._lasting(alone, factor * once.duration)).scenario

        # a goal may be occupied at this time, but not at others
        duration, _ = durations(unchecked(self._scenario, grid=once.grid), trials, variant)
        plan = trials.plan
        if duration is None or plan is None:
            return None
        timed = self._lasting(alone, plan.scenario.grid.duration)
        start = dataclasses.replace(timed, accelerations=plan.accelerations)
        if not coupled:
            return start
        return self._shortest([partial(self._least.around, start), lambda: start])

    def _around_alone(self, alone: Timed) -> Timed | None:
        """Return a least-time motion around the vehicles' own least times, if one is found."""
        least = self._least_of(alone)
        for longer in (1.0, 1.0 + _EXCESS, *_LITTLE_LONGER, *_LONGER):
            near = partial(self._least.around, self._lasting(alone, longer * least))
            if (found := self._shortest([near])) is not None:
                return found
        return None

    def _from_first_plans(self, alone: Timed) -> Timed:
        """Return a least-time motion near a slower first plan."""
        failures = list[Exception]()
        for longer in (1.0, *_LONGER) if self._waypoints.given.any() else _LONGER:
            try:
                found = self._from_first_plan(alone, longer * alone.duration)
            except (InfeasibleError, SolverError, ScenarioError) as error:
                failures.append(error)
            else:
                if found is not None:
                    return found
        if infeasible := [each for each in failures if isinstance(each, InfeasibleError)]:
            raise in_no_time(infeasible, self._backend)
        refused = [each for each in failures if isinstance(each, ScenarioError)]
        if refused:  # a goal or a waypoint is not allowed in any of the final times
            because = f"in no final time that was tried; in the last, {refused[-1]}"
            raise InfeasibleError({}, because=because)
        none = SolverError("no motion was found around the first plans")
        raise failures[-1] if failures else none

    def _shorter(self, low: float, best: Timed) -> Timed:
        """Return a faster motion than a local optimum, if one is found.

        Slightly faster plans are sought near the motion first, then much faster ones anywhere.

        Args:
            low: time below which there is no motion [s].
            best: local optimum.
        """
        for part in _LESS:
            if (1.0 - part) * best.duration < low:
                continue
            near = partial(self._from_near, best, (1.0 - part) * best.duration)
            best = self._shortest([near], best) or best
        for _ in range(_SEARCHES):
            if best.duration - low <= _WORTHWHILE * best.duration:
                break
            middle = (low + best.duration) / 2.0
            search = partial(self._from_first_plan, best, middle, quick=True)
            found = self._shortest([search], best) or best
            low = low if found.duration < best.duration else middle
            best = found
        return best

    def _shortest(
        self, searches: Iterable[Callable[[], Timed | None]], best: Timed | None = None
    ) -> Timed | None:
        """Return the fastest motion that several searches find; None if none finds any.

        Args:
            searches: the searches.
            best: motion known before, if any.
        """
        for search in searches:
            found = None
            with suppress(InfeasibleError, SolverError, ScenarioError):
                if best is None:
                    found = search()
                else:
                    with self._least.or_cut():
                        found = search()
            if found is not None and (best is None or found.duration < best.duration):
                best = found
        return best

    def _lasting(self, like: Timed, duration: float) -> Timed:
        """Return a motion scaled to another final time, or to the least that is allowed.

        Args:
            like: motion whose waypoint times are scaled with the final time.
            duration: final time [s].
        """
        narrowest = self._scenario.averaging_width * (self._scenario.grid.knots - 1)
        duration = max(duration, narrowest * (1.0 + 1e-9))
        duration = max(duration, latest(self._scenario, like.passing) * (1.0 + 1e-9))
        return dataclasses.replace(like.lasting(duration), scenario=self._scenario)

    def _problem(self, timed: Timed) -> Problem:
        """Return the problem with the final time and the waypoint times of a motion.

        Raises:
            ScenarioError: a goal or a waypoint is not allowed then.
        """
        return Problem.of(self._plans.scenario(timed.grid, timed.passing.times))

    def _from_near(self, like: Timed, duration: float) -> Timed | None:
        """Return a least-time motion from a plan of given duration [s] near another motion."""
        timed = self._lasting(like, duration)
        problem = self._problem(timed)
        reference = Plan.from_motion(problem.scenario, timed.motion)
        plan = plan_near(problem, reference, backend=self._backend, progress=self._progress)
        return self._least.around(dataclasses.replace(timed, accelerations=plan.accelerations))

    def _from_first_plan(
        self, like: Timed, duration: float, *, quick: bool = False
    ) -> Timed | None:
        """Return a least-time motion from a first plan of given duration; None if none.

        Args:
            like: motion whose waypoint times are scaled with the final time.
            duration: duration of the first plan [s].
            quick: whether few paths are tried.
        """
        timed = self._lasting(like, duration)
        problem = self._problem(timed)
        options = dataclasses.replace(self._options, max_ways=2) if quick else self._options
        search = FirstPlan(self._backend, self._progress, options)
        first = search.of(problem) if quick else search.of_any_duration(problem)
        return self._least.around(dataclasses.replace(timed, accelerations=first.accelerations))

    def _finished(self, best: Timed, alone: FloatArray) -> Plan:
        """Return a motion as a plan, with the earliest arrivals if the search is for these.

        Args:
            best: motion in which all arrive at the last knot.
            alone: least time of each vehicle alone [s], shape (N,).

        Raises:
            InfeasibleError: vehicles cannot hold at their goals from this time on, as required.
            SolverError: the motion violates a constraint.
        """
        plan = self._plans.of(self._arriving(best, alone))
        return plan.with_statistics(Statistics(converged=best.converged))
