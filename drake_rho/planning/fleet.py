"""Plans of vehicles that keep apart: the rows of pairs, and a first plan that is separated."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.pairs import Meetings, at_knots, closest
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints import WORST
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.loop import Programs, constraints_around
from drake_rho.planning.separation import Coupling, by_halves, directions, jointly, listed
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import Scenario

MOST_TOGETHER = 30
"""Vehicles up to which a fleet is planned jointly."""

NEAR = 1.6
"""Pairs within so many times the separation, in the reference, get rows from the start."""

ALMOST = 0.95
"""Part of the separation from which on the rows of a first plan are tried as hard ones."""

MAX_SPREADS = 60
"""Bound on the iterations towards a first plan."""


def meetings_of(scenario: Scenario, motion: Motion, within: float) -> Meetings:
    """Pairs closer than `within` [m]: at the knots or, if that is asked, at any instant."""
    separation = _separation(scenario)
    if scenario.between_knots:
        return closest(motion, separation, within)
    return at_knots(motion, separation, within)


def too_close(scenario: Scenario, motion: Motion) -> Meetings:
    """Pairs that break their separation."""
    separation = _separation(scenario)
    return meetings_of(scenario, motion, separation.distance - WORST * separation.tolerance)


def plan_apart(
    scenario: Scenario,
    reference: Plan,
    coupling: Coupling = by_halves,
    solver: SolverInterface | None = None,
    *,
    price: float = np.inf,
    aside: bool = False,
) -> Plan:
    """The plan of least index with obstacles and pairs linearised around `reference`.

    Args:
        scenario: with a separation.
        reference: a motion of the same vehicles on the same grid.
        coupling: how the rows of pairs are written.
        solver: a Drake solver; Clarabel if not given.
        price: what the index may rise for each metre that a pair is too close.
        aside: whether close encounters of the reference get one direction each.

    Raises:
        InfeasibleError: there is none.
        SolverError: the solvers fail numerically.
    """
    separation, motion = _separation(scenario), reference.motion()
    programs = Programs(scenario, together=coupling is jointly)
    constraints = constraints_around(scenario, reference)

    def rows_at(where: Meetings) -> None:
        n = directions(separation, motion, where, aside=aside)
        constraints.append(listed(coupling(separation, motion, where, n, price)))

    near = at_knots(motion, separation, NEAR * separation.distance)
    rows_at(near.and_also(meetings_of(scenario, motion, separation.distance)))
    while True:
        programs.keep_to(constraints, solver)
        if np.isfinite(price):
            return programs.plan(reference)
        plan = programs.plan(reference)
        broken = too_close(scenario, plan.motion())
        if len(broken) == 0:
            return plan
        rows_at(broken)


def spread(scenario: Scenario, plan: Plan, solver: SolverInterface | None = None) -> Plan:
    """A plan whose vehicles keep apart, from one that need not.

    Every pair's rows may give way at a price, which doubles from one linearisation to the next
    until none of them does. Each vehicle yields half, so all are planned side by side.

    Raises:
        InfeasibleError: none was found.
    """
    spent = plan.statistics
    price = _first_price(scenario, plan)
    for number in range(MAX_SPREADS):
        broken = too_close(scenario, plan.motion())
        if len(broken) == 0:
            return plan.with_statistics(spent)
        if broken.distances.min() > ALMOST * _separation(scenario).distance:
            with suppress(InfeasibleError, SolverError):
                found = plan_apart(scenario, plan, by_halves, solver)
                return found.with_statistics(spent + found.statistics)
        plan = plan_apart(scenario, plan, by_halves, solver, price=price, aside=number == 0)
        spent += plan.statistics
        price *= 2.0
    raise InfeasibleError({}, statistics=spent, scenario=scenario)


def _first_price(scenario: Scenario, plan: Plan) -> float:
    """What a metre is worth at first: the index of moving aside, and that of the plan, a metre."""
    separation, T = _separation(scenario), scenario.grid.duration
    aside = scenario.grid.knots * (4.0 * separation.distance / T**2) ** 2
    return (plan.cost / len(scenario.vehicles) + aside) / separation.distance


def _separation(scenario: Scenario) -> Separation:
    if scenario.separation is None:
        raise ValueError("scenario: got one without a separation, expected one with it")
    return scenario.separation
