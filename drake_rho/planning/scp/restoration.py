"""Feasibility restoration: linearised anew at rising penalties until nothing is violated."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.scp.patience import DeadEnds, Patience, least_extent
from drake_rho.planning.scp.sequential_convex import in_words
from drake_rho.planning.scp.subproblem import Subproblem

Follow = Callable[[Plan, Plan], Plan]
"""The next reference, made of a reference and the plan that was found around it."""

MAX_RESTORATIONS = 100
"""Bound on the penalties of one restoration."""

GROWTH = 3.0
"""Factor by which the penalty grows."""

_BACK = 3
"""Penalties that are tried in one step, each after the first one step less."""

_CLOSER = 10.0
"""Times the first penalty for a reference that is a path among obstacles and dynamically
inconsistent: what is drawn aside from it too far comes out on other sides of them."""

_ROUNDS_AMONG_OBSTACLES = 4
"""Rounds of rows in the first steps of a restoration that has to bring vehicles round obstacles:
with fewer they come out inside of some, and on the wrong side of others."""

_AGAIN = 0.5
"""Part of a violation that was too large for hard rows, from which on these are tried again."""


class Step(Protocol):
    """One step of a restoration."""

    steepest: float
    """times the first penalty up to which penalties grow"""

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return a plan that violates less; it may still violate something.

        Args:
            reference: positions of the same vehicles at the same knots.
            penalty: cost of each metre by which a vehicle is too close.
            number: steps before: the first gives each encounter one normal, and later ones are
                solved more exactly.

        Raises:
            InfeasibleError: the constraints without any obstacle or pair cannot be met.
            SolverError: the solvers fail numerically.
        """
        ...


class SoftRows:
    """Steps in which rows of obstacles and pairs may be violated at the penalty.

    As soon as a reference violates little, the rows are tried as hard ones. Vehicles that fly the
    reference, and violate nothing, go on flying it. Rows of obstacles are soft only where the
    reference violates more than the separation of pairs.

    Args:
        subproblem: solved in each step.
        limits: constraints beside obstacles and pairs, at a penalty; the problem's if not given.
    """

    steepest = 1e5

    def __init__(
        self, subproblem: Subproblem, limits: Callable[[float], list[Constraint]] | None = None
    ) -> None:
        self._subproblem, self._limits = subproblem, limits
        self._too_much = np.inf

    def __call__(self, reference: Plan, penalty: float, number: int) -> Plan:
        """Return a step's plan, as every `Step` does."""
        problem, found = self._subproblem.problem, self._subproblem.violations(reference)
        worst = found.worst
        if found.is_small and worst < _AGAIN * self._too_much:
            try:
                return self._subproblem.around(reference)
            except (InfeasibleError, SolverError):  # not yet
                self._too_much = worst
        motion, rounds = reference.motion(), number // 2
        rounds += 1 if found.is_of_pairs_only else _ROUNDS_AMONG_OBSTACLES
        constraints = list(problem.convex) if self._limits is None else self._limits(penalty)
        for each in problem.obstacles_around(motion):
            soft = dataclasses.replace(each.softened(penalty), rounds=rounds, searches=1)
            constraints.append(each if found.is_of_pairs_only else soft)
        if problem.scenario.separation is not None:
            pairs = problem.pairs_around(
                motion,
                self._subproblem.coupling,
                penalty=penalty,
                one_normal=number == 0,
                of=found.vehicles,
            )
            constraints.append(dataclasses.replace(pairs, rounds=rounds))
        return self._subproblem.solved(reference, constraints, found.vehicles)


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
    """Return a plan that keeps all constraints, from a motion that need not.

    The penalty grows from one linearisation to the next. Of a pair each vehicle yields half, so
    that all are planned side by side.

    Args:
        subproblem: decoupled.
        plan: where to begin; its positions may be dynamically inconsistent.
        step: one step; `SoftRows` of the subproblem if not given.
        offset: steps that count as taken before the first.
        most: bound on the penalties.
        progress: called after each linearisation.
        follow: the next reference, as long as a plan violates much; the plan itself if not given.
        dead_ends: of other restorations: one that comes near them is given up. If this one ends
            without a plan, it is added.

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
    """Return the last plan of a restoration, which may still violate something.

    Args are those of `restore_feasibility`.
    """
    patience, spent, reference = Patience(subproblem, dead_ends), plan.statistics, plan
    first = _first_penalty(subproblem, plan)
    for number in range(offset, offset + most):
        if subproblem.holds(plan):
            break
        check_time()
        try:
            after = _stepped(step, reference, first * min(GROWTH**number, step.steepest), number)
        except (InfeasibleError, SolverError):  # by rounding, where there is no slack at all
            break
        spent += after.statistics
        if progress is not None:
            progress(_in_words(subproblem, after, spent.linearisations))
        far = follow is not None and not subproblem.violations(after).is_small
        plan, reference = after, follow(reference, after) if follow and far else after
        if patience.ends(after):
            break
    return plan.with_statistics(
        dataclasses.replace(spent, converged=True, cut=False, last_fall=None, tolerance=1.0)
    )


def _stepped(step: Step, reference: Plan, penalty: float, number: int) -> Plan:
    """Return a step's plan, at a penalty that is less by as much as solvers ask for.

    Raises:
        InfeasibleError: the constraints without any obstacle or pair cannot be met.
        SolverError: the solvers fail numerically at lower penalties too.
    """
    spent = Statistics()
    for back in range(_BACK):
        try:
            after = step(reference, penalty / GROWTH**back, max(number - back, 0))
        except SolverError as error:
            spent += error.statistics
            failure = SolverError(str(error), spent)
        else:
            return after.with_statistics(spent + after.statistics)
    raise failure


def _in_words(subproblem: Subproblem, plan: Plan, linearisations: int) -> str:
    """Return what is told after each linearisation."""
    found, words = subproblem.violations(plan), in_words(linearisations, plan.cost)
    if found.worst == 0.0:
        return words
    return f"{words}, worst violation {found.worst:.3g} m, {len(found.vehicles)} vehicles violating"


def _first_penalty(subproblem: Subproblem, plan: Plan) -> float:
    """Return what a metre is worth at first: the cost of moving aside, and of the plan, a metre."""
    scenario, motion = subproblem.problem.scenario, subproblem.problem.effort.motion
    effort = float(np.sum(motion.accelerations**2))
    extent, T = least_extent(scenario), scenario.grid.duration
    aside = scenario.grid.knots * (4.0 * extent / T**2) ** 2
    first = (max(plan.cost, effort) / len(scenario.vehicles) + aside) / extent
    consistent = len(subproblem.violations(plan).inconsistent) == 0
    return first if consistent else _CLOSER * first
