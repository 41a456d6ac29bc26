"""Sequential convex programming: the convex method iterated to convergence."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from contextlib import suppress
from functools import partial

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.plan import Plan
from drake_rho.planning.convex import plan_convex
from drake_rho.planning.detour import detour
from drake_rho.planning.errors import Conflicts, InfeasibleError, Names, SolverError
from drake_rho.planning.fleet import Apart, by_size, spread, too_close
from drake_rho.planning.loop import plan_around
from drake_rho.planning.separation import Coupling, by_halves, jointly
from drake_rho.scenario.records import Scenario

MAX_ITERATIONS = 200
"""Bound on the linearisations of one call; `statistics.converged` says if it was reached."""

CONVERGED = 1e-9
"""A vehicle's iteration stops when its part falls by less than this part of the whole index."""


CLOSE = 1e-3
"""The same for a fleet that keeps apart, where every iteration moves all of it: a further digit
takes as long as all before, and changes the index in the fourth."""

CLOSE_IF_SMALL = 1e-7
"""The same for a few vehicles, which are quick and can be certified."""

CLOSE_BY_HALVES = 5e-2
"""The same by halves, where the index falls ever more slowly to no optimum: what vehicles could
gain by trading room is left."""

_SMALL = 6
"""A few vehicles."""


def plan_scp(
    scenario: Scenario,
    *,
    reference: Plan | None = None,
    coupling: Coupling | None = None,
    solver: SolverInterface | None = None,
) -> Plan:
    """Linearise obstacles and pairs around one plan after the other until the index stops falling.

    The half-space of (15) lies inside what (8) allows, so every iterate meets the true
    constraints, and since it is itself allowed by the next linearisation, the index does not rise
    (in exact arithmetic). Neither a trust region nor a line search is needed. Where the first
    linearisation has no solution, the vehicles it fails are given ways round the obstacles
    (`drake_rho.planning.detour`), and fleets are spread (`drake_rho.planning.fleet`), to begin
    with.

    Args:
        scenario: what is asked.
        reference: a motion to linearise around at first, in place of the plan without obstacles.
        coupling: how pairs are kept apart: `by_halves`, every vehicle with a program of its own,
            or `jointly`, at the least index. If not given, jointly as long as the fleet is small
            (`drake_rho.planning.fleet.MOST_TOGETHER`).
        solver: a Drake solver; Clarabel if not given.

    Returns:
        A plan that meets every constraint of the scenario.

    Raises:
        InfeasibleError: a vehicle has no plan without the obstacles, or no way round was found.
        SolverError: the solvers fail numerically.
    """
    plan = first_plan(scenario, reference=reference, solver=solver)
    if scenario.separation is not None:
        return _converged_apart(plan, coupling, solver)
    if not scenario.obstacles:
        return plan
    return _converged(plan, solver)


def _converged(plan: Plan, solver: SolverInterface | None) -> Plan:
    """Iterate vehicles that nothing couples: each stops by itself."""
    scenario, falling = plan.scenario, np.arange(len(plan.scenario.vehicles))
    for _ in range(MAX_ITERATIONS):
        before = plan.only(falling)
        try:
            after = scp_step(before, solver=solver)
        except (InfeasibleError, SolverError):  # by rounding, where a plan has no room at all
            return _stopped(plan)
        fallen = np.sum(before.accelerations**2 - after.accelerations**2, axis=(1, 2))
        accelerations = np.array(plan.accelerations)
        accelerations[falling[fallen > 0.0]] = after.accelerations[fallen > 0.0]
        falling = falling[fallen > CONVERGED * plan.cost]
        statistics = dataclasses.replace(
            plan.statistics + after.statistics, converged=len(falling) == 0
        )
        plan = Plan.from_accelerations(scenario, accelerations, statistics)
        if statistics.converged:
            break
    return plan


def _converged_apart(plan: Plan, coupling: Coupling | None, solver: SolverInterface | None) -> Plan:
    """Iterate a fleet that keeps apart, all of it at once."""
    coupling = coupling or by_size(plan.scenario)
    close = CLOSE_IF_SMALL if len(plan.scenario.vehicles) <= _SMALL else CLOSE
    close = CLOSE_BY_HALVES if coupling is by_halves else close
    apart = Apart(plan.scenario, coupling, solver)
    for _ in range(MAX_ITERATIONS):
        try:
            after = apart.around(plan)
        except (InfeasibleError, SolverError):  # by rounding, where there is no room at all
            return _stopped(plan)
        fallen = plan.cost - after.cost
        statistics = plan.statistics + after.statistics
        plan = (after if fallen > 0.0 else plan).with_statistics(statistics)
        if fallen <= close * plan.cost:
            return plan.with_statistics(dataclasses.replace(statistics, converged=True))
    return _stopped(plan)


def first_plan(
    scenario: Scenario, *, reference: Plan | None = None, solver: SolverInterface | None = None
) -> Plan:
    """What `plan_scp` begins with: the convex method's plan or, where it has none, ways round.

    Args and errors are those of `plan_scp`.
    """
    if scenario.separation is not None:
        return _first_apart(scenario, reference, solver)
    try:
        return plan_convex(scenario, reference=reference, solver=solver)
    except InfeasibleError as error:
        if not error.about_linearisation:
            raise
        return _plan_round(scenario, error, solver)


def _first_apart(
    scenario: Scenario, reference: Plan | None, solver: SolverInterface | None
) -> Plan:
    """A first plan of a fleet: around the reference if that is apart, else spread from it."""
    if reference is not None and len(too_close(scenario, reference.motion())) == 0:
        with suppress(InfeasibleError, SolverError):
            return Apart(scenario, by_halves, solver).around(reference)
    alone = first_plan(scenario.without_separation(), reference=reference, solver=solver)
    plan = Plan.from_accelerations(scenario, alone.accelerations, alone.statistics)
    return spread(scenario, plan, solver)


def scp_step(plan: Plan, *, solver: SolverInterface | None = None) -> Plan:
    """One iteration: the plan of least index with obstacles linearised around `plan`.

    Pairs, if there is a separation, are linearised too, and kept apart jointly.
    """
    if plan.scenario.separation is not None:
        return Apart(plan.scenario, jointly, solver).around(plan)
    return plan_around(plan.scenario, plan, solver)


def _plan_round(
    scenario: Scenario, failure: InfeasibleError, solver: SolverInterface | None
) -> Plan:
    """A first plan where the first linearisation has none: detours for the vehicles it failed.

    Raises:
        InfeasibleError: for one of them no way round was found.
    """
    free = plan_around(scenario.without_obstacles(), None, solver)
    accelerations = np.array(free.accelerations)
    spent = failure.statistics + free.statistics
    conflicts: dict[str, Callable[[], Names]] = {}
    obstacles: dict[str, frozenset[str]] = {}
    for name in failure.conflicts:
        index = scenario.index_of(name)
        alone = dataclasses.replace(scenario, vehicles=(scenario.vehicles[index],))
        way = Plan.from_accelerations(alone, free.accelerations[index : index + 1])
        try:
            found = detour(alone, way, solver)
        except InfeasibleError as error:
            conflicts[name] = partial(error.conflicts.__getitem__, name)
            obstacles |= error.obstacles
            spent += error.statistics
        else:
            accelerations[index] = found.accelerations[0]
            spent += found.statistics
    if conflicts:
        raise InfeasibleError(
            Conflicts(conflicts), statistics=spent, scenario=scenario, obstacles=obstacles
        )
    plan = plan_around(scenario, Plan.from_accelerations(scenario, accelerations), solver)
    return plan.with_statistics(spent + plan.statistics)


def _stopped(plan: Plan) -> Plan:
    """The plan with a note that the iteration did not come to its own end."""
    statistics = dataclasses.replace(plan.statistics, converged=False)
    return plan.with_statistics(statistics)
