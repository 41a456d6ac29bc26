"""What it took to find a plan."""

from __future__ import annotations

import dataclasses

from pydantic import ConfigDict

from drake_rho.scenario.described import Described


@dataclasses.dataclass(frozen=True, kw_only=True)
class Searched:
    """Where ways among obstacles and vehicles were looked for."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # for reading it from files

    spacing: float = 0.0
    """greatest distance of neighbours along an axis of the finest grid [m]; 0 if every grid
    takes more memory than it may"""
    points: int = 0
    """how many points it has, clear ones and others"""
    layers: int = 0
    """in how many moves a way was to lead to its goal; 0 where time did not matter"""
    orders: int = 0
    """in how many orders vehicles were planned, on all grids; 0 where the order did not matter"""
    ways: int = 0
    """how many ways were found, of all vehicles together where they were looked for together"""

    def __str__(self) -> str:
        """What was found, and on which grid."""
        if self.points == 0:
            return "every grid for ways would take more than `max_memory`"
        if self.ways == 0:
            return f"no way was found on a grid of {self.spacing:.2g} m"
        found = "1 way was" if self.ways == 1 else f"{self.ways} ways were"
        return f"{found} found on a grid of {self.spacing:.2g} m and tried"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statistics(metaclass=Described):
    """What it took to find a plan."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # for reading it from files

    programs: int = 0
    """quadratic programs solved"""
    rows: int = 0
    """rows added because a solution broke them"""
    linearisations: int = 0
    """references around which (8) was linearised"""
    converged: bool = True
    """whether an iterated planner stopped because the cost fell by less than `tolerance`"""
    cut: bool = False
    """whether time was up before that, by a time limit or by Ctrl-C"""
    last_fall: float | None = None
    """by what part of itself the cost fell in the last linearisation; None where nothing was
    iterated"""
    tolerance: float | None = None
    """relative fall of the cost in one linearisation below which an iteration counts as converged;
    None where nothing was iterated"""
    steps_tried: tuple[float, ...] = ()
    """steps h in the order tried [s], the plan's own last; empty if there was no choice"""
    solver: str = ""
    """solver of the last program"""
    solver_seconds: float = 0.0
    """time the solvers report for themselves [s]; over 1 per second if they ran side by side"""
    seconds: float = 0.0
    """wall time from the call of a planner to its return [s]; of a window that of the whole step,
    of windows that are flown as they come the sum"""
    searched: Searched | None = None
    """where ways were looked for, last; None if a plan was found without, or given up before"""

    def __add__(self, other: Statistics) -> Statistics:
        """Counts and times of both; the rest as in `other`, which came later, if it says so."""
        return Statistics(
            programs=self.programs + other.programs,
            rows=self.rows + other.rows,
            linearisations=self.linearisations + other.linearisations,
            solver_seconds=self.solver_seconds + other.solver_seconds,
            seconds=self.seconds + other.seconds,
            converged=self.converged and other.converged,
            cut=self.cut or other.cut,
            last_fall=self.last_fall if other.last_fall is None else other.last_fall,
            solver=other.solver or self.solver,
            tolerance=other.tolerance or self.tolerance,
            steps_tried=other.steps_tried or self.steps_tried,
            searched=other.searched or self.searched,
        )
