"""Sequential convex programming: the one loop that linearises anew."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from itertools import islice, repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.keep_apart import coupled
from drake_rho.planning.options import DEFAULTS
from drake_rho.planning.progress import Progress
from drake_rho.planning.solve import Solver
from drake_rho.planning.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray

Follow = Callable[[Plan, Plan], Plan]
"""What is linearised around next, of a reference and the plan that was found around it."""

MAX_RESTORATIONS = 100
"""Bound on the penalties of one restoration."""

PATIENCE = 20
"""Penalties after which a restoration is given up if there are no fewer vehicles in trouble."""

GROWTH = 3.0
"""How fast the penalty grows."""

_CLOSER = 10.0
"""Times the first penalty for a reference that is a way among obstacles and cannot be flown: what
is drawn aside from it too far comes out on other sides of them."""


def iterate(
    subproblem: Subproblem,
    plan: Plan,
    tolerance: float,
    penalties: Iterable[float] | None = None,
    *,
    most: int = DEFAULTS.max_iterations,
    progress: Progress | None = None,
    follow: Follow | None = None,
) -> Plan:
    """Linearise obstacles and pairs around one plan after the other.

    Without penalties the plan has to keep its constraints. Every iterate then does, and the
    iteration ends when the cost falls by less than the tolerance: of each vehicle by itself, of
    fleets that keep apart as a whole. With penalties, pairs of the plan may be too close, and one
    penalty after the other is tried until they are not (feasibility restoration), or until as many
    vehicles as before are left in trouble for `PATIENCE` of them.

    Args:
        subproblem: what is solved in each iteration.
        plan: where to begin.
        tolerance: relative fall of the cost at which a plan has converged.
        penalties: cost of each metre by which a pair is too close, rising.
        most: bound on the linearisations.
        progress: called after each.
        follow: what a restoration linearises around next, as long as a plan is far from keeping
            its constraints; the plan itself if not given.

    Returns:
        The last plan; `statistics.converged` says whether its cost fell by less than the tolerance.

    Raises:
        InfeasibleError: no penalty keeps the pairs apart.
        SolverError: the solvers fail numerically where they are apart.
    """
    restoring, falling = penalties is not None, np.arange(len(plan.accelerations))
    fewest, since = len(falling) + 1, 0
    converged, spent, around = False, plan.statistics, plan
    for number, penalty in enumerate(islice(penalties or repeat(np.inf), most)):
        if restoring and subproblem.holds(plan):
            break
        try:
            if restoring:
                after = subproblem.restored(around, penalty, subproblem.begun + number)
            else:
                after = subproblem.improved(plan, falling, tolerance)
        except (InfeasibleError, SolverError):  # by rounding, where there is no room at all
            break
        spent += after.statistics
        if progress is not None:
            worst = subproblem.worst_breach(after) if restoring else 0.0
            left = len(subproblem.in_trouble(after)) if worst > 0.0 else 0
            progress(_words(spent.linearisations, after.cost, worst, left))
        if restoring:
            far = follow is not None and not subproblem.almost_holds(after)
            plan, around = after, follow(around, after) if follow and far else after
            if (left := len(subproblem.in_trouble(after))) < fewest:
                fewest, since = left, number
            if number - since >= PATIENCE:
                break
            continue
        plan, falling = _better(subproblem, plan, after, falling, tolerance)
        if converged := len(falling) == 0 or subproblem.settled:
            break
    if restoring and (failure := subproblem.failure(plan, spent)) is not None:
        raise failure
    done = dataclasses.replace(spent, converged=converged or restoring, tolerance=tolerance)
    return plan.with_statistics(done)


def _words(linearisations: int, cost: float, worst: float, left: int) -> str:
    times = "once" if linearisations == 1 else f"{linearisations} times"
    breach = f", worst breach {worst:.3g} m, {left} vehicles in trouble" if worst > 0.0 else ""
    return f"linearised {times}, cost {cost:.6g} m²/s⁴{breach}"


def _better(
    subproblem: Subproblem, plan: Plan, after: Plan, falling: IntArray, tolerance: float
) -> tuple[Plan, IntArray]:
    """For each vehicle, or all that stop together, the better plan; and who goes on."""
    labels = subproblem.labels
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


def restored(
    plan: Plan,
    subproblem: Subproblem,
    progress: Progress | None = None,
    follow: Follow | None = None,
    *,
    most: int = MAX_RESTORATIONS,
    growth: float = GROWTH,
) -> Plan:
    """A plan that keeps out of obstacles and of other vehicles, from one that need not.

    The penalty grows from one linearisation to the next. Each vehicle yields half, so all are
    planned side by side.

    Args:
        plan: of a scenario; its positions may be ones that cannot be flown.
        subproblem: of that scenario, decoupled.
        progress: called after each linearisation.
        follow: as in `iterate`.
        most: bound on the penalties.
        growth: of the penalty, from one linearisation to the next.

    Raises:
        InfeasibleError: none was found.
    """
    first = _first_penalty(plan, subproblem.least_cost)
    if not subproblem.is_flown(plan):
        first *= _CLOSER
    numbers = range(subproblem.begun, subproblem.begun + most)
    penalties = (first * min(growth**number, subproblem.steepest) for number in numbers)
    return iterate(subproblem, plan, 1.0, penalties, progress=progress, follow=follow)


def scp_step(plan: Plan, *, solver: Solver | None = None) -> Plan:
    """One iteration: the plan of least cost with obstacles linearised around `plan`.

    Pairs, if there is a separation, are linearised too, and coupled.

    Raises:
        InfeasibleError: there is none.
        SolverError: the solvers fail numerically.
    """
    return Subproblem(plan.scenario, coupled, solver).around(plan)


def _first_penalty(plan: Plan, effort: float) -> float:
    """What a metre is worth at first: the cost of moving aside, and that of the plan, a metre.

    Args:
        plan: where to begin.
        effort: the least cost of all motions [m²/s⁴].
    """
    scenario = plan.scenario
    rooms = [float(obstacle.shape.extent.min()) for _, obstacle in scenario.known]
    if scenario.separation is not None:
        rooms.append(scenario.separation.distance)
    room, T = min(rooms, default=float(scenario.fleet.lengths.max())), scenario.grid.duration
    aside = scenario.grid.knots * (4.0 * room / T**2) ** 2
    return (max(plan.cost, effort) / len(scenario.vehicles) + aside) / room
