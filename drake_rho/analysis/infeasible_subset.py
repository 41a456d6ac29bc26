"""Irreducible infeasible subsets: conflicting constraints, feasible if any one is dropped.

An elastic program finds the least violation. By Farkas' lemma its multipliers combine the
constraints into a contradiction: constraints with zero multipliers are not needed for it. Each of
the remaining constraints is then dropped in turn, and stays dropped if the others still conflict.
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
from drake_rho.system.threads import single_threaded_blas

_NEGLIGIBLE = 1e-6
"""Fraction of the largest multiplier below which a multiplier counts as zero."""


@checked
@single_threaded_blas
def infeasible_subset(
    error: InfeasibleError, *, solver: Solver | SolverName | None = None
) -> dict[str, Names]:
    """Narrow an error's conflicts down to irreducible sets of constraints.

    This solves a program for each constraint in a conflict. Conflicts with other vehicles, of a
    single step, or with constraints that cannot be tightened enough for the disturbance are
    returned as they are.

    Args:
        error: the error that a planner raised.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.

    Returns:
        For each vehicle without a plan, the names of constraints, with axes and times, that cannot
        be met together. Obstacles count as linearised around the error's reference.

    Raises:
        SolverError: the solvers fail numerically.
    """
    scenario, backend = error.scenario, Backend.of(solver)
    if scenario is None or error.bearable is not None:  # tightening fails for every motion
        return error.conflicts
    problem = finest(scenario)  # as planners try last
    constraints = elastic(problem, problem.linearized(error.reference))
    unreachable = problem.effort.unreachable
    narrowed = {}
    for name, names in error.conflicts.items():
        vehicle = scenario.index_of(name)
        final = unreachable[vehicle] or 0 in error.obstacles.get(name, ())
        found = () if final else _irreducible(problem, vehicle, constraints, backend)
        narrowed[name] = found or names
    return narrowed


def _irreducible(
    problem: Problem,
    vehicle: int,
    constraints: Sequence[Constraint],
    backend: Backend,
) -> Names:
    """Return descriptions of one vehicle's subset; empty if all violations are tolerable."""

    def contradiction(names: Iterable[str]) -> dict[str, HalfSpaces]:
        """Return conflicting rows of the constraints with these names; {} if there is none."""
        planes = elastic_planes(problem, backend, problem.with_linked(np.array([vehicle])))
        wanted = set(names)
        planes.keep_to([each for each in constraints if each.name in wanted])
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
    """Return rows with a positive multiplier by their constraint's name; {} without violations."""
    parts = planes.working.multipliers(vehicle)
    if not any(np.any(rows.margins(planes.motion) < -rows.tolerances) for rows, _ in parts):
        return {}
    largest = max(float(np.max(y)) for _, y in parts)
    weighed: dict[str, HalfSpaces] = {}
    for rows, y in parts:  # position and velocity of an axis of the goal share a name
        if np.any(taking_part := y > _NEGLIGIBLE * largest):
            weighed.setdefault(rows.constraint.name, rows.select(taking_part))
    return weighed
