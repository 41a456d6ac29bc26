"""Missions in several flights: what an interval of time cannot tell begins another flight.

A flight has one set of vehicles, limits, separation and objective, and its obstacles become more as
more becomes known. Where these change, or are too many, the record of the flight ends, and another
one begins with the plan in force.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.planning.horizon.known_now import Known, changes_of
from drake_rho.planning.horizon.known_obstacles import Numbers
from drake_rho.planning.horizon.places_of_rest import within_window
from drake_rho.planning.horizon.situation import Situation
from drake_rho.planning.horizon.waypoints_ahead import free_of
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.obstacles import AnyObstacle
from drake_rho.scenario.parts import State
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import from_states

_MORE = 12
"""Largest number of obstacles of a flight beyond those known now; each costs time."""


def is_crowded(known: Known) -> bool:
    """Return whether a flight has many more obstacles than are known now."""
    many = len(known.flight.bodies) > len(known.told.bodies) + _MORE
    return many and known.numbers == known.necessary[1]


def next_flight(
    situation: Situation,
    remaining: Plan,
    now: Scenario | None,
    endless: Callable[[Scenario], Scenario],
) -> Situation:
    """Return the situation of another flight, which begins with the rest of the plan in force.

    Args:
        situation: of the flight before.
        remaining: rest of the plan in force, as far as a window plans.
        now: scenario with other vehicles, limits, separation or objective; None for the same.
        endless: function that returns the scenario of a flight without an end.

    Raises:
        ScenarioError: the scenario differs in what stays the same in a mission, or a vehicle joins
            in motion or too close to another.
    """
    known = situation.known
    told, (obstacles, numbers) = known.told, _obstacles(known)
    if now is not None:
        changes_of(known.told, now)
        told, obstacles = now, now.obstacles
        numbers = tuple((number,) for number in range(1, 1 + len(obstacles)))
    base = endless(told.derived(grid=remaining.scenario.grid, obstacles=obstacles))
    starts = (*_starts(remaining, told), tracking_of(remaining.scenario))
    flight = from_states(base, base.grid, *starts)
    steps = remaining.scenario.grid.knots - 1
    rest = _continued(remaining, from_states(base, base.grid.from_knot(0, steps), *starts))
    required = tuple((number,) for number in range(1, 1 + len(told.requirements)))
    necessary = flight.obstacles, numbers
    begun = Known(told, flight, numbers, necessary, required, is_new=now is not None, endless=True)
    last = situation.last and unchecked(
        situation.last, first_knot=0, plan=rest, reference=rest, contingency=None
    )
    return dataclasses.replace(
        situation, given=flight, known=begun, free=free_of(flight), last=last, is_begun=True
    )


def _obstacles(known: Known) -> tuple[tuple[AnyObstacle, ...], Numbers]:
    """Return the obstacles that are not over, maps as they are known now, and their numbers."""
    bodies, numbers = list[AnyObstacle](), list[tuple[int, ...]]()
    for body, own in zip(known.told.bodies, known.numbers, strict=True):
        if own:
            is_map = isinstance(body.shape, Map) and not body.moves
            bodies.append(body if is_map else known.flight.bodies[own[0] - 1])
        numbers.append((len(bodies),) if own else ())
    return tuple(bodies), tuple(numbers)


def _starts(remaining: Plan, told: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions [m], velocities [m/s] and accelerations before [m/s²], (N, 3) each.

    Vehicles of the flight before have those planned; others join at rest at their starts.

    Raises:
        ScenarioError: a vehicle joins in motion, or too close to another.
    """
    fleet, names = remaining.scenario.fleet, remaining.scenario.names
    positions, velocities, before = np.zeros((3, len(told.vehicles), 3))
    for i, vehicle in enumerate(told.vehicles):
        if vehicle.name in names:
            own = names.index(vehicle.name)
            positions[i], velocities[i] = fleet.start_positions[own], fleet.start_velocities[own]
            before[i] = fleet.accelerations_before[own]
            continue
        if np.any(vehicle.start.velocity):
            where, got = f"scenario.vehicles[{i}].start.velocity", vehicle.start.velocity.tolist()
            raise ScenarioError(where, got, f"0: {vehicle.name} joins at rest")
        positions[i] = vehicle.start.position
    _check_joined(positions, told, names)
    return positions, velocities, before


def _check_joined(positions: FloatArray, told: Scenario, names: tuple[str, ...]) -> None:
    """Check that vehicles that join are apart from all others.

    Args:
        positions: of all vehicles [m], shape (N, 3).
        told: scenario as it is known now.
        names: of the vehicles of the flight before.

    Raises:
        ScenarioError: one is not.
    """
    if told.separation is None:
        return
    for i, vehicle in enumerate(told.vehicles):
        if vehicle.name in names:
            continue
        others = np.delete(np.arange(len(positions)), i)
        distances = told.separation.shape.local_distance(positions[others] - positions[i])
        if np.any(distances < 0.0):
            other = told.names[int(others[np.argmin(distances)])]
            expected = f"a place apart from {other}, which is too close"
            got = Description(f"{vehicle.name} at {vehicle.start.position.tolist()}")
            raise ScenarioError(f"scenario.vehicles[{i}].start", got, expected)


def _continued(remaining: Plan, scenario: Scenario) -> Plan:
    """Return the rest of the plan in force as one of another flight's vehicles.

    Vehicles that join stay where they are.

    Args:
        remaining: the rest of the plan in force.
        scenario: of the other flight, from the same states, as far as a window plans.
    """
    before = {each.name: i for i, each in enumerate(remaining.scenario.vehicles)}
    vehicles, steps = list(scenario.vehicles), scenario.grid.knots - 1
    accelerations = np.zeros((len(vehicles), steps, 3))
    for i, vehicle in enumerate(vehicles):
        if (index := before.get(vehicle.name)) is None:
            vehicles[i] = unchecked(vehicle, goal=State(vehicle.start.position))
            continue
        own = remaining.scenario.vehicles[index]
        vehicles[i] = unchecked(vehicle, goal=own.goal, waypoints=own.waypoints)
        accelerations[i] = remaining.accelerations[index]
    rest = scenario.derived(
        vehicles=tuple(vehicles),
        requirements=within_window(scenario.requirements, scenario.grid),
        objective=unchecked(
            scenario.objective,
            terminal_position=remaining.scenario.objective.terminal_position,
        ),
        hold_at_goal=True,
        fleet=scenario.fleet.aimed(vehicles),
    )
    return Plan.from_accelerations(rest, accelerations)
