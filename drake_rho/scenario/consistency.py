"""Checks that the parts of a scenario are consistent with each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.parts import Grid, Quantity, Vehicle
from drake_rho.scenario.waypoints import is_during_flight


def check_names(vehicles: Sequence[Vehicle]) -> None:
    """Check that the names of vehicles are unique.

    Raises:
        ScenarioError: two vehicles have the same name.
    """
    names: set[str] = set()
    for index, vehicle in enumerate(vehicles):
        if vehicle.name in names:
            expected = "a name no other vehicle has"
            raise ScenarioError(f"vehicles[{index}].name", vehicle.name, expected)
        names.add(vehicle.name)


def check_obstacles(obstacles: Sequence[AnyObstacle], grid: Grid) -> None:
    """Check that obstacles are solid and become known before the end of the flight.

    Raises:
        ScenarioError: an obstacle is not, or does not.
    """
    for index, each in enumerate(obstacles):
        try:
            (each.shape if isinstance(each, Obstacle) else each).check_solid()
        except ScenarioError as error:
            raise error.inside(f"obstacles[{index}]") from None
    for index, each in enumerate(obstacles):
        known_from = each.known_from if isinstance(each, Obstacle) else 0.0
        if known_from > max(grid.end, 0.0):  # 0 stands for the start
            expected = f"a time in the flight, which ends at {grid.end:g} s"
            raise ScenarioError(f"obstacles[{index}].known_from", known_from, expected)


def check_limits(fleet: Fleet, *, under_way: bool = False) -> None:
    """Check that starts and goals satisfy the limits of their vehicles.

    Args:
        fleet: the vehicles.
        under_way: whether starts are states that a flight has reached, which are not checked.

    Raises:
        ScenarioError: a start or a goal violates a limit.
    """
    starts: tuple[tuple[str, Quantity, FloatArray], ...] = (
        ("start", "position", fleet.start_positions),
        ("start", "velocity", fleet.start_velocities),
        ("start", "acceleration", fleet.accelerations_before),
    )
    goals: tuple[tuple[str, Quantity, FloatArray], ...] = (
        ("goal", "position", fleet.goal_positions),
        ("goal", "velocity", fleet.goal_velocities),
    )
    for end, quantity, values in goals if under_way else (*starts, *goals):
        bounds = fleet.bounds(quantity)
        if bounds is not None:
            bounds.check(f"{end}.{quantity}", values)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                limit.check(f"{end}.{quantity}", values)


def check_waypoints(fleet: Fleet, grid: Grid, obstacles: Sequence[Obstacle]) -> None:
    """Check that waypoints are during the flight, in position boxes and outside obstacles.

    Raises:
        ScenarioError: a waypoint is not.
    """
    for index, waypoints in enumerate(fleet.waypoints):
        where = f"waypoints[{index}]"
        for i in np.flatnonzero(waypoints.present):
            time = float(waypoints.times[i])
            if not is_during_flight(time, grid):
                expected = f"after {grid.start:g} s and before {grid.end:g} s"
                raise ScenarioError(
                    f"vehicles[{i}].{where}.time", time, f"a time in the flight, {expected}"
                )
        if (bounds := fleet.bounds("position")) is not None:
            bounds.check(f"{where}.position", waypoints.positions)
        check_outside(fleet, obstacles, f"{where}.position", waypoints.positions, waypoints.times)


def check_outside(
    fleet: Fleet,
    obstacles: Sequence[Obstacle],
    where: str,
    positions: FloatArray,
    times: FloatArray,
) -> None:
    """Check that vehicles are at least their radius away from all obstacles, known or not.

    The required distance from an obstacle on a track is larger by the track's deviation.

    Args:
        fleet: the vehicles.
        obstacles: all obstacles, numbered from 1 in this order.
        where: field of a vehicle that holds the positions, such as `"start.position"`.
        positions: of the vehicles [m], shape (N, 3).
        times: on the scenario's clock [s], shape (N,); NaN for a vehicle that is not checked.

    Raises:
        ScenarioError: a vehicle is too close to an obstacle.
    """
    checked = np.flatnonzero(np.isfinite(times))
    for number, obstacle in enumerate(obstacles, start=1):
        distances = obstacle.distances(positions[checked], times[checked])
        margins = fleet.radii[checked] + obstacle.deviation
        tolerances = fleet.obstacle_tolerances(obstacle.shape)[checked]
        inside = distances < margins - tolerances
        if np.any(inside):
            first = int(np.argmax(inside))
            i, margin, d = checked[first], margins[first], float(distances[first])
            required = f"at least {margin:g} m from" if margin > 0.0 else "outside"
            actual = f"{d:g} m from" if d > 0.0 else f"{-d:g} m in"
            when = f" at {clock_time(float(times[i]))}" if not obstacle.is_steady else ""
            expected = (
                f"a position {required} {obstacle.called(number)}, not {actual} it{when} "
                f"({obstacle.shape})"
            )
            raise ScenarioError(f"vehicles[{i}].{where}", positions[i].tolist(), expected)
