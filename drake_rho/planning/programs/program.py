"""Programs as arrays or of Drake's type, with slacks of soft rows, and their solutions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache, partial

import numpy as np
import scipy  # its parts load when first used
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_BLOCK = 150
"""Largest number of variables in one quadratic cost, whose matrix is dense in Drake."""


@dataclasses.dataclass(frozen=True, eq=False)
class DenseProgram:
    """Minimise norm(x)² + penalties · slacks, subject to matrix @ x + slack >= needed, slack >= 0.

    Rows with an infinite penalty have no slack. Rows that share a slack may be in different units:
    it is in that of the first, and the penalties tell the ratios.
    """

    matrix: FloatArray
    """coefficients of the rows, shape (R, V)"""
    needed: FloatArray
    """right-hand sides, shape (R,)"""
    penalties: FloatArray
    """penalties of a violation by one, shape (R,)"""
    slacks: IntArray
    """index of each row's slack, which several soft rows can share, shape (R,)"""
    linear: bool = False
    """whether only slacks have a cost"""

    @cached_property
    def soft(self) -> bool:
        """Whether any row may be violated."""
        return min(self.penalties.tolist(), default=np.inf) < np.inf

    @cached_property
    def written(self) -> MathematicalProgram:
        """The program as Drake's type; its variables are x, then the slacks."""
        common, x = _common(self.matrix.shape[1], self.linear)
        program, matrix = common.Clone(), self.matrix
        if self.soft:
            matrix, x = _with_slack(program, matrix, self.penalties, self.slacks, x)
        program.AddLinearConstraint(matrix, self.needed, _infinite(len(self.needed)), x)
        return program


_MOST = 1e9
"""Largest penalty of a slack in a program, whose cost is of order one: solvers fail beyond it, and
the slack is at its least to nine digits already."""

Program = MathematicalProgram | DenseProgram
"""Program of either form."""


@lru_cache(maxsize=64)
def _common(size: int, linear: bool) -> tuple[MathematicalProgram, np.ndarray]:
    """Return the common part of all programs with `size` variables, and the variables."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(size)
    if not linear:
        add_cost(program, x)
    return program, x


def add_cost(to: MathematicalProgram, x: np.ndarray) -> None:
    """Add (13), f minus the minimum effort in squared units: the sum of squares."""
    for first in range(0, len(x), _BLOCK):
        block = x[first : first + _BLOCK]
        hessian, linear = _sum_of_squares(len(block))
        to.AddQuadraticCost(hessian, linear, block, is_convex=True)


@lru_cache(maxsize=_BLOCK)
def _sum_of_squares(size: int) -> tuple[FloatArray, FloatArray]:
    """Return the Hessian and the linear part of norm(x)² for `size` variables."""
    return 2.0 * np.eye(size), np.zeros(size)


def add_rows(
    to: MathematicalProgram,
    matrix: FloatArray | scipy.sparse.csc_array,
    needed: FloatArray,
    penalties: FloatArray,
    slacks: IntArray,
    x: np.ndarray,
) -> Binding[LinearConstraint]:
    """Add linearised constraints as rows matrix @ x >= needed; soft rows have slacks."""
    if penalties.min(initial=np.inf) < np.inf:
        matrix, x = _with_slack(to, matrix, penalties, slacks, x)
    if not isinstance(matrix, np.ndarray):
        matrix = scipy.sparse.csc_matrix(matrix)  # the type that Drake accepts
    return to.AddLinearConstraint(matrix, needed, _infinite(len(needed)), x)


def slack_columns(
    penalties: FloatArray, slacks: IntArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return the soft rows, the slack of each and its coefficient, and the penalty of each slack.

    A slack is in the unit of its first row, in which the coefficient is one.
    """
    rows = np.flatnonzero(np.isfinite(penalties))
    _, first, columns = np.unique(slacks[rows], return_index=True, return_inverse=True)
    costs = penalties[rows[first]]
    return rows, columns, costs[columns] / penalties[rows], np.minimum(costs, _MOST)


def _with_slack(
    to: MathematicalProgram,
    matrix: FloatArray | scipy.sparse.csc_array,
    penalties: FloatArray,
    slacks: IntArray,
    x: np.ndarray,
) -> tuple[FloatArray | scipy.sparse.csc_array, np.ndarray]:
    """Return rows and variables with slacks of the soft rows, and add their penalties."""
    rows, columns, coefficients, costs = slack_columns(penalties, slacks)
    slack = to.NewContinuousVariables(len(costs))
    to.AddBoundingBoxConstraint(np.zeros(len(costs)), _infinite(len(costs)), slack)
    to.AddLinearCost(costs, slack)
    x = np.concatenate([x, slack])
    if isinstance(matrix, np.ndarray) and len(penalties) <= _BLOCK:
        ones = np.zeros((len(penalties), len(costs)))
        ones[rows, columns] = coefficients
        return np.hstack([matrix, ones]), x
    shape = len(penalties), len(costs)
    ones = scipy.sparse.coo_array((coefficients, (rows, columns)), shape=shape)
    return scipy.sparse.hstack([scipy.sparse.csc_array(matrix), ones], format="csc"), x


@lru_cache(maxsize=64)
def _infinite(size: int) -> FloatArray:
    """Return infinities, which Drake copies."""
    return np.full(size, np.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """Result of one program."""

    x: FloatArray
    """values of the program's variables; meaningless unless `feasible`"""
    feasible: bool
    """whether there is a solution; if false, the solver has proved infeasibility"""
    solver: str
    """name of the solver"""
    seconds: float
    """time reported by the solver [s]"""
    multipliers: Callable[[], FloatArray]
    """function that returns multipliers on demand: of the linear constraints in their order, at
    least 0 for rows M x >= b, then of cones. Bounds of variables and equalities are omitted. If
    there is no solution, they are the weights of a contradiction (Farkas), provided the solver
    returns any"""
    exact: bool = True
    """whether the solution meets the solver's tolerances; an inexact one only indicates where rows
    may be missing"""


@dataclasses.dataclass(frozen=True, eq=False)
class Answers:
    """Solutions of the programs of groups with equal numbers of vehicles and of rows."""

    groups: IntArray
    """indices of the vehicles, shape (B, G)"""
    accelerations: FloatArray
    """u in units, shape (B, G, K-1, 3); meaningless if there is no solution"""
    feasible: BoolArray
    """whether there is a solution; if false, infeasibility is proved, shape (B,)"""
    exact: BoolArray
    """whether the solution meets the solver's tolerances, shape (B,)"""
    weights: Sequence[Callable[[], FloatArray]]
    """multipliers of each program's rows, as in `Solution`"""
    lengths: FloatArray
    """factors by which `weights` become those of rows of length one, shape (B, R)"""
    solver: str
    """name of the solver of the last program"""
    seconds: float
    """time reported by the solvers [s]"""

    def multipliers(self, index: int) -> FloatArray:
        """Return the multipliers y >= 0 of one group's rows, scaled to length one, shape (R,)."""
        y: FloatArray = np.maximum(self.weights[index](), 0.0) * self.lengths[index]
        return y

    def select(self, chosen: BoolArray) -> Answers:
        """Return some of the answers, chosen by flags (B,)."""
        weights = [each for each, kept in zip(self.weights, chosen, strict=True) if kept]
        return dataclasses.replace(
            self,
            groups=self.groups[chosen],
            accelerations=self.accelerations[chosen],
            feasible=self.feasible[chosen],
            exact=self.exact[chosen],
            weights=weights,
            lengths=self.lengths[chosen],
        )

    def sent(self) -> Answers:
        """Return the answers in a picklable form."""
        found = [partial(np.asarray, weights()) for weights in self.weights]
        return dataclasses.replace(self, weights=found)
