"""Quadratic programs as dense arrays: read from Drake's, judged by their optimality conditions."""

from __future__ import annotations

import dataclasses

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_rho.planning.programs.dense import DenseProgram, slack_columns
from drake_rho.scenario.fields import FloatArray

_KEPT = 1e-9
"""How far a row may be broken, as part of the largest of the bounds or of one."""

_GAP = 1e-9
"""How far a cost may be from the least, as part of what it is the sum of."""


@dataclasses.dataclass(frozen=True, eq=False)
class Quadratic:
    """Minimise x' hessian x / 2 + linear · x with lower <= (x, matrix @ x) <= upper."""

    hessian: FloatArray
    """shape (V, V)"""
    linear: FloatArray
    """shape (V,)"""
    matrix: FloatArray
    """shape (R, V)"""
    lower: FloatArray
    """of the variables, then of the rows, shape (V + R,)"""
    upper: FloatArray
    """the same"""
    rows: int
    """how many rows at the end of the matrix are equations rather than inequalities of a program"""

    @classmethod
    def of_dense(cls, program: DenseProgram) -> Quadratic:
        """X and the slacks of a program with soft rows."""
        (count, size), needed = program.matrix.shape, program.needed
        soft, columns, costs = slack_columns(program.penalties, program.slacks)
        every = size + len(costs)
        matrix, hessian = np.zeros((count, every)), np.zeros((every, every))
        matrix[:, :size] = program.matrix
        matrix[soft, size + columns] = 1.0
        if not program.linear:
            hessian[range(size), range(size)] = 2.0
        linear = np.concatenate([np.zeros(size), costs])
        lower = np.concatenate([np.full(size, -np.inf), np.zeros(len(costs)), needed])
        return cls(hessian, linear, matrix, lower, np.full(every + count, np.inf), 0)

    @classmethod
    def read(cls, program: MathematicalProgram) -> Quadratic | None:
        """A program of Drake's; None if it has other costs or constraints than linear ones.

        Linear constraints come first among the rows, then equations.
        """
        size = program.num_vars()
        hessian, linear = np.zeros((size, size)), np.zeros(size)
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        quadratic, costs = program.quadratic_costs(), program.linear_costs()
        rows, equations = program.linear_constraints(), program.linear_equality_constraints()
        boxes = program.bounding_box_constraints()
        if len(quadratic) + len(costs) < len(program.GetAllCosts()):
            return None
        if len(rows) + len(equations) + len(boxes) < len(program.GetAllConstraints()):
            return None
        for cost in quadratic:
            own = program.FindDecisionVariableIndices(cost.variables())
            np.add.at(hessian, np.ix_(own, own), cost.evaluator().Q())
            np.add.at(linear, own, cost.evaluator().b())
        for cost in costs:
            own = program.FindDecisionVariableIndices(cost.variables())
            np.add.at(linear, own, cost.evaluator().a())
        for box in boxes:
            own = program.FindDecisionVariableIndices(box.variables())
            np.maximum.at(lower, own, box.evaluator().lower_bound())
            np.minimum.at(upper, own, box.evaluator().upper_bound())
        matrices, lowers, uppers = [np.zeros((0, size))], [lower], [upper]
        for row in [*rows, *equations]:
            own = program.FindDecisionVariableIndices(row.variables())
            part = row.evaluator().GetDenseA()
            columns = np.zeros((size, len(part)))
            np.add.at(columns, own, part.T)
            matrices.append(columns.T)
            lowers.append(row.evaluator().lower_bound())
            uppers.append(row.evaluator().upper_bound())
        last = sum(each.evaluator().num_constraints() for each in equations)
        bounds = np.concatenate(lowers), np.concatenate(uppers)
        return cls(hessian, linear, np.concatenate(matrices), *bounds, last)

    def of_rows(self, multipliers: FloatArray) -> FloatArray:
        """Of the multipliers of variables and rows those of the inequalities among the rows."""
        every = multipliers[len(self.linear) :]
        return every[: len(every) - self.rows]

    def one_sided(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """All bounds as rows M x >= b: M, b, and the matrix that turns their weights into ours.

        The weights of an upper bound count negatively.
        """
        every = np.concatenate([np.eye(len(self.linear)), self.matrix])
        below, above = np.isfinite(self.lower), np.isfinite(self.upper)
        matrix = np.concatenate([every[below], -every[above]])
        needed = np.concatenate([self.lower[below], -self.upper[above]])
        unit = np.eye(len(every))
        return matrix, needed, np.concatenate([unit[below], -unit[above]]).T

    def is_solved_by(self, x: FloatArray, multipliers: FloatArray) -> bool:
        """Whether the conditions of an optimum hold to the package's tolerances.

        Args:
            x: values of the variables, shape (V,).
            multipliers: at least 0 at lower bounds, at most 0 at upper ones, shape (V + R,).
        """
        values = np.concatenate([x, self.matrix @ x])
        finite = [each[np.isfinite(each)] for each in (self.lower, self.upper)]
        largest = max((float(np.abs(each).max(initial=1.0)) for each in finite), default=1.0)
        if max(np.max(self.lower - values), np.max(values - self.upper)) > _KEPT * largest:
            return False
        pull = multipliers[: len(x)] + self.matrix.T @ multipliers[len(x) :]
        curved = self.hessian @ x
        left = curved + self.linear - pull
        active = np.flatnonzero(multipliers)
        bounds = np.where(multipliers > 0.0, self.lower, self.upper)[active]
        gaps = multipliers[active] * (values[active] - bounds)
        cost = float(np.abs(curved) @ np.abs(x) + np.abs(self.linear) @ np.abs(x))
        gap = float(np.abs(left) @ np.abs(x) + np.abs(gaps).sum())
        steep = np.abs(left).max() > np.sqrt(_GAP) * max(1.0, np.abs(self.linear).max())
        return bool(gap <= _GAP * max(cost, _GAP) and not steep)
