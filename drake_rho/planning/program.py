"""The quadratic program (16), on Drake's `MathematicalProgram`.

The decision variables are the accelerations, the paper's choice: position and velocity at any
time are affine in them by (10)-(11). They are counted from the free motion, the one of least index
(13) that reaches the goal, in a unit of the scenario's scale, and every row has length one, so
that the numbers a solver sees depend neither on the scale nor on where it lies.

The solution lies in the span of its rows: what is square to all of them and to the goal's only
costs. With few rows a program therefore has one variable for each row instead of 3 (K - 1), the
coordinates in an orthonormal basis of that span; this is exact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram
from scipy.sparse import csc_array, csc_matrix, diags_array, hstack, vstack

from drake_rho.planning.frame import Frame
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.states import StateRows
from drake_rho.scenario.fields import FloatArray, IntArray

_FEW = 32
"""Rows up to which a program is written in their span, whatever they are."""

_SPARSE = 2000
"""Operations that each number of a sparse program costs, measured from 50 to 5000 knots within a
factor of two. The span of R rows costs about R² (3 K + 5 R)."""

_BLOCK = 150
"""Most variables in one quadratic cost: Drake takes a dense matrix for each."""


@dataclasses.dataclass(frozen=True)
class Batch:
    """Quadratic programs of vehicles that have as many rows each, one for each vehicle."""

    vehicles: IntArray
    """their indices in the scenario, shape (B,)"""
    programs: list[MathematicalProgram]
    """minimise norm(x)² subject to the rows, u = basis @ x"""
    rows: list[Binding[LinearConstraint]]
    """the half-spaces, in the order they were given in"""
    basis: FloatArray | None
    """shape (B, 3 (K-1), number of variables); None if u are the first of the variables"""
    lengths: FloatArray
    """by what multipliers are multiplied to be those of rows of length one, shape (B, R)"""

    def solutions(self, x: FloatArray, steps: int) -> FloatArray:
        """The accelerations u from the free motions, in units, shape (B, K-1, 3).

        Args:
            x: the programs' variables, shape (B, number of variables).
            steps: K - 1.
        """
        u = x[:, : 3 * steps] if self.basis is None else np.matvec(self.basis, x)
        return u.reshape(len(x), steps, 3)


def programs_of(frame: Frame, rows: Sequence[HalfSpaces]) -> list[Batch]:
    """The programs of all vehicles that have rows.

    Args:
        frame: of the scenario.
        rows: constraint by constraint; those of a vehicle keep their order.
    """
    vehicles = np.concatenate([part.vehicles for part in rows])
    count = np.bincount(vehicles)
    many = np.flatnonzero(count > _FEW)
    if len(many) == 0:
        return _of_few(frame, rows, count)
    batches: list[Batch] = []
    if np.any(count[vehicles] <= _FEW):
        few = [part.select(count[part.vehicles] <= _FEW) for part in rows]
        batches = _of_few(frame, few, count)
    for vehicle in many.tolist():
        batches.append(_of_many(frame, vehicle, [part.of(vehicle) for part in rows]))
    return batches


def _of_few(frame: Frame, rows: Sequence[HalfSpaces], count: IntArray) -> list[Batch]:
    """Programs in the span of their rows; the arithmetic of all of them at once."""
    vehicles = np.concatenate([part.vehicles for part in rows])
    sizes = count[vehicles]
    order = np.lexsort((vehicles, sizes))  # by size, then by vehicle, and stable
    responses = np.concatenate([part.responses(frame.grid) for part in rows])[order]
    normals = np.concatenate([part.normals for part in rows])[order]
    short = -np.concatenate([part.margins(frame.free) for part in rows])[order]
    lengths = np.sqrt(np.einsum("rj,rj->r", responses, responses))
    inside = _without_goal(frame, responses / lengths[:, None])
    vehicles, sizes = vehicles[order], sizes[order]
    needed = short / (lengths * frame.units[vehicles])
    matrix = (inside[:, :, None] * normals[:, None, :]).reshape(len(order), -1)
    batches = []
    for size in np.unique(sizes).tolist():
        own = slice(*np.searchsorted(sizes, [size, size + 1]))
        stack = matrix[own].reshape(-1, size, matrix.shape[1])
        batches.append(_in_span(vehicles[own][::size], stack, needed[own].reshape(-1, size)))
    return batches


def _of_many(frame: Frame, vehicle: int, rows: Sequence[HalfSpaces]) -> Batch:
    """One program, in the span of its rows or, if that is cheaper, with sparse rows."""
    sparse = StateRows(frame, vehicle, rows)
    count = sum(map(len, rows))
    if count**2 * (3 * frame.grid.knots + 5 * count) > _SPARSE * sparse.entries:
        return _in_states(sparse)
    matrix, needed = rows_of(frame, vehicle, rows)
    dense = matrix.toarray().reshape(len(needed), -1, 3)
    inside = np.stack([_without_goal(frame, dense[:, :, axis]) for axis in range(3)], axis=2)
    return _in_span(np.array([vehicle]), inside.reshape(1, len(needed), -1), needed[None])


def rows_of(frame: Frame, vehicle: int, rows: Sequence[HalfSpaces]) -> tuple[csc_array, FloatArray]:
    """Half-spaces as rows matrix @ u >= needed, by (10)-(11), each of length one.

    Here u are the accelerations of one vehicle from its free motion, in its unit.
    """
    blocks, needed = [csc_array((0, 3 * (frame.grid.knots - 1)))], [np.zeros(0)]
    for part in rows:
        responses = part.sparse_responses(frame.grid)
        lengths = np.sqrt(responses.power(2).sum(axis=1))
        along = [diags_array(part.normals[:, axis] / lengths) @ responses for axis in range(3)]
        by_axis = hstack(along, format="csc")
        steps = frame.grid.knots - 1
        blocks.append(by_axis[:, np.arange(3 * steps).reshape(3, steps).T.reshape(-1)])
        needed.append(-part.margins(frame.free) / (lengths * frame.units[vehicle]))
    return vstack(blocks, format="csc"), np.concatenate(needed)


def _without_goal(frame: Frame, rows: FloatArray) -> FloatArray:
    """The part of `rows` that leaves the goal where it is; projected twice, against rounding."""
    goal = frame.goal_rows
    for _ in range(2):
        rows = rows - (rows @ goal.T) @ goal
    return rows


def _in_span(vehicles: IntArray, matrices: FloatArray, needed: FloatArray) -> Batch:
    """Programs in coordinates of the span of their rows, which leave the goal alone.

    Args:
        vehicles: whose, shape (B,).
        matrices: rows of length at most one, shape (B, R, 3 (K-1)).
        needed: shape (B, R).
    """
    basis, triangles = np.linalg.qr(np.swapaxes(matrices, 1, 2))
    programs, rows = [], []
    for triangle, least in zip(np.swapaxes(triangles, 1, 2), needed, strict=True):
        program = MathematicalProgram()
        x = program.NewContinuousVariables(triangle.shape[1])
        add_index(program, x)
        rows.append(add_rows(program, triangle, least, x))
        programs.append(program)
    return Batch(vehicles, programs, rows, basis, np.ones_like(needed))


def _in_states(sparse: StateRows) -> Batch:
    """The program in the accelerations, with the states that its rows speak of beside them."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(sparse.columns)
    u = x[: 3 * sparse.steps]
    add_index(program, u)
    add_goal(program, sparse.frame, u)
    for equations in sparse.dynamics():
        zero = np.zeros(equations.shape[0])
        program.AddLinearEqualityConstraint(csc_matrix(equations), zero, x)
    matrix, needed, lengths = sparse.matrix()
    rows = add_rows(program, csc_matrix(matrix), needed, x)
    return Batch(np.array([sparse.vehicle]), [program], [rows], None, lengths[None])


def add_index(to: MathematicalProgram, x: np.ndarray) -> None:
    """(13): f less that of the free motion, in units squared: the sum of squares."""
    for first in range(0, len(x), _BLOCK):
        block = x[first : first + _BLOCK]
        hessian, linear = _sum_of_squares(len(block))
        to.AddQuadraticCost(hessian, linear, block, is_convex=True)


@lru_cache(maxsize=_BLOCK)
def _sum_of_squares(size: int) -> tuple[FloatArray, FloatArray]:
    """Hessian and linear part of norm(x)² for so many variables."""
    return 2.0 * np.eye(size), np.zeros(size)


def add_goal(to: MathematicalProgram, frame: Frame, u: np.ndarray) -> None:
    """(12): position and velocity at the last knot stay those of the free motion."""
    rows = frame.goal_rows
    for axis in range(3):
        to.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), u[axis::3])


def add_rows(
    to: MathematicalProgram, matrix: FloatArray | csc_matrix, needed: FloatArray, x: np.ndarray
) -> Binding[LinearConstraint]:
    """(4) to (7) and (15): matrix @ x >= needed."""
    return to.AddLinearConstraint(matrix, needed, _no_upper_bounds(len(needed)), x)


@lru_cache(maxsize=_BLOCK)
def _no_upper_bounds(size: int) -> FloatArray:
    return np.full(size, np.inf)
