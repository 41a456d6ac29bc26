"""Row generation for programs with a free final time: violated and nearly active rows.

Solutions are motions in the final time that the program is linearised around, but limits apply in
the new final time: positions, velocities and accelerations are scaled by powers of its change.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces
from drake_rho.planning.constraints.boxes import QUANTITIES
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.free_times import FreeTime, Passing, bound_rates, powers
from drake_rho.scenario.parts import Quantity

_NEAR = 0.1
"""Largest margin of a nearly active row, as a fraction of the quantity's scale."""


def violated_rows(
    constraints: Sequence[Constraint],
    found: FreeTime,
    problem: Problem,
    passing: Passing,
    reference: Motion,
) -> list[HalfSpaces]:
    """Return the rows that a solution violates at the knots or, if there are none, between them.

    Args:
        constraints: constraints around the reference.
        found: solution of the program.
        problem: problem of the program.
        passing: the waypoints.
        reference: motion that the program is linearised around.
    """
    motions = {each: _in_its_time(found, problem, each) for each in QUANTITIES}
    every = np.arange(len(problem))
    gates = _at_gates(found, problem)
    constraints = [_shifted(each, found, problem, passing, reference) for each in constraints]
    for between in (False, True):
        rows = [
            each.violated_rows(
                gates if each.is_gate else motions[each.quantity], every, between=between
            )
            for each in constraints
            if not between or each.searches > 0
        ]
        if more := [rest for each in rows if len(rest := _still_violated(each, found, problem))]:
            return more
    return []


def _shifted(
    constraint: Constraint, found: FreeTime, problem: Problem, passing: Passing, reference: Motion
) -> Constraint:
    """Return a constraint with the values at the changed times of waypoints, to first order."""
    if not (constraint.moves and isinstance(constraint, KeepInSets)) or len(passing) == 0:
        return constraint
    at, rates = passing.rates_at(constraint, reference)
    divisor = _divisor(constraint, found, problem)
    return dataclasses.replace(constraint, shift=found.changes[at][:, None] * rates / divisor)


def _divisor(constraint: Constraint, found: FreeTime, problem: Problem) -> float:
    """Return what values are divided by in the final time of a solution.

    Velocities at waypoints are divided by the root of y as linearised in the program, so that both
    sides of a single value agree.
    """
    if constraint.is_gate:
        return float((1.0 + found.factor) / 2.0)
    return float(found.factor ** powers(problem.scenario)[constraint.quantity])


def _at_gates(found: FreeTime, problem: Problem) -> Motion:
    """Return a solution as a motion with the program's step, scaled for velocities at waypoints."""
    motion, root = _in_its_time(found, problem, "position"), (1.0 + found.factor) / 2.0
    return dataclasses.replace(
        motion, velocities=motion.velocities / root, accelerations=motion.accelerations / root
    )


def _still_violated(rows: HalfSpaces, found: FreeTime, problem: Problem) -> HalfSpaces:
    """Return the rows that are still violated with obstacles and tracks at the solution's times.

    Args:
        rows: rows that a solution violates with obstacles at the program's times.
        found: solution of the program.
        problem: problem of the program.
    """
    later = bound_rates(rows) * (found.factor - 1.0)
    if not later.any():
        return rows
    margins = rows.margins(_in_its_time(found, problem, rows.constraint.quantity)) - later
    return rows.select(margins < -VIOLATED * rows.tolerances)


def near_rows(rows: Iterable[HalfSpaces], found: FreeTime, problem: Problem) -> list[HalfSpaces]:
    """Return the nearly active rows of a solution, for the next program."""
    near = list[HalfSpaces]()
    for each in rows:
        if each.constraint.moves:  # to other instants
            continue
        quantity = each.constraint.quantity
        margins = each.margins(_in_its_time(found, problem, quantity))
        scale = problem.scenario.fleet.scale(quantity)[each.vehicles]
        near.append(each.select(margins < _NEAR * scale))
    return [each for each in near if len(each) > 0]


def _in_its_time(found: FreeTime, problem: Problem, quantity: Quantity) -> Motion:
    """Return a solution as a motion with the program's step, scaled for limits of a quantity.

    Args:
        found: solution of the program.
        problem: problem of the program.
        quantity: the quantity that the limits are of.
    """
    divisor = found.factor ** powers(problem.scenario)[quantity]
    fleet, step = problem.scenario.fleet, problem.scenario.grid.step
    velocities = (1.0 + found.factor) / 2.0 * fleet.start_velocities  # linearised in y
    p, v = roll_out(fleet.start_positions, velocities, found.accelerations, step)
    outside = fleet.accelerations_before, fleet.accelerations_after
    ends = (each * found.factor / divisor for each in outside)
    return Motion(step, p, v / divisor, found.accelerations / divisor, *ends)
