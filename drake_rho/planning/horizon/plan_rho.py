"""`plan_rho`: a whole flight by the receding horizon, undisturbed."""

from __future__ import annotations

from typing import Unpack

from drake_rho.motion.flight import Flight
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.settings import Windows, takes_windows
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas


@checked
@with_wall_time
@with_time_limit
@single_threaded_blas
@takes_windows
def plan_rho(scenario: Scenario, **windows: Unpack[Windows]) -> Flight:
    """Fly with a receding horizon that shrinks towards the goals and the arrival time.

    Each window plans from the current state to the goal and is flown for `replan_every` steps. If
    the planner has no solution, the fallback plans around the rest of the previous plan. If it has
    none either, the window continues the previous plan, which is still valid, and its
    `Window.infeasible` gives the reason.

    This is `RecedingHorizon` with perfect measurements: every window begins at the states planned
    for its start. In a scenario with a disturbance each window has a new error tube, and disturbed
    flights within that tube meet all constraints.

    A window avoids the obstacles that are known at its start. If an obstacle becomes known too late
    to be avoided, the plan that violates its distance least is flown, and planning continues from
    there; `Flight.sightings` lists the times at which obstacles became known.

    With a smoothing, the flight is the average of all windows' accelerations as one plan. Averages
    look ahead: an obstacle that becomes known reaches windows that begin `Scenario.lead` later.

    Args:
        scenario: to be flown.
        **windows: settings of windows, as for `RecedingHorizon`. When the whole flight exceeds
            `time_limit` of the options, the previous plan is continued.

    Returns:
        The flight; `flight.plan` meets every constraint of the scenario, except for obstacles that
        became known too late.

    Raises:
        InfeasibleError: the first window has no solution, even with the fallback.
        OutOfTimeError: the time limit expired before the first window had a plan.
        SolverError: the solvers fail numerically in the first window, even with the fallback.
        ValueError: a setting is invalid.
        ScenarioError: a vehicle moves at its goal and the final time is free.

    Examples:
        >>> flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=5)
        >>> len(flight.windows), flight.plan
        (10, <Plan of paper: 4 vehicles, 50 knots, cost 17027.2 m²/s⁴>)
    """
    horizon = RecedingHorizon(scenario, **windows)
    times = scenario.grid.times
    for knot in horizon.knots:
        horizon.step(horizon.planned(knot), times[knot])
    return horizon.flight
