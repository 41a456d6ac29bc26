"""Which constraints of a vehicle without a plan cannot be met together.

In the elastic program every row may give way at a price and the least total is sought. By Farkas'
lemma its multipliers weigh constraints into a contradiction: those without a multiplier are not
needed for it. Of those that are left, one after the other is then tried without: what remains is
a conflict from which no constraint can be spared.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import csc_matrix, hstack, identity

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.errors import SolverError
from drake_rho.planning.halfspaces import BoolArray, HalfSpaces
from drake_rho.planning.program import VehicleProgram, rows_of
from drake_rho.planning.solve import solve
from drake_rho.scenario.fields import FloatArray

_NO_PART = 1e-6
"""Multipliers below this part of the largest one count as zero."""

_MET = 1e-7
"""Rows are of length one and accelerations of the order of one: if they give way by less than
this in total they count as met."""

_ROUNDS = 40
"""Bound on the rounds of one trial; each adds rows, soon whole neighbourhoods of them."""

_BOX = "acceleration box"


@dataclasses.dataclass
class _Rows:
    """A constraint, and which of its rows have been needed so far."""

    all: HalfSpaces
    present: BoolArray


@dataclasses.dataclass(frozen=True)
class _Elastic:
    """Solution of an elastic program."""

    total: float
    """by how much its rows give way"""
    weights: dict[str, FloatArray]
    """multipliers of each constraint that takes part, of its present rows"""
    motion: Motion
    """the motion that breaks them least"""


def conflict(
    of: VehicleProgram, constraints: Sequence[HalfSpaces], present: Sequence[BoolArray]
) -> tuple[str, ...]:
    """Names of constraints, with axes and times, that cannot be met together.

    Args:
        of: a program without a solution.
        constraints: everything the vehicle has to keep to beside its goal and acceleration box.
        present: which rows of each constraint are in the program.

    Raises:
        SolverError: an elastic program cannot be solved.
    """
    rows = {
        each.name: _Rows(each, mask.copy()) for each, mask in zip(constraints, present, strict=True)
    }
    box = [] if of.acceleration_box is None else [_BOX]
    names = [*(f"goal {axis}" for axis in "xyz"), *box, *rows]
    kept = [name for name in names if name in _solve_elastic(of, names, rows).weights]
    for name in list(kept):
        without = [other for other in kept if other != name]
        if _cannot_be_met(of, without, rows):
            kept = without
    weights = _solve_elastic(of, kept, rows).weights
    return tuple(_describe(name, weights[name], rows) for name in kept if name in weights)


def least_breach(
    of: VehicleProgram, constraints: Sequence[HalfSpaces], present: Sequence[BoolArray]
) -> Motion:
    """The motion that breaks goal and constraints least in total, each in its own scale.

    Args:
        of: a program, with or without a solution.
        constraints: as for `conflict`.
        present: as for `conflict`.

    Raises:
        SolverError: an elastic program cannot be solved.
    """
    masks = zip(constraints, present, strict=True)
    rows = {each.name: _Rows(each, mask.copy()) for each, mask in masks}
    box = [] if of.acceleration_box is None else [_BOX]
    names = [*(f"goal {axis}" for axis in "xyz"), *box, *rows]
    for number in range(_ROUNDS):
        elastic = _solve_elastic(of, names, rows)
        if not _add_needed(list(rows.values()), elastic.motion, number):
            break
    return elastic.motion


def _add_needed(each_of: Sequence[_Rows], motion: Motion, number: int) -> bool:
    """Make the rows present that the motion breaks, and their neighbours; False if none."""
    found = False
    for each in each_of:
        broken = ~each.present & (each.all.margins(motion) < -each.all.tolerances)
        if np.any(broken):
            each.present |= each.all.near(broken, 2**number)
            found = True
    return found


def _cannot_be_met(of: VehicleProgram, names: Sequence[str], rows: dict[str, _Rows]) -> bool:
    """Whether the constraints `names` contradict each other, with all their rows.

    Rows that are found to be needed become present.
    """
    for number in range(_ROUNDS):
        elastic = _solve_elastic(of, names, rows)
        if elastic.total > _MET:
            return True
        needed = [rows[name] for name in names if name in rows]
        if not _add_needed(needed, elastic.motion, number):
            return False
    raise SolverError(f"a conflict could not be narrowed down in {_ROUNDS} rounds")


def _solve_elastic(of: VehicleProgram, names: Sequence[str], rows: dict[str, _Rows]) -> _Elastic:
    """Break the present rows of the constraints `names` as little as possible."""
    elastic = MathematicalProgram()
    variables = of.accelerations.reshape(-1)
    elastic.AddDecisionVariables(variables)
    bindings = {}
    for axis, goal in zip("xyz", of.goal, strict=True):
        if f"goal {axis}" in names:
            equality = goal.evaluator()
            bindings[f"goal {axis}"] = _add_elastic(
                elastic,
                equality.get_sparse_A(),
                equality.lower_bound(),
                goal.variables(),
                both_ways=True,
            )
    for name in names:
        if name in rows and np.any(rows[name].present):
            matrix, lower = rows_of(of, rows[name].all.select(rows[name].present))
            bindings[name] = _add_elastic(elastic, matrix, lower, variables, both_ways=False)
    if _BOX in names:  # can always be met, so it stays hard
        bindings[_BOX] = elastic.AddConstraint(of.acceleration_box)
    (solution,) = solve([elastic])
    multipliers = {
        name: np.abs(solution.result.GetDualSolution(binding)) for name, binding in bindings.items()
    }
    least = _NO_PART * max((float(np.max(each)) for each in multipliers.values()), default=0.0)
    weights = {
        name: np.where(each > least, each, 0.0)
        for name, each in multipliers.items()
        if np.any(each > least)
    }
    accelerations = of.unit * solution.result.GetSolution(of.accelerations).reshape(-1, 3)
    motion = Motion.from_start(of.vehicle.start, accelerations, of.grid.step)
    return _Elastic(float(solution.result.get_optimal_cost()), weights, motion)


def _add_elastic(
    elastic: MathematicalProgram,
    matrix: csc_matrix,
    lower: FloatArray,
    variables: np.ndarray,
    *,
    both_ways: bool,
) -> object:
    """Rows matrix @ variables >= (or, both ways, ==) lower that may give way, at that cost."""
    size = len(lower)
    ways = [identity(size), -identity(size)] if both_ways else [identity(size)]
    give = elastic.NewContinuousVariables(size * len(ways), "give")
    elastic.AddBoundingBoxConstraint(0.0, np.inf, give)
    elastic.AddLinearCost(np.ones(give.size), give)
    return elastic.AddLinearConstraint(
        hstack([matrix, *ways], format="csc"),
        lower,
        lower if both_ways else np.full(size, np.inf),
        np.concatenate([variables, give]),
    )


def _describe(name: str, weights: FloatArray, rows: dict[str, _Rows]) -> str:
    """One constraint by its name, with the axes of its sides if it is a box, and its times."""
    if name == _BOX:
        return f"{name} {_axes(np.any(weights.reshape(-1, 3), axis=0))}"
    if name not in rows:  # an axis of the goal
        return name
    part = rows[name].all.select(rows[name].present).select(weights > 0)
    sides = f" {_axes(np.any(part.normals, axis=0))}" if part.sides > 1 else ""
    first, last = part.times.min(), part.times.max()
    when = f"at {first:g} s" if first == last else f"from {first:g} s to {last:g} s"
    return f"{name}{sides} {when}"


def _axes(mask: BoolArray) -> str:
    return "/".join(axis for axis, taken in zip("xyz", mask, strict=True) if taken)
