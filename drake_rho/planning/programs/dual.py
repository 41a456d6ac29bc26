"""Dual of a quadratic program with hard or soft rows: its solution and the check of KKT conditions.

With unknowns u, in the unit of the rows, and slacks s,

    minimise norm(u)² + p · s   subject to   M u + s >= b, s >= 0

has the solution u = M' y, where y minimises y' G y / 2 - b · y subject to 0 <= y <= p / 2 and
G = M M' is the Gram matrix. This is a least-squares problem with bounds, with one unknown per row.
Multipliers of hard rows have no upper bound. y is half the derivative of the cost in b.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import scipy  # its parts load when first used

from drake_rho.planning.errors import SolverError
from drake_rho.planning.programs import daqp
from drake_rho.planning.programs.program import DenseProgram, Solution
from drake_rho.scenario.fields import FloatArray

_DAQP_ROWS = 150
"""Largest number of rows for DAQP, which begins without bounds and adds the active ones one by one:
of 600 multipliers all but 35 are zero, and it takes 2 s where this package's method takes 2 ms."""

KKT_TOLERANCE = 1e-9
"""Largest violation of an optimality condition, relative to the largest entry of b or to one."""


def multipliers_of(
    gram: FloatArray,
    needed: FloatArray,
    most: FloatArray,
    begin: FloatArray | None = None,
    *,
    by_daqp: bool = False,
) -> FloatArray:
    """Return the minimiser y of y · gram @ y / 2 - needed · y subject to 0 <= y <= most.

    Without upper bounds the method is scipy's non-negative least squares, with bounds and few rows
    DAQP if it is the chosen solver. Otherwise, or if these fail, it is an active-set method of this
    package.

    Args:
        gram: G, positive definite, shape (R, R).
        needed: b, shape (R,).
        most: the upper bounds, positive and possibly infinite, shape (R,).
        begin: initial guess of the active-set method, shape (R,); zero if not given.
        by_daqp: whether DAQP solves problems with upper bounds.

    Raises:
        SolverError: no method finds multipliers that meet the optimality conditions.
    """
    for y in _candidates(gram, needed, most, begin, by_daqp):
        if y is not None and is_optimal(gram @ y - needed, needed, y, most):
            return y
    raise SolverError("the multipliers of a group were not found")


def is_optimal(slope: FloatArray, needed: FloatArray, y: FloatArray, most: FloatArray) -> bool:
    """Return whether multipliers meet the KKT conditions to `KKT_TOLERANCE`.

    Rows with y = 0 are satisfied (slope >= 0), rows with y = most are violated or active
    (slope <= 0), and all others are active. All this holds exactly if y is equal to its projected
    gradient step, min(max(y - slope, 0), most); the difference is the natural residual.

    Args:
        slope: G y - b, which is M u - b, shape (R,).
        needed: b, shape (R,).
        y: the multipliers, shape (R,).
        most: the upper bounds of y, shape (R,).
    """
    tolerance = KKT_TOLERANCE * max(1.0, float(np.abs(needed).max(initial=0.0)))
    residual = y - slope
    np.maximum(residual, 0.0, out=residual)
    np.minimum(residual, most, out=residual)
    residual -= y
    return bool(np.abs(residual).max(initial=0.0) <= tolerance)  # False if one is not a number


def _candidates(
    gram: FloatArray,
    needed: FloatArray,
    most: FloatArray,
    begin: FloatArray | None,
    by_daqp: bool,
) -> Iterator[FloatArray | None]:
    """Yield the result of each method; None if it fails."""
    if np.isinf(most).all():
        yield _unbounded(gram, needed)
    elif by_daqp and len(needed) <= _DAQP_ROWS:
        yield daqp.bounded_least_squares(gram, needed, most)
    yield _bounded(gram, needed, np.zeros(len(needed)) if begin is None else begin, most)


def _bounded(
    gram: FloatArray, needed: FloatArray, begin: FloatArray, most: FloatArray
) -> FloatArray | None:
    """Return y by the active-set method of Lawson and Hanson, with Stark and Parker's bounds.

    All multipliers whose slope is more than half the steepest leave their bounds at once. The cost
    still falls, because a multiplier that would be infeasible returns to its bound before others
    move. Multipliers that are zero in the initial guess are free at first if their row is violated.
    """
    y = np.minimum(np.maximum(begin, 0.0), most)
    full = y >= most
    free = ~full & ((y > 0.0) | (needed - gram @ y > KKT_TOLERANCE))
    remaining = needed - gram @ np.where(full, most, 0.0)
    for _ in range(10 * len(y)):  # changes of the active set
        rows = free.nonzero()[0]
        z, failed = np.zeros(0), 0
        if len(rows) > 0:
            _, z, failed = scipy.linalg.lapack.dposv(gram[rows[:, None], rows], remaining[rows])
        if failed:
            break
        out = ((z <= 0.0) | (z >= most[rows])).nonzero()[0]
        if len(out) > 0:
            gone, bounds = rows[out], np.where(z[out] <= 0.0, 0.0, most[rows[out]])
            step, before = z[out] - y[gone], bounds - y[gone]
            parts = np.divide(before, step, out=np.zeros(len(out)), where=step != 0.0)
            part = max(float(parts.min()), 0.0)
            y[rows] += part * (z - y[rows])
            first = (parts <= part).nonzero()[0]
            gone, bounds = gone[first], bounds[first]
            y[gone], free[gone], full[gone] = bounds, False, bounds > 0.0
        else:
            y[rows] = z
            steep = needed - gram @ y
            steep[free] = 0.0
            steep[full] *= -1.0
            worst = float(steep.max())
            if worst <= KKT_TOLERANCE:
                return y
            gone = (steep > 0.5 * worst).nonzero()[0]
            bounds = y[gone]
            free[gone], full[gone] = True, False
        if bounds.any():  # the set at upper bounds has changed
            remaining = needed - gram @ np.where(full, most, 0.0)
    return None


def _unbounded(gram: FloatArray, needed: FloatArray) -> FloatArray | None:
    """Return y by non-negative least squares, without upper bounds; None if this fails."""
    from scipy.optimize import nnls  # slow to load, so only where needed

    factor, failed = scipy.linalg.lapack.dpotrf(gram, lower=True, clean=True)
    if not failed:
        with suppress(RuntimeError):  # too many iterations
            y: FloatArray = nnls(
                factor.T, scipy.linalg.lapack.dtrtrs(factor, needed, lower=True)[0]
            )[0]
            return y
    return None


NAME = "NNLS"
"""Name of non-negative least squares as a solver of programs."""

_RIDGE = 1e-13
"""Regularisation of the Gram matrix's diagonal, relative to its largest entry, which gives linearly
dependent rows a Cholesky factor too."""

_ZERO = 1e-11
"""Length below which a row counts as zero, as it does in DAQP."""

_FAR = 1e8
"""Norm of x, relative to the right-hand sides, beyond which a program counts as infeasible."""


def solved_by_daqp(program: DenseProgram) -> Solution | None:
    """Return DAQP's solution or proof of infeasibility; None if the check of either fails."""
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


def solved_by_least_squares(program: DenseProgram) -> Solution | None:
    """Return the point of least norm that satisfies hard rows, or a checked proof of none.

    The dual is solved by non-negative least squares; None if neither passes its check.
    """
    start = time.perf_counter()
    gram = program.matrix @ program.matrix.T
    y = _unbounded(gram + _RIDGE * gram.max() * np.eye(len(gram)), program.needed)
    if y is not None and is_optimal(
        gram @ y - program.needed, program.needed, y, program.penalties
    ):
        found, seconds = y, time.perf_counter() - start
        return Solution(y @ program.matrix, True, NAME, seconds, lambda: 2.0 * found)
    return _refuted(program, time.perf_counter() - start, NAME)


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
    for _ in range(2):  # refinements, since the ridge leaves residuals in active rows
        y[free] += np.linalg.solve(own, (program.needed - gram @ y)[free])
    if not is_optimal(gram @ y - program.needed, program.needed, y, most):
        return None
    x, seconds = y @ program.matrix, time.perf_counter() - start
    return Solution(x, True, daqp.NAME, seconds, lambda: 2.0 * y)


def _refuted(program: DenseProgram, seconds: float, solver: str = daqp.NAME) -> Solution | None:
    """Return the proof that there is no solution; None if no weights prove it."""
    hard = np.isinf(program.penalties)
    weights = contradiction(program.matrix[hard], program.needed[hard])
    if weights is None:
        return None
    every = np.zeros(len(hard))
    every[hard] = weights
    x = np.zeros(program.matrix.shape[1])
    return Solution(x, False, solver, seconds, lambda: every)


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
    from scipy.optimize import nnls  # slow to load, so only where needed

    lengths = np.linalg.norm(matrix, axis=1)
    impossible = (lengths < _ZERO) & (needed > _ZERO)
    if impossible.any():  # 0 x >= b > 0
        return np.where(impossible, 1.0, 0.0)
    lengths = np.where(lengths < _ZERO, np.inf, lengths)
    least = needed / lengths
    least /= max(np.abs(least).max(), np.finfo(float).tiny)
    rows = np.concatenate([(matrix / lengths[:, None]).T, least[None]])
    try:
        weights, residual = nnls(rows, np.append(np.zeros(len(rows) - 1), 1.0))
    except RuntimeError:  # too many iterations
        return None
    found: FloatArray = weights / lengths
    return found if residual < 1.0 / _FAR else None
