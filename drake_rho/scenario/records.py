"""What is asked: a scenario of vehicles, limits, obstacles and separation on a grid.

Everything a user makes a scenario of can be had from here; the parts are defined in
`drake_rho.scenario.parts`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from drake_rho.scenario.disturbance import Disturbance, Tracking
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, Name, locked, record, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.obstacles import AnyObstacle, Obstacle, Track
from drake_rho.scenario.pairs import check_apart
from drake_rho.scenario.parts import (
    Grid,
    Limits,
    Quantity,
    Separation,
    State,
    Vehicle,
    Waypoint,
)
from drake_rho.scenario.shapes.base import TOLERANCE, Shape
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere
from drake_rho.scenario.waypoints import is_under_way

__all__ = [
    "TOLERANCE",
    "Box",
    "Cylinder",
    "Disturbance",
    "Ellipsoid",
    "Grid",
    "Limits",
    "Obstacle",
    "Polytope",
    "Quantity",
    "Scenario",
    "Separation",
    "Sphere",
    "State",
    "Track",
    "Vehicle",
    "Waypoint",
]


@record
class Scenario:
    """Everything a planner needs to know.

    Examples:
        >>> scenario = rho.Scenario(
        ...     "short hop",
        ...     rho.Grid.lasting(5.0, step=0.25),
        ...     [rho.Vehicle("scout", rho.State([0, 0, 1]), rho.State([4, 0, 1]), radius=0.2)],
        ...     limits=rho.Limits(max_speed=2.0),
        ...     obstacles=[rho.Sphere([2, 0.1, 1], 0.5)],
        ... )
        >>> print(f"{rho.plan(scenario).cost:.2f} m²/s⁴")
        8.39 m²/s⁴
    """

    name: Name
    """shown in figures and reports"""
    grid: Grid
    """knots and step"""
    vehicles: Annotated[tuple[Vehicle, ...], Field(min_length=1)]
    """the vehicles, each with a name of its own"""
    limits: Limits = dataclasses.field(default_factory=Limits)
    """limits of every vehicle, box by box, unless it has its own"""
    obstacles: tuple[AnyObstacle, ...] = ()
    """what to keep out of, shapes at rest or `Obstacle`s; numbered from 1 in reports"""
    separation: Separation | None = None
    """how far every pair of vehicles keeps apart at all times; not at all if not given"""
    between_knots: bool = True
    """whether obstacles, separation and position boxes must hold at every instant, or at the
    knots only"""
    disturbance: Disturbance | None = None
    """what moves vehicles off their plans, and the feedback against it; nothing if not given"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            grid: Grid,
            vehicles: Sequence[Vehicle],
            limits: Limits = ...,
            obstacles: Sequence[Shape | Obstacle] = (),
            separation: Separation | None = None,
            between_knots: bool = True,
            disturbance: Disturbance | None = None,
        ) -> None: ...

    @cached_property
    def fleet(self) -> Fleet:
        """The vehicles as arrays."""
        return self._fleet_of(self.vehicles)

    def _fleet_of(self, vehicles: Sequence[Vehicle]) -> Fleet:
        aside = 0.0 if self.separation is None else self.separation.distance
        return Fleet(self.grid, vehicles, self.limits, aside, [body for _, body in self.known])

    @model_validator(mode="after")
    def _consistent(self, info: ValidationInfo[bool | None]) -> Self:
        under_way = bool(info.context)  # where a vehicle is then is for no one to choose
        names: set[str] = set()
        for index, vehicle in enumerate(self.vehicles):
            if vehicle.name in names:
                expected = "a name no other vehicle has"
                raise ScenarioError(f"vehicles[{index}].name", vehicle.name, expected)
            names.add(vehicle.name)
        for index, each in enumerate(self.obstacles):
            try:
                (each.shape if isinstance(each, Obstacle) else each).check_solid()
            except ScenarioError as error:
                raise error.inside(f"obstacles[{index}]") from None
        for index, obstacle in enumerate(self.bodies):
            if obstacle.known_from > max(self.grid.end, 0.0):  # at 0 it is known from the start
                expected = f"a time in the flight, which ends at {self.grid.end:g} s"
                raise ScenarioError(f"obstacles[{index}].known_from", obstacle.known_from, expected)
        if self.disturbance is not None:
            self.disturbance.check(self.grid)
        self.check_ends(under_way=under_way)
        self.check_waypoints()
        return self

    def check_ends(self, *, under_way: bool = False) -> None:
        """See that all starts and goals are in their boxes, outside the obstacles and apart.

        Args:
            under_way: whether starts are states that a flight has reached, which are not looked at:
                wind may have taken it there, or too late it was seen what to avoid.

        Raises:
            ScenarioError: one is not.
        """
        fleet = self.fleet
        states: tuple[tuple[str, Quantity, FloatArray], ...] = (
            ("start", "position", fleet.start_positions),
            ("start", "velocity", fleet.start_velocities),
            ("start", "acceleration", fleet.accelerations_before),
            ("goal", "position", fleet.goal_positions),
            ("goal", "velocity", fleet.goal_velocities),
        )
        for end, quantity, values in states:
            if end == "start" and under_way:
                continue
            bounds = fleet.bounds(quantity)
            if bounds is not None:
                bounds.check(f"{end}.{quantity}", values)
            for limit in fleet.norms.values():
                if limit.kind.quantity == quantity:
                    limit.check(f"{end}.{quantity}", values)
        ends = (
            ("start", fleet.start_positions, self.grid.start),
            ("goal", fleet.goal_positions, self.grid.end),
        )
        for end, positions, time in ends:
            if end == "start" and under_way:
                continue
            times = np.full(len(positions), time)
            self.check_outside(f"{end}.position", positions, times)
            if self.separation is not None:
                check_apart(self.separation, self.vehicles, f"{end}.position", positions)

    def check_waypoints(self) -> None:
        """See that all waypoints are in the flight, in position boxes and outside the obstacles.

        Raises:
            ScenarioError: one is not.
        """
        for index, waypoints in enumerate(self.fleet.waypoints):
            where = f"waypoints[{index}]"
            for i in np.flatnonzero(waypoints.due):
                time = float(waypoints.times[i])
                if not is_under_way(time, self.grid):
                    expected = f"after {self.grid.start:g} s and before {self.grid.end:g} s"
                    raise ScenarioError(
                        f"vehicles[{i}].{where}.time", time, f"a time in the flight, {expected}"
                    )
            if (bounds := self.fleet.bounds("position")) is not None:
                bounds.check(f"{where}.position", waypoints.positions)
            self.check_outside(f"{where}.position", waypoints.positions, waypoints.times)

    def check_outside(self, where: str, positions: FloatArray, times: FloatArray) -> None:
        """See that the vehicles keep their radius from all obstacles, known or not, at some time.

        Of an obstacle on a track they keep its deviation more.

        Args:
            where: the field of a vehicle that holds its position, as `"start.position"`.
            positions: of the vehicles [m], shape (N, 3).
            times: on the scenario's clock [s], shape (N,); NaN for a vehicle that is not looked at.

        Raises:
            ScenarioError: one does not.
        """
        who = np.flatnonzero(np.isfinite(times))
        for number, obstacle in enumerate(self.bodies, start=1):
            distances = obstacle.distances(positions[who], times[who])
            margins = self.fleet.radii[who] + obstacle.deviation
            inside = distances < margins - self.fleet.obstacle_tolerances(obstacle.shape)[who]
            if np.any(inside):
                place = int(np.argmax(inside))
                i, margin, d = who[place], margins[place], float(distances[place])
                kept = f"at least {margin:g} m from" if margin > 0.0 else "outside"
                far = f"{d:g} m from" if d > 0.0 else f"{-d:g} m in"
                when = f" at {times[i]:g} s" if obstacle.moves else ""
                expected = (
                    f"a position {kept} {self.obstacle_name(number)}, not {far} it{when} "
                    f"({obstacle.shape})"
                )
                raise ScenarioError(f"vehicles[{i}].{where}", positions[i].tolist(), expected)

    @cached_property
    def under_way(self) -> bool:
        """Whether this is what is left of a flight, in which the previous plan may go on."""
        return False

    @cached_property
    def bodies(self) -> tuple[Obstacle, ...]:
        """The obstacles, each as an `Obstacle`."""
        return tuple(
            each if isinstance(each, Obstacle) else Obstacle(each) for each in self.obstacles
        )

    @property
    def spheres(self) -> tuple[Sphere, ...]:
        """The obstacles (8) as the paper has them: spheres at rest that are known all the time."""
        always = (each for each in self.bodies if each.is_steady and each.known_from <= 0.0)
        return tuple(each.shape for each in always if isinstance(each.shape, Sphere))

    @cached_property
    def bodies_in_flight(self) -> tuple[Obstacle, ...]:
        """The obstacles, each on a clock that is 0 at the first knot."""
        return tuple(each.since(self.grid.start) for each in self.bodies)

    @cached_property
    def known(self) -> tuple[tuple[int, Obstacle], ...]:
        """The obstacles that planners know of at the first knot, with their numbers from 1.

        Their clocks are 0 at the first knot, as in `bodies_in_flight`.
        """
        return _known(self.bodies, self.bodies_in_flight, self.grid)

    def obstacle_name(self, number: int) -> str:
        """What an obstacle is called in reports, by its number from 1: number, and name if any."""
        name = self.bodies[number - 1].name
        return f"obstacle {number}" + (f" ({name})" if name else "")

    def limits_of(self, vehicle: Vehicle) -> Limits:
        """The vehicle's own limits where it has them, else the scenario's."""
        return self.limits.overridden_by(vehicle.limits)

    def without_obstacles(self) -> Scenario:
        """This scenario with nothing in the way (the paper's Examples 1 and 3)."""
        return self.derived(obstacles=())

    def on_grid(self, grid: Grid) -> Scenario:
        """This scenario on another grid, on which the feedback is sampled as often or more often.

        Raises:
            ScenarioError: something in it does not fit the grid.
        """
        around = None if self.disturbance is None else self.disturbance.for_grid(grid)
        return dataclasses.replace(self, grid=grid, disturbance=around)

    def without_separation(self) -> Scenario:
        """This scenario without a separation."""
        known = [body for _, body in self.known]
        alone = Fleet(self.grid, self.vehicles, self.limits, bodies=known)
        return self.derived(separation=None, fleet=alone)

    def with_disturbance(self, disturbance: Disturbance | None) -> Scenario:
        """Return this scenario with another disturbance, which is known to fit its grid."""
        return self.derived(disturbance=disturbance)

    def derived(self, **changes: object) -> Scenario:
        """Return a copy with other values that are known to be valid.

        What is computed of vehicles and obstacles is that of this scenario as long as nothing
        changes that it is computed of; `changes` can name what it is then.
        """
        own = {
            name: getattr(self, name)
            for name, sources in _COMPUTED_OF.items()
            if not sources & changes.keys()
        }
        return unchecked(self, **(own | changes))

    def of_vehicles(self, indices: Sequence[int]) -> Scenario:
        """This scenario of some of its vehicles only, which are not looked at again."""
        vehicles = tuple(self.vehicles[index] for index in indices)
        return self.derived(vehicles=vehicles, fleet=self._fleet_of(vehicles))

    def from_states(
        self,
        grid: Grid,
        positions: FloatArray,
        velocities: FloatArray,
        before: FloatArray,
        tracking: Tracking | None = None,
    ) -> Scenario:
        """This scenario from other states on another grid, which are not looked at.

        Waypoints that have passed are left out.

        Args:
            grid: what is left of the flight.
            positions: at its first knot [m], shape (N, 3).
            velocities: at its first knot [m/s], shape (N, 3).
            before: accelerations just before [m/s²], shape (N, 3).
            tracking: since when feedback holds the vehicles to their plan, if it does.
        """
        around = self.disturbance and unchecked(self.disturbance, tracking=tracking)
        states = zip(locked(positions), locked(velocities), locked(before), strict=True)
        vehicles = tuple(
            unchecked(
                vehicle,
                start=unchecked(vehicle.start, position=p, velocity=v, acceleration=a),
                waypoints=tuple(
                    each for each in vehicle.waypoints if is_under_way(each.time, grid)
                ),
            )
            for vehicle, (p, v, a) in zip(self.vehicles, states, strict=True)
        )
        passed = grid.step * round((grid.start - self.grid.start) / grid.step)
        bodies = tuple(each.since(passed) for each in self.bodies_in_flight)
        known = _known(self.bodies, bodies, grid)
        seen = [body for _, body in known]
        fleet = self.fleet.started_at(grid, vehicles, positions, velocities, before, seen)
        return self.derived(
            grid=grid,
            vehicles=vehicles,
            fleet=fleet,
            disturbance=around,
            bodies_in_flight=bodies,
            known=known,
            under_way=True,
        )

    def index_of(self, name: str) -> int:
        """The place of the vehicle called `name` in `vehicles`.

        Raises:
            ValueError: there is no such vehicle.
        """
        names = [vehicle.name for vehicle in self.vehicles]
        if name not in names:
            raise ValueError(f"vehicle: got {name!r}, expected one of {', '.join(names)}")
        return names.index(name)


_COMPUTED_OF: dict[str, set[str]] = {
    "bodies": {"obstacles"},
    "bodies_in_flight": {"obstacles", "grid"},
    "fleet": {"grid", "vehicles", "limits", "obstacles", "separation"},
    "under_way": set(),
}
"""What a scenario passes on to what is derived from it, and the fields that it is computed of."""


def _known(
    obstacles: Sequence[Obstacle], in_flight: Sequence[Obstacle], grid: Grid
) -> tuple[tuple[int, Obstacle], ...]:
    """Return the obstacles that planners know of at the first knot of a grid.

    Args:
        obstacles: all of them, on the scenario's clock.
        in_flight: the same on a clock that is 0 at that knot.
        grid: of the scenario, or what is left of it.

    Returns:
        Those of `in_flight`, with their numbers from 1.
    """
    now = max(grid.start, 0.0) + grid.rounding
    both = enumerate(zip(obstacles, in_flight, strict=True), start=1)
    return tuple((number, body) for number, (each, body) in both if each.known_from <= now)
