"""`plan_rho`: a whole flight by the receding horizon, undisturbed."""

from __future__ import annotations

from drake_rho.motion.flight import Flight
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.horizon.interfaces import (
    Planner,
    Reference,
)
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.planning.planners.plan import plan as best_plan
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas


@checked
@with_wall_time
@with_time_limit
@single_threaded_blas()
def plan_rho(
    scenario: Scenario,
    *,
    replan_every: int = 5,
    free_final_time: bool = False,
    planner: Planner = plan_convex,
    fallback: Planner | None = best_plan,
    reference: Reference | None = None,
    solver: Solver | SolverName | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
    contingencies: bool = False,
    bounded_cost: bool = False,
) -> Flight:
    """Fly with a receding horizon that shrinks towards the goals and the arrival time.

    Each window plans from the current state to the goal and is flown for `replan_every` steps. If
    the planner has no solution, the fallback plans from the tail of the previous prediction. If it
    has none either, the window continues along the tail, which is still valid, and its
    `Window.infeasible` gives the reason.

    This is `RecedingHorizon` with perfect measurements: every window begins at the states planned
    for its start. In a scenario with a disturbance each window has a new error tube, and disturbed
    flights within that tube meet all constraints.

    A window avoids the obstacles that are known at its start. If an obstacle becomes known too late
    to be avoided, the plan that violates its distance least is flown, and planning continues from
    there; `Flight.sightings` lists when which obstacle became known.

    With a smoothing, the flight is the average of all windows' accelerations as one plan. Averages
    reach ahead: what becomes known in flight is known to windows that begin `Scenario.lead` later.

    Args:
        scenario: to be flown.
        replan_every: d, the steps flown of each window; the last window has the remaining ones.
        free_final_time: whether windows arrive at the earliest knot for which a plan is found, and
            vehicles then rest; the grid's last knot is the latest arrival.
        planner: plans one window.
        fallback: plans a window, including the first, if `planner` has no solution or its solvers
            fail; None to continue along the tail at once.
        reference: motion around which a window is linearised: `free_reference` (the paper's),
            `tail_reference`, or another function of this form. By default the paper's and, for
            fleets with a separation, the tail, which is a plan for the next window already.
        solver: `"clarabel"`, `"daqp"` or `"osqp"`, or a Drake solver; Clarabel if not given.
        progress: called with a short text when a window begins, as 'window 3 of 10'.
        options: of this package's planners. When the flight exceeds `time_limit`, the previous plan
            is continued.
        contingencies: whether windows have contingencies, as those of `RecedingHorizon`.
        bounded_cost: whether no window costs more than the rest of the one before.

    Returns:
        The flight; `flight.plan` meets every constraint of the scenario, except for obstacles that
        became known too late.

    Raises:
        InfeasibleError: the first window has no solution, even with the fallback.
        OutOfTimeError: the time limit expired before the first window had a plan.
        SolverError: the solvers fail numerically in the first window, even with the fallback.
        ValueError: `replan_every` is not a whole number of at least 1.
        ScenarioError: a vehicle moves at its goal and the final time is free.

    Examples:
        >>> flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=5)
        >>> len(flight.windows), flight.plan
        (10, <Plan of paper: 4 vehicles, 50 knots, cost 17027.2 m²/s⁴>)
    """
    horizon = RecedingHorizon(
        scenario,
        replan_every=replan_every,
        free_final_time=free_final_time,
        planner=planner,
        fallback=fallback,
        reference=reference,
        solver=solver,
        progress=progress,
        options=options,
        contingencies=contingencies,
        bounded_cost=bounded_cost,
    )
    times = scenario.grid.times
    for knot in horizon.knots:
        horizon.step(horizon.planned(knot), times[knot])
    return horizon.flight
