"""Least violations of a scenario without a plan, by vehicle and constraint."""

from __future__ import annotations

from contextlib import suppress

from drake_rho.motion.plan import Plan
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.minimum_violation import minimum_distance_violation, minimum_violation
from drake_rho.scenario.kinds import LIMITS
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, Check
from drake_rho.verification.verify import verify

_PAIR = "separation"

_SLIGHT = 1e-3
"""Relative excess of a limit up to which it counts as the solver's tolerance."""


def least_violations(
    scenario: Scenario, error: InfeasibleError, backend: Backend
) -> tuple[Check, ...]:
    """Return the violations of a motion with the least total violation, missed goals first.

    Each vehicle and constraint has its worst violation only; a pair of vehicles is named once.
    Separations count only if they are part of a conflict.

    Args:
        scenario: scenario without a plan.
        error: the planner's error.
        backend: solves the programs.
    """
    motion = minimum_violation(Problem.of(scenario), backend)
    violations = verify(motion).violations
    with_pairs = any(0 in numbers for numbers in error.obstacles.values())
    if with_pairs and all(each.kind == _PAIR for each in violations):
        violations = verify(_furthest_apart(motion, backend)).violations
    if not with_pairs:
        violations = tuple(each for each in violations if each.kind != _PAIR)
    return tuple(sorted(_worst(violations), key=lambda each: each.kind != "goals"))


def _furthest_apart(motion: Plan, backend: Backend) -> Plan:
    """Return a motion with smaller violations of distances, if one is found."""
    with suppress(InfeasibleError, SolverError):
        return minimum_distance_violation(motion, backend)
    return motion


def _worst(violations: tuple[Check, ...]) -> list[Check]:
    """Return the worst violation of each constraint of each vehicle, and of each pair."""
    worst = dict[tuple[object, ...], Check]()
    for each in violations:
        if each.kind in LIMITS and each.excess < _SLIGHT * abs(each.limit) and len(violations) > 1:
            continue
        key = (_members(each), each.constraint, each.unit)
        if key not in worst or each.badness > worst[key].badness:
            worst[key] = each
    return list(worst.values())


def _members(check: Check) -> frozenset[str]:
    """Return the names of a check's vehicles."""
    partner = partner_of(check)
    return frozenset([check.vehicle] if partner is None else [check.vehicle, partner])


def partner_of(check: Check) -> str | None:
    """Return the other vehicle of a pair that is too close; None for another check."""
    if check.kind != _PAIR:
        return None
    part = check.part.removeprefix("from ")
    return part.removesuffix(AT_KNOTS).removesuffix(AT_ALL_TIMES).rstrip()
