"""Plans for the scenario's own final time, with which the least time is compared."""

from __future__ import annotations

import dataclasses

from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, within
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.planners.waypoint_times import passing_of
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.gates import Gates
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import AllWaypoints


def planned_in(
    duration: float,
    given: Scenario,
    without: Scenario,
    backend: Backend,
    options: Options,
    progress: Progress | None,
) -> Timed:
    """Return the motion that `rho.plan` finds for a final time.

    Args:
        duration: final time [s].
        given: the scenario; its waypoints may have no time.
        without: the same without waypoints, on a grid with the knots to plan on.
        backend: its solver is used.
        options: bounds of the search.
        progress: called with a short description of the current step.

    Raises:
        InfeasibleError: no plan was found.
        OutOfTimeError: time was up before a plan was found.
        SolverError: the solvers fail numerically.
    """
    grid = dataclasses.replace(without.grid, step=duration / (without.grid.knots - 1))
    planned = best_plan(
        given.ending_with(grid),
        solver=backend.solver,
        options=options,
        progress=within(progress, f"trying a duration of {grid.duration:.5g} s"),
    )
    waypoints = AllWaypoints.of(planned.scenario.vehicles)
    passing = passing_of(
        AllWaypoints.of(given.vehicles),
        without.ending_with(grid),
        grid,
        Gates.of(given.requirements, given.vehicles),
    )
    passing = dataclasses.replace(passing, times=waypoints.times - grid.start)
    return Timed(without, grid.step, planned.accelerations, passing)


def is_too_short(scenario: Scenario, alone: Timed | None, *, given: bool) -> bool:
    """Return whether a scenario's own final time is below a vehicle's least time alone.

    Args:
        scenario: the scenario without waypoints.
        alone: motion in the least time of each vehicle alone, if known.
        given: whether any waypoint has a time, so that `alone` is not in the least time.
    """
    least = alone is not None and scenario.fleet.are_at_rest and not given
    return least and alone is not None and scenario.grid.duration < alone.duration
