"""The scenario as it is known now, told in flight: what it changes from now on.

What is known of the flight so far stays: obstacles and requirements are active until now, or from
now on. Goals and waypoints ahead are those told; starts are ignored.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from operator import is_
from typing import Self

from drake_rho.planning.horizon.known_obstacles import (
    ChangingObstacles,
    Numbers,
    just_before,
    partners,
    until_name,
)
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.gates import bound_to_vehicles, on_known_legs, on_legs
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle
from drake_rho.scenario.parts import Vehicle, Waypoint
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.rest_of_flight import with_obstacles

_OF_MISSIONS = ("between_knots", "disturbance", "smoothing", "hold_at_goal")
"""Fields of a scenario that stay the same in a mission."""

_OF_FLIGHTS = ("limits", "separation", "objective")
"""Fields that stay the same in a flight; in a mission of several flights they may change."""

_OF_VEHICLES = ("limits", "radius", "weight")
"""Fields of a vehicle that do."""


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """Scenario as it was told last, and the flight's own: what was known when."""

    told: Scenario
    """scenario as it was told last"""
    flight: Scenario
    """scenario of the whole flight, with the times found for waypoints"""
    numbers: Numbers
    """numbers of the flight's obstacles that each obstacle told consists of"""
    necessary: tuple[tuple[AnyObstacle, ...], Numbers]
    """the same without sightings within the errors of former ones: obstacles that the plan in force
    has to avoid, and their numbers"""
    required: Numbers
    """numbers of the flight's requirements that each requirement told consists of"""
    has_news: bool = False
    """whether anything was told in flight"""
    is_new: bool = False
    """whether it was told for the next window"""
    endless: bool = False
    """whether the grid told only gives the step: the flight has no end"""

    @classmethod
    def of(cls, given: Scenario, flight: Scenario) -> Self:
        """Return what is known before a flight.

        Args:
            given: scenario as it was given.
            flight: the same with obstacles that become known later, by the time of planning ahead.
        """
        numbers, required = (
            tuple((number,) for number in range(1, 1 + count))
            for count in (len(flight.bodies), len(flight.requirements))
        )
        return cls(given, flight, numbers, (flight.obstacles, numbers), required)

    def with_flight(self, flight: Scenario) -> Self:
        """Return what is known after a window, with other times of waypoints in the flight."""
        if flight is self.flight and not self.is_new:
            return self
        necessary = flight.obstacles, self.numbers
        return dataclasses.replace(self, flight=flight, necessary=necessary, is_new=False)

    def without_spare(self) -> Self:
        """Return what is known without sightings within the errors of former ones."""
        obstacles, numbers = self.necessary
        flight = with_obstacles(self.flight, obstacles)
        return dataclasses.replace(self, flight=flight, numbers=numbers)

    def required_of(self, vehicles: Sequence[Vehicle]) -> tuple[KeepIn, ...]:
        """Return the flight's requirements for vehicles of a plan, whose waypoints may differ."""
        return on_known_legs(bound_to_vehicles(self.flight.requirements, vehicles), vehicles)

    def with_news(self, now: Scenario, time: float, ago: float) -> Self:
        """Return what is known from a time on.

        Args:
            now: the scenario as it is known now.
            time: from which on it holds, on the scenario's clock [s].
            ago: time since obstacles that move otherwise were seen, before this time [s].

        Raises:
            ScenarioError: the scenario differs in what stays the same in a flight, or two obstacles
                or requirements have one name.
        """
        _check(self.told, now, ("start", "step") if self.endless else ("start", "step", "knots"))
        flight = self.flight
        obstacles = ChangingObstacles(flight.bodies, self.numbers, time, flight.grid)
        former, numbers = obstacles.tell(self.told.bodies, now.bodies, ago)
        both = zip(flight.vehicles, self.told.vehicles, now.vehicles, strict=True)
        vehicles = tuple(_with_orders(own, was, each, time) for own, was, each in both)
        requirements, required = _requirements(self, now, time)
        changed = with_obstacles(flight, _as_before(flight, obstacles.bodies))
        changed = changed.derived(requirements=tuple(requirements))
        if not all(map(is_, vehicles, flight.vehicles)):
            changed = changed.derived(vehicles=vehicles)
        return dataclasses.replace(
            self,
            told=now,
            flight=changed,
            numbers=tuple(obstacles.numbers),
            necessary=(_as_before(flight, former), numbers),
            required=required,
            has_news=True,
            is_new=True,
        )


def _as_before(flight: Scenario, bodies: Sequence[Obstacle]) -> tuple[AnyObstacle, ...]:
    """Return obstacles, the flight's own if they are these."""
    same = len(bodies) == len(flight.bodies) and all(map(is_, bodies, flight.bodies))
    return flight.obstacles if same else tuple(bodies)


def _check(before: Scenario, now: Scenario, of_grid: Sequence[str]) -> None:
    """Check that a scenario differs only in what may change in a flight.

    Args:
        before: as it was told last.
        now: as it is told now.
        of_grid: fields of the grid that stay.
    """
    for error in (*_changes(before, now, of_grid, _OF_MISSIONS), *changes_of(before, now)):
        raise error


def changes_of(before: Scenario, now: Scenario) -> list[ScenarioError]:
    """Return the errors of what stays the same in a flight and differs, if it may in a mission.

    Args:
        before: as it was told last.
        now: as it is told now.

    Raises:
        ScenarioError: what stays the same in a mission differs, or two obstacles or requirements
            have one name.
    """
    for error in _changes(before, now, ("start", "step"), _OF_MISSIONS):
        raise error
    _check_names("obstacles", [each.name for each in now.bodies])
    _check_names("requirements", [each.name for each in now.requirements])
    if now.names != before.names:
        expected = f"the vehicles of the flight, {', '.join(before.names)}"
        return [ScenarioError("scenario.vehicles", list(now.names), expected)]
    found = list(_changes(before, now, (), _OF_FLIGHTS))
    for i, (own, other) in enumerate(zip(now.vehicles, before.vehicles, strict=True)):
        for field in _OF_VEHICLES:
            if (value := getattr(own, field)) != getattr(other, field):
                where = f"scenario.vehicles[{i}].{field}"
                found.append(ScenarioError(where, value, "that of the flight, which stays"))
    return found


def _changes(
    before: Scenario, now: Scenario, of_grid: Sequence[str], fields: Sequence[str]
) -> Iterator[ScenarioError]:
    """Yield the errors of fields of the grid and of a scenario that differ."""
    for field in of_grid:
        value, own = getattr(now.grid, field), getattr(before.grid, field)
        if value != own:
            yield ScenarioError(f"scenario.grid.{field}", value, f"{own}, as in the flight")
    for field in fields:
        if (value := getattr(now, field)) != getattr(before, field):
            yield ScenarioError(f"scenario.{field}", value, "that of the flight, which stays")


def _check_names(field: str, names: Sequence[str | None]) -> None:
    """Check that no two items have one name."""
    for index, name in enumerate(names):
        if name is not None and name in names[:index]:
            expected = "a name of its own, by which it is known in flight"
            raise ScenarioError(f"scenario.{field}[{index}].name", name, expected)


def _requirements(known: Known, now: Scenario, time: float) -> tuple[list[KeepIn], Numbers]:
    """Return the flight's requirements, until now and from now on, and numbers of those told."""
    flight, grid, before = known.flight, known.flight.grid, known.told.requirements
    former, which = list[KeepIn | None](flight.requirements), partners(before, now.requirements)
    kept = [
        index if index is not None and each == before[index] else None
        for index, each in zip(which, now.requirements, strict=True)
    ]
    for gone in set(range(len(before))) - set(kept):
        for number in known.required[gone]:
            former[number - 1] = _until(flight.requirements[number - 1], flight, time)
    left = [number for number, each in enumerate(former, start=1) if each is not None]
    found, numbers = [each for each in former if each is not None], list[tuple[int, ...]]()
    for index, each in zip(kept, now.requirements, strict=True):
        if index is not None:
            own = known.required[index]
            numbers.append(tuple(1 + left.index(number) for number in own))
        elif each.between or grid.clock.after((each.active or (0.0, grid.end))[1], time):
            first, last = each.active or (grid.start, grid.end)
            active = None if each.between else (max(first, time), last)
            found.append(unchecked(each, active=active))
            numbers.append((len(found),))
        else:  # it is over
            numbers.append(())
    return found, tuple(numbers)


def _until(requirement: KeepIn, flight: Scenario, time: float) -> KeepIn | None:
    """Return a requirement as it was until now; None if it has not begun.

    Between waypoints it holds from the first of them on, which may differ from vehicle to vehicle:
    then from the earliest time.
    """
    grid = flight.grid
    first, last = requirement.active or (grid.start, grid.end)
    if requirement.between is not None:
        legs = on_legs(requirement, flight.vehicles, grid)
        ends = [each.active for each in legs if each.active is not None]
        first = max(min((each[0] for each in ends), default=grid.end), grid.start)
        last = max((each[1] for each in ends), default=grid.end)
    if not grid.clock.after(last, time):
        return requirement
    before = just_before(time, grid)
    if not grid.clock.before(first, before):
        return None
    name = until_name(requirement.name, time)
    return unchecked(requirement, between=None, active=(first, before), name=name)


def _with_orders(own: Vehicle, before: Vehicle, now: Vehicle, time: float) -> Vehicle:
    """Return a vehicle of the flight with another goal, or with other waypoints ahead.

    Args:
        own: of the flight, with the times found for waypoints.
        before: as it was told last.
        now: as it is told now.
        time: from which on it holds, on the scenario's clock [s].
    """
    waypoints = own.waypoints
    if now.waypoints != before.waypoints:
        passed = [each for each in waypoints if each.time is not None and each.time <= time]
        waypoints = (*passed, *_ahead(passed, now.waypoints, time))
    if waypoints is own.waypoints and now.goal == before.goal:
        return own
    return unchecked(own, goal=now.goal, waypoints=waypoints)


def _ahead(
    passed: Sequence[Waypoint], waypoints: Sequence[Waypoint], time: float
) -> Iterator[Waypoint]:
    """Yield the waypoints that have not been passed yet.

    Args:
        passed: those passed, some at times that were found.
        waypoints: all waypoints as told, some without times.
        time: now, on the scenario's clock [s].
    """
    left = [unchecked(each, time=None) for each in passed]
    for each in waypoints:
        if each.time is None and each in left:
            left.remove(each)
        elif each.time is None or each.time > time:
            yield each
