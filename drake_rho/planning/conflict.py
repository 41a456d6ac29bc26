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
from scipy.sparse import csc_array, csc_matrix, eye_array, hstack

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints import Constraint
from drake_rho.planning.errors import SolverError
from drake_rho.planning.frame import Frame
from drake_rho.planning.halfspaces import HalfSpaces, near
from drake_rho.planning.program import add_rows, rows_of
from drake_rho.planning.solve import solve
from drake_rho.scenario.fields import BoolArray, FloatArray

_NO_PART = 1e-6
"""Multipliers below this part of the largest one count as zero."""

_MET = 1e-7
"""Rows are of length one and accelerations of the order of one: if they give way by less than
this in total they count as met."""

_ROUNDS = 40
"""Bound on the rounds of one trial; each adds rows, soon whole neighbourhoods of them."""

_GOALS = ("goal x", "goal y", "goal z")

_HARD = "acceleration box"
"""Can always be met by itself, so it does not give way."""


@dataclasses.dataclass
class _Rows:
    """A constraint of one vehicle, and which of its rows have been needed so far."""

    all: HalfSpaces
    """those at the knots, side by side, and then those already in the vehicle's program"""
    present: BoolArray
    knots: int
    """rows at the knots"""
    sides: int

    def near(self, rows: BoolArray, reach: int) -> BoolArray:
        """The mask `rows` and, at the knots, neighbours of the same side up to `reach` away."""
        by_side = near(rows[: self.knots].reshape(-1, self.sides).T, reach).T
        return np.concatenate([by_side.reshape(-1), rows[self.knots :]])


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
    frame: Frame, vehicle: int, constraints: Sequence[Constraint], present: Sequence[HalfSpaces]
) -> tuple[str, ...]:
    """Names of constraints, with axes and times, that cannot be met together.

    Args:
        frame: of the scenario.
        vehicle: the index of one whose program has no solution.
        constraints: everything the vehicles have to keep to beside their goals.
        present: the rows in the program.

    Raises:
        SolverError: an elastic program cannot be solved.
    """
    alone = frame.only(np.array([vehicle]))
    rows = _rows(vehicle, constraints, present)
    names = [*_GOALS, *rows]
    kept = [name for name in names if name in _solve_elastic(alone, names, rows).weights]
    for name in list(kept):
        without = [other for other in kept if other != name]
        if _cannot_be_met(alone, without, rows):
            kept = without
    weights = _solve_elastic(alone, kept, rows).weights
    told = (_describe(name, weights[name], rows, frame.names) for name in kept if name in weights)
    return tuple(told)


def least_breach(frame: Frame, vehicle: int, constraints: Sequence[Constraint]) -> FloatArray:
    """The motion that breaks goal and constraints least in total, each in its own scale.

    Args:
        frame: of the scenario.
        vehicle: the index of one, with or without a plan.
        constraints: as for `conflict`.

    Returns:
        Its accelerations [m/s²], shape (K-1, 3).

    Raises:
        SolverError: an elastic program cannot be solved.
    """
    alone = frame.only(np.array([vehicle]))
    rows = _rows(vehicle, constraints, ())
    names = [*_GOALS, *rows]
    for number in range(_ROUNDS):
        elastic = _solve_elastic(alone, names, rows)
        if not _add_needed(list(rows.values()), elastic.motion, number):
            break
    accelerations: FloatArray = elastic.motion.accelerations[0]
    return accelerations


def _rows(
    vehicle: int, constraints: Sequence[Constraint], present: Sequence[HalfSpaces]
) -> dict[str, _Rows]:
    """For each constraint every row at the knots, none of them needed yet, and those present."""
    found = {}
    for constraint in constraints:
        knots = constraint.rows_of(vehicle)
        own = [part.of(vehicle) for part in present if part.name == constraint.name]
        rows = HalfSpaces.joined([knots, *own])
        found[constraint.name] = _Rows(
            dataclasses.replace(rows, vehicles=np.zeros_like(rows.vehicles)),
            np.arange(len(rows)) >= len(knots),
            len(knots),
            constraint.sides,
        )
    return found


def _add_needed(each_of: Sequence[_Rows], motion: Motion, number: int) -> bool:
    """Make the rows present that the motion breaks, and their neighbours; False if none."""
    found = False
    for each in each_of:
        broken = ~each.present & (each.all.margins(motion) < -each.all.tolerances)
        if np.any(broken):
            each.present |= each.near(broken, 2**number)
            found = True
    return found


def _cannot_be_met(alone: Frame, names: Sequence[str], rows: dict[str, _Rows]) -> bool:
    """Whether the constraints `names` contradict each other, with all their rows.

    Rows that are found to be needed become present.
    """
    for number in range(_ROUNDS):
        elastic = _solve_elastic(alone, names, rows)
        if elastic.total > _MET:
            return True
        needed = [rows[name] for name in names if name in rows]
        if not _add_needed(needed, elastic.motion, number):
            return False
    raise SolverError(f"a conflict could not be narrowed down in {_ROUNDS} rounds")


def _solve_elastic(alone: Frame, names: Sequence[str], rows: dict[str, _Rows]) -> _Elastic:
    """Break the present rows of the constraints `names` as little as possible."""
    steps = alone.grid.knots - 1
    elastic = MathematicalProgram()
    u = elastic.NewContinuousVariables(3 * steps)
    bindings = {}
    for axis, name in enumerate(_GOALS):
        if name in names:
            goal = np.zeros((len(alone.goal_rows), 3 * steps))
            goal[:, axis::3] = alone.goal_rows
            zero = np.zeros(len(goal))
            bindings[name] = _add_elastic(elastic, csc_array(goal), zero, u, both_ways=True)
    for name in names:
        if name in rows and (name == _HARD or np.any(rows[name].present)):
            if name == _HARD:
                rows[name].present[:] = True
            needed = rows[name].all.select(rows[name].present)
            matrix, lower, hard = rows_of(alone, np.zeros(1, dtype=int), [needed])
            if name == _HARD:
                bindings[name] = add_rows(elastic, matrix, lower, hard, u)
            else:
                bindings[name] = _add_elastic(elastic, matrix, lower, u, both_ways=False)
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
    from_free = alone.units[0] * solution.result.GetSolution(u).reshape(1, -1, 3)
    motion = alone.free.with_accelerations(alone.free.accelerations + from_free)
    return _Elastic(float(solution.result.get_optimal_cost()), weights, motion)


def _add_elastic(
    elastic: MathematicalProgram,
    matrix: csc_array,
    lower: FloatArray,
    variables: np.ndarray,
    *,
    both_ways: bool,
) -> object:
    """Rows matrix @ variables >= (or, both ways, ==) lower that may give way, at that cost."""
    size = len(lower)
    one = eye_array(size)
    ways = [one, -one] if both_ways else [one]
    give = elastic.NewContinuousVariables(size * len(ways), "give")
    elastic.AddBoundingBoxConstraint(0.0, np.inf, give)
    elastic.AddLinearCost(np.ones(give.size), give)
    return elastic.AddLinearConstraint(
        csc_matrix(hstack([matrix, *ways], format="csc")),
        lower,
        lower if both_ways else np.full(size, np.inf),
        np.concatenate([variables, give]),
    )


def _describe(name: str, weights: FloatArray, rows: dict[str, _Rows], names: Sequence[str]) -> str:
    """One constraint by its name, with a box's axes or a pair's other vehicle, and its times."""
    if name not in rows:  # an axis of the goal
        return name
    own = rows[name]
    part = own.all.select(own.present).select(weights > 0)
    axes = np.any(part.normals, axis=0)
    sides = f" {_axes(axes)}" if own.sides > 1 else ""
    if name == _HARD:
        return f"{name}{sides}"
    if part.partners is not None:
        sides = f" from {', '.join(names[other] for other in np.unique(part.partners))}"
    first, last = part.times.min(), part.times.max()
    when = f"at {first:g} s" if first == last else f"from {first:g} s to {last:g} s"
    return f"{name}{sides} {when}"


def _axes(mask: BoolArray) -> str:
    return "/".join(axis for axis, taken in zip("xyz", mask, strict=True) if taken)
