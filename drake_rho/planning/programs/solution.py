"""What a solver says of one program, whichever it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class Solution:
    """What a solver says of one program."""

    x: FloatArray
    """values of the program's variables; they mean nothing unless `feasible`"""
    feasible: bool
    """whether there is a solution; if not, the solver has proved that there is none"""
    solver: str
    """which solver said so"""
    seconds: float
    """time the solver reports for itself [s]"""
    multipliers: Callable[[], FloatArray]
    """those of the program's linear constraints in their order, bounds of single variables and
    equations left out: at least 0 for rows M x >= b. Those of cones come after them. Of a program
    without a solution they are weights with which its rows contradict each other (Farkas), where
    the solver gives any. Most are never asked for"""
    exact: bool = True
    """whether it is one to the solver's tolerances; else it shows no more than where rows may be
    missing"""
