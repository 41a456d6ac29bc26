"""`plan_minimum_time`: the least time in which vehicles reach their goals."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.planners.first_plan import FirstPlan
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.planning.programs.free_time import Passing
from drake_rho.planning.scp.least_time import LeastTime, Timed
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import FreeWaypoints
from drake_rho.system.threads import single_threaded_blas

_LONGER = 1.3, 2.0, 4.0, 8.0
"""Multiples of the least time without obstacles and other vehicles in which a first plan is sought,
around which both are linearised."""

_GAP = 0.05
"""Least time between waypoints of a vehicle, and from its start and goal, in steps."""


@checked
@with_wall_time
@with_time_limit
@single_threaded_blas()
def plan_minimum_time(
    scenario: Scenario,
    *,
    knots: int | None = None,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return a plan of the least time in which all vehicles reach their goals.

    The final time is free, and so is the time of every waypoint without one. The step of the
    scenario's grid is a first guess.
    """
    grid = scenario.grid
    if knots is not None:
        grid = Grid(grid.duration / (knots - 1), knots, grid.start)
    search = _Search(scenario, grid, Backend.of(solver), progress, options or DEFAULTS)
    return search.plan()


class _Search:
    """Search for the plan of least time of one scenario."""

    def __init__(
        self,
        scenario: Scenario,
        grid: Grid,
        backend: Backend,
        progress: Progress | None,
        options: Options,
    ) -> None:
        self._free = FreeWaypoints.of(scenario.vehicles)
        self._given = scenario
        vehicles = self._free.placed(scenario.vehicles, None)
        self._scenario = dataclasses.replace(scenario, vehicles=vehicles).on_grid(grid)
        self._backend, self._progress, self._options = backend, progress, options
        self._least = LeastTime(backend, progress)

    def plan(self) -> Plan:
        """Return the plan."""
        scenario = self._scenario
        alone = scenario.derived(obstacles=(), separation=None)
        alone = dataclasses.replace(scenario, obstacles=(), separation=None)
        problem = Problem.of(alone)
        start = Timed(problem, problem.effort.motion.accelerations, self._passing(alone.grid))
        best = self._least.from_motion(start)
        if best is None:
            raise SolverError("no solution without obstacles and other vehicles")
        if scenario.avoided or scenario.separation is not None:
            best = self._around_others(best)
        return self._finished(best)

    def _around_others(self, alone: Timed) -> Timed:
        """Return a motion around obstacles and other vehicles."""
        failure: Exception | None = None
        for longer in _LONGER:
            step = longer * alone.problem.scenario.grid.step
            grid = dataclasses.replace(self._scenario.grid, step=step)
            passing = dataclasses.replace(
                alone.passing, times=alone.passing.times * longer, changes=np.full(len(self._free), 12*step), least=_GAP*step
            )
            timed = self._timed(grid, passing.times)
            search = FirstPlan(self._backend, self._progress, self._options)
            try:
                first = search.of_any_duration(Problem.of(timed))
            except (InfeasibleError, SolverError) as error:
                failure = error
                continue
            problem = Problem.of(self._scenario.on_grid(grid))
            best = self._least.from_motion(Timed(problem, first.accelerations, passing))
            if best is not None:
                return best
        raise failure or SolverError("no motion")

    def _timed(self, grid: Grid, times: FloatArray) -> Scenario:
        vehicles = self._free.placed(self._given.vehicles, grid.start + times)
        return dataclasses.replace(self._given, grid=grid, vehicles=vehicles)

    def _finished(self, best: Timed) -> Plan:
        scenario = self._timed(best.problem.scenario.grid, best.passing.times)
        return Plan.from_accelerations(scenario, best.accelerations, self._least.statistics)

    def _passing(self, grid: Grid) -> Passing:
        """Return the free waypoints at times that grow with the roots of distances."""
        free, fleet = self._free, self._scenario.fleet
        times = np.zeros(len(free))
        for i in np.unique(free.vehicles):
            own = np.flatnonzero(free.vehicles == i)
            path = np.vstack([fleet.start_positions[i], free.positions[own], fleet.goal_positions[i]])
            legs = np.sqrt(np.linalg.norm(np.diff(path, axis=0), axis=1))
            times[own] = grid.duration * np.cumsum(legs)[:-1] / legs.sum()
        reach = np.full(len(free), grid.duration / (2 * (1 + np.bincount(free.vehicles).max(initial=0))))
        return Passing(free.vehicles, times, free.positions, free.within, reach, _GAP * grid.step)
