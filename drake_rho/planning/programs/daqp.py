"""DAQP, an active-set solver for small dense programs, as an alternative to Drake's solvers.

DAQP solves programs with hard rows directly, and programs with soft rows by their dual
(`drake_rho.planning.programs.dual`). Answers are checked: a solution has to meet the optimality
conditions, and infeasibility has to be proved by weights. Linear and sparse programs, and those for
which the check fails, go to Drake's solvers (`drake_rho.planning.programs.solve`).
"""

from __future__ import annotations

import dataclasses
import importlib
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import SolverId

from drake_rho.planning.errors import NotInstalledError
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray

NAME = "DAQP"

_OPTIONS = {"primal_tol": 1e-10, "iter_limit": 2000}
"""Largest violation of a row of length one, a hundredth of that for which rows are added, and the
largest number of iterations: small programs need as many as they have rows."""

_INFINITE = 1e30
"""Value that DAQP regards as infinite."""

_OPTIMAL, _INFEASIBLE = 1, -1
"""Exit flags of DAQP."""


@dataclasses.dataclass(frozen=True)
class Daqp(metaclass=Described):
    """DAQP as `solver=`, in addition to Drake's solvers: fast for small, dense programs.

    Clarabel solves linear and sparse programs, and programs that DAQP does not solve to this
    package's tolerances.

    Raises:
        NotInstalledError: the package daqp is not installed; the error is an ImportError.
    """

    def __post_init__(self) -> None:
        _package()

    def available(self) -> bool:
        """Return True: the constructor requires the package."""
        return True

    def enabled(self) -> bool:
        """Return True: DAQP needs no licence."""
        return True

    def solver_id(self) -> SolverId:
        """Return the name in the form of Drake's solvers."""
        return SolverId(NAME)


class HardAnswer(NamedTuple):
    """Answer of DAQP to: minimise norm(x)² subject to hard rows matrix @ x >= needed."""

    x: FloatArray
    """solution, shape (V,); meaningless unless `optimal`"""
    y: FloatArray
    """multipliers with x = matrix.T @ y, shape (R,); meaningless unless `optimal`"""
    optimal: bool
    """whether DAQP reports x as the solution"""
    infeasible: bool
    """whether DAQP reports that there is no solution"""
    seconds: float
    """time reported by DAQP [s]"""


def with_hard_rows(matrix: FloatArray, needed: FloatArray) -> HardAnswer:
    """Return DAQP's answer for the point of least norm that satisfies all rows.

    Args:
        matrix: the coefficients, shape (R, V).
        needed: the right-hand sides, shape (R,).
    """
    matrix, needed = np.ascontiguousarray(matrix), np.ascontiguousarray(needed)
    upper, sense = np.full(len(needed), _INFINITE), np.zeros(len(needed), dtype=np.int32)
    x, _, flag, info = _package().solve(None, None, matrix, upper, needed, sense, **_OPTIONS)
    seconds = float(info["setup_time"] + info["solve_time"])
    return HardAnswer(x, -info["lam"], flag == _OPTIMAL, flag == _INFEASIBLE, seconds)


def bounded_least_squares(
    gram: FloatArray, needed: FloatArray, most: FloatArray
) -> FloatArray | None:
    """Return DAQP's minimiser y of y · gram @ y / 2 - needed · y subject to 0 <= y <= most.

    Args:
        gram: the Gram matrix, positive definite, shape (R, R).
        needed: the right-hand sides, shape (R,).
        most: the upper bounds, positive and possibly infinite, shape (R,).

    Returns:
        y, exactly at its active bounds, shape (R,); None if DAQP fails.
    """
    count = len(needed)
    lower, sense = np.zeros(count), np.zeros(count, dtype=np.int32)
    rows, upper = np.zeros((0, count)), np.minimum(most, _INFINITE)
    y, _, flag, info = _package().solve(gram, -needed, rows, upper, lower, sense, **_OPTIONS)
    slope: FloatArray = info["lam"]
    y = np.where(slope < 0.0, 0.0, np.where(slope > 0.0, most, y))
    return y if flag == _OPTIMAL and np.isfinite(y).all() else None


@cache
def _package() -> Any:
    """Return the package, which is needed only if this solver is chosen."""
    try:
        return importlib.import_module("daqp")
    except ImportError as error:
        raise NotInstalledError(
            "rho.Daqp() needs the package daqp: pip install 'drake-rho[fast]'"
        ) from error
