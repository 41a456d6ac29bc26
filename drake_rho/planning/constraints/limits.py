"""Keep-in constraints of a scenario: limits on norms, waypoints, requirements."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np

from drake_rho.planning.constraints.base import VIOLATED, GivenEnd, constrained_knots
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.margins import Margins, PlanMargins, jerk_factor
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.gates import has_rest_inside
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.times import END_MARGIN

_ACCEPTED = 0.25
"""Violation of a requirement, in tolerances, up to which no row is added. Each round quarters the
violation of a set with a curved surface, at the knots and again between them, and linked vehicles
need many rounds."""

_FASTEST = 2.0
"""Half the speed at waypoints, as a multiple of the average from start to goal, for rounding
errors: times are equal up to half a tick."""

_ROUNDED = 0.4
"""Largest part of a waypoint's tolerance by which the rounding of its time may move it."""


def norms_of(scenario: Scenario, margins: PlanMargins) -> list[KeepInSets]:
    """Return the limits on norms of all vehicles, imposed at the knots.

    Velocities are linear between knots, accelerations constant, and jerks are their changes at the
    knots. A motion that is in a convex set at all knots is therefore in it at every instant. The
    first and the last velocity are not constrained, since start and goal fix them.
    """
    norms, open_end = list[KeepInSets](), scenario.fleet.open_end
    for norm in NORMS:
        if norm not in scenario.fleet.norms:
            continue
        limit = scenario.fleet.norms[norm]
        quantity = limit.kind.quantity
        jerks = quantity == "jerk"
        own = margins.of(quantity)
        times = own.grid.elapsed[constrained_knots(quantity, open_end=open_end)]
        first = int(quantity == "velocity")
        norms.append(
            KeepInSets(
                kind=norm,
                key=norm,
                name=limit.kind.name,
                quantity=quantity,
                sets=limit.sets.scaled(jerk_factor(scenario)) if jerks else limit.sets,
                members=np.arange(len(scenario.vehicles)),
                times=times,
                knots=slice(first, first + len(times)),
                margins=own,
                roundings=np.zeros(len(scenario.vehicles)),
                given_end=GivenEnd.of(scenario, quantity) if open_end else None,
            )
        )
    return norms


def waypoints_of(scenario: Scenario, margins: PlanMargins) -> list[KeepInSets]:
    """Return the waypoints of all vehicles; the k-th of each, of one name, are one constraint.

    A waypoint is a ball of positions at one time, which need not be a knot's. If it is to be passed
    exactly the radius is zero, which needs no special treatment: the boundary of every half-space
    that a motion violates contains the waypoint. With a smoothing the ball is one of averaged
    positions, which are linear in the accelerations too. Soft ones are constraints of
    their own.
    """
    fleet, clock = scenario.fleet, scenario.grid.clock
    if not fleet.waypoints:
        return []
    everyone = np.arange(len(scenario.vehicles))
    scale = fleet.scale("position")
    late = clock.tick * _FASTEST * fleet.scale("velocity")  # by the rounding of times
    hard = [
        KeepInSets(
            kind="waypoints",
            key=("waypoint", waypoints.called),
            name=waypoints.called,
            quantity="position",
            sets=waypoints.balls(scale),
            members=everyone[~waypoints.soft],
            roundings=fleet.coordinate_errors
            + np.minimum(late, _ROUNDED * waypoints.tolerances(scale)),
            times=scenario.grid.since_start(waypoints.times)[:, None],
            averaged=scenario.smoothing,
            margins=margins.states.pointwise,
        )
        for waypoints in fleet.waypoints
    ]
    soft = [
        dataclasses.replace(
            each,
            key=(each.key, "soft"),
            members=everyone[waypoints.soft],
            prices=np.where(waypoints.soft, waypoints.penalties * fleet.weights, 0.0),
            as_cone=False,
        )
        for each, waypoints in zip(hard, fleet.waypoints, strict=True)
        if waypoints.soft.any()
    ]
    return [each for each in [*hard, *soft] if len(each.members) > 0]


def requirements_of(scenario: Scenario, margins: PlanMargins) -> list[KeepInSets]:
    """Return the constraints of all requirements that have not ended."""
    if not scenario.required:
        return []
    found, names, grid = list[KeepInSets](), scenario.names, scenario.grid
    open_end = scenario.fleet.open_end
    local = grid.beginning_at(0.0)
    for number, requirement in enumerate(scenario.required, start=1):
        each = requirement.since(grid).longer(scenario.lead)
        if (interval := each.interval(local)) is None:
            continue
        own, quantity = margins.of(each.quantity), each.quantity
        sets, every_instant = each.sets(scenario.fleet, names), scenario.between_knots
        times = _instants(
            each,
            interval,
            local,
            own,
            every_instant=every_instant,
            open_end=open_end,
        )
        if quantity == "jerk":
            sets = sets.scaled(jerk_factor(scenario))
            if scenario.smoothing is not None:  # jerks of averages are those at knots
                times = times[grid.clock.within(times, interval)]
        found.append(
            KeepInSets(
                kind="goals" if requirement.is_goal else "requirements",
                key=("requirement", number),
                name=requirement.called(number),
                quantity=quantity,
                active=None if each.active is None else interval,
                clock=grid.clock,
                sets=sets,
                members=each.members(names),
                partner=each.partner(names),
                coupled=each.leader is not None,
                prices=each.prices(scenario.fleet, names),
                times=times,
                margins=own,
                roundings=scenario.fleet.coordinate_errors * (quantity == "position"),
                as_cone=False,
                threshold=_ACCEPTED if each.penalty is None else VIOLATED,  # prices are exact
                searches=sys.maxsize * (quantity == "position" and every_instant),
                open_end=open_end,
                given_end=GivenEnd.of(scenario, quantity) if open_end else None,
                moves=requirement.moves,
                is_gate=requirement.at_waypoint
                and quantity == "velocity"
                and not has_rest_inside(requirement.set),
            )
        )
    return found


def _instants(
    each: KeepIn,
    interval: tuple[float, float],
    grid: Grid,
    margins: Margins,
    *,
    every_instant: bool,
    open_end: bool,
) -> FloatArray:
    """Return the times at which a requirement is checked without a search, (T,).

    Accelerations have one time for each step that meets the interval. So have jerks, which are
    changes at the beginnings of steps, and one at the last knot. Velocities are linear in a step,
    so that the ends of the interval and corners of the track suffice beside the knots. The states
    at the first and, unless the end is open, the last knot are given.

    Args:
        each: requirement on a clock that is 0 at the first knot.
        interval: its first and last active time on that clock [s].
        grid: grid of the plan on that clock.
        margins: margins of its values.
        every_instant: whether it applies at every instant, not at the knots only.
        open_end: whether the last state is not given.
    """
    (first, last), h, clock = interval, grid.step, grid.clock
    if each.quantity in ("acceleration", "jerk"):
        begins = grid.elapsed[constrained_knots(each.quantity)]
        return np.asarray(begins[clock.meets(begins, begins + h, interval)])
    knots = margins.grid.elapsed if every_instant else grid.elapsed
    times = knots[clock.within(knots, interval)]
    if every_instant or first == last:
        corners = np.append(each.corners, interval)
        corners = corners[(corners >= first) & (corners <= last)]
        times = np.union1d(times, clock.apart(corners, knots))
    near = END_MARGIN * h
    return np.asarray(times[(times > near) & (open_end | (times < grid.duration - near))])
