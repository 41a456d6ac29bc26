"""Checks that the parts of a scenario are consistent with each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.errors import ScenarioError, one_of
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.nominal_goals import nearest_in
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.pairs import check_separation
from drake_rho.scenario.parts import UNITS, Grid, Quantity, Separation, State, Vehicle
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.sets import ConvexSet, set_text
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.times import END_MARGIN
from drake_rho.scenario.waypoints import is_during_flight

_TIMES = 10.0
"""Least radius of a vehicle among maps, as a multiple of their tolerance."""

_RESTING = 17
"""Number of instants at which vehicles at rest before the start, or after the end, are compared
with obstacles that move; `verify` compares every instant."""

_Active = TypeVar("_Active", Obstacle, KeepIn)


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


def check_obstacles(obstacles: Sequence[AnyObstacle], end: float, grid: Grid) -> None:
    """Check that obstacles are solid and become known before the end of the flight.

    Args:
        obstacles: all of them.
        end: of the flight, on the scenario's clock [s]; infinite for a window, which may end
            earlier.
        grid: of the flight or the window.

    Raises:
        ScenarioError: an obstacle is not solid, or becomes known later.
    """
    for index, each in enumerate(obstacles):
        try:
            (each.shape if isinstance(each, Obstacle) else each).check_solid()
        except ScenarioError as error:
            raise error.inside(f"obstacles[{index}]") from None
    for index, each in enumerate(obstacles):
        known_from = each.known_from if isinstance(each, Obstacle) else 0.0
        if grid.clock.after(known_from, max(end, 0.0)):  # 0 stands for the start
            expected = f"a time in the flight, which ends at {end:g} s"
            raise ScenarioError(f"obstacles[{index}].known_from", known_from, expected)


def check_maps(obstacles: Sequence[Obstacle], fleet: Fleet) -> None:
    """Check that vehicles have a radius where there are maps.

    A map is a surface, or cells side by side. A vehicle without a radius could pass a wall between
    two cells, or through a sheet.

    Raises:
        ScenarioError: a vehicle has no radius, or one too small for the map's tolerance.
    """
    for number, obstacle in enumerate(obstacles, start=1):
        if isinstance(obstacle.shape, Map):
            least = _TIMES * obstacle.shape.tolerance
            small = np.flatnonzero(fleet.radii < least)
            if len(small) > 0:
                expected = f"at least {least:.3g} m, since {obstacle.called(number)} is a map"
                radius = float(fleet.radii[small[0]])
                raise ScenarioError(f"vehicles[{small[0]}].radius", radius, expected)


def check_ends(
    fleet: Fleet,
    vehicles: Sequence[Vehicle],
    grid: Grid,
    obstacles: Sequence[Obstacle],
    separation: Separation | None,
    *,
    under_way: bool,
    smoothing: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Check that starts and goals satisfy limits and separation and are outside obstacles.

    Args:
        fleet: the vehicles as arrays.
        vehicles: the vehicles.
        grid: first and last knot.
        obstacles: all obstacles.
        separation: required of every pair, if any.
        under_way: whether starts are states reached in flight, which are not checked.
        smoothing: margin of positions [m], and time before the start and after the end [s] during
            which vehicles stay within this margin of them.

    Raises:
        ScenarioError: a start or a goal violates one of these constraints.
    """
    check_limits(fleet, vehicles, under_way=under_way)
    obstacles = [_at_ends(each, grid) for each in obstacles]
    margin, lead = smoothing
    goals = fleet.given_goals("position")
    if under_way:  # the goals of windows that may be missed are no places of vehicles
        goals = np.where(fleet.fixed_positions[:, None], goals, np.nan)
    ends = (
        ("start", fleet.start_positions, grid.start, -lead),
        ("goal", goals, grid.end, lead),
    )
    for end, positions, time, longer in ends[under_way:]:
        for at in np.linspace(time, time + longer, _RESTING if lead > 0.0 else 1):
            times = np.full(len(positions), at)
            moved = 0.0 if at == time else margin
            check_outside(fleet, obstacles, f"{end}.position", positions, times, moved)
        if separation is not None:
            known = np.flatnonzero(np.isfinite(positions[:, 0]))
            check_separation(separation, vehicles, f"{end}.position", positions, known)


def check_goals_at_rest(
    vehicles: Sequence[Vehicle],
    expected: str = "none with hold_at_goal: vehicles hold at goals at rest only",
) -> None:
    """Check that the goals at which vehicles have to hold are at rest.

    Args:
        vehicles: the vehicles.
        expected: text of what was expected, for the error.

    Raises:
        ScenarioError: a goal has a velocity, or an acceleration after it.
    """
    for index, each in enumerate(vehicles):
        if not each.goal.is_at_rest:
            velocity = each.goal.velocity
            at_rest = isinstance(velocity, np.ndarray) and not velocity.any()
            field = "acceleration" if at_rest else "velocity"
            value = each.goal.acceleration_outside if at_rest else velocity
            plain = value.tolist() if isinstance(value, np.ndarray) else value
            raise ScenarioError(f"vehicles[{index}].goal.{field}", plain, expected)


def check_limits(fleet: Fleet, vehicles: Sequence[Vehicle], *, under_way: bool = False) -> None:
    """Check that starts and goals satisfy the limits of their vehicles.

    Args:
        fleet: the vehicles as arrays.
        vehicles: the vehicles.
        under_way: whether starts are states reached in flight, which are not checked.

    Raises:
        ScenarioError: a start or a goal violates a limit.
    """
    starts: tuple[tuple[str, Quantity, FloatArray], ...] = (
        ("start", "position", fleet.start_positions),
        ("start", "velocity", fleet.start_velocities),
        ("start", "acceleration", _given_accelerations([each.start for each in vehicles])),
    )
    goals: tuple[tuple[str, Quantity, FloatArray], ...] = (
        ("goal", "position", fleet.given_goals("position")),
        ("goal", "velocity", fleet.given_goals("velocity")),
        ("goal", "acceleration", _given_accelerations([each.goal for each in vehicles])),
    )
    for end, quantity, values in goals if under_way else (*starts, *goals):
        bounds = fleet.bounds(quantity)
        if bounds is not None:
            bounds.check(f"{end}.{quantity}", values)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                limit.check(f"{end}.{quantity}", values)


def _given_accelerations(states: Sequence[State | Goal]) -> FloatArray:
    """Return the given accelerations [m/s²], shape (N, 3); NaN where none is given."""
    given = [each.acceleration if isinstance(each, State) else None for each in states]
    return np.array([np.full(3, np.nan) if each is None else each for each in given])


def check_goal_sets(goals: Sequence[KeepIn], names: Sequence[str], fleet: Fleet) -> None:
    """Check that goals that are sets have values within the limits of their vehicles.

    Raises:
        ScenarioError: a plane separates a set from a box or from the ball of a norm's limit.
    """
    for goal in goals:
        (i,) = goal.members(names).tolist()
        quantity = goal.quantity
        if (bounds := fleet.bounds(quantity)) is not None:
            lower, upper = bounds.lower[i], bounds.upper[i]
            tolerance = float(bounds.tolerances[i].max())
            near = np.clip(np.zeros(3), lower, upper)
            box = fleet.projection(quantity, i)
            if _are_apart(goal.set, box, near, tolerance):
                expected = f"a set that meets the {quantity} box"
                raise ScenarioError(f"vehicles[{i}].goal.{quantity}", goal.set, expected)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity and np.isfinite(limit.limits[i]):
                most = float(limit.limits[i])

                def ball(x: FloatArray, most: float = most) -> FloatArray:
                    lengths = np.linalg.norm(x, axis=-1, keepdims=True)
                    return np.asarray(x * np.minimum(1.0, most / np.maximum(lengths, most)))

                if _are_apart(goal.set, ball, np.zeros(3), TOLERANCE * most):
                    expected = f"a set that meets the {limit.kind.name}, {most:g} {goal.unit}"
                    raise ScenarioError(f"vehicles[{i}].goal.{quantity}", goal.set, expected)


def _are_apart(
    convex_set: ConvexSet,
    limit: Callable[[FloatArray], FloatArray],
    near: FloatArray,
    tolerance: float,
) -> bool:
    """Return whether a plane separates a set from a limit, which has a projection."""
    inside, within = nearest_in(convex_set, limit, near)
    apart = inside - within
    distance = float(np.linalg.norm(apart))
    if distance <= tolerance:
        return False
    normal = apart / distance  # from the limit to the set
    # the limit is on the near side of the plane through its nearest point, but for rounding
    beyond = -float(convex_set.support(-normal)) - float(normal @ within)
    return bool(beyond > max(tolerance, 0.5 * distance))


def check_waypoints(
    fleet: Fleet, grid: Grid, obstacles: Sequence[Obstacle], earlier: float = 0.0
) -> None:
    """Check that waypoints are during the flight, in position boxes and outside obstacles.

    Args:
        fleet: the vehicles.
        grid: the grid.
        obstacles: all obstacles.
        earlier: time by which the motion of a window begins before the first knot [s].

    Raises:
        ScenarioError: a waypoint violates one of these constraints.
    """
    times = np.array([each.times for each in fleet.waypoints])  # (M, N)
    for number, waypoints in enumerate(fleet.waypoints):
        where = f"waypoints[{waypoints.index}]"
        for i in np.flatnonzero(waypoints.present):
            time = float(waypoints.times[i])
            if grid.clock.same(times[:number, i], time).any():
                expected = "a time that no other waypoint of the vehicle has"
                raise ScenarioError(f"vehicles[{i}].{where}.time", time, expected)
            if not is_during_flight(time, grid, earlier):
                expected = f"after {grid.start:g} s and before {grid.end:g} s"
                raise ScenarioError(
                    f"vehicles[{i}].{where}.time", time, f"a time in the flight, {expected}"
                )
        # a soft one may be out of reach
        required = np.where(waypoints.soft[:, None], np.nan, waypoints.positions)
        if (bounds := fleet.bounds("position")) is not None:
            bounds.check(f"{where}.position", required)
        check_outside(
            fleet,
            obstacles,
            f"{where}.position",
            required,
            waypoints.times,
            called=f" of {waypoints.called}",
            hard_only=True,
        )


def check_outside(
    fleet: Fleet,
    obstacles: Sequence[Obstacle],
    where: str,
    positions: FloatArray,
    times: FloatArray,
    margin: float = 0.0,
    *,
    called: str = "",
    hard_only: bool = False,
) -> None:
    """Check that vehicles are at least their radius away from all obstacles, known or not.

    The required distance from an obstacle on a track is larger by the track's deviation.

    Args:
        fleet: the vehicles.
        obstacles: all obstacles, numbered from 1 in this order.
        where: field of a vehicle that holds the positions, such as `"start.position"`.
        positions: of the vehicles [m], shape (N, 3).
        times: on the scenario's clock [s], shape (N,). Where they are NaN, only steady obstacles
            count (`Obstacle.is_steady`).
        margin: further distance from obstacles that are not steady [m].
        called: words for whose position it is, such as `" of waypoint 2 (roof)"`.
        hard_only: whether soft obstacles are left out.

    Raises:
        ScenarioError: a vehicle is too close to an obstacle.
    """
    timed, placed = np.isfinite(times), np.isfinite(positions).all(axis=1)
    for number, obstacle in enumerate(obstacles, start=1):
        if hard_only and obstacle.penalty is not None:
            continue
        checked = np.flatnonzero(placed & (timed | obstacle.is_steady))
        at = np.where(timed, times, 0.0)[checked]
        distances = obstacle.distances(positions[checked], at)
        margins = fleet.radii[checked] + obstacle.deviation
        if not obstacle.is_steady:
            margins += margin
        tolerances = fleet.obstacle_tolerances(obstacle.shape)[checked]
        inside = distances < margins - tolerances
        if np.any(inside):
            first = int(np.argmax(inside))
            i, least, d = checked[first], margins[first], float(distances[first])
            required = f"at least {least:g} m from" if least > 0.0 else "outside"
            actual = f"{d:g} m from" if d > 0.0 else f"{-d:g} m in"
            place = "where {} may be" if obstacle.is_uncertain else "{}"
            expected = (
                f"a position{called} {required} {place.format(obstacle.called(number))}, "
                f"not {actual} it{_circumstances(obstacle, positions[i], times[i], margin)}"
            )
            raise ScenarioError(f"vehicles[{i}].{where}", positions[i].tolist(), expected)


def _circumstances(
    obstacle: Obstacle, position: FloatArray, time: np.float64, margin: float
) -> str:
    """Return when a vehicle is too close to an obstacle, and how the obstacle is described."""
    when = f" at {clock_time(float(time))}" if not obstacle.is_steady else ""
    when += " (with smoothing, vehicles rest before their plan and after)" * (margin > 0.0)
    relative = position - obstacle.centers(np.array([time]))[0]
    return f"{when} ({obstacle.shape.described_near(relative)})"


def check_requirements(
    requirements: Sequence[KeepIn],
    required: Sequence[KeepIn],
    fleet: Fleet,
    names: Sequence[str],
    grid: Grid,
    under_way: bool,
) -> None:
    """Check that requirements name vehicles, are active in the flight, and hold at given states.

    Args:
        requirements: all requirements, numbered from 1 in this order.
        required: these and those that waypoints add, with their intervals of time.
        fleet: the vehicles.
        names: names of the vehicles.
        grid: first and last knot.
        under_way: whether starts are states reached in flight, and requirements may be
            over; neither is checked then.

    Raises:
        ScenarioError: a requirement names no vehicle, is not in the flight, or does not contain a
            start, a goal or a waypoint at which it is active.
    """
    for index, each in enumerate(requirements):
        where = f"requirements[{index}]"
        for field, given in (("vehicles", each.vehicles or ()), ("relative_to", (each.leader,))):
            for name in given:
                if name is not None and name not in names:
                    raise ScenarioError(f"{where}.{field}", name, one_of(names, name))
        if len(each.members(names)) == 0:
            expected = f"a scenario with other vehicles than {each.leader!r}"
            raise ScenarioError(f"{where}.vehicles", None, expected)
        flight = (grid.start, grid.end)
        if not (each.active is None or under_way or grid.clock.within(each.active, flight).all()):
            expected = f"times in the flight, from {grid.start:g} s to {grid.end:g} s"
            raise ScenarioError(f"{where}.active", list(each.active), expected)
    for number, each in enumerate(required, start=1):
        _check_given_states(each, number, fleet, names, grid, under_way)


class _Given(NamedTuple):
    """Given values of a quantity, one of each vehicle."""

    field: str
    """field of a vehicle with the values"""
    called: str
    """words for whose values they are; empty for ends"""
    quantity: Quantity
    values: FloatArray
    """values in the quantity's unit, shape (N, 3)"""
    times: FloatArray
    """times on the scenario's clock [s], NaN where there is no value, shape (N,)"""
    within: FloatArray
    """largest allowed distances from the values, shape (N,)"""


def _check_given_states(
    requirement: KeepIn,
    number: int,
    fleet: Fleet,
    names: Sequence[str],
    grid: Grid,
    under_way: bool,
) -> None:
    """Check that a requirement contains the starts, goals and waypoints at which it is active."""
    states: tuple[tuple[str, Quantity, FloatArray], ...] = (
        ("start", "position", fleet.start_positions),
        ("start", "velocity", fleet.start_velocities),
        ("goal", "position", fleet.given_goals("position")),
        ("goal", "velocity", fleet.given_goals("velocity")),
    )
    ends, passed, exactly = list[_Given](), list[_Given](), np.zeros(len(names))
    for end, quantity, values in states[2 * under_way :]:
        time = grid.start if end == "start" else grid.end
        times = np.where(np.isnan(values[:, 0]), np.nan, time)
        ends.append(_Given(f"{end}.{quantity}", "", quantity, values, times, exactly))
    if requirement.leader is None and requirement.penalty is None:
        for each in fleet.waypoints:
            field, times = (
                f"waypoints[{each.index}].position",
                np.where(each.soft, np.nan, each.times),
            )
            at = each.positions, times, each.within
            passed.append(_Given(field, f" of {each.called}", "position", *at))
    for required, given in ((_at_ends(requirement, grid), ends), (requirement, passed)):
        for one in given:
            if one.quantity == requirement.quantity:
                _check_values(required, number, fleet, names, grid, one)


def _check_values(
    requirement: KeepIn,
    number: int,
    fleet: Fleet,
    names: Sequence[str],
    grid: Grid,
    given: _Given,
) -> None:
    """Check that given values are in a requirement's set if it is active."""
    interval = requirement.interval(grid)
    if interval is None:
        return
    members = requirement.members(names)
    active = grid.clock.within(given.times[members], interval)  # false for NaN
    members, tolerances = members[active], requirement.tolerances(fleet, names)[active]
    relative = requirement.relative(given.values, given.times, names)[active]
    outside = requirement.set.signed_distance(relative) - given.within[members]
    if np.any(outside > tolerances):
        worst = int(np.argmax(outside - tolerances))
        vehicle, unit = int(members[worst]), UNITS[requirement.quantity]
        of = "" if requirement.relative_to is None else " relative to "
        of += requirement.leader or ("the track" if of else "")
        expected = (
            f"a {given.quantity}{given.called}{of} in {requirement.called(number)}, "
            f"not {outside[worst]:.4g} {unit} outside it ({set_text(requirement.set)})"
        )
        value = given.values[vehicle].tolist()
        raise ScenarioError(f"vehicles[{vehicle}].{given.field}", value, expected)


def _at_ends(active: _Active, grid: Grid) -> _Active:
    """Return an obstacle or a requirement, active at an end if it is active close to it.

    Args:
        active: an obstacle or a requirement with an active interval.
        grid: first and last knot.
    """
    if active.active is None:
        return active
    (first, last), near = active.active, END_MARGIN * grid.step
    return unchecked(active, active=(first - near, last + near))
