"""Farkas certificates: the contradicting constraints of an infeasible program.

By Farkas' lemma the rows M u >= b of an infeasible program have weights y >= 0 with y · b > 0, for
which M' y vanishes on all motions that leave the goal unchanged. The rows of positive weight
contradict each other and the axes of the goal along which M' y does not vanish by itself.
"""

from __future__ import annotations

import numpy as np

from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.errors import Names
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.scp.working_set import WorkingSet
from drake_rho.scenario.fields import FloatArray

_NEGLIGIBLE = 1e-4
"""Fraction of the largest weight below which a weight counts as zero. Solvers are accurate to some
1e-5 of the largest."""


def conflict_of(
    working: WorkingSet, effort: MinimumEffort, vehicle: int, names: list[str]
) -> Names:
    """Return descriptions of the goal axes and constraints that a vehicle cannot meet together.

    If the solver returns no weights, the description covers all rows of the program.

    Args:
        working: the working set in which the last program of the vehicle is infeasible.
        effort: the minimum-effort motions from which the program's unknowns are measured.
        vehicle: the index of the vehicle.
        names: the names of all vehicles.
    """
    if effort.unreachable[vehicle]:
        return "goal position", "goal velocity", "a single step"
    parts, described = working.multipliers(vehicle), list[str]()
    largest = max((float(np.max(y)) for _, y in parts), default=0.0)
    weighted = [
        (rows, np.where(y > _NEGLIGIBLE * largest, y, 0.0) if largest > 0.0 else np.ones(len(y)))
        for rows, y in parts
    ]
    for rows, y in weighted:
        own = rows.select((y > 0.0) & (rows.vehicles == vehicle))
        if len(own) > 0:
            described.append(rows.constraint.describe(own, names, effort.grid.start))
    gradient = np.zeros((effort.grid.knots - 1, 3))
    for rows, y in weighted:
        gradient += _gradient(effort, vehicle, rows, y)
    return (*_axes(effort.goals.of(vehicle)[0], gradient), *described)


def _gradient(effort: MinimumEffort, vehicle: int, rows: HalfSpaces, y: FloatArray) -> FloatArray:
    """Return the dual gradient M' y of one vehicle, from rows of unit length, shape (K-1, 3)."""
    signs = (rows.vehicles == vehicle).astype(float)
    if rows.constraint.coupled:
        signs -= rows.partners == vehicle
    weights = signs * y
    own = rows.select(weights != 0.0)
    responses = own.responses(effort.grid)
    weights = weights[weights != 0.0] / effort.changes.lengths_of(
        responses, own.vehicles, own.partners if rows.constraint.coupled else None
    )
    weights *= effort.changes.factors[vehicle]
    gradient: FloatArray = responses.T @ (weights[:, None] * own.normals)
    return gradient


def _axes(goals: FloatArray, gradient: FloatArray) -> list[str]:
    """Return the axes along which M' y vanishes only if the goal, as rows, is held fixed."""
    sizes = np.linalg.norm(goals @ gradient, axis=0)
    least = _NEGLIGIBLE * np.abs(gradient).max()
    return [f"goal {axis}" for axis, size in zip("xyz", sizes, strict=True) if size > least]


def obstacles_in(working: WorkingSet, vehicle: int) -> frozenset[int]:
    """Return the numbers of the obstacles in the rows of a vehicle's program; 0 is other vehicles.

    Vehicles in one program have one conflict, which may include obstacles of any of them.
    """
    group = working.group(vehicle)
    found = (
        rows.constraint.obstacles
        for rows in working.rows.values()
        if not rows.soft and np.any(np.isin(rows.vehicles, group))
    )
    return frozenset[int]().union(*found)
