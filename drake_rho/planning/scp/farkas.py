"""Which constraints a program without a solution shows to contradict each other.

By Farkas' lemma there are weights y >= 0 of the rows M u >= b with M' y = 0, on the motions that
leave the goal where it is, and y · b > 0: the rows with a weight cannot be met together, nor
with those axes of the goal in which M' y does not vanish by itself.
"""

from __future__ import annotations

import numpy as np

from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.errors import Names
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.scp.working_set import WorkingSet
from drake_rho.scenario.fields import FloatArray

_NO_PART = 1e-4
"""Weights below this part of the largest one count as zero: they are known to some 1e-5 of it."""


def conflict_of(
    working: WorkingSet, effort: MinimumEffort, vehicle: int, names: list[str]
) -> Names:
    """Return axes of the goal and constraints, in words, that a vehicle cannot meet together.

    Where the solver gives no weights, all the rows in the program are named.

    Args:
        working: whose last program of the vehicle has no solution.
        effort: what it is written in.
        vehicle: its index.
        names: of all vehicles.
    """
    if effort.unreachable[vehicle]:
        return "goal position", "goal velocity", "a single step"
    parts, told = working.multipliers(vehicle), list[str]()
    largest = max((float(np.max(y)) for _, y in parts), default=0.0)
    weighted = [
        (rows, np.where(y > _NO_PART * largest, y, 0.0) if largest > 0.0 else np.ones(len(y)))
        for rows, y in parts
    ]
    for rows, y in weighted:
        own = rows.select((y > 0.0) & (rows.vehicles == vehicle))
        if len(own) > 0:
            told.append(rows.constraint.describe(own, names, effort.grid.start))
    pull = np.zeros((effort.grid.knots - 1, 3))
    for rows, y in weighted:
        pull += _pull(effort, vehicle, rows, y)
    return (*_axes(effort, pull), *told)


def _pull(effort: MinimumEffort, vehicle: int, rows: HalfSpaces, y: FloatArray) -> FloatArray:
    """Return M' y of one vehicle's accelerations, from rows of length one, shape (K-1, 3)."""
    signs = (rows.vehicles == vehicle).astype(float)
    if rows.constraint.coupled:
        signs -= rows.partners == vehicle
    weights = signs * y
    own = rows.select(weights != 0.0)
    responses = own.responses(effort.grid)
    weights = weights[weights != 0.0] / np.linalg.norm(responses, axis=1)
    weights /= np.sqrt(2.0) if rows.constraint.coupled else 1.0
    pull: FloatArray = responses.T @ (weights[:, None] * own.normals)
    return pull


def _axes(effort: MinimumEffort, pull: FloatArray) -> list[str]:
    """Return the axes of the goal that M' y needs to vanish."""
    sizes = np.linalg.norm(effort.goals.rows @ pull, axis=0)
    least = _NO_PART * np.abs(pull).max()
    return [f"goal {axis}" for axis, size in zip("xyz", sizes, strict=True) if size > least]


def in_the_way(working: WorkingSet, vehicle: int) -> frozenset[int]:
    """Return the numbers of obstacles that a vehicle's rows are about; 0 for other vehicles."""
    found = (
        rows.constraint.obstacle_number
        for rows in working.rows.values()
        if np.any(rows.vehicles == vehicle)
    )
    return frozenset(number for number in found if number is not None)
