"""`diagnose`: why a scenario has no plan, its least violation, and changes that give one.

For a plan of least time: the sensitivity of that time to the limits.
"""

from __future__ import annotations

import math
from typing import overload

from drake_rho.analysis.conflict_search import ConflictSearch
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.sensitivity import TimeSensitivity
from drake_rho.analysis.time_sensitivity import SensitivityAnalysis
from drake_rho.analysis.trials import Trials
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas

_WORK = 500.0
"""Work of a diagnosis without a time limit [rounds], a few seconds for a vehicle or two."""

_PENALTIES = 8
"""Largest number of penalties in a trial of a change; trials begin near a plan."""


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
@single_threaded_blas
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
    search = ConflictSearch(Trials(backend, progress, _PENALTIES), backend, progress, work)
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
