"""DAQP, an active-set solver for small dense programs, beside Drake's solvers.

It solves hard rows in its own form, and rows that may be violated by their dual
(`drake_rho.planning.programs.dual`). No answer is taken on trust: a solution has to meet the
optimality conditions, and a program counts as one without a solution only with weights that prove
it. What does not pass, is linear, or is sparse, goes on to Drake's solvers (`solve`).
"""

from __future__ import annotations

import dataclasses
import importlib
from functools import cache
from typing import Any

import numpy as np
from pydrake.solvers import SolverId

from drake_rho.planning.errors import NotInstalledError
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray

NAME = "DAQP"

_OPTIONS = {"primal_tol": 1e-10, "iter_limit": 2000}
"""Largest violation of a row of length one: two digits less than those for which the loop adds
rows. Small programs take as many iterations as they have rows."""

_INFINITE = 1e30
"""What DAQP takes for it."""

_OPTIMAL, _INFEASIBLE = 1, -1
"""Exit flags."""


@dataclasses.dataclass(frozen=True)
class Daqp(metaclass=Described):
    """DAQP as `solver=`, beside Drake's solvers: fast where programs are small and dense.

    Linear programs, programs in the sparse form, and what DAQP does not solve to the package's
    tolerances are solved by Clarabel.

    Raises:
        NotInstalledError: the package daqp is not there; it is an ImportError.
    """

    def __post_init__(self) -> None:
        _package()

    def available(self) -> bool:
        """Return True: else it could not have been made."""
        return True

    def enabled(self) -> bool:
        """Return True: it needs no licence."""
        return True

    def solver_id(self) -> SolverId:
        """Return its name, as Drake's solvers have one."""
        return SolverId(NAME)


@dataclasses.dataclass(frozen=True, eq=False)
class HardAnswer:
    """DAQP's answer to the least norm(x)² with hard rows matrix @ x >= needed."""

    x: FloatArray
    """shape (V,); means nothing unless `optimal`"""
    y: FloatArray
    """multipliers with x = matrix.T @ y, shape (R,); mean nothing unless `optimal`"""
    optimal: bool
    """whether DAQP takes x for the solution"""
    infeasible: bool
    """whether DAQP says that there is no solution"""
    seconds: float
    """time that it reports for itself [s]"""


def with_hard_rows(matrix: FloatArray, needed: FloatArray) -> HardAnswer:
    """Return what DAQP says of the point of least norm that keeps all rows.

    Args:
        matrix: shape (R, V).
        needed: shape (R,).
    """
    matrix, needed = np.ascontiguousarray(matrix), np.ascontiguousarray(needed)
    upper, sense = np.full(len(needed), _INFINITE), np.zeros(len(needed), dtype=np.int32)
    x, _, flag, info = _package().solve(None, None, matrix, upper, needed, sense, **_OPTIONS)
    seconds = float(info["setup_time"] + info["solve_time"])
    return HardAnswer(x, -info["lam"], flag == _OPTIMAL, flag == _INFEASIBLE, seconds)


def bounded_least_squares(
    gram: FloatArray, needed: FloatArray, most: FloatArray
) -> FloatArray | None:
    """Return the y, 0 <= y <= most, that DAQP finds to minimise y · gram @ y / 2 - needed · y.

    Args:
        gram: positive definite, shape (R, R).
        needed: shape (R,).
        most: above 0, may be infinite, shape (R,).

    Returns:
        y, those at a bound exactly so, shape (R,); None where it finds none.
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
    """Return the package, which is not needed where this solver is not asked for."""
    try:
        return importlib.import_module("daqp")
    except ImportError as error:
        raise NotInstalledError(
            "rho.Daqp() needs the package daqp: pip install 'drake-rho[fast]'"
        ) from error
