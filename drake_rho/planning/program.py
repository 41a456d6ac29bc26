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
from pydrake.solvers import (
    Binding,
    LinearConstraint,
    MathematicalProgram,
    MathematicalProgramResult,
)
from scipy.sparse import coo_array, csc_array, csc_matrix, hstack
from scipy.sparse.csgraph import connected_components

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
    """Quadratic programs of groups of as many vehicles and rows each, one for each group.

    A group is one vehicle, or several that rows couple.
    """

    groups: IntArray
    """indices of the vehicles in the scenario, shape (B, G)"""
    programs: list[MathematicalProgram]
    """minimise norm(x)² subject to the rows, u = basis @ x"""
    rows: list[Binding[LinearConstraint]]
    """the half-spaces, in the order they were given in"""
    basis: FloatArray | None
    """shape (B, 3 G (K-1), number of variables); None if u are the first of the variables"""
    lengths: FloatArray
    """by what multipliers are multiplied to be those of rows of length one, shape (B, R)"""

    def solutions(self, results: Sequence[MathematicalProgramResult], steps: int) -> FloatArray:
        """The accelerations u from the free motions, in units, shape (B, G, K-1, 3).

        Args:
            results: one for each program.
            steps: K - 1.
        """
        (count, vehicles), basis = self.groups.shape, self.basis
        size = 3 * steps * vehicles if basis is None else basis.shape[2]
        x = np.array([result.get_x_val()[:size] for result in results])
        u = x if basis is None else np.matvec(basis, x)
        return u.reshape(count, vehicles, steps, 3)


def programs_of(frame: Frame, rows: Sequence[HalfSpaces]) -> list[Batch]:
    """The programs of all vehicles that have rows.

    Args:
        frame: of the scenario.
        rows: constraint by constraint; those of a group keep their order.
    """
    groups = groups_of(len(frame.units), rows)
    count = np.bincount(np.concatenate([groups[part.vehicles] for part in rows]))
    alone = np.bincount(groups)[: len(count)] == 1
    batches: list[Batch] = []
    for group in np.flatnonzero((count > 0) & (~alone | (count > _FEW))):
        own = [part.select(groups[part.vehicles] == group) for part in rows]
        sparse = StateRows(frame, np.flatnonzero(groups == group), own)
        if _cheaper_in_states(sparse, count[group]):
            alone[group] = False
            batches.append(_in_states(sparse))
        elif not alone[group]:
            batches.append(_in_span_of(frame, sparse.group, own))
    single = [part.select(alone[groups[part.vehicles]]) for part in rows]
    return _in_spans(frame, [part for part in single if len(part) > 0]) + batches


def _cheaper_in_states(sparse: StateRows, count: int) -> bool:
    width = 3 * len(sparse.group) * sparse.steps
    return bool(count**2 * (width + 5 * count) > _SPARSE * sparse.entries)


def groups_of(vehicles: int, rows: Sequence[HalfSpaces]) -> IntArray:
    """For each vehicle the number of its group: those that rows couple have the same."""
    coupled = [part for part in rows if part.coupled and part.partners is not None]
    if not coupled:
        return np.arange(vehicles)
    one = np.concatenate([part.vehicles for part in coupled])
    other = np.concatenate([part.partners for part in coupled if part.partners is not None])
    links = coo_array((np.ones(len(one)), (one, other)), shape=(vehicles, vehicles))
    labels: IntArray = connected_components(links, directed=False)[1]
    return labels


def _in_spans(frame: Frame, rows: Sequence[HalfSpaces]) -> list[Batch]:
    """Programs of single vehicles in the span of their rows; the arithmetic of all at once."""
    if not rows:
        return []
    vehicles = np.concatenate([part.vehicles for part in rows])
    sizes = np.bincount(vehicles)[vehicles]
    order = np.lexsort((vehicles, sizes))  # by size, then by vehicle, and stable
    responses = np.concatenate([part.responses(frame.grid) for part in rows])[order]
    normals = np.concatenate([part.normals for part in rows])[order]
    short = -np.concatenate([part.margins(frame.free) for part in rows])[order]
    prices = np.repeat([part.price for part in rows], [len(part) for part in rows])[order]
    lengths = np.sqrt(np.einsum("rj,rj->r", responses, responses))
    inside = _without_goal(frame, responses / lengths[:, None])
    vehicles, sizes = vehicles[order], sizes[order]
    units = frame.units[vehicles]
    needed, weights = short / (lengths * units), prices * lengths / units
    matrix = (inside[:, :, None] * normals[:, None, :]).reshape(len(order), -1)
    batches = []
    for size in np.unique(sizes).tolist():
        own = slice(*np.searchsorted(sizes, [size, size + 1]))
        stack = matrix[own].reshape(-1, size, matrix.shape[1])
        numbers = (needed[own].reshape(-1, size), weights[own].reshape(-1, size))
        batches.append(_in_span(vehicles[own][::size, None], stack, *numbers))
    return batches


def _in_span_of(frame: Frame, group: IntArray, rows: Sequence[HalfSpaces]) -> Batch:
    """One program, in the span of its rows."""
    matrix, needed, weights = rows_of(frame, group, rows)
    dense = matrix.toarray().reshape(len(needed) * len(group), -1, 3)
    inside = np.stack([_without_goal(frame, dense[:, :, axis]) for axis in range(3)], axis=2)
    return _in_span(group[None], inside.reshape(1, len(needed), -1), needed[None], weights[None])


def rows_of(
    frame: Frame, group: IntArray, rows: Sequence[HalfSpaces]
) -> tuple[csc_array, FloatArray, FloatArray]:
    """Half-spaces as rows matrix @ u >= needed, by (10)-(11), each of length one.

    Here u are the accelerations of a group of vehicles from their free motions, in its unit.

    Returns:
        The matrix (R, 3 G (K-1)), `needed` (R,), and what it costs that a row gives way by one,
        (R,).
    """
    steps, unit = frame.grid.knots - 1, frame.units[group].max()
    place = np.zeros(len(frame.units), dtype=int)
    place[group] = np.arange(len(group))
    entries, where, needed, weights = [np.zeros(0)], [np.zeros((2, 0), dtype=int)], [], []
    first = 0
    for part in rows:
        responses = part.sparse_responses(frame.grid).tocoo()
        terms = [(part.vehicles, 1.0)]
        if part.coupled and part.partners is not None:
            terms.append((part.partners, -1.0))
        lengths = np.sqrt(len(terms) * responses.power(2).sum(axis=1))
        r, j = responses.coords
        for vehicles, sign in terms:
            vectors = place[vehicles[r]] * steps + j
            values = (sign * responses.data / lengths[r])[:, None] * part.normals[r]
            entries.append(values.reshape(-1))
            columns = (3 * vectors[:, None] + np.arange(3)).reshape(-1)
            where.append(np.stack([np.repeat(first + r, 3), columns]))
        needed.append(-part.margins(frame.free) / (lengths * unit))
        weights.append(part.price * lengths / unit)
        first += len(part)
    shape = (first, 3 * steps * len(group))
    matrix = coo_array((np.concatenate(entries), tuple(np.concatenate(where, axis=1))), shape=shape)
    return matrix.tocsc(), np.concatenate(needed), np.concatenate(weights)


def _without_goal(frame: Frame, rows: FloatArray) -> FloatArray:
    """The part of `rows` that leaves the goal where it is; projected twice, against rounding."""
    goal = frame.goal_rows
    for _ in range(2):
        rows = rows - (rows @ goal.T) @ goal
    return rows


def _in_span(
    groups: IntArray, matrices: FloatArray, needed: FloatArray, weights: FloatArray
) -> Batch:
    """Programs in coordinates of the span of their rows, which leave the goal alone.

    Args:
        groups: whose, shape (B, G).
        matrices: rows of length at most one, shape (B, R, 3 G (K-1)).
        needed: shape (B, R).
        weights: what it costs that a row gives way by one, shape (B, R).
    """
    basis, triangles = np.linalg.qr(np.swapaxes(matrices, 1, 2))
    programs, rows = [], []
    for triangle, least, price in zip(np.swapaxes(triangles, 1, 2), needed, weights, strict=True):
        program = MathematicalProgram()
        x = program.NewContinuousVariables(triangle.shape[1])
        add_index(program, x)
        rows.append(add_rows(program, triangle, least, price, x))
        programs.append(program)
    return Batch(groups, programs, rows, basis, np.ones_like(needed))


def _in_states(sparse: StateRows) -> Batch:
    """The program in the accelerations, with the states that its rows speak of beside them."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(sparse.columns)
    u = x[: 3 * sparse.steps * len(sparse.group)]
    add_index(program, u)
    add_goal(program, sparse.frame, u)
    for equations in sparse.dynamics():
        zero = np.zeros(equations.shape[0])
        program.AddLinearEqualityConstraint(csc_matrix(equations), zero, x)
    matrix, needed, weights, lengths = sparse.matrix()
    rows = add_rows(program, matrix, needed, weights, x)
    return Batch(sparse.group[None], [program], [rows], None, lengths[None])


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
    rows, steps = frame.goal_rows, frame.grid.knots - 1
    for first in range(0, len(u), 3 * steps):
        for axis in range(3):
            own = u[first + axis : first + 3 * steps : 3]
            to.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), own)


def add_rows(
    to: MathematicalProgram,
    matrix: FloatArray | csc_array,
    needed: FloatArray,
    weights: FloatArray,
    x: np.ndarray,
) -> Binding[LinearConstraint]:
    """(4) to (8) and pairs, made linear: matrix @ x >= needed, or less at a price."""
    soft = np.flatnonzero(np.isfinite(weights))
    if len(soft) > 0:
        give = to.NewContinuousVariables(len(soft))
        to.AddBoundingBoxConstraint(np.zeros(len(soft)), _infinite(len(soft)), give)
        to.AddLinearCost(weights[soft], give)
        where = (soft, np.arange(len(soft)))
        if isinstance(matrix, np.ndarray) and len(needed) <= _BLOCK:
            ones = np.zeros((len(needed), len(soft)))
            ones[where] = 1.0
            matrix = np.hstack([matrix, ones])
        else:
            ones = coo_array((np.ones(len(soft)), where), shape=(len(needed), len(soft)))
            matrix = hstack([csc_array(matrix), ones], format="csc")
        x = np.concatenate([x, give])
    if not isinstance(matrix, np.ndarray):
        matrix = csc_matrix(matrix)  # what Drake knows
    return to.AddLinearConstraint(matrix, needed, _infinite(len(needed)), x)


def _infinite(size: int) -> FloatArray:
    return np.full(size, np.inf)
