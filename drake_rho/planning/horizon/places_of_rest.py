"""Planner of windows that end where vehicles may stay.

A plan that ends at rest is continued there. What comes later than its end - obstacles that move on,
errors that grow - counts at its last knot already, and the verifier decides whether vehicles may
stay.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.rest_tube import rest_tube
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.horizon.windows import WindowPlanner
from drake_rho.planning.programs.backend import Solver
from drake_rho.scenario.fields import BoolArray, FloatArray, read_only, unchecked
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.tracks import Track
from drake_rho.verification.rest import check_rest

_AROUND = 0.1
"""Distance from the reference within which obstacles are near, in lengths of the motion."""

_APART = 0.5
"""Distance between places of an obstacle after the end, in its thickness and the vehicle's
radius."""

_MOST_PLACES = 200
"""Largest number of places at which an obstacle counts after the end."""

_STILL = Track([0.0], np.zeros((1, 3)), after="rests")
"""Track of an obstacle at a place."""

_Numbered = tuple[int, Obstacle]


def ending_at_rest(windows: WindowPlanner) -> WindowPlanner:
    """Return the planner of windows that end where vehicles may stay."""
    planner = partial(_to_rest, windows.planner)
    fallback = windows.fallback and partial(_to_rest, windows.fallback)
    return dataclasses.replace(windows, planner=planner, fallback=fallback, reference=_standing)


def _standing(scenario: Scenario, remaining: Plan | None, solver: Solver | None) -> Plan | None:
    """Return the rest of the plan in force or, before there is one, vehicles that stay at rest."""
    if remaining is not None or scenario.fleet.start_velocities.any():
        return remaining
    still = np.zeros((len(scenario.vehicles), scenario.grid.knots - 1, 3))
    return Plan.from_accelerations(scenario, still)


def avoided_until(scenario: Scenario, until: float) -> Scenario:
    """Return the scenario of a window in which obstacles whose errors grow are avoided for a time.

    Without an end they may be anywhere in the end.

    Args:
        scenario: of the window.
        until: time on the scenario's clock, not before the window's end [s].
    """
    begin = scenario.grid.start - scenario.grid.step
    bodies = tuple(
        unchecked(each, active=(begin, until) if each.active is None else each.active)
        if each.velocity_error > 0.0
        else each
        for each in scenario.bodies
    )
    if all(one is other for one, other in zip(bodies, scenario.bodies, strict=True)):
        return scenario
    return scenario.derived(obstacles=bodies, fleet=scenario.fleet)


def within_window(requirements: Sequence[KeepIn], grid: Grid) -> tuple[KeepIn, ...]:
    """Return the requirements of a window; those with an interval or a track end with it.

    Only requirements that always hold say where vehicles may stay.
    """
    found = list[KeepIn]()
    for each in requirements:
        if each.active is None and each.track is None:
            found.append(each)
            continue
        first, last = each.active or (grid.start - grid.step, grid.end)
        if not grid.clock.after(first, grid.end):
            found.append(unchecked(each, active=(first, min(last, grid.end))))
    return tuple(found)


def largest_radius(scenario: Scenario) -> float:
    """Return the largest radius of the error tube at the knots of a window and after it [m]."""
    if scenario.disturbance is None:
        return 0.0
    tube = tube_of(scenario)
    after = rest_tube(tube, scenario.grid.end).largest("position")
    return max(float(tube.position(scenario.grid.times).max()), after)


def _to_rest(
    planner: Planner, scenario: Scenario, *, reference: Plan | None, solver: Solver | None
) -> Plan:
    """Return a planner's plan, if vehicles may stay where it ends.

    Raises:
        InfeasibleError: they may not.
    """
    plan = _among_near(planner, scenario, reference, solver)
    for column in check_rest(scenario, plan.positions[:, -1], near_only=True):
        if not column.holds:
            checks = (each for each in column.checks(scenario.names) if each is not None)
            raise InfeasibleError(
                {each.vehicle: (each.what,) for each in checks if not each.holds},
                statistics=plan.statistics,
                scenario=scenario,
                because="the plan found ends where vehicles cannot stay",
            )
    return plan


def _among_near(
    planner: Planner, scenario: Scenario, reference: Plan | None, solver: Solver | None
) -> Plan:
    """Return a planner's plan, found among the obstacles near the reference and near the plan.

    An obstacle further away is added only if a plan comes near it.
    """
    count, later = len(scenario.bodies), tuple(_places_after(scenario))
    numbers = range(count + 1, count + 1 + len(later))
    every = (*scenario.avoided, *zip(numbers, later, strict=True))
    bodies = (*scenario.bodies, *later)
    near = np.ones(len(every), dtype=bool)
    if reference is not None:
        near = _are_near(every, scenario, reference, _AROUND * scenario.fleet.lengths)
    spent = Statistics()
    while True:
        avoided = tuple(each for each, one in zip(every, near, strict=True) if one)
        among = scenario.derived(
            obstacles=bodies, bodies=bodies, avoided=avoided, fleet=scenario.fleet
        )
        plan = planner(among, reference=reference, solver=solver)
        spent += plan.statistics
        more = ~near & _are_near(every, scenario, plan)
        if not more.any():
            return unchecked(plan, scenario=scenario, statistics=spent)
        near |= more


def _are_near(
    bodies: Sequence[_Numbered], scenario: Scenario, plan: Plan, further: FloatArray | float = 0.0
) -> BoolArray:
    """Return which obstacles a motion may touch, (B,).

    Balls around them at the knots decide, and boxes around the parts of maps.

    Args:
        bodies: obstacles and their numbers.
        scenario: of the window.
        plan: the motion.
        further: distance from them that is near as well [m], shape (N,).
    """
    near = np.ones(len(bodies), dtype=bool)
    bounded = [i for i, (_, body) in enumerate(bodies) if np.isfinite(body.shape.extent).all()]
    if not bounded:
        return near
    elapsed, step = scenario.grid.elapsed, scenario.grid.step
    required = scenario.fleet.radii + largest_radius(scenario) + further
    within = required[:, None] + step * np.linalg.norm(plan.velocities, axis=2)
    centers = np.array([bodies[i][1].centers(elapsed) for i in bounded])
    errors = np.array(
        [body.deviation + body.uncertainty(elapsed) for body in (bodies[i][1] for i in bounded)]
    )
    moves = np.linalg.norm(np.diff(centers, axis=1), axis=2)
    errors[:, :-1] += moves  # what moves on the way from a knot to the next counts at both
    errors[:, 1:] += moves
    sizes = np.linalg.norm([bodies[i][1].shape.extent for i in bounded], axis=1)
    away = plan.positions - centers[:, None]
    reached = within + errors[:, None]
    balls = np.linalg.norm(away, axis=3) <= reached + sizes[:, None, None]
    near[bounded] = balls.any(axis=(1, 2))
    for i, offsets, distances in zip(bounded, away, reached, strict=True):
        shape = bodies[i][1].shape
        if near[i] and isinstance(shape, Parts):
            x = shape.in_frame(offsets).reshape(-1, 3)
            near[i] = len(shape.tree.pairs(x, x, distances.ravel())[0]) > 0
    return near


def _places_after(scenario: Scenario) -> Iterator[Obstacle]:
    """Yield obstacles as they are after the end, as if they were there at the last knot.

    Those at rest are larger by the growth of the error tube.
    """
    end = float(scenario.grid.elapsed[-1])
    growth = 0.0
    if scenario.disturbance is not None:
        growth = largest_radius(scenario) - float(tube_of(scenario).position(scenario.grid.end))
    for number, each in scenario.known:
        if each.active is not None and each.active[1] <= end:
            continue
        body = unchecked(each, shape=each.shape.cover)
        if body.changes or (body.active is not None and body.active[0] > end):
            for place, error in _places(body, scenario, end):
                yield _at_place(body, number, place, end, error + growth)
        elif growth > 0.0:
            error = body.position_error + growth
            yield _at_place(body, number, body.first_center, end, error)


def _at_place(
    body: Obstacle, number: int, place: FloatArray, time: float, error: float
) -> Obstacle:
    """Return an obstacle at a place at one time since the first knot [s], for its errors."""
    positions = read_only(place[None])
    track = unchecked(_STILL, positions=positions, deviation=body.deviation)
    return unchecked(
        body,
        velocity=None,
        track=track,
        active=(time, time),
        position_error=error,
        velocity_error=0.0,
        name=f"{body.called(number)} after the end",
    )


def _places(body: Obstacle, scenario: Scenario, end: float) -> Iterator[tuple[FloatArray, float]]:
    """Yield places of a moving obstacle after the end (3,), and its errors there [m].

    Between two places it moves less than the errors are larger.
    """
    fleet = scenario.fleet
    until = body.active[1] if body.active is not None else np.inf
    last = 0.0 if body.track is None or len(body.track.times) == 0 else float(body.track.times[-1])
    apart = _APART * (body.shape.thickness + float(fleet.radii.min()))
    begin = end if body.active is None else max(end, body.active[0])
    corners = [begin, *(each for each in body.corners.tolist() if begin < each < until)]
    far = float(
        np.linalg.norm(fleet.start_positions - body.centers(np.array([begin])), axis=1).max()
    )
    if body.track is not None and body.track.after == "goes_on":
        speed = float(np.linalg.norm(body.track.last_velocity))
        away = 2.0 * (far + float(fleet.lengths.max()) + float(np.linalg.norm(body.shape.extent)))
        corners.append(min(until, max(last, begin) + away / max(speed, 1e-9)))
    elif until < np.inf:
        corners.append(until)
    times = [np.array([begin])]
    for first, then in pairwise(corners):
        moved = float(np.linalg.norm(np.diff(body.centers(np.array([first, then])), axis=0)))
        count = min(max(int(np.ceil(moved / apart)), 1), _MOST_PLACES)
        times.append(np.linspace(first, then, count + 1)[1:])
    at = np.concatenate(times)
    centers, errors = body.centers(at), body.uncertainty(at)
    gaps = np.append(np.linalg.norm(np.diff(centers, axis=0), axis=1), 0.0)
    between = np.maximum(gaps, np.append(0.0, gaps[:-1])) / 2.0
    for place, error, gap in zip(centers, errors, between, strict=True):
        yield place, float(error + gap)
