"""`verify`: every constraint of a scenario, judged from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Flight, Plan, Sighting
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked
from drake_rho.verification.boxes import check_boxes
from drake_rho.verification.course import Course
from drake_rho.verification.kinds import refuse_unchecked
from drake_rho.verification.norms import check_norms
from drake_rho.verification.notes import notes_on, notes_on_simulation, notes_on_tracks
from drake_rho.verification.obstacles import check_obstacles
from drake_rho.verification.report import Check, Report
from drake_rho.verification.separation import check_separation
from drake_rho.verification.simulated import check_simulated, course_of
from drake_rho.verification.states import check_planned
from drake_rho.verification.tubes import Tubes
from drake_rho.verification.waypoints import check_waypoints

__all__ = ["Check", "Report", "verify"]


@checked
def verify(flown: Plan | Flight | Simulation) -> Report:
    """Judge every constraint of the scenario that was planned for.

    Positions and velocities are flown anew from the initial states and the accelerations; those
    of the plan are only compared with them ("dynamics"). Obstacles, separation and position boxes
    are examined at the knots and at every instant, by sampling with lower bounds that leave no
    instant out (`drake_rho.verification.continuous_time`): none is worse than what is told by more
    than a hundredth of the tolerance. A scenario that asks for the knots only (`between_knots`)
    is judged by these, and the other is told beside it. A value that is no number never holds.

    From an obstacle a vehicle keeps its radius, and the deviation of the obstacle's track. One that
    is known later is judged from then on; how close it was before is told in a row of its own.
    All times are on the scenario's clock.

    With a disturbance, a plan is judged with all of its tube: every constraint holds wherever in it
    vehicles are. Limits are tighter by the radius of errors, which is exact at every time; what a
    check tells of it is `Check.errors`. Of a flight every window is judged with its own tube, from
    its first knot to the next window's. Jerk and goal are those of the plan. Nothing of the margins
    that planners keep is used.

    Of a simulation the true motion is judged, without a tube, and so are the limits as they are
    asked; those on accelerations are on the commands, and that on jerk on the plans. A goal is
    reached by who is as close to it as the tube in force lets be.

    The arithmetic is that of double precision. A position at the knots is a sum of 2K terms, none
    larger than the largest of the motion's coordinates and its length scale, so with the unit
    roundoff u = 1.1e-16 it is within 4 K u of that; an instant adds a few roundings more. For the
    paper's data that is below 1e-9 m, a millionth of the least tolerance.

    Args:
        flown: a plan, a flight, of which the whole as flown is judged, or a simulation.

    Returns:
        A report; `report.ok` says whether all holds.

    Examples:
        >>> report = rho.verify(rho.plan(rho.load_scenario("paper")))
        >>> report.ok
        True
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is told as no number
        if isinstance(flown, Simulation):
            course = course_of(flown)
            jerks = flown.flight.plan.motion().jerks()
            own, notes = check_simulated(flown, course), notes_on_simulation(flown, course)
        else:
            plan = flown.plan if isinstance(flown, Flight) else flown
            fleet, grid = plan.scenario.fleet, plan.scenario.grid
            motion = Motion.from_starts(fleet, plan.accelerations, grid.step)
            course = Course.of(plan.scenario, motion, Tubes.around(flown))
            own, jerks, notes = check_planned(plan, course), motion.jerks(), notes_on(course)
        columns = [
            *own,
            *check_boxes(course, jerks),
            *check_norms(course, jerks),
            *check_waypoints(course),
            *check_obstacles(course),
            *check_separation(course),
        ]
    scenario = course.scenario
    refuse_unchecked(scenario, columns)
    names = [vehicle.name for vehicle in scenario.vehicles]
    by_vehicle = zip(*(column.checks(names) for column in columns), strict=True)
    checks = tuple(check for checks in by_vehicle for check in checks if check is not None)
    hit = {check.constraint for check in checks if not check.holds}
    sightings = tuple(
        dataclasses.replace(each, avoided=_is_avoided(each) and each.obstacle not in hit)
        for each in _sightings(flown)
    )
    return Report(scenario, checks, sightings, (*notes, *notes_on_tracks(scenario)))


def _is_avoided(sighting: Sighting) -> bool:
    """Return whether plans avoid what was seen; where none knew of it, the motion alone tells."""
    return sighting.avoided or not sighting.planned_for


def _sightings(flown: Plan | Flight | Simulation) -> tuple[Sighting, ...]:
    """What was learned under way."""
    if isinstance(flown, Plan):
        return ()
    return (flown.flight if isinstance(flown, Simulation) else flown).sightings
