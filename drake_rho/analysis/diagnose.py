"""`diagnose`: reason why a scenario has no plan, its least violation, and changes that give one.

Of a plan in the least time it is the limits that make it as long as it is.
"""

from __future__ import annotations

import dataclasses
from typing import overload

from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.infeasible_subset import infeasible_subset
from drake_rho.analysis.sensitivity import TimeSensitivity
from drake_rho.analysis.time_sensitivity import SensitivityAnalysis
from drake_rho.analysis.trials import Trials, durations, least_factor, precision_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.planners.first_plan import first_plan
from drake_rho.planning.planners.related import can_be_slower
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.minimum_violation import minimum_violation
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Box, Limits, Scenario, Vehicle
from drake_rho.system.threads import single_threaded_blas
from drake_rho.verification.check import Check
from drake_rho.verification.verify import verify


@overload
def diagnose(
    scenario: Scenario,
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
    scenario: Scenario | Plan,
    *,
    planned: Scenario | None = None,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> Diagnosis | TimeSensitivity:
    """Find out why a scenario has no plan, or which limits make a plan of least time so long.

    Of a scenario without a plan, it finds the constraints that cannot be met together, the least
    violation, and changes that give a plan. Of a plan of `plan_minimum_time`, it finds by how much
    the final time falls if each limit is relaxed by a little: each is relaxed in turn, in a program
    with a free final time around the plan. Where limits bend, the change is that to first order.

    Conflicts with obstacles are those of the first linearisation, around the plan without
    obstacles. Changes that give a plan are found with the first plan of `plan_scp`, which also
    tries paths round obstacles. Where a longer duration is not always possible (`can_be_slower`),
    shorter ones are tried as well.

    Args:
        scenario: scenario to diagnose, or plan of the least time.
        planned: for a plan, the scenario that it was planned for, whose times of waypoints are
            kept. If not given, the times of all waypoints count as found.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given. Plans
            are diagnosed with Clarabel.
        progress: called with a short description of the current step, as on each trial.
        time_limit: seconds, above 0, after which the findings so far are returned (`cut`).

    Returns:
        A `Diagnosis` of a scenario, the `TimeSensitivity` of a plan.

    Raises:
        OutOfTimeError: time was up before a plan, or a reason why there is none, was found.
        ScenarioError: a waypoint of the scenario has no time, or no limit bounds a plan's time.
        SolverError: the solvers fail numerically.
        ValueError: the plan is none of least time, or not one of the scenario `planned`.

    Examples:
        >>> scenario = rho.Scenario(
        ...     "hurry",
        ...     rho.Grid.lasting(10.0, step=0.25),
        ...     [rho.Vehicle("scout", rho.State([0, 0, 2]), rho.State([20, 0, 2]))],
        ...     limits=rho.Limits(max_acceleration=0.7),
        ... )
        >>> rho.diagnose(scenario).conflicts
        {'scout': ('goal x', 'maximum acceleration from 0 s to 9.75 s')}
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
    violations: tuple[Check, ...] = ()
    tolerable, premise, trials = None, "", Trials(backend, progress)
    try:
        plan = first_plan(Problem.of(scenario), backend=backend, progress=progress)
    except InfeasibleError as error:
        trials.begin(None)
        tolerable = _largest_tolerable_wind(scenario, trials)
        conflicts, premise = error.conflicts, error.premise
        try:
            if tolerable is None and scenario.disturbance is not None:
                error = _undisturbed(error, scenario, backend)
            tell(progress, "looking for constraints that cannot be met together")
            conflicts, premise = infeasible_subset(error, solver=backend.solver), error.premise
            tell(progress, "looking for the least violation")
            violations = verify(minimum_violation(Problem.of(scenario), backend)).violations
        except OutOfTimeError:
            trials.cut = True
        if tolerable is not None:  # without it there is a plan, so it is part of every conflict
            conflicts = {name: (*why, "disturbance") for name, why in conflicts.items()}
    else:
        trials.begin(plan)
        conflicts, violations = {}, verify(plan).violations
    shortest, longest = durations(scenario, trials)
    stronger = _smallest_relaxation(scenario, trials)
    return Diagnosis(
        scenario=scenario,
        conflicts=conflicts,
        violations=tuple(one for one in violations if one.vehicle in conflicts),
        shortest_duration=shortest,
        longest_duration=longest,
        is_monotone=is_monotone(scenario),
        acceleration_factor=stronger,
        premise=premise,
        bearable_wind=tolerable,
        cut=trials.cut,
    )


def is_monotone(scenario: Scenario) -> bool:
    """Return whether a plan for one duration implies that one is found for every longer duration.

    With obstacles or a separation this is False even where it is true of the problem
    (`can_be_slower`), because the planner may miss the plan for one duration and find that for
    another.
    """
    return can_be_slower(scenario) and not scenario.obstacles and scenario.separation is None


def _undisturbed(error: InfeasibleError, scenario: Scenario, backend: Backend) -> InfeasibleError:
    """Return the error without the disturbance, which is more telling, if there is one."""
    try:
        first_plan(Problem.of(scenario.with_disturbance(None)), backend=backend)
    except InfeasibleError as other:
        return other
    except SolverError:
        pass
    return error


def _largest_tolerable_wind(scenario: Scenario, trials: Trials) -> float | None:
    """Return the largest wind with a plan [m/s²], for a scenario without one; see `Diagnosis`."""
    disturbance = scenario.disturbance
    if disturbance is None:
        return None

    def tolerates(part: float) -> bool:
        weaker = dataclasses.replace(disturbance, acceleration=part * disturbance.acceleration)
        words = f"wind up to {weaker.acceleration:.4g} m/s²"
        return trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=weaker), words)

    if not trials.has_plan(lambda: dataclasses.replace(scenario, disturbance=None), "no wind"):
        return None
    if disturbance.acceleration == 0.0 or not tolerates(0.0):
        return 0.0
    low, high = 0.0, 1.0
    while high - low > precision_of(scenario):
        middle = (low + high) / 2.0
        low, high = (middle, high) if tolerates(middle) else (low, middle)
    return low * disturbance.acceleration


def _smallest_relaxation(scenario: Scenario, trials: Trials) -> float | None:
    limits = [scenario.limits_of(vehicle) for vehicle in scenario.vehicles]
    if not any(each.acceleration or each.max_acceleration for each in limits):
        return None

    def suffices(factor: float, near: bool = False) -> bool:
        words = f"acceleration limits {factor:.5g} times as wide"
        return trials.has_plan(lambda: _stronger(scenario, factor), words, near=near)

    return least_factor(suffices, trials.feasible, precision_of(scenario))


def _stronger(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with every limit on accelerations scaled by `factor` about zero."""

    def wider(limits: Limits | None) -> Limits | None:
        if limits is None:
            return None
        box, most = limits.acceleration, limits.max_acceleration
        return dataclasses.replace(
            limits,
            acceleration=box and Box(factor * box.lower, factor * box.upper),
            max_acceleration=most and factor * most,
        )

    def stronger(vehicle: Vehicle) -> Vehicle:
        return dataclasses.replace(vehicle, limits=wider(vehicle.limits))

    return dataclasses.replace(
        scenario,
        limits=wider(scenario.limits) or Limits(),
        vehicles=tuple(stronger(vehicle) for vehicle in scenario.vehicles),
    )
