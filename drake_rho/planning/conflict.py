"""Which constraints of a program without a solution cannot be met together.

In the elastic program every row may give way at a price and the least total is sought. By Farkas'
lemma its multipliers weigh constraints into a contradiction: those without a multiplier are not
needed for it. Of those that are left, one after the other is then tried without: what remains is
a conflict from which no constraint can be spared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram
from scipy.sparse import hstack, identity

from drake_rho.planning.halfspaces import BoolArray, HalfSpaces
from drake_rho.planning.program import VehicleProgram
from drake_rho.planning.solve import solve
from drake_rho.scenario.fields import FloatArray

_NO_PART = 1e-6
"""Multipliers below this part of the largest one count as zero."""

_MET = 1e-7
"""Rows are of length one and accelerations of the order of one: if they give way by less than
this in total they count as met."""

_BOX = "acceleration box"


def conflict(of: VehicleProgram) -> tuple[str, ...]:
    """Names of constraints, with axes and times, that cannot be met together.

    Args:
        of: a program without a solution.

    Raises:
        SolverError: the elastic program cannot be solved either.
    """
    needed = _weights(of, _names(of))[1]
    kept = [name for name in _names(of) if name in needed]
    for name in list(kept):
        without = [other for other in kept if other != name]
        total, _ = _weights(of, without)
        if total > _MET:
            kept = without
    weights = _weights(of, kept)[1]
    return tuple(_describe(of, name, weights[name]) for name in kept if name in weights)


def _names(of: VehicleProgram) -> list[str]:
    """The program's constraints, each once: goal axes, acceleration box, and what was added."""
    box = [] if of.acceleration_box is None else [_BOX]
    added = dict.fromkeys(rows.halfspaces.name for rows in of.rows)
    return [*(f"goal {axis}" for axis in "xyz"), *box, *added]


def _weights(of: VehicleProgram, names: Sequence[str]) -> tuple[float, dict[str, list[FloatArray]]]:
    """Solve the elastic program with the constraints `names` alone.

    Returns:
        The total by which rows give way, and the multipliers of each constraint that has any,
        one array for each of its bindings.
    """
    elastic = MathematicalProgram()
    elastic.AddDecisionVariables(of.accelerations.reshape(-1))
    bindings: dict[str, list[Binding[LinearConstraint]]] = {name: [] for name in names}
    for axis, goal in zip("xyz", of.goal, strict=True):
        if f"goal {axis}" in bindings:
            bindings[f"goal {axis}"].append(_add_elastic(elastic, goal, both_ways=True))
    for rows in of.rows:
        if rows.halfspaces.name in bindings:
            added = _add_elastic(elastic, rows.binding, both_ways=False)
            bindings[rows.halfspaces.name].append(added)
    if not elastic.linear_costs():
        return 0.0, {}
    if _BOX in bindings:  # can always be met, so it stays hard
        bindings[_BOX].append(elastic.AddConstraint(of.acceleration_box))
    (solution,) = solve([elastic])
    weights = {
        name: [np.abs(solution.result.GetDualSolution(binding)) for binding in each]
        for name, each in bindings.items()
    }
    largest = max(float(np.max(one)) for each in weights.values() for one in each)
    taking_part = {
        name: [np.where(one > _NO_PART * largest, one, 0.0) for one in each]
        for name, each in weights.items()
        if any(np.any(one > _NO_PART * largest) for one in each)
    }
    return float(solution.result.get_optimal_cost()), taking_part


def _add_elastic(
    elastic: MathematicalProgram, binding: Binding[LinearConstraint], *, both_ways: bool
) -> Binding[LinearConstraint]:
    """The same rows, each with a variable by which it may give way, at that cost."""
    constraint = binding.evaluator()
    size = constraint.num_constraints()
    ways = [identity(size), -identity(size)] if both_ways else [identity(size)]
    give = elastic.NewContinuousVariables(size * len(ways), "give")
    elastic.AddBoundingBoxConstraint(0.0, np.inf, give)
    elastic.AddLinearCost(np.ones(give.size), give)
    return elastic.AddLinearConstraint(
        hstack([constraint.get_sparse_A(), *ways], format="csc"),
        constraint.lower_bound(),
        constraint.upper_bound(),
        np.concatenate([binding.variables(), give]),
    )


def _describe(of: VehicleProgram, name: str, weights: Sequence[FloatArray]) -> str:
    """One constraint by its name, with the axes of its sides if it is a box, and its times."""
    if name.startswith("goal"):
        return name
    if name == _BOX:
        return f"{name} {_axes(np.any(weights[0].reshape(-1, 3), axis=0))}"
    bindings = [rows.halfspaces for rows in of.rows if rows.halfspaces.name == name]
    parts = [part.select(weight > 0) for part, weight in zip(bindings, weights, strict=True)]
    return f"{name}{_sides(parts)} {_when(parts)}"


def _sides(parts: Sequence[HalfSpaces]) -> str:
    if parts[0].sides == 1:
        return ""
    return f" {_axes(np.any(np.concatenate([part.normals for part in parts]), axis=0))}"


def _when(parts: Sequence[HalfSpaces]) -> str:
    times = np.concatenate([part.times for part in parts])
    first, last = times.min(), times.max()
    return f"at {first:g} s" if first == last else f"from {first:g} s to {last:g} s"


def _axes(mask: BoolArray) -> str:
    return "/".join(axis for axis, taken in zip("xyz", mask, strict=True) if taken)
