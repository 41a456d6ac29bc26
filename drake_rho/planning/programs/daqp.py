"""DAQP, an active-set solver for small dense programs, beside Drake's solvers.

What it says is not taken on trust: a solution has to meet the conditions of an optimum, and a
program counts as one without a solution only with weights that prove it. What does not pass, is
linear, or is larger than this solver is for, goes on to Drake's (`solve`).
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from pydrake.solvers import SolverId
from scipy.optimize import nnls

from drake_rho.planning.errors import NotInstalledError
from drake_rho.planning.programs.dense import DenseProgram, Program
from drake_rho.planning.programs.quadratic import Quadratic
from drake_rho.planning.programs.solution import Solution
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray

NAME = "DAQP"

_HARD = {"primal_tol": 1e-10, "iter_limit": 2000}
"""By how much a row of length one may be broken: two digits less than the loop adds rows for. Small
programs take as many iterations as they have rows."""

_FLAT = {**_HARD, "primal_tol": 1e-12, "eps_prox": -1e-4, "eta_prox": 1e-12}
"""For costs that are flat in some directions, as in slacks. Only these are made strictly convex,
and solved again around the last solution until it stays. At DAQP's own values penalties from 1 to
10 000 in one program come out wrong in the fourth digit."""

_RIDGE = 1e-13
"""Added to the squares of rows' lengths, as part of the largest, so that dependent ones have a
factor."""

_KEPT = 1e-9
"""How far bounds and costs may be missed, as part of the largest bound or of the cost."""

_STIFF = 1e-7
"""What contradictory rows are broken by for each unit of their multipliers."""

_MAY_BE_BROKEN = 8
"""DAQP's code for a row that may be broken at the cost of its slack squared."""

_MOST_TRIALS = 60
"""Guesses of which rows are broken; four are needed in the mean."""

_TOGETHER = 15
"""Guesses that put all wrong rows right at once. If they go round in circles, those after them put
the first one right only."""

_ZERO = 1e-11
"""Length below which a row counts as zero, in DAQP as well."""

_INFINITE = 1e30
"""What DAQP takes for it."""

_OPTIMAL, _OPTIMAL_BUT_BROKEN, _INFEASIBLE = 1, 2, -1
"""Exit flags."""

_EQUATION = 5
"""Its code for a row that is one."""

_MOST = 400
"""Variables up to which a program of Drake's is read: beyond, its zeros cost more than its rows."""

_FAR = 1e8
"""Norm of x, in units of the bounds, beyond which there is no solution."""


@dataclasses.dataclass(frozen=True)
class Daqp(metaclass=Described):
    """DAQP as `solver=`, beside Drake's solvers: fast where programs are small and dense.

    Linear programs, those with states (variables that equations tie to others and that cost
    nothing, as in the sparse form), those of more than 400 variables in Drake's form, and what DAQP
    does not solve to the package's tolerances are solved by Clarabel.

    Raises:
        NotInstalledError: the package daqp is not there; it is an ImportError.
    """

    def __post_init__(self) -> None:
        _package()

    def available(self) -> bool:
        """True: else it could not have been made."""
        return True

    def enabled(self) -> bool:
        """True: it needs no licence."""
        return True

    def solver_id(self) -> SolverId:
        """Its name, as Drake's solvers have one."""
        return SolverId(NAME)

    def knows(self, program: Program) -> bool:
        """Whether it is for programs of this kind."""
        if isinstance(program, DenseProgram):
            return not program.linear
        curved = sum(len(cost.variables()) for cost in program.quadratic_costs())
        states = curved < program.num_vars() and len(program.linear_equality_constraints()) > 0
        return curved > 0 and program.num_vars() <= _MOST and not states

    def solve(self, programs: Sequence[Program]) -> list[Solution | None]:
        """The solution of each program, or the proof that there is none; None where it fails."""
        return [_solved(program) for program in programs]


def least_within(products: FloatArray, needed: FloatArray, most: FloatArray) -> FloatArray | None:
    """The y, 0 <= y <= most, that minimises y · products @ y / 2 - needed · y.

    Args:
        products: positive definite, shape (R, R).
        needed: shape (R,).
        most: above 0, shape (R,).

    Returns:
        y, those at a bound exactly so, shape (R,); None where it is not found.
    """
    count = len(needed)
    zero, sense = np.zeros(count), np.zeros(count, dtype=np.int32)
    y, _, flag, info = _package().solve(
        products, -needed, np.zeros((0, count)), np.minimum(most, _INFINITE), zero, sense, **_HARD
    )
    if flag != _OPTIMAL:
        return None
    pull: FloatArray = info["lam"]
    none, full = pull < 0.0, pull > 0.0
    y = np.where(none, 0.0, np.where(full, most, y))
    slope = products @ y - needed
    slope[none], slope[full] = np.minimum(slope[none], 0.0), np.maximum(slope[full], 0.0)
    within = y.min() >= 0.0 and np.all(y <= most)
    return y if within and np.abs(slope).max() <= _KEPT * max(1.0, np.abs(needed).max()) else None


@cache
def _package() -> Any:
    """The package, which is not needed where this solver is not asked for."""
    try:
        return importlib.import_module("daqp")
    except ImportError as error:
        raise NotInstalledError(
            "rho.Daqp() needs the package daqp: pip install 'drake-rho[fast]'"
        ) from error


def _solved(program: Program) -> Solution | None:
    if not isinstance(program, DenseProgram):
        quadratic = Quadratic.read(program)
        return None if quadratic is None else _solved_quadratic(quadratic)
    if not program.soft:
        return _solved_hard(program)
    return _solved_soft(program) or _solved_in_span(program)


def _solved_hard(program: DenseProgram) -> Solution | None:
    """The point of least norm that keeps all rows, which is DAQP's own form of a program."""
    matrix, needed = np.ascontiguousarray(program.matrix), np.ascontiguousarray(program.needed)
    upper, sense = np.full(len(needed), _INFINITE), np.zeros(len(needed), dtype=np.int32)
    x, _, flag, info = _package().solve(None, None, matrix, upper, needed, sense, **_HARD)
    if flag == _INFEASIBLE:
        return _refuted(matrix, needed, matrix.shape[1], lambda weights: weights, info)
    y = -2.0 * info["lam"]
    kept = flag == _OPTIMAL and (matrix @ x >= needed - 10 * _HARD["primal_tol"]).all()
    return _solution(x, lambda: y, info) if kept else None


def _solved_soft(program: DenseProgram) -> Solution | None:
    """The point of least cost where rows may be broken, by points of least norm; None if not found.

    A row that is broken pulls with all of its penalty, and the others are hard rows. Which are
    broken is found out: those whose multipliers are above their penalties count as broken until
    they are kept. The points lie in the span of the rows, in which their factor stands for them.
    """
    needed, penalties = program.needed, program.penalties
    if len(np.unique(program.slacks)) < len(needed):
        return None  # penalties bound sums of multipliers
    half: FloatArray = program.matrix @ program.matrix.T / 2.0
    ridge = _RIDGE * half.max() * np.eye(len(needed))
    try:
        factor = np.linalg.cholesky(2.0 * half + ridge)
    except np.linalg.LinAlgError:
        return None
    broken, seconds = np.zeros(len(needed), dtype=bool), 0.0
    for trial in range(_MOST_TRIALS):
        y = np.where(broken, penalties, 0.0)
        left: FloatArray = np.where(broken, -_INFINITE, needed - half @ y)
        found = _least_norm(factor, left, np.isfinite(penalties))
        if found is None:
            return None
        info, contradictory = found
        seconds += float(info["setup_time"] + info["solve_time"])
        y -= 2.0 * np.where(broken, 0.0, info["lam"])
        above = ~broken & (y > (1.0 + _KEPT) * penalties)
        kept = broken & (half @ y - needed > _KEPT)
        if not np.any(above | kept):
            if contradictory:
                return None
            pulling = np.flatnonzero(~broken & (y != 0.0))
            own = (half + ridge)[np.ix_(pulling, pulling)]
            for _ in range(2):  # what the ridge has left
                y[pulling] += np.linalg.solve(own, (needed - half @ y)[pulling])
            return _of_multipliers(program, y, broken, seconds)
        wrong = above | kept
        if trial >= _TOGETHER:
            wrong[wrong.nonzero()[0][1:]] = False
        broken ^= wrong
    return None


def _least_norm(
    matrix: FloatArray, needed: FloatArray, soft: BoolArray
) -> tuple[dict[str, Any], bool] | None:
    """What DAQP tells of the point of least norm, and whether hard rows contradict each other.

    Then those that may be broken are, at a cost that is far above their penalties.
    """
    upper, sense = np.full(len(needed), _INFINITE), np.zeros(len(needed), dtype=np.int32)
    *_, flag, info = _package().solve(None, None, matrix, upper, needed, sense, **_HARD)
    if contradictory := flag != _OPTIMAL:
        sense[soft] = _MAY_BE_BROKEN
        options = {**_HARD, "rho_soft": _STIFF}
        *_, flag, info = _package().solve(None, None, matrix, upper, needed, sense, **options)
    done = flag in (_OPTIMAL, _OPTIMAL_BUT_BROKEN) and np.isfinite(info["lam"]).all()
    return (info, contradictory) if done else None


def _of_multipliers(
    program: DenseProgram, y: FloatArray, broken: BoolArray, seconds: float
) -> Solution | None:
    """The solution with these multipliers of the rows; None if they are not those of an optimum."""
    x = y @ program.matrix / 2.0
    short = program.needed - program.matrix @ x
    slack = np.where(broken, short, 0.0)
    short -= slack
    gap = float(np.abs(y[~broken] * short[~broken]).sum())
    cost = float(x @ x + slack[broken] @ program.penalties[broken])
    largest = max(1.0, float(np.abs(program.needed).max()))
    exact = gap <= _KEPT * max(cost, _KEPT) and np.all(y >= -_KEPT * max(1.0, np.abs(y).max()))
    exact &= np.all(y <= (1.0 + 2.0 * _KEPT) * program.penalties)
    if not exact or max(short.max(), -slack.min()) > _KEPT * largest:
        return None
    return Solution(x, True, NAME, seconds, lambda: y)


def _solved_in_span(program: DenseProgram) -> Solution | None:
    """Soft rows in any case, with slacks as variables beside those of the span of the rows."""
    basis, triangle = np.linalg.qr(program.matrix.T)
    reduced = dataclasses.replace(program, matrix=triangle.T)
    found = _solved_quadratic(Quadratic.of_dense(reduced))
    if found is None:
        return None
    return dataclasses.replace(found, x=basis @ found.x[: basis.shape[1]])


def _solved_quadratic(program: Quadratic) -> Solution | None:
    """Any cost: where it is flat, as in slacks, by DAQP's proximal-point iterations."""
    lower = np.maximum(program.lower, -_INFINITE)
    upper = np.minimum(program.upper, _INFINITE)
    sense = np.where(lower == upper, _EQUATION, 0).astype(np.int32)
    x, _, flag, info = _package().solve(
        program.hessian, program.linear, program.matrix, upper, lower, sense, **_FLAT
    )
    if flag == _INFEASIBLE:
        matrix, needed, signs = program.one_sided()
        return _refuted(
            matrix, needed, len(x), lambda weights: program.of_rows(signs @ weights), info
        )
    if flag != _OPTIMAL or not program.is_solved_by(x, -info["lam"]):
        return None
    y = program.of_rows(-info["lam"])
    return _solution(x, lambda: y, info)


def _refuted(
    matrix: FloatArray,
    needed: FloatArray,
    size: int,
    of_rows: Callable[[FloatArray], FloatArray],
    info: dict[str, Any],
) -> Solution | None:
    """That there is no solution, with weights that prove it; None if they do not."""
    weights = contradiction(matrix, needed)
    if weights is None:
        return None
    y = of_rows(weights)
    return dataclasses.replace(_solution(np.zeros(size), lambda: y, info), feasible=False)


def contradiction(matrix: FloatArray, needed: FloatArray) -> FloatArray | None:
    """Weights y >= 0 with matrix.T @ y = 0 and needed · y > 0; None if there are none (Farkas).

    By Lawson and Hanson: y >= 0 that bring (matrix.T @ y, needed · y) closest to (0, 1) reach it if
    rows contradict each other; else what they leave over points to the x of least norm.
    """
    lengths = np.linalg.norm(matrix, axis=1)
    alone = (lengths < _ZERO) & (needed > _ZERO)
    if alone.any():  # 0 x >= b > 0
        return np.where(alone, 1.0, 0.0)
    lengths = np.where(lengths < _ZERO, np.inf, lengths)
    least = needed / lengths
    least /= max(np.abs(least).max(), np.finfo(float).tiny)
    rows = np.concatenate([(matrix / lengths[:, None]).T, least[None]])
    try:
        weights, left = nnls(rows, np.append(np.zeros(len(rows) - 1), 1.0))
    except RuntimeError:  # it did not come to an end
        return None
    found: FloatArray = weights / lengths
    return found if left < 1.0 / _FAR else None


def _solution(
    x: FloatArray, multipliers: Callable[[], FloatArray], info: dict[str, Any]
) -> Solution:
    seconds = float(info["setup_time"] + info["solve_time"])
    return Solution(x, True, NAME, seconds, multipliers)
