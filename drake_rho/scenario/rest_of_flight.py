"""Scenarios of the remainder of a flight, from states reached in flight.

These are not checked: a flight may have left the limits, and the previous plan may be continued.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np

from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import FloatArray, read_only, unchecked
from drake_rho.scenario.gates import bound_to_vehicles
from drake_rho.scenario.known_obstacles import active_during, known_at_start
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.parts import Grid, Vehicle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import is_ahead


def from_states(
    scenario: Scenario,
    grid: Grid,
    positions: FloatArray,
    velocities: FloatArray,
    before: FloatArray,
    tracking: Tracking | None = None,
    flown: FloatArray | None = None,
    jerks: FloatArray | None = None,
) -> Scenario:
    """Return a scenario from other states on another grid, without waypoints before it.

    Averages of a smoothing begin `lead` before the grid, and so do waypoints.

    Args:
        scenario: of a flight, or of its remainder.
        grid: remainder of the flight.
        positions: at its first knot [m], shape (N, 3).
        velocities: at its first knot [m/s], shape (N, 3).
        before: accelerations just before the first knot [m/s²], shape (N, 3); NaN where unknown.
        tracking: feedback that has tracked a plan since an earlier time, if any.
        flown: accelerations of the steps before the first knot that enter the averages [m/s²],
            shape (N, REACHED, 3); none if averages begin at rest, or without a smoothing.
        jerks: at the knot before the first [m/s³], shape (N, 3); those of the scenario if not
            given.
    """
    disturbance = scenario.disturbance and unchecked(scenario.disturbance, tracking=tracking)
    at_rest = ~velocities.any(axis=1, keepdims=True)
    before = np.where(np.isnan(before) & at_rest, 0.0, before)
    unknown = np.asarray(np.isnan(before).any(axis=1))
    accelerations = zip(read_only(before), unknown, strict=True)
    states: dict[str, Iterable[object]] = {
        "position": read_only(positions),
        "velocity": read_only(velocities),
        "acceleration": [None if is_unknown else each for each, is_unknown in accelerations],
        "flown": [None] * len(before) if flown is None else read_only(flown),
        "jerk_before": [each.start.jerk_before for each in scenario.vehicles]
        if jerks is None
        else read_only(jerks),
    }
    vehicles = _started_at(scenario, grid, states)
    passed = grid.step * round((grid.start - scenario.grid.start) / grid.step)
    since = grid.beginning_at(passed)
    bodies = tuple([each.since(since) for each in scenario.bodies_in_flight])
    known = known_at_start(scenario.bodies, bodies, grid)
    avoided = active_during(known, grid)
    fleet = scenario.fleet.started_at(
        grid, vehicles, positions, velocities, before, [body for _, body in avoided]
    )
    return scenario.derived(
        grid=grid,
        vehicles=vehicles,
        requirements=bound_to_vehicles(scenario.requirements, scenario.vehicles),
        fleet=fleet,
        disturbance=disturbance,
        bodies_in_flight=bodies,
        known=known,
        avoided=avoided,
        under_way=True,
    )


def _started_at(
    scenario: Scenario, grid: Grid, states: Mapping[str, Iterable[object]]
) -> tuple[Vehicle, ...]:
    """Return a scenario's vehicles with other starts, without the waypoints before a grid.

    Args:
        scenario: of a flight, or of its remainder.
        grid: remainder of the flight.
        states: fields of the starts, each with one value for every vehicle.
    """
    lead, names = scenario.lead, tuple(states)
    vehicles = list[Vehicle]()
    for vehicle, values in zip(scenario.vehicles, zip(*states.values(), strict=True), strict=True):
        start = unchecked(vehicle.start, **dict(zip(names, values, strict=True)))
        ahead = vehicle.waypoints and tuple(
            each for each in vehicle.waypoints if is_ahead(each, grid, lead)
        )
        vehicles.append(unchecked(vehicle, start=start, waypoints=ahead))
    return tuple(vehicles)


def going_on(scenario: Scenario, flown: FloatArray) -> Scenario:
    """Return a scenario with the accelerations flown before it, for a smoothing's averages.

    Args:
        scenario: of a flight, or of its remainder.
        flown: accelerations of the steps before the first knot [m/s²], (N, REACHED, 3).
    """
    vehicles = tuple(
        unchecked(each, start=unchecked(each.start, flown=own))
        for each, own in zip(scenario.vehicles, read_only(flown), strict=True)
    )
    return scenario.derived(vehicles=vehicles)


def with_obstacles(scenario: Scenario, obstacles: tuple[AnyObstacle, ...]) -> Scenario:
    """Return a scenario, or the rest of one, with other obstacles; itself if they are its own.

    The scales of motions, and so the tolerances, stay those of the flight.
    """
    if obstacles is scenario.obstacles:
        return scenario
    return scenario.derived(obstacles=obstacles, fleet=scenario.fleet)


def known_later(scenario: Scenario, ahead: float) -> Scenario:
    """Return the scenario in which obstacles become known later, by the time of planning ahead.

    A window avoids the obstacles that are known when planning begins. Errors of obstacles grow from
    the time of the sighting, as without a latency. Obstacles become known at the end at the latest.

    Args:
        scenario: scenario to fly.
        ahead: time by which windows are planned ahead [s].
    """
    end, late = scenario.grid.end, [each.is_late(scenario.grid) for each in scenario.bodies]
    if ahead == 0.0 or not any(late):
        return scenario
    obstacles = tuple(
        dataclasses.replace(
            each, known_from=min(each.known_from + ahead, end), seen_at=each.errors_from
        )
        if isinstance(each, Obstacle) and is_late
        else each
        for each, is_late in zip(scenario.obstacles, late, strict=True)
    )
    return dataclasses.replace(scenario, obstacles=obstacles)


def known_when_seen(scenario: Scenario, given: Scenario) -> Scenario:
    """Return the scenario of a flight in which obstacles become known at their declared times.

    Args:
        scenario: scenario of the windows, from `known_later`, with newer obstacles after the given.
        given: scenario that was given.
    """
    old, newer = scenario.obstacles[: len(given.bodies)], scenario.obstacles[len(given.bodies) :]
    obstacles = tuple(
        unchecked(each, known_from=own.known_from) if isinstance(each, Obstacle) else each
        for each, own in zip(old, given.bodies, strict=True)
    )
    same = all(one == other for one, other in zip(obstacles, old, strict=True))
    return scenario if same else with_obstacles(scenario, (*obstacles, *newer))


def within_flight(scenario: Scenario) -> Scenario:
    """Return the scenario of a flight that ended earlier than was told.

    Requirements last as long as the flight. What would have become known only later never was: its
    interval is before the flight, so that all others keep their numbers.
    """
    grid = scenario.grid
    requirements = tuple(
        each if each.active is None else unchecked(each, active=_clipped(each.active, grid))
        for each in scenario.requirements
        if each.active is None or grid.clock.overlap(each.active, (grid.start, grid.end))
    )
    never = grid.start - 2.0 * grid.step, grid.start - grid.step
    late = [grid.clock.after(each.known_from, max(grid.end, 0.0)) for each in scenario.bodies]
    if any(late):
        both = zip(scenario.bodies, late, strict=True)
        bodies = (unchecked(each.known_by(0.0), active=never) if no else each for each, no in both)
        scenario = with_obstacles(scenario, tuple(bodies))
    if requirements == scenario.requirements:
        return scenario
    return scenario.derived(requirements=requirements)


def _clipped(active: tuple[float, float], grid: Grid) -> tuple[float, float]:
    first, last = np.clip(active, grid.start, grid.end).tolist()
    return first, last
