"""Result of one program in a form common to all solvers: `Solution`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from drake_rho.scenario.fields import FloatArray


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
