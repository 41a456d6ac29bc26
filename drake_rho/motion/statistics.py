"""Statistics of planning: counts, times and convergence."""

from __future__ import annotations

import dataclasses
from typing import Literal

from pydantic import ConfigDict

from drake_rho.scenario.described import Described


@dataclasses.dataclass(frozen=True, kw_only=True)
class PathSearch:
    """Grid on which collision-free paths were searched, and their number."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # applies when it is read from files

    spacing: float = 0.0
    """greatest distance of neighbours along an axis of the finest grid [m]; 0 if every grid
    exceeds the memory limit"""
    points: int = 0
    """number of points of the grid, free and occupied ones"""
    layers: int = 0
    """number of time steps of space-time paths; 0 for paths in space only"""
    orders: int = 0
    """number of priority orders tried on all grids; 0 without prioritized planning"""
    ways: int = 0
    """number of paths found; paths of vehicles planned together count as one"""

    def __str__(self) -> str:
        """Return a description of the result and the grid."""
        if self.points == 0:
            return "every grid for paths would take more than `max_memory`"
        if self.ways == 0:
            return f"no path was found on a grid of {self.spacing:.2g} m"
        found = "1 path was" if self.ways == 1 else f"{self.ways} paths were"
        return f"{found} found on a grid of {self.spacing:.2g} m and tried"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Statistics(metaclass=Described):
    """Statistics of planning: counts, times and convergence."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # applies when it is read from files

    programs: int = 0
    """number of quadratic programs solved"""
    rows: int = 0
    """number of rows added because a solution violated them"""
    linearisations: int = 0
    """number of references around which (8) was linearised"""
    converged: bool = True
    """true unless an iterative planner stopped before the cost fell by less than `tolerance`"""
    cut: bool = False
    """true if a time limit or Ctrl-C stopped the planner before it converged"""
    last_fall: float | None = None
    """relative decrease of the cost in the last linearisation; None without iterations"""
    tolerance: float | None = None
    """relative decrease of the cost in one linearisation below which an iteration has converged;
    None without iterations"""
    minimised: Literal["cost", "time"] | None = "cost"
    """what the planner minimised, the cost or the final time; None if a plan of least time is held
    at its goals, and so ends later"""
    time_bound: float | None = None
    """time that every plan on as many knots takes at least [s]: the least time of the slowest
    vehicle without obstacles and other vehicles; None if it is not known"""
    steps_tried: tuple[float, ...] = ()
    """steps h in the order tried [s], ending with that of the plan; empty without a choice"""
    solver: str = ""
    """solver of the last program"""
    solver_seconds: float = 0.0
    """sum of the times reported by solvers [s]; it may exceed the wall time if they ran in
    parallel"""
    seconds: float = 0.0
    """wall time from a planner's call to its return [s]; for a window, that of the whole update;
    for windows planned during a flight, their sum"""
    searched: PathSearch | None = None
    """last search for collision-free paths; None if a plan was found, or planning ended, without"""
    detours: int = 0
    """number of other sides of obstacles that were tried to save cost once a plan had converged"""

    def held(self) -> Statistics:
        """Return the statistics of a plan that is held at its goals, and so ends later."""
        if self.minimised != "time":
            return self
        return dataclasses.replace(self, minimised=None, time_bound=None)

    def with_work(self, spent: Statistics) -> Statistics:
        """Return the statistics of the same plan with the work that went into other plans."""
        return dataclasses.replace(
            self + spent,
            converged=self.converged,
            cut=self.cut or spent.cut,
            last_fall=self.last_fall,
            tolerance=self.tolerance,
        )

    def __add__(self, other: Statistics) -> Statistics:
        """Return the sums of counts and times, and the other values of the later `other` if set."""
        return Statistics(
            programs=self.programs + other.programs,
            rows=self.rows + other.rows,
            linearisations=self.linearisations + other.linearisations,
            solver_seconds=self.solver_seconds + other.solver_seconds,
            seconds=self.seconds + other.seconds,
            converged=self.converged and other.converged,
            cut=self.cut or other.cut,
            last_fall=self.last_fall if other.last_fall is None else other.last_fall,
            minimised=self.minimised,
            time_bound=self.time_bound if other.time_bound is None else other.time_bound,
            solver=other.solver or self.solver,
            tolerance=other.tolerance or self.tolerance,
            steps_tried=other.steps_tried or self.steps_tried,
            searched=other.searched or self.searched,
            detours=self.detours + other.detours,
        )
