"""Which constraints of a program without a solution cannot be met together.

The elastic program lets every row give way, the acceleration box alone stays hard, and minimises
the total by which they do. By Farkas' lemma its multipliers weigh the constraints into the
contradiction: those with a multiplier cannot be met together, the others have no part in it.
"""

from __future__ import annotations

import numpy as np
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram

from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.program import VehicleProgram
from drake_rho.planning.solve import solve

_NO_PART = 1e-6
"""Multipliers below this part of the largest one count as zero."""


def conflict(of: VehicleProgram) -> tuple[str, ...]:
    """Names of the constraints, with axes and times, that cannot be met together.

    Args:
        of: a program without a solution.

    Raises:
        SolverError: the elastic program cannot be solved either.
    """
    elastic = MathematicalProgram()
    elastic.AddDecisionVariables(of.accelerations.reshape(-1))
    goal = [_add_elastic(elastic, binding, both_ways=True) for binding in of.goal]
    rows = [_add_elastic(elastic, rows.binding, both_ways=False) for rows in of.rows]
    box = of.acceleration_box
    if box is not None:
        elastic.AddConstraint(box)
    (solution,) = solve([elastic])
    multiplier = solution.result.GetDualSolution
    weights = [np.abs(multiplier(binding)) for binding in goal + rows]
    least = _NO_PART * max(float(np.max(weight)) for weight in weights)

    names = [
        f"goal {axis}"
        for axis, weight in zip("xyz", weights, strict=False)
        if np.any(weight > least)
    ]
    if box is not None:
        taken = np.any(np.abs(multiplier(box)).reshape(-1, 3) > least, axis=0)
        names += [f"acceleration box {_axes(taken)}"] if np.any(taken) else []
    taking_part = [
        row.halfspaces.select(weight > least)
        for row, weight in zip(of.rows, weights[3:], strict=True)
        if np.any(weight > least)
    ]
    names += [
        _describe([rows for rows in taking_part if rows.name == name])
        for name in dict.fromkeys(rows.name for rows in taking_part)
    ]
    return tuple(names)


def _add_elastic(
    elastic: MathematicalProgram, binding: Binding[LinearConstraint], *, both_ways: bool
) -> Binding[LinearConstraint]:
    """The same rows, each with a variable by which it may give way, at that cost."""
    constraint = binding.evaluator()
    size = constraint.num_constraints()
    ways = [np.eye(size), -np.eye(size)] if both_ways else [np.eye(size)]
    give = elastic.NewContinuousVariables(size * len(ways), "give")
    elastic.AddBoundingBoxConstraint(0.0, np.inf, give)
    elastic.AddLinearCost(np.ones(give.size), give)
    return elastic.AddLinearConstraint(
        np.hstack([constraint.GetDenseA(), *ways]),
        constraint.lower_bound(),
        constraint.upper_bound(),
        np.concatenate([binding.variables(), give]),
    )


def _describe(parts: list[HalfSpaces]) -> str:
    """One constraint by its name, with the axes of its sides if it is a box, and its times."""
    name = parts[0].name
    times = np.concatenate([part.times for part in parts])
    first, last = times.min(), times.max()
    when = f"at {first:g} s" if first == last else f"from {first:g} s to {last:g} s"
    if not name.endswith("box"):
        return f"{name} {when}"
    sides = np.any(np.concatenate([part.normals for part in parts]), axis=0)
    return f"{name} {_axes(sides)} {when}"


def _axes(mask: np.ndarray) -> str:
    return "/".join(axis for axis, taken in zip("xyz", mask, strict=True) if taken)
