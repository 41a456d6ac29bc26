"""Feasibility restoration: repeated linearisation with rising penalties until all rows hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from drake_rho.motion.costs import cost_of
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.patience import DeadEnds, Patience, least_extent
from drake_rho.planning.scp.sequential_convex import progress_line
from drake_rho.planning.scp.subproblem import Subproblem

Follow = Callable[[Plan, Plan], Plan]
"""Function that returns the next reference, given a reference and the plan found around it."""

MAX_RESTORATIONS = 100
"""Largest number of penalties in one restoration."""

GROWTH = 3.0
"""Factor by which the penalty grows from one step to the next."""

_ATTEMPTS = 3
"""Penalties tried in one step: after a numerical failure, that of the previous step is used."""

_PATH_FACTOR = 10.0
"""Factor on the first penalty if the reference is a dynamically inconsistent path among obstacles.
Motions that deviate from it too far pass obstacles on other sides."""

_ROUNDS_AMONG_OBSTACLES = 4
"""Rounds of rows in the first steps of a restoration among obstacles. With fewer, motions end
inside some obstacles and pass others on the wrong side."""


class Step(Protocol):
    """One step of a feasibility restoration."""

    max_growth: float
    """largest penalty, as a multiple of the first"""

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return a plan found around a reference; it may still violate something.

        Args:
            reference: a motion of the same vehicles at the same knots.
            penalty: the cost of each metre by which a vehicle is too close.
            number: the number of earlier steps. Step 0 has one normal per encounter, and later
                steps are solved more exactly.

        Raises:
            InfeasibleError: the constraints cannot be met even without obstacles and pairs.
            SolverError: the solvers fail numerically.
        """
        ...


class SoftRows:
    """Steps in which rows of obstacles and pairs may be violated at the penalty.

    Once the violations of a reference are small, hard rows are tried. Until then, vehicles that
    violate nothing keep the reference. Rows of obstacles are soft only if the reference
    violates something other than the separation of pairs.

    Args:
        subproblem: the subproblem that each step solves.
        limits: function from the penalty to all constraints except obstacles and pairs; those of
            the problem if not given.
    """

    max_growth = 1e5

    def __init__(
        self, subproblem: Subproblem, limits: Callable[[float], list[Constraint]] | None = None
    ) -> None:
        self._subproblem = subproblem
        self._limits = limits or (lambda penalty: [*subproblem.problem.convex])
        self._failed_violation = np.inf

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return the plan of a step, as every `Step` does."""
        problem, found = self._subproblem.problem, self._subproblem.violations(reference)
        worst = found.worst
        if found.is_small and worst < self._failed_violation / 2.0:
            try:
                return self._subproblem.solve_around(reference)
            except (InfeasibleError, SolverError):  # hard rows come too early
                self._failed_violation = worst
        motion, rounds = reference.motion(), number // 2
        vehicles = problem.with_linked(found.vehicles)
        rounds += 1 if found.is_of_pairs_only else _ROUNDS_AMONG_OBSTACLES
        constraints = self._limits(penalty)
        for each in problem.obstacles_around(motion):
            soft = each.softened_for(penalty, rounds)
            constraints.append(each if found.is_of_pairs_only else soft)
        if problem.scenario.separation is not None:
            pairs = problem.pairs_around(
                motion,
                self._subproblem.coupling,
                penalty=penalty,
                one_normal=number == 0,
                of=vehicles,
            )
            constraints.append(dataclasses.replace(pairs, rounds=rounds))
        return self._subproblem.solve_with(reference, constraints, vehicles)


def restore_feasibility(
    subproblem: Subproblem,
    plan: Plan,
    *,
    step: Step | None = None,
    offset: int = 0,
    most: int = MAX_RESTORATIONS,
    progress: Progress | None = None,
    follow: Follow | None = None,
    dead_ends: DeadEnds | None = None,
) -> Plan:
    """Return a plan that satisfies all constraints, starting from a motion that may violate some.

    The penalty grows from one linearisation to the next. Each vehicle of a pair has half the
    responsibility, so that all vehicles can be planned in parallel.

    Args:
        subproblem: the subproblem to solve, decoupled.
        plan: the initial motion; its positions may be dynamically inconsistent.
        step: one step; `SoftRows` of the subproblem if not given.
        offset: the number of steps that count as taken already.
        most: the largest number of penalties.
        progress: receives a line of text after each linearisation.
        follow: makes the next reference while violations are large; the plan itself if not given.
        dead_ends: ends of earlier restorations, near which this one stops. If it finds no plan, its
            own end is added.

    Raises:
        InfeasibleError: no plan was found.
    """
    plan = least_violating(
        subproblem,
        plan,
        step or SoftRows(subproblem),
        offset=offset,
        most=most,
        progress=progress,
        follow=follow,
        dead_ends=dead_ends,
    )
    found = subproblem.violations(plan)
    if found.none:
        return plan
    if dead_ends is not None:
        dead_ends.add(plan)
    raise found.error(plan.statistics)


def least_violating(
    subproblem: Subproblem,
    plan: Plan,
    step: Step,
    *,
    offset: int = 0,
    most: int = MAX_RESTORATIONS,
    progress: Progress | None = None,
    follow: Follow | None = None,
    dead_ends: DeadEnds | None = None,
) -> Plan:
    """Return the last plan of a restoration; it may still violate constraints.

    The arguments are those of `restore_feasibility`.
    """
    patience, spent, reference = Patience(subproblem, dead_ends), plan.statistics, plan
    first = _first_penalty(subproblem, plan)
    for number in range(offset, offset + most):
        if subproblem.holds(plan):
            break
        check_time()
        try:
            after = _try_step(step, reference, first * min(GROWTH**number, step.max_growth), number)
        except (InfeasibleError, SolverError):  # rounding errors, where constraints lack slack
            break
        spent += after.statistics
        if progress is not None:
            progress(_progress_line(subproblem, after, spent.linearisations))
        large = follow is not None and not subproblem.violations(after).is_small
        plan, reference = after, follow(reference, after) if follow and large else after
        if patience.ends(after):
            break
    return plan.with_statistics(
        dataclasses.replace(spent, converged=True, cut=False, last_fall=None, tolerance=1.0)
    )


def _try_step(step: Step, reference: Plan, penalty: float, number: int) -> Plan:
    """Return the plan of a step, at a lower penalty if solvers fail numerically.

    Raises:
        InfeasibleError: the constraints cannot be met even without obstacles and pairs.
        SolverError: the solvers fail numerically at lower penalties too.
    """
    spent = Statistics()
    for back in range(_ATTEMPTS):
        try:
            after = step(reference, penalty / GROWTH**back, max(number - back, 0))
        except SolverError as error:
            spent += error.statistics
            failure = SolverError(str(error), spent)
        else:
            return after.with_statistics(spent + after.statistics)
    raise failure


def _progress_line(subproblem: Subproblem, plan: Plan, linearisations: int) -> str:
    """Return the line that reports progress after a linearisation."""
    found, line = subproblem.violations(plan), progress_line(linearisations, plan.cost)
    if found.worst == 0.0:
        return line
    return f"{line}, worst violation {found.worst:.3g} m, {len(found.vehicles)} vehicles violating"


def _first_penalty(subproblem: Subproblem, plan: Plan) -> float:
    """Return the first penalty: the cost per metre of the plan and of an evasive motion."""
    scenario, motion = subproblem.problem.scenario, subproblem.problem.effort.motion
    effort = cost_of(scenario, motion)
    extent, T = least_extent(scenario), scenario.grid.duration
    evasion = scenario.grid.knots * (4.0 * extent / T**2) ** 2
    evasion *= float(np.mean(scenario.fleet.weights))
    first = (max(plan.cost, effort) / len(scenario.vehicles) + evasion) / extent
    consistent = len(subproblem.violations(plan).inconsistent) == 0
    return first if consistent else _PATH_FACTOR * first
