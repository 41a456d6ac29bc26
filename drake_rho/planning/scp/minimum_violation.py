"""The motions that violate a scenario least, where it has no plan."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.coupling import decoupled
from drake_rho.planning.constraints.goals import goals_of
from drake_rho.planning.constraints.tightening import starts_beyond_limits
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.restoration import SoftRows, least_violating
from drake_rho.planning.scp.subproblem import Subproblem

_PENALTIES = 8
"""Penalties after which what is still too close stays so. Larger ones make it no smaller, and other
constraints less exact."""


def minimum_violation(problem: Problem, backend: Backend | None = None) -> Plan:
    """Return the plan that violates goals and constraints least in total, each in its own scale.

    Acceleration boxes are kept, since they can always be met by themselves, and pairs are left out.
    Obstacles are linearised around the plan that violates the rest least.

    Args:
        problem: to be solved.
        backend: Clarabel if not given.

    Raises:
        SolverError: the solvers fail numerically.
    """
    plan = _least_around(problem, None, backend)
    if not problem.scenario.known:
        return plan
    with suppress(SolverError):
        check_time()
        after = _least_around(problem, plan, backend)
        return after.with_statistics(plan.statistics + after.statistics)
    return plan


def _least_around(problem: Problem, reference: Plan | None, backend: Backend | None) -> Plan:
    """Return the minimum violation with obstacles linearised around a reference, if any."""
    planes = elastic_planes(problem, backend)
    planes.keep_to(elastic(problem, problem.linearized(reference)))
    if reference is None:
        motion = problem.effort.motion
        positions, velocities = motion.positions, motion.velocities
        reference = Plan(problem.scenario, positions, velocities, motion.accelerations)
    return planes.plan(reference)


def minimum_distance_violation(plan: Plan, backend: Backend | None = None) -> Plan:
    """Return a plan that keeps goals and limits, and violates distances as little as can be.

    The total over obstacles, pairs and instants is made small, linearised again and again. Vehicles
    that begin beyond limits of position or velocity come back at a penalty.

    Args:
        plan: a motion that keeps goals and limits.
        backend: Clarabel if not given.

    Raises:
        InfeasibleError: the motion violates limits, and no other was found.
    """
    subproblem = Subproblem(Problem.of(plan.scenario), decoupled, backend)
    problem = subproblem.problem

    def limits(penalty: float) -> list[Constraint]:
        if not starts_beyond_limits(problem.scenario, problem.margins):
            return list(problem.convex)
        return [
            each.softened(penalty) if each.quantity in ("position", "velocity") else each
            for each in problem.convex
        ]

    step = SoftRows(subproblem, limits)
    found = least_violating(subproblem, plan, step, most=_PENALTIES)
    if not subproblem.holds(found) and (violated := _violated_limits(found, limits(1.0))):
        raise InfeasibleError(violated, statistics=found.statistics)
    return found


def _violated_limits(plan: Plan, limits: Sequence[Constraint]) -> dict[str, tuple[str, ...]]:
    """Return by vehicle the names of hard limits that a plan violates."""
    motion, everyone = plan.motion(), np.arange(len(plan.accelerations))
    violated: dict[str, tuple[str, ...]] = {}
    for limit in limits:
        if np.isfinite(limit.penalty):
            continue
        rows = limit.violated_rows(motion, everyone)
        rows = rows.select(rows.margins(motion) < -rows.tolerances)
        for vehicle in np.unique(rows.vehicles):
            name = plan.scenario.vehicles[vehicle].name
            violated[name] = (*violated.get(name, ()), limit.name)
    return violated


def elastic(
    problem: Problem, constraints: Sequence[Constraint], penalty: float = 1.0
) -> list[Constraint]:
    """Return the goals and some constraints, to be violated at a penalty in each quantity's scale.

    The scale is the largest of the vehicles'. Acceleration boxes remain as they are; curved sets
    of accelerations do not, since tangent planes would come to an end late where nothing but
    violations costs anything.
    """
    fleet = problem.scenario.fleet
    unit = float(fleet.scale("acceleration").max())
    return [
        each
        if each.quantity == "acceleration" and not each.curved
        else each.softened(penalty * unit**2 / float(fleet.scale(each.quantity).max()))
        for each in [*goals_of(problem.scenario), *constraints]
    ]


def elastic_planes(
    problem: Problem, backend: Backend | None = None, vehicles: Sequence[int] | None = None
) -> CuttingPlanes:
    """Return programs in which only violations cost anything, and goals may be missed."""
    return CuttingPlanes(
        problem.of_violations(),
        backend,
        vehicles=None if vehicles is None else np.array(vehicles),
        accelerations=problem.effort.motion.accelerations,
    )
