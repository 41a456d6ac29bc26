"""`certify_time`: lower bound on the final time of every plan, and the gap of a given plan.

Each vehicle is bounded alone, by branch and bound (`drake_rho.analysis.time_bounds`), and the
largest bound holds for the fleet. Constraints that are left out only lower it. Bounds are optimal
values of convex programs solved to 1e-8, less a millionth.
"""

from __future__ import annotations

from drake_rho.analysis.time_bounds import TimeBound
from drake_rho.analysis.time_certificate import TimeCertificate, VehicleTimeBound
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import with_time_limit
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.objective import check_only_effort
from drake_rho.scenario.penalties import NO_COST, check_no_penalties
from drake_rho.scenario.records import Scenario
from drake_rho.system.numbers import percent
from drake_rho.system.threads import single_threaded_blas
from drake_rho.verification.verify import verify

_MOST = 1000
"""Largest number of relaxations besides the first of each vehicle."""


@checked
@with_time_limit
@single_threaded_blas
def certify_time(
    plan: Plan,
    *,
    gap: float = 0.01,
    progress: Progress | None = None,
    time_limit: float | None = None,
) -> TimeCertificate:
    """Compute a lower bound on the final time of every plan, and the gap of a given plan.

    The bound holds for plans with the same number of knots and a uniform step, on any side of the
    obstacles. It is that of the slowest vehicle alone. Waypoints may be passed at any times, in the
    order of this plan.

    Args:
        plan: any plan of a scenario, such as one of `plan_minimum_time`.
        gap: relative gap, 0 or more, at which the search for a better bound ends.
        progress: called with the bound so far.
        time_limit: seconds, above 0, after which the best bound so far is returned (`cut`). Without
            one, the search ends after a thousand programs.

    Raises:
        OutOfTimeError: time was up before there was a bound.
        ScenarioError: the objective has other terms than effort.
        ValueError: the gap is negative.

    Examples:
        >>> limits = rho.Limits(max_acceleration=2.0)
        >>> ends = rho.State([0, 0, 1]), rho.State([8, 0, 1])
        >>> scout = rho.Vehicle("scout", *ends, radius=0.2)
        >>> ball = rho.Sphere([4, 0.3, 1], 0.8)
        >>> scenario = rho.Scenario("one", rho.Grid(0.2, 21), [scout], limits, obstacles=[ball])
        >>> certificate = rho.certify_time(rho.plan_minimum_time(scenario))
        >>> certificate.gap <= 0.01
        True
    """
    if not gap >= 0.0:
        raise ValueError(f"gap: got {gap!r}, expected a number of at least 0")
    scenario = plan.scenario
    check_only_effort(scenario.objective, "where the time is minimised")
    check_no_penalties(scenario.penalties, NO_COST)
    duration = scenario.grid.duration
    bounds = list[TimeBound]()
    for number, vehicle in enumerate(scenario.vehicles):
        tell(progress, f"bounding the least time of {vehicle.name}")
        bounds.append(TimeBound(scenario.of_vehicles([number]), duration))
    improving, cut = list(bounds), False
    first = sum(each.relaxations for each in bounds)
    try:
        while improving and max(each.bound for each in bounds) < (1.0 - gap) * duration:
            if sum(each.relaxations for each in bounds) - first >= _MOST and time_limit is None:
                cut = True
                break
            slowest = max(improving, key=lambda each: each.bound)
            if not slowest.improve():
                improving.remove(slowest)
            part = 1.0 - max(each.bound for each in bounds) / duration
            tell(progress, f"bounding the least time: gap {percent(part)}")
    except OutOfTimeError:
        cut = True
    return TimeCertificate(
        scenario,
        tuple(
            VehicleTimeBound(vehicle.name, each.bound)
            for vehicle, each in zip(scenario.vehicles, bounds, strict=True)
        ),
        verify(plan).ok,
        _left_out(scenario, bounds),
        sum(each.relaxations for each in bounds),
        cut,
    )


def _left_out(scenario: Scenario, bounds: list[TimeBound]) -> tuple[str, ...]:
    """Return the constraints that a scenario's bound leaves out."""
    several = len(scenario.vehicles) > 1
    present = {
        "the separation": several and scenario.separation is not None,
        "the requirements": not all(each.at_waypoint for each in scenario.required),
        "the velocities and dwells at waypoints": any(e.at_waypoint for e in scenario.required),
        "the disturbance": scenario.disturbance is not None,
        "the margin of the smoothing": scenario.smoothing is not None,
        "the growth of errors of obstacles": any(e.velocity_error > 0.0 for e in scenario.bodies),
    }
    names = set[str]().union(*(each.left_out for each in bounds))
    return (*(words for words, is_left_out in present.items() if is_left_out), *sorted(names))
