"""`verify`: check every constraint of a scenario from initial states and accelerations alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.flight import Sighting
from drake_rho.motion.flown import Flown, Planned
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.averages import averaged
from drake_rho.verification.check import Check, Column
from drake_rho.verification.checkers import checkers, refuse_unchecked
from drake_rho.verification.jerks import notes_on_free_jerks
from drake_rho.verification.measured import check_measured, notes_on_measured
from drake_rho.verification.notes import (
    notes_on,
    notes_on_jumps,
    notes_on_late_obstacles,
    notes_on_separation,
    notes_on_simulation,
    notes_on_tracks,
    notes_on_uncertainty,
)
from drake_rho.verification.referee import (
    check_own,
    notes_on_trajectories,
    trajectory_of_any,
)
from drake_rho.verification.report import Report
from drake_rho.verification.rest import check_rest, notes_on_rest
from drake_rho.verification.sampled import with_rates
from drake_rho.verification.states import check_planned, check_simulated, trajectory_of
from drake_rho.verification.summary import Summary
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import Tubes

__all__ = ["Check", "Report", "Summary", "verify"]


@checked
def verify(flown: Flown, scenario: Scenario | None = None) -> Report:
    """Verify every constraint of a scenario for a plan, a flight, a simulation or trajectories.

    Positions and velocities are integrated anew from the initial states and the accelerations; the
    plan's own states are only compared with them ("dynamics"). Obstacles, separation and position
    boxes are verified at the knots and at every instant, by sampling with rigorous bounds between
    the samples (`drake_rho.verification.continuous_time`): no instant is worse than the reported
    value by more than a hundredth of the tolerance. If a scenario requires the knots only
    (`between_knots`), the checks at every instant are reported as well but do not count. A value
    that is NaN never holds.

    A vehicle's distance from an obstacle must be at least its radius plus the deviation of the
    obstacle's track. Distances from an uncertain obstacle are from its nearest possible position.
    An obstacle that becomes known later counts from then on; a separate check, which does not
    count, reports earlier distances. All times are on the scenario's clock.

    With a disturbance, a plan is verified with its error tube: constraints must hold everywhere in
    the tube. Limits are tightened by the error radius, which is exact at every time and reported
    as `Check.errors`. Each window of a flight is verified with its own tube, from its first knot to
    that of the next window. Jerk and goal are those of the plan. The planners' margins are not
    used.

    A flight is verified as flown, from the initial states of its windows. Where these were measured
    it jumps: it is verified up to the jump and from there on, and a note gives the largest jump. At
    the time of a jump the measured states count. With a disturbance a vehicle is in both tubes
    then, so a waypoint at that time is passed if one of the two proves it.

    With smoothing, the smooth motion is verified, from before the first knot until after the last;
    it is computed anew from the accelerations (`drake_rho.verification.averages`). Limits on
    velocities, accelerations and jerks are verified at every instant too, with the largest error
    radius in each of its polynomials.

    Jerks are limited from the acceleration before the start to the one after the goal, which are
    zero at rest. At a start or goal in motion with no given acceleration they are not limited, and
    a note says so.

    Vehicles whose goals are at rest hold there after the end (`drake_rho.verification.rest`). Notes
    name vehicles that cannot hold for ever, and until when they can, unless the scenario says
    otherwise (`hold_at_goal`); if it requires holding, there are checks, which count.

    Measurements of a flight (`Flight.measured`) have checks of their own, "at measured samples",
    which count too: boxes and limits of positions and velocities, requirements, distances from
    obstacles once they are known, and between vehicles seen at the same time. States count as
    measured: neither the error tube nor the errors of the estimate are added, and distances from an
    uncertain obstacle are from its nearest possible position, as always. Nothing is said about the
    time between samples, about vehicles that were not seen, and about the time after the end. Notes
    give the largest deviation from the planned motion and, with a disturbance, whether all samples
    are within the tube.

    For a simulation the true motion is verified, without a tube and against the limits as given.
    Limits on accelerations apply to the commands, and the limit on jerk to the plans. A vehicle
    reaches its goal if it ends within the radii of the last window's tube.

    Trajectories of other planners (`Trajectories`) are verified at every instant for a scenario
    with the same vehicles. They must be continuous in position and velocity, begin at the starts
    and end at the goals. Polynomials are verified as smooth motions are. Their accelerations may
    jump; the jerk is then that over one step of the scenario's grid. Samples are verified with the
    largest distance from the straight lines between them that their bound on the acceleration
    allows. Where that leaves it open whether a constraint holds, the check does not count as
    violated but as undecided (`Report.undecided`), and `ok` is False. Only the velocities of start
    and goal, which samples can contradict but never prove, are met if one of these motions has
    them; a note says how well they are known. Before and after its own trajectory a vehicle is at
    rest, and a note says so.

    The arithmetic is in double precision. A position at the knots is a sum of 2K terms, none
    larger than the largest of the motion's coordinates and its length scale, so with the unit
    roundoff u = 1.1e-16 its error is at most 4 K u times that; an instant between the knots adds a
    few roundings. For the paper's data the error is below 1e-9 m, a millionth of the least
    tolerance.

    Args:
        flown: a plan, a flight, which is verified as flown from start to end, a simulation, or
            trajectories.
        scenario: scenario for trajectories, by default their own if they have one; plans, flights
            and simulations have their own.

    Returns:
        A report; `report.ok` says whether every constraint holds.

    Raises:
        ValueError: a scenario is missing or given where it should not be; or the vehicles or times
            of trajectories are not those of the scenario.

    Examples:
        >>> report = rho.verify(rho.plan(rho.load_scenario("paper")))
        >>> report.ok
        True
        >>> print(report.clearance.vehicle, report.summary.fastest)
        UAV-2 UAV-3
    """
    if isinstance(flown, Trajectories):
        scenario = scenario or flown.judged_for
        if scenario is None:
            raise ValueError("scenario: got None, expected that of the trajectories")
        return _of_trajectories(flown, scenario)
    if scenario is not None:
        expected = f"None for a {flown.kind}, which has one of its own"
        raise ValueError(f"scenario: got {scenario.name!r}, expected {expected}")
    return _of_flown(flown)


def _of_flown(flown: Planned) -> Report:
    """Return the report on a plan, a flight or a simulation."""
    last = flown.windows[-1].plan if flown.windows else flown.plan
    with np.errstate(over="ignore", invalid="ignore"):  # values that overflow become NaN or inf
        if (simulation := flown.simulation) is not None:
            trajectory = trajectory_of(simulation)
            own = check_simulated(simulation, trajectory)
            notes = notes_on_simulation(simulation, trajectory)
        else:
            plan = flown.plan
            fleet, grid = plan.scenario.fleet, plan.scenario.grid
            begins = _beginnings(flown)
            motion = Motion.in_pieces(fleet, plan.accelerations, grid.step, begins)
            tubes = Tubes.of(flown)
            trajectory = PiecewiseTrajectory.of(plan.scenario, motion, tubes, plan.jumps)
            own = check_planned(plan, trajectory)
            trajectory, notes = averaged(trajectory), notes_on(trajectory)
            notes += notes_on_jumps(plan)
        ends = last.scenario, last.positions[:, -1]
        columns = [*own, *_every_column(trajectory), *check_rest(*ends)]
        summary = Summary.of(trajectory, flown)
        notes += notes_on_rest(*ends)
        measured = list[Column]()
        if flown.flight is not None:
            measured += check_measured(trajectory, flown.flight)
            notes += notes_on_measured(flown.flight)
    refuse_unchecked(trajectory.scenario, columns)
    return _report(trajectory, [*columns, *measured], summary, notes, flown)


def _of_trajectories(trajectories: Trajectories, scenario: Scenario) -> Report:
    """Return the report on trajectories, for a scenario with the same vehicles."""
    trajectory, plan = trajectory_of_any(trajectories, scenario), trajectories.as_plan(scenario)
    with np.errstate(over="ignore", invalid="ignore"):
        ends = scenario, trajectory.positions[:, -1]
        found = [*_every_column(trajectory), *check_rest(*ends)]
        judged = (with_rates(column, trajectory.tubes) for column in found)
        columns = [*check_own(trajectory, trajectories), *judged]
        summary = Summary.of(trajectory, plan)
        notes = notes_on_trajectories(trajectories, scenario) + notes_on_rest(*ends)
    refuse_unchecked(scenario, columns)
    return _report(trajectory, columns, summary, notes, plan)


def _every_column(trajectory: PiecewiseTrajectory) -> Iterator[Column]:
    """Yield the checks of everything that a trajectory has to satisfy during the flight."""
    for each in checkers(range(1, len(trajectory.scenario.bodies) + 1)):
        yield from each.check(trajectory)


def _report(
    trajectory: PiecewiseTrajectory,
    columns: Sequence[Column],
    summary: Summary,
    notes: tuple[str, ...],
    flown: Planned,
) -> Report:
    """Return the report of all columns, with what became of the sighted obstacles of a flight."""
    scenario = trajectory.scenario
    names = [vehicle.name for vehicle in scenario.vehicles]
    by_vehicle = zip(*[column.checks(names) for column in columns], strict=True)
    checks = tuple([check for checks in by_vehicle for check in checks if check is not None])
    hit = {
        each.constraint
        for each in checks
        if each.kind == "obstacles" and not each.holds and not each.is_measured
    }
    sightings = tuple(
        dataclasses.replace(each, avoided=_is_avoided(each) and each.obstacle not in hit)
        for each in flown.sightings
    )
    if not flown.windows:
        notes += notes_on_late_obstacles(scenario, hit)
    about = (notes_on_free_jerks, notes_on_separation, notes_on_tracks, notes_on_uncertainty)
    notes = (*notes, *(note for notes_of in about for note in notes_of(scenario)))
    return Report(scenario, checks, summary, sightings, notes)


def _beginnings(flown: Planned) -> dict[int, FloatArray]:
    """Return the states with which the pieces of a motion begin, (N, 6) each, by knot.

    A plan without windows, such as that of a flight, has them itself.
    """
    plan = flown.plan
    if not plan.jumps:
        return {}
    begins = {each.first_knot: each.plan.scenario.fleet.start_states for each in flown.windows}
    return {knot: begins.get(knot, plan.states(knot)) for knot in plan.jumps}


def _is_avoided(sighting: Sighting) -> bool:
    """Return whether the plans avoid a sighted obstacle; True if no plan took it into account.

    In the latter case the motion alone decides.
    """
    return sighting.avoided or not sighting.planned_for
