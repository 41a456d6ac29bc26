"""Minimum-time planning: `plan_minimum_time` and `shortest_plan`."""

from __future__ import annotations

from typing import Literal

from drake_rho.analysis.time_search import TimeSearch
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import DEFAULTS, Options
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.programs.backend import Backend, Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.objective import check_only_effort
from drake_rho.scenario.penalties import NO_COST, check_no_penalties
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.system.threads import single_threaded_blas

Arrival = Literal["together", "each"]
"""Arrival at the goals: all together, or each vehicle as early as it can."""


@checked
@with_wall_time
def shortest_plan(
    scenario: Scenario,
    *,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return the plan of least duration with the same number of knots: `plan_minimum_time`.

    Args and errors are those of `plan_minimum_time`.
    """
    return plan_minimum_time(scenario, solver=solver, progress=progress, options=options)


@checked
@with_wall_time
@with_time_limit
@single_threaded_blas
def plan_minimum_time(
    scenario: Scenario,
    *,
    knots: int | None = None,
    arrival: Arrival = "together",
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return a minimum-time plan.

    The final time is free, and so is the time of every waypoint without one; a vehicle passes these
    in their order. From rest to rest without obstacles, separation and free waypoints the program
    is convex, and no plan with as many knots takes less time. Otherwise it is linearised until the
    time has converged, to the least time near the initial motions of the search.

    Args:
        scenario: scenario to plan for. Its step is a first guess of the plan's.
        knots: number of knots of the plan; the scenario's if not given. With a smoothing no step is
            shorter than its width, so that fewer knots may take less time.
        arrival: "together", all at the last knot; or "each", every vehicle at the earliest knot
            found, and then at rest at its goal. The last arrival is no later than "together".
        solver: solver of the first plans, as for `plan`. Programs with a free final time are
            solved by Clarabel.
        progress: called with a short description of the current step, as after each iteration.
        options: `time_limit`, after which the plan of least time so far is returned
            (`statistics.cut`), and the bounds of the searches for first plans.

    Returns:
        A plan that meets every constraint. Its scenario has the final time and the waypoint times
        found. It takes no longer than the scenario's own final time if `plan` finds a plan for
        that.

    Raises:
        InfeasibleError: no plan was found for any final time tried, or vehicles cannot hold at
            their goals from the least time on (`Scenario.hold_at_goal`).
        OutOfTimeError: time was up before a plan was found.
        ScenarioError: no limit and no requirement bounds the time, a limit is soft, the scenario
            does not fit the number of knots, or its objective has other terms than effort.
        SolverError: the solvers fail numerically.

    Examples:
        >>> scenario = rho.Scenario(
        ...     "race",
        ...     rho.Grid(step=0.1, knots=61),
        ...     [
        ...         rho.Vehicle(
        ...             "racer",
        ...             rho.State([0, 0, 1]),
        ...             rho.State([8, 0, 1]),
        ...             waypoints=[rho.Waypoint(None, [2, 2, 1]), rho.Waypoint(None, [6, -2, 1])],
        ...         )
        ...     ],
        ...     limits=rho.Limits(max_acceleration=8.0),
        ... )
        >>> plan = rho.plan_minimum_time(scenario)
        >>> print(f"{plan.scenario.grid.duration:.2f} s")
        3.48 s
    """
    check_only_effort(scenario.objective, "where the time is minimised")
    check_no_penalties(scenario.penalties, NO_COST)
    grid = scenario.grid
    if knots is not None:
        grid = Grid(grid.duration / max(knots - 1, 1), knots, grid.start)
    each, options = arrival == "each", options or DEFAULTS
    backend = Backend.of(solver, options=options.solver_options)
    search = TimeSearch(scenario, grid, backend, progress, options, each=each)
    return search.plan()
