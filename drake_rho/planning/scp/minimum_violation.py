"""Motions of minimum violation, for scenarios without a plan."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.goals import goals_of
from drake_rho.planning.constraints.separation import decoupled
from drake_rho.planning.constraints.tightening import has_room_for, starts_beyond_limits
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.restoration import SoftRows, least_violating
from drake_rho.planning.scp.subproblem import Subproblem
from drake_rho.scenario.fields import IntArray


def minimum_violation(problem: Problem, backend: Backend | None = None) -> Plan:
    """Return the plan with the least total violation of goals and constraints, each scaled.

    Acceleration boxes stay hard if margins leave them feasible, as they can then always be met.
    The separation of pairs is omitted. Obstacles are linearised around the plan of minimum
    violation without them.

    Args:
        problem: the problem to solve.
        backend: the solver and its settings; Clarabel if not given.

    Raises:
        SolverError: the solvers fail numerically.
    """
    plan = _least_around(problem, None, backend)
    if not problem.scenario.avoided:
        return plan
    with suppress(SolverError):
        check_time()
        after = _least_around(problem, plan, backend)
        return after.with_statistics(plan.statistics + after.statistics)
    return plan


def _least_around(problem: Problem, reference: Plan | None, backend: Backend | None) -> Plan:
    """Return the plan of minimum violation with obstacles linearised around a reference, if any."""
    planes = elastic_planes(problem, backend)
    planes.keep_to(elastic(problem, problem.linearized(reference)))
    if reference is None:
        motion = problem.effort.motion
        positions, velocities = motion.positions, motion.velocities
        reference = Plan(problem.scenario, positions, velocities, motion.accelerations)
    return planes.plan(reference)


def minimum_distance_violation(plan: Plan, backend: Backend | None = None) -> Plan:
    """Return a plan within goals and limits that violates distances as little as possible.

    Successive linearisations reduce the total violation over obstacles, pairs and instants, and of
    requirements. For vehicles that begin beyond limits of position or velocity, these are soft too.

    Args:
        plan: a motion that satisfies goals and limits.
        backend: the solver and its settings; Clarabel if not given.

    Raises:
        InfeasibleError: the motion found violates hard limits.
    """
    subproblem = Subproblem(Problem.of(plan.scenario), decoupled, backend)
    problem = subproblem.problem

    def limits(penalty: float) -> list[Constraint]:
        beyond = starts_beyond_limits(problem.scenario, problem.margins)
        soft = ("position", "velocity") if beyond else ()
        own = [*problem.boxes, *problem.norms_and_waypoints]
        return [
            *(each.softened(penalty) if each.quantity in soft else each for each in own),
            *(each.softened(penalty) for each in problem.requirements),
        ]

    step = SoftRows(subproblem, limits)
    # penalties beyond the first few do not reduce violations, and make other constraints less exact
    found = least_violating(subproblem, plan, step, most=8)
    if not subproblem.holds(found) and (violated := _violated_limits(found, limits(1.0))):
        raise InfeasibleError(violated, statistics=found.statistics)
    return found


def _violated_limits(plan: Plan, limits: Sequence[Constraint]) -> dict[str, tuple[str, ...]]:
    """Return the names of the hard limits that a plan violates, for each vehicle by name."""
    motion, everyone = plan.motion(), np.arange(len(plan.accelerations))
    violated: dict[str, tuple[str, ...]] = {}
    for limit in limits:
        if limit.soft:
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
    """Return the goals and some constraints, softened with penalties scaled by quantity.

    The scale of a quantity is the largest of all vehicles. Penalties have the programs' unit: in
    another, solvers would take large violations for none. Acceleration boxes stay hard if
    margins leave them feasible. Other sets of accelerations are soft: a requirement may contradict
    the boxes, and tangent planes converge slowly where only violations have a cost. Soft limits of
    the scenario are left out.
    """
    hard = "acceleration" if has_room_for(problem.scenario, problem.margins, "acceleration") else ""
    fleet = problem.scenario.fleet
    unit = float(fleet.units_of_violations.max())
    return [
        each
        if each.kind == hard
        else each.softened(penalty * unit**2 / float(fleet.scale(each.quantity).max()))
        for each in [*goals_of(problem.scenario), *constraints]
        if each.prices is None
    ]


def elastic_planes(
    problem: Problem, backend: Backend | None = None, vehicles: IntArray | None = None
) -> CuttingPlanes:
    """Return programs in which only violations have a cost, and goals may be missed."""
    return CuttingPlanes(
        problem.of_violations(),
        backend,
        vehicles=vehicles,
        accelerations=problem.effort.motion.accelerations,
    )
