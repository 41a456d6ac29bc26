"""Sequential convex programming: constraints are linearised around one plan after another.

Every iterate keeps all constraints, and no iterate costs more than the one before.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.constraints.coupling import coupled
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import IntArray


class Improvement(Protocol):
    """One iteration of sequential convex programming."""

    def __call__(self, plan: Plan, vehicles: IntArray, tolerance: float) -> tuple[Plan, bool]:
        """Return a plan that may cost less, and whether it is known that no other step would help.

        Args:
            plan: keeps every constraint.
            vehicles: which are planned anew, rising indices.
            tolerance: relative fall of the cost that is small enough.

        Raises:
            InfeasibleError: there is none.
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
    """Linearise obstacles and pairs around one plan after another until the cost stops falling.

    Args:
        subproblem: solved in each iteration.
        plan: where to begin; it keeps every constraint.
        tolerance: relative fall of the cost at which a plan has converged: of each vehicle by
            itself, of fleets that keep apart as a whole.
        improve: one iteration; the subproblem around the plan if not given.
        labels: the same for vehicles that stop together, shape (N,), if not as above.
        most: bound on the linearisations.
        progress: called after each.

    Returns:
        The last plan; `statistics.converged` says whether its cost fell by less than the tolerance.
    """
    labels = subproblem.stopping_together if labels is None else labels
    falling, spent = np.arange(len(plan.accelerations)), plan.statistics
    converged = cut = False
    fall: float | None = None
    for _ in range(most):
        try:
            check_time()
            if improve is None:
                after, settled = subproblem.around(plan, falling), False
            else:
                after, settled = improve(plan, falling, tolerance)
        except (InfeasibleError, SolverError):  # by rounding, where there is no slack at all
            break
        except OutOfTimeError:
            cut = True
            break
        spent += after.statistics
        if progress is not None:
            progress(in_words(spent.linearisations, after.cost))
        fall = max(0.0, 1.0 - after.cost / plan.cost) if plan.cost > 0.0 else 0.0
        plan, falling = _better(plan, after, labels, falling, tolerance)
        if converged := len(falling) == 0 or settled:
            break
    return plan.with_statistics(
        dataclasses.replace(
            spent, converged=converged, cut=cut, last_fall=fall, tolerance=tolerance
        )
    )


def in_words(linearisations: int, cost: float) -> str:
    """Return what is told after each linearisation."""
    times = "once" if linearisations == 1 else f"{linearisations} times"
    return f"linearised {times}, cost {cost:.6g} m²/s⁴"


def _better(
    plan: Plan, after: Plan, labels: IntArray, falling: IntArray, tolerance: float
) -> tuple[Plan, IntArray]:
    """Return the better plan of those that stop together, and which vehicles go on."""
    differences = plan.accelerations**2 - after.accelerations**2
    fallen = np.bincount(labels, np.sum(differences, axis=(1, 2)))[labels]
    falling = falling[fallen[falling] > tolerance * plan.cost]
    if np.all(fallen >= 0.0):
        return after, falling
    if not np.any(fallen > 0.0):
        return plan, falling
    accelerations = np.where((fallen > 0.0)[:, None, None], after.accelerations, plan.accelerations)
    better = Plan.from_accelerations(plan.scenario, accelerations)
    return better if after.reference is None else better.found_around(after.reference), falling


@checked
@with_wall_time
def scp_step(plan: Plan, *, solver: Solver | SolverName | None = None) -> Plan:
    """Return the plan of least cost with obstacles linearised around `plan`: one iteration.

    Pairs, if there is a separation, are linearised too, and coupled.

    Raises:
        InfeasibleError: there is none.
        SolverError: the solvers fail numerically.
    """
    return Subproblem(Problem.of(plan.scenario), coupled, Backend.of(solver)).around(plan)
