"""Sequential convex programming: linearise constraints around the latest plan, solve, and repeat.

Every iterate satisfies all constraints, and no iterate costs more than the one before.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from drake_rho.motion.costs import savings
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.constraints.separation import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.momentum import Momentum
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray, IntArray


class Improvement(Protocol):
    """One iteration of sequential convex programming."""

    def __call__(self, plan: Plan, vehicles: IntArray, tolerance: float) -> tuple[Plan, bool]:
        """Return a plan that may cost less, and whether the iteration is known to have converged.

        Args:
            plan: a plan that satisfies every constraint.
            vehicles: indices of the vehicles to plan again, ascending.
            tolerance: the relative decrease of the cost at which a plan has converged.

        Raises:
            InfeasibleError: the linearised program has no solution.
            SolverError: the solvers fail numerically.
        """
        ...


def sequential_convex(
    subproblem: Subproblem,
    plan: Plan,
    tolerance: float,
    *,
    improve: Improvement | None = None,
    labels: IntArray | None = None,
    most: int = DEFAULTS.max_iterations,
    progress: Progress | None = None,
) -> Plan:
    """Linearise obstacles and pairs around the latest plan until the cost converges.

    Where this takes long, references are ahead of the latest plan (`momentum`). A vehicle has
    converged only if a linearisation around its plan lowers the cost by less than the tolerance.

    Args:
        subproblem: the convex subproblem of each iteration.
        plan: the initial plan, which satisfies every constraint.
        tolerance: the relative decrease of the cost at which a plan has converged. A fleet with a
            separation converges as a whole, other vehicles individually.
        improve: one iteration; if not given, the subproblem is solved around the plan.
        labels: equal numbers for vehicles that converge together, shape (N,); if not given, as
            described for `tolerance`.
        most: the largest number of linearisations.
        progress: receives a line of text after each linearisation.

    Returns:
        The last plan; `statistics.converged` tells whether its cost fell by less than `tolerance`.
    """
    labels = subproblem.converging_together if labels is None else labels
    falling, spent = np.arange(len(plan.accelerations)), plan.statistics
    problem, converged, cut = subproblem.problem, False, False
    paid, priced = problem.prices(plan), bool(problem.scenario.penalties)
    fall: float | None = None
    momentum = Momentum(len(plan.accelerations))
    for _ in range(most):
        try:
            check_time()
            if improve is None:
                reference = momentum.reference(plan, falling, fall)
                after, converged = subproblem.solve_around(reference, falling), False
            else:
                after, converged = improve(plan, falling, tolerance)
        except (InfeasibleError, SolverError):  # rounding errors, where constraints lack slack
            if not momentum.ahead.any():
                break
            momentum.restart(falling)
            continue
        except OutOfTimeError:
            cut = True
            break
        spent += after.statistics
        if progress is not None:
            progress(progress_line(spent.linearisations, after.cost))
        price = problem.prices(after) if priced else paid
        cost, less = plan.cost + sum(paid.tolist()), after.cost + sum(price.tolist())
        fall = max(0.0, 1.0 - less / cost) if cost > 0.0 else 0.0
        plan, fell = _better(plan, after, paid - price, labels, falling, tolerance * cost)
        stalled = np.setdiff1d(falling, fell)
        momentum.restart(stalled)
        falling = np.union1d(fell, stalled[momentum.ahead[stalled]])
        paid = price if plan is after else problem.prices(plan)
        if converged := len(falling) == 0 or converged:
            break
    return plan.with_statistics(
        dataclasses.replace(
            spent, converged=converged, cut=cut, last_fall=fall, tolerance=tolerance
        )
    )


def progress_line(linearisations: int, cost: float) -> str:
    """Return the line that reports progress after a linearisation."""
    times = "once" if linearisations == 1 else f"{linearisations} times"
    return f"linearised {times}, cost {cost:.6g} m²/s⁴"


def _better(
    plan: Plan,
    after: Plan,
    saved: FloatArray,
    labels: IntArray,
    falling: IntArray,
    least: float,
) -> tuple[Plan, IntArray]:
    """Return the better plan of each set that converges together, and the vehicles to continue.

    Args:
        plan: plan before an iteration.
        after: plan after it.
        saved: decrease of the price of soft limits, of each vehicle [m²/s⁴], shape (N,).
        labels: equal numbers for vehicles that converge together, shape (N,).
        falling: indices of the vehicles planned again.
        least: decrease of the cost above which vehicles continue [m²/s⁴].
    """
    fallen = np.bincount(labels, savings(plan.scenario, plan, after) + saved)[labels]
    falling = falling[fallen[falling] > least]
    if (fallen >= 0.0).all():
        return after, falling
    if not (fallen > 0.0).any():
        return plan, falling
    accelerations = np.where((fallen > 0.0)[:, None, None], after.accelerations, plan.accelerations)
    better = Plan.from_accelerations(plan.scenario, accelerations)
    return better if after.reference is None else better.found_around(after.reference), falling


@checked
@with_wall_time
def scp_step(plan: Plan, *, solver: Solver | SolverName | None = None) -> Plan:
    """Run one iteration: return the plan of least cost with obstacles linearised around `plan`.

    If the scenario has a separation, pairs are linearised too, and coupled.

    Raises:
        InfeasibleError: the linearised program has no solution.
        SolverError: the solvers fail numerically.
    """
    return Subproblem(Problem.of(plan.scenario), coupled, Backend.of(solver)).solve_around(plan)
