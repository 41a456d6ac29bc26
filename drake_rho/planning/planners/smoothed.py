"""Plans whose smoothing margin fits their own accelerations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.problem import Problem
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.times import steps_lasting

_MORE = 1.25
"""Bound on accelerations of a plan, as a multiple of those of the plan before."""

_LEAST = 0.02
"""Least bound on accelerations of a plan, as a fraction of the largest."""

_ROUNDS = 4
"""Largest number of plans with margins from the accelerations of the plan before."""


def with_own_margin(
    first: Callable[[Problem], Plan], again: Callable[[Problem, Plan], Plan], problem: Problem
) -> Plan:
    """Return a plan whose smoothing margin is sufficient for its own accelerations.

    Limits usually allow much larger accelerations than plans have. Margins are therefore computed
    for those of a plan without margins, and are enlarged where the next plan exceeds them.

    Args:
        first: function that plans a problem.
        again: function that plans a problem from the plan of a similar one.
        problem: problem of a scenario with a smoothing, with the margin for its limits.

    Raises:
        InfeasibleError: no plan is found.
        SolverError: the solvers fail numerically.
    """
    largest = np.zeros(problem.scenario.grid.knots - 1)
    plan = first(problem.for_accelerations(largest))
    spent = plan.statistics
    for _ in range(_ROUNDS):
        largest = np.maximum(largest, _MORE * accelerations_near(plan))
        largest = np.maximum(largest, _LEAST * largest.max())
        plan = again(problem.for_accelerations(largest), plan)
        spent += plan.statistics
        if np.all(accelerations_near(plan) <= largest):
            return plan.with_statistics(spent)
    plan = again(problem, plan)
    return plan.with_statistics(spent + plan.statistics)


def accelerations_near(plan: Plan) -> FloatArray:
    """Return the largest acceleration over each step's averaging interval, shape (K-1,)."""
    most = np.linalg.norm(plan.accelerations, axis=2).max(axis=0)
    reached = steps_lasting(plan.scenario.lead, plan.scenario.grid.step)
    padded = np.pad(most, reached)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reached + 1).max(axis=1))
