"""Free waypoints of windows: selection of those ahead, and updates of their times."""

from __future__ import annotations

from collections.abc import Iterator

from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.planning.planners.waypoint_times import passing_of
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.parts import Grid, Vehicle, Waypoint
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import from_states
from drake_rho.scenario.waypoints import AllWaypoints, is_ahead

Free = tuple[tuple[bool, ...], ...]
"""Flag of each waypoint of each vehicle, in order: true if its time is free."""


def free_of(scenario: Scenario) -> Free:
    """Return flags of the free waypoints of a scenario, those without a time."""
    return tuple(
        tuple(waypoint.time is None for waypoint in each.waypoints) for each in scenario.vehicles
    )


def free_ahead(free: Free, whole: Scenario, grid: Grid) -> Free:
    """Return flags of the free waypoints in the rest of a flight.

    Args:
        free: of the whole flight.
        whole: scenario of the whole flight, with times of all waypoints.
        grid: grid of the rest.
    """
    return tuple(
        [
            own
            and tuple(
                one
                for one, each in zip(own, vehicle.waypoints, strict=True)
                if is_ahead(each, grid, whole.lead)
            )
            for own, vehicle in zip(free, whole.vehicles, strict=True)
        ]
    )


def with_guessed_times(scenario: Scenario) -> Scenario:
    """Return a scenario with guesses of the times of its free waypoints; itself without any."""
    waypoints = AllWaypoints.of(scenario.vehicles)
    if waypoints.given.all():
        return scenario
    guess = passing_of(waypoints, scenario, scenario.grid, None).times
    return scenario.derived(
        vehicles=waypoints.placed(scenario.vehicles, scenario.grid.start + guess)
    )


def timed_as(whole: Scenario, rest: Scenario) -> Scenario:
    """Return the scenario of a whole flight with the waypoint times of its rest.

    Args:
        whole: scenario of the whole flight, which is returned if no time differs.
        rest: scenario of a window's plan, whose waypoints are those ahead.
    """
    vehicles = tuple(
        _replaced(vehicle, iter(own.waypoints), rest.grid, rest.lead)
        for vehicle, own in zip(whole.vehicles, rest.vehicles, strict=True)
    )
    return with_waypoints(whole, vehicles)


def with_waypoints(scenario: Scenario, vehicles: tuple[Vehicle, ...]) -> Scenario:
    """Return a scenario with other times of waypoints; itself if none differs."""
    pairs = zip(scenario.vehicles, vehicles, strict=True)
    if all(_times(one) == _times(other) for one, other in pairs):
        return scenario
    changed = until(scenario, scenario.grid, vehicles)
    return changed.derived(disturbance=scenario.disturbance)


def until(scenario: Scenario, grid: Grid, vehicles: tuple[Vehicle, ...]) -> Scenario:
    """Return a scenario with another end and the same error tube; not validated again.

    Args:
        scenario: scenario of a flight or of the rest of one.
        grid: grid that begins as the scenario's.
        vehicles: the vehicles, with other times of their waypoints.
    """
    fleet = scenario.fleet
    given = scenario.derived(vehicles=vehicles, fleet=fleet)
    starts = fleet.start_positions, fleet.start_velocities, fleet.accelerations_before
    ended = from_states(given, grid, *starts, tracking_of(scenario), fleet.flown)
    return ended.derived(under_way=scenario.under_way)


def sooner(vehicle: Vehicle, free: tuple[bool, ...], start: float, factor: float) -> Vehicle:
    """Return a vehicle with the times of its free waypoints scaled.

    Args:
        vehicle: vehicle of a window.
        free: flags of its free waypoints.
        start: time of the first knot [s]; with a smoothing waypoints may be a little earlier.
        factor: factor on times since the first knot.
    """
    waypoints = tuple(
        unchecked(each, time=start + factor * (each.time - start))
        if one and each.time is not None and each.time > start
        else each
        for one, each in zip(free, vehicle.waypoints, strict=True)
    )
    return unchecked(vehicle, waypoints=waypoints)


def _replaced(vehicle: Vehicle, ahead: Iterator[Waypoint], grid: Grid, lead: float) -> Vehicle:
    """Return a vehicle with other waypoints in place of those ahead."""
    waypoints = tuple(
        next(ahead) if is_ahead(each, grid, lead) else each for each in vehicle.waypoints
    )
    return unchecked(vehicle, waypoints=waypoints)


def _times(vehicle: Vehicle) -> list[float | None]:
    return [each.time for each in vehicle.waypoints]
