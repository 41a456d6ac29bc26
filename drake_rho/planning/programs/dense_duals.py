"""Solution of dense programs with DAQP, directly or by their duals."""

from __future__ import annotations

import time

import numpy as np
from scipy.optimize import nnls

from drake_rho.planning.programs import daqp
from drake_rho.planning.programs.dense import DenseProgram
from drake_rho.planning.programs.dual import is_optimal
from drake_rho.planning.programs.solution import Solution
from drake_rho.scenario.fields import FloatArray

_RIDGE = 1e-13
"""Regularisation of the Gram matrix's diagonal, relative to its largest entry, which gives linearly
dependent rows a Cholesky factor too."""

_REFINEMENTS = 2
"""Number of refinements, which remove the residual that the ridge leaves in active rows."""

_ZERO = 1e-11
"""Length below which a row counts as zero, as it does in DAQP."""

_FAR = 1e8
"""Norm of x, relative to the right-hand sides, beyond which a program counts as infeasible."""


def solved(program: DenseProgram) -> Solution | None:
    """Return the solution or a proof that there is none; None if DAQP finds neither."""
    return _soft(program) if program.soft else _hard(program)


def _hard(program: DenseProgram) -> Solution | None:
    """Return the point of least norm that satisfies all rows; None if DAQP fails."""
    found = daqp.with_hard_rows(program.matrix, program.needed)
    if found.infeasible:
        return _refuted(program, found.seconds)
    slope, y = program.matrix @ found.x - program.needed, found.y
    if not (found.optimal and is_optimal(slope, program.needed, y, program.penalties)):
        return None
    return Solution(found.x, True, daqp.NAME, found.seconds, lambda: 2.0 * y)


def _soft(program: DenseProgram) -> Solution | None:
    """Return the point of least cost, each soft row with its own slack; None if DAQP fails."""
    soft = program.slacks[np.isfinite(program.penalties)]
    if len(np.unique(soft)) < len(soft):
        return None  # for shared slacks, penalties bound sums of multipliers
    start, most = time.perf_counter(), program.penalties / 2.0
    gram = program.matrix @ program.matrix.T
    ridge = _RIDGE * gram.max() * np.eye(len(gram))
    y = daqp.bounded_least_squares(gram + ridge, program.needed, most)
    if y is None:
        return _refuted(program, time.perf_counter() - start)
    free = np.flatnonzero((y > 0.0) & (y < most))
    own = (gram + ridge)[np.ix_(free, free)]
    for _ in range(_REFINEMENTS):
        y[free] += np.linalg.solve(own, (program.needed - gram @ y)[free])
    if not is_optimal(gram @ y - program.needed, program.needed, y, most):
        return None
    x, seconds = y @ program.matrix, time.perf_counter() - start
    return Solution(x, True, daqp.NAME, seconds, lambda: 2.0 * y)


def _refuted(program: DenseProgram, seconds: float) -> Solution | None:
    """Return the proof that there is no solution; None if no weights prove it."""
    hard = np.isinf(program.penalties)
    weights = contradiction(program.matrix[hard], program.needed[hard])
    if weights is None:
        return None
    every = np.zeros(len(hard))
    every[hard] = weights
    x = np.zeros(program.matrix.shape[1])
    return Solution(x, False, daqp.NAME, seconds, lambda: every)


def contradiction(matrix: FloatArray, needed: FloatArray) -> FloatArray | None:
    """Return weights y >= 0 with matrix.T @ y = 0 and needed · y > 0; None if there are none.

    By Farkas' lemma they prove that no x satisfies matrix @ x >= needed. Following Lawson and
    Hanson, the y >= 0 for which (matrix.T @ y, needed · y) is closest to (0, 1) attains it if rows
    contradict each other; otherwise the residual is parallel to the x of least norm.

    Args:
        matrix: the coefficients, shape (R, V).
        needed: the right-hand sides, shape (R,).
    """
    if len(needed) == 0:  # scipy's nnls crashes without columns
        return None
    lengths = np.linalg.norm(matrix, axis=1)
    impossible = (lengths < _ZERO) & (needed > _ZERO)
    if impossible.any():  # 0 x >= b > 0
        return np.where(impossible, 1.0, 0.0)
    lengths = np.where(lengths < _ZERO, np.inf, lengths)
    least = needed / lengths
    least /= max(np.abs(least).max(), np.finfo(float).tiny)
    rows = np.concatenate([(matrix / lengths[:, None]).T, least[None]])
    try:
        weights, left = nnls(rows, np.append(np.zeros(len(rows) - 1), 1.0))
    except RuntimeError:  # too many iterations
        return None
    found: FloatArray = weights / lengths
    return found if left < 1.0 / _FAR else None
