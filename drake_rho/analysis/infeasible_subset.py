"""Irreducible infeasible subsets: constraints that cannot be met together, none to spare.

Every row may be broken at a cost, and the least violation is sought. By Farkas' lemma its
multipliers weigh constraints into a contradiction: those without a multiplier are not needed for
it. Of those that are left, one after the other is then tried without.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.errors import InfeasibleError, Names
from drake_rho.planning.problem import Problem, finest
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.planning.scp.minimum_violation import elastic, elastic_planes
from drake_rho.scenario.arguments import checked

_NO_PART = 1e-6
"""Multipliers below this part of the largest one count as zero."""


@checked
def infeasible_subset(
    error: InfeasibleError, *, solver: Solver | SolverName | None = None
) -> dict[str, Names]:
    """Narrow an error's conflicts down to constraints none of which can be spared.

    It solves a program for each constraint in a conflict. Conflicts with other vehicles, those of a
    single step, and a lack of room for the disturbance are told as they are.

    Args:
        error: as a planner raised it.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.

    Returns:
        For each vehicle without a plan names of constraints, with axes and times, that cannot be
        met together; obstacles as linearised around the error's reference.

    Raises:
        SolverError: the solvers fail numerically.
    """
    scenario, backend = error.scenario, Backend.of(solver)
    if scenario is None or error.bearable is not None:  # no room is no matter of a motion
        return error.conflicts
    problem = finest(scenario)  # as planners try last
    constraints = elastic(problem, problem.linearized(error.reference))
    unreachable = problem.effort.unreachable
    narrowed = {}
    for name, names in error.conflicts.items():
        vehicle = scenario.index_of(name)
        told = unreachable[vehicle] or 0 in error.obstacles.get(name, ())
        found = () if told else _irreducible(problem, vehicle, constraints, backend)
        narrowed[name] = found or names
    return narrowed


def _irreducible(
    problem: Problem,
    vehicle: int,
    constraints: Sequence[Constraint],
    backend: Backend,
) -> Names:
    """The subset of one vehicle, in words; empty if nothing is broken beyond its tolerance."""

    def contradiction(names: Iterable[str]) -> dict[str, HalfSpaces]:
        """Rows of the constraints of some names that cannot be met together; {} if all can."""
        planes = elastic_planes(problem, backend, [vehicle])
        kept = set(names)
        planes.keep_to([each for each in constraints if each.name in kept])
        return _contradiction(planes, vehicle)

    found = contradiction(each.name for each in constraints)
    for name in list(found):
        if name in found:
            found = contradiction(found.keys() - {name}) or found
    order = dict.fromkeys(each.name for each in constraints)
    names = [each.name for each in problem.scenario.vehicles]
    start = problem.scenario.grid.start
    chosen = (found[name] for name in order if name in found)
    return tuple(rows.constraint.describe(rows, names, start) for rows in chosen)


def _contradiction(planes: CuttingPlanes, vehicle: int) -> dict[str, HalfSpaces]:
    """By the name of their constraint, rows with a multiplier; {} if none has to be broken."""
    parts = planes.working.multipliers(vehicle)
    if not any(np.any(rows.margins(planes.motion) < -rows.tolerances) for rows, _ in parts):
        return {}
    largest = max(float(np.max(y)) for _, y in parts)
    weighed: dict[str, HalfSpaces] = {}
    for rows, y in parts:  # position and velocity of an axis of the goal share a name
        if np.any(taking_part := y > _NO_PART * largest):
            weighed.setdefault(rows.constraint.name, rows.select(taking_part))
    return weighed
