"""Search for the plan of least time: first motions, and how each of them gets faster."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from itertools import islice

from drake_rho.analysis.early_arrivals import as_soon_as_each_can
from drake_rho.analysis.time_alone import TimesAlone, in_no_time
from drake_rho.analysis.timed_plans import TimedPlans
from drake_rho.analysis.trials import Trials, durations
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.constraints.tightening import enlarged_by_margins
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.path_search.initial_guesses import paths_on_grids
from drake_rho.planning.planners.first_plan import FirstPlan, plan_near
from drake_rho.planning.planners.related import changes_with_time, is_steady
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.least_time import ROUGH, LeastTime
from drake_rho.planning.scp.timed import Timed, latest
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import AllWaypoints

_LONGER = 1.3, 2.0, 4.0, 8.0
"""Multiples of the least time without obstacles and other vehicles in which a first plan is sought,
around which both are linearised."""

_LESS = 0.02, 0.005
"""Parts by which the time of a local optimum is reduced for another plan near it."""

_SEARCHES = 2
"""Number of searches for plans in less time than a local optimum."""

_ROUGHLY = 3e-3
"""Relative fall of the final time at which motions along different paths are compared."""

_SPARE = 1e-3
"""Part by which a time in which plans are sought first is longer than the least time of a vehicle
alone: at that itself there is at most one motion, around which programs take very long."""

_WORTHWHILE = 0.01
"""Part of the final time that has to be possible to gain for another search."""


class TimeSearch:
    """Search for the plan of least time of one scenario.

    Args:
        scenario: scenario to plan for.
        grid: grid of the first motion, with the knots of the plan.
        backend: solver of first plans.
        progress: called with descriptions of what is being done.
        options: bounds of the searches.
        each: whether vehicles arrive one by one, as soon as each can.
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
        self._each = each
        self._bound: float | None = None
        self._waypoints = AllWaypoints.of(scenario.vehicles)
        vehicles = self._waypoints.placed(scenario.vehicles, None)
        self._scenario = scenario.ending_with(grid, vehicles)
        self._backend, self._progress, self._options = backend, progress, options
        self._steady = is_steady(self._scenario) and not self._waypoints.given.any()
        self._least = LeastTime(ROUGH, progress, steady=self._steady)
        self._plans = TimedPlans(scenario, self._waypoints, progress, steady=self._steady)

    def plan(self) -> Plan:
        """Return the plan of least time.

        Where solvers are too inexact for the limits, it is the one that bisection finds.
        """
        scenario = self._scenario
        apart = scenario.separation is not None or Problem.of(scenario).has_links
        smooth = scenario.smoothing is not None
        bound = apart or smooth or scenario.avoided or scenario.requirements
        alone = TimesAlone(scenario, self._waypoints, self._backend, self._progress)
        free = self._steady and not bound
        each = alone.motion(spare=free and not self._each)
        self._least.statistics += alone.statistics
        self._bound = alone.bound
        best = each if free else self._together(each, apart)
        try:
            return self._finished(self._arriving(best, alone.durations))
        except SolverError:
            slower = self._by_bisection(each, coupled=False)
            if slower is None:
                raise
            slower = dataclasses.replace(slower, converged=False)
            return self._finished(self._arriving(slower, alone.durations))

    def _arriving(self, best: Timed, alone: FloatArray) -> Timed:
        """Return a motion in which vehicles arrive one by one, if that is asked for.

        Args:
            best: motion in which all arrive at the last knot.
            alone: time that each vehicle takes at least [s], shape (N,).
        """
        if not self._each:
            return best
        least = LeastTime(ROUGH, self._progress, final_time=False)
        best = as_soon_as_each_can(best, alone, least, self._progress)
        self._least.statistics += least.statistics
        return best

    def _together(self, alone: Timed, apart: bool) -> Timed:
        """Return the motion in the least time in which all arrive.

        Args:
            alone: motion of each vehicle alone.
            apart: whether vehicles have to keep a distance or a link.
        """
        scenario, options, count = self._scenario, self._options, len(self._scenario.vehicles)
        best = None
        if apart and count > options.max_coupled:
            best = self._by_bisection(alone, coupled=False)
        elif self._steady and count == 1:
            best = self._along_paths(alone)
        elif changes_with_time(scenario):
            best = self._by_bisection(alone)
        if best is None:
            given = self._waypoints.given.any()
            low = latest(scenario, alone.passing) if given else alone.duration
            best = self._shorter(low, self._from_first_plans(alone))
        return best

    def _along_paths(self, alone: Timed) -> Timed | None:
        """Return the motion in least time of one vehicle near paths around the obstacles."""
        tell(self._progress, "looking for paths around the obstacles")
        problem, timed = self._scaled(alone, _LONGER[0] * alone.duration)
        larger = enlarged_by_margins(problem.scenario, problem.margins)
        options, found = self._options, [timed]
        for grid in islice(paths_on_grids(larger, options.max_ways, options.max_memory), 1):
            found += [dataclasses.replace(timed, reference=each) for each in grid.references]
        best = self._shortest(partial(self._least.around, each, _ROUGHLY) for each in found)
        return best and self._shortest([partial(_same, best), partial(self._least.around, best)])

    def _by_bisection(self, alone: Timed, *, coupled: bool = True) -> Timed | None:
        """Return the motion in least time near the plan that bisection of the final time finds.

        Args:
            alone: motion with times of waypoints that are to be kept in proportion.
            coupled: whether one program of all vehicles is solved afterwards.
        """
        trials, scenario = Trials(self._backend, self._progress), self._at(alone, 1.0)

        def variant(factor: float) -> Scenario:
            return self._at(alone, factor)

        duration, _ = durations(scenario, trials, variant)
        plan = trials.plan
        if duration is None or plan is None:
            return None
        _, timed = self._scaled(alone, plan.scenario.grid.duration)
        start = dataclasses.replace(timed, accelerations=plan.accelerations)
        if not coupled:
            return start
        return self._shortest([partial(self._least.around, start), partial(_same, start)])

    def _at(self, like: Timed, factor: float) -> Scenario:
        """Return the scenario with waypoints, in a multiple of little more time than a motion's."""
        return self._scaled(like, factor * (1.0 + _SPARE) * like.duration)[0].scenario

    def _from_first_plans(self, alone: Timed) -> Timed:
        """Return a motion in least time near a first plan in more time."""
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
        none = SolverError("no motion was found around the first plans")
        raise failures[-1] if failures else none

    def _shorter(self, low: float, best: Timed) -> Timed:
        """Return a motion that takes less time than a local optimum, if one is found.

        Plans are sought in a little less time near the motion, and then in much less time anywhere.

        Args:
            low: time below which there is no motion [s].
            best: local optimum.
        """
        for part in _LESS:
            if (1.0 - part) * best.duration < low:
                continue
            near = partial(self._from_near, best, (1.0 - part) * best.duration)
            best = self._shortest([partial(_same, best), near]) or best
        for _ in range(_SEARCHES):
            if best.duration - low <= _WORTHWHILE * best.duration:
                break
            middle = (low + best.duration) / 2.0
            search = partial(self._from_first_plan, best, middle, quick=True)
            found = self._shortest([partial(_same, best), search]) or best
            low = low if found.duration < best.duration else middle
            best = found
        return best

    def _shortest(self, searches: Iterable[Callable[[], Timed | None]]) -> Timed | None:
        """Return the shortest result of several searches; None if none has any."""
        best: Timed | None = None
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

    def _scaled(self, like: Timed, duration: float) -> tuple[Problem, Timed]:
        """Return the problem with all waypoints in another final time, and a motion in that time.

        Args:
            like: motion with times of waypoints that are to be kept in proportion.
            duration: final time [s].
        """
        smoothing, steps = self._scenario.smoothing, self._scenario.grid.knots - 1
        if smoothing is not None:
            duration = max(duration, smoothing.width * steps * (1.0 + 1e-9))
        duration = max(duration, latest(self._scenario, like.passing) * (1.0 + 1e-9))
        scaled = dataclasses.replace(like.lasting(duration), scenario=self._scenario)
        return Problem.of(self._plans.scenario(scaled.grid, scaled.passing.times)), scaled

    def _from_near(self, like: Timed, duration: float) -> Timed | None:
        """Return a motion in the least time from a plan near another, in a given time [s]."""
        problem, timed = self._scaled(like, duration)
        reference = Plan.from_motion(problem.scenario, timed.motion)
        plan = plan_near(problem, reference, backend=self._backend, progress=self._progress)
        return self._least.around(dataclasses.replace(timed, accelerations=plan.accelerations))

    def _from_first_plan(
        self, like: Timed, duration: float, *, quick: bool = False
    ) -> Timed | None:
        """Return a motion in the least time from a first plan in a given time; None if none.

        Args:
            like: motion with times of waypoints that are to be kept in proportion.
            duration: time of the first plan [s].
            quick: whether few paths are tried.
        """
        problem, timed = self._scaled(like, duration)
        options = dataclasses.replace(self._options, max_ways=2) if quick else self._options
        search = FirstPlan(self._backend, self._progress, options)
        first = search.of(problem) if quick else search.of_any_duration(problem)
        return self._least.around(dataclasses.replace(timed, accelerations=first.accelerations))

    def _finished(self, best: Timed) -> Plan:
        """Return a motion as a plan with the statistics of the whole search.

        Raises:
            InfeasibleError: vehicles have to hold at their goals, and cannot from this time on.
            SolverError: the motion violates a constraint.
        """
        plan = self._plans.of(best)
        spent = self._least.statistics + self._plans.statistics
        found = dataclasses.replace(spent, converged=best.converged, time_bound=self._bound)
        return plan.with_statistics(found)


def _same(timed: Timed) -> Timed:
    """Return a motion that is known."""
    return timed
