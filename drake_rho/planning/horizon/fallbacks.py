"""Motions of windows without a plan: the rest of the previous plan, or least violation."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.minimum_effort import least_accelerations
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver
from drake_rho.planning.scp.minimum_violation import minimum_distance_violation, minimum_violation
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.records import Scenario

Failure = InfeasibleError | SolverError | OutOfTimeError
"""Error of a planner in the form that a window records."""

FAILURES = InfeasibleError, SolverError, OutOfTimeError, MemoryError
"""Errors of this package's planners."""


def failure_of(error: Exception) -> Failure:
    """Return an error of a planner in the form that a window records."""
    if isinstance(error, Failure):
        return error
    if isinstance(error, MemoryError):
        return SolverError("the planner ran out of memory")
    return SolverError(f"the planner failed: {type(error).__name__}: {error}")


def least_violation(reference: Plan, solver: Solver | None = None) -> Plan:
    """Return a plan of minimum violation of its scenario, from any start.

    If possible, goals and limits are met, and the violations of requirements and of distances from
    obstacles and other vehicles are minimised. Otherwise goals may be missed too. If no solver
    finds a plan, the accelerations of the reference are flown.

    Args:
        reference: a motion of the scenario's vehicles from its starts to its goals.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.
    """
    scenario, spent = reference.scenario, Statistics()
    if scenario.avoided or scenario.separation is not None or scenario.required:
        try:
            return minimum_distance_violation(reference, Backend(solver))
        except FAILURES as error:
            spent = failure_of(error).statistics
    try:
        plan = minimum_violation(Problem.of(scenario), Backend(solver))
    except FAILURES as error:
        return reference.with_statistics(spent + failure_of(error).statistics)
    return plan.with_statistics(spent + plan.statistics)


def moved(remaining: Plan, scenario: Scenario) -> Plan:
    """Return the rest of a plan, moved to other starts with the least change of accelerations."""
    if scenario.fleet is remaining.scenario.fleet:
        return unchecked(remaining, scenario=scenario)
    there, here = map(least_accelerations, (scenario, remaining.scenario))
    changed = np.asarray(remaining.accelerations + there - here, dtype=np.float64)
    return Plan.from_accelerations(scenario, changed)
