"""The planning problem, `Scenario`, and all records in it, for import from here."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from drake_rho.scenario.consistency import (
    check_ends,
    check_goal_sets,
    check_goals_at_rest,
    check_maps,
    check_names,
    check_obstacles,
    check_requirements,
    check_waypoints,
)
from drake_rho.scenario.context import Context, context_of
from drake_rho.scenario.described import ShownInNotebooks
from drake_rho.scenario.disturbance import CALM, Disturbance
from drake_rho.scenario.errors import one_of
from drake_rho.scenario.fields import Boolean, Name, record, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.frame import Frame
from drake_rho.scenario.gates import check_gates, on_known_legs, required_of
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.known_obstacles import active_during, known_at_start
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.maps.mesh import Mesh
from drake_rho.scenario.maps.voxels import Voxels
from drake_rho.scenario.objective import TERMINAL, Objective, check_objective, check_without
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid, Quantity, Separation, State, Vehicle, Waypoint
from drake_rho.scenario.penalties import penalties_of
from drake_rho.scenario.printed import (
    in_columns,
    limit_lines,
    obstacle_lines,
    option_lines,
    requirement_lines,
    time_line,
    title_of,
    vehicle_lines,
)
from drake_rho.scenario.requirements import KeepIn, goal_sets, parts_for, reaches_of
from drake_rho.scenario.scales import warn_of_scales
from drake_rho.scenario.shapes.base import TOLERANCE, Solid
from drake_rho.scenario.shapes.capsules import Capsule
from drake_rho.scenario.shapes.cylinders import Cylinder
from drake_rho.scenario.shapes.polyhedra import Box, Polytope
from drake_rho.scenario.shapes.posed import Posed
from drake_rho.scenario.shapes.quadrics import Ellipsoid, Sphere
from drake_rho.scenario.shapes.unbounded import Cone, HalfSpace
from drake_rho.scenario.smoothing import (
    Smoothing,
    check_limits_of_averages,
    check_requirements_of_averages,
    check_smoothing,
    largest_accelerations,
)
from drake_rho.scenario.tracks import Track
from drake_rho.scenario.worlds import Obstacles

__all__ = [
    "TOLERANCE",
    "Ball",
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Disturbance",
    "Ellipsoid",
    "Frame",
    "Goal",
    "Grid",
    "HalfSpace",
    "KeepIn",
    "Limits",
    "Mesh",
    "Objective",
    "Obstacle",
    "Polytope",
    "Posed",
    "Quantity",
    "Scenario",
    "Separation",
    "Smoothing",
    "Sphere",
    "State",
    "Track",
    "Vehicle",
    "Voxels",
    "Waypoint",
]
Ball = Sphere  # the name of the solid, for sets to keep in


def _is_effort(objective: Objective) -> bool:
    return objective.is_effort and objective.reference is None


def _is_nothing(value: object) -> bool:
    return value is None


@record
class Scenario(ShownInNotebooks):
    """Planning problem: vehicles, limits, obstacles and separation on a grid.

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
    """name shown in figures and reports"""
    grid: Grid
    """knots and step"""
    vehicles: Annotated[tuple[Vehicle, ...], Field(min_length=1)]
    """the vehicles, each with a unique name"""
    limits: Limits = dataclasses.field(default_factory=Limits)
    """limits of every vehicle; each one is overridden by the vehicle's own, if it has any"""
    obstacles: Obstacles = ()
    """obstacles to avoid, shapes at rest or `Obstacle`s; numbered from 1 in reports"""
    separation: Separation | None = None
    """least distance of every pair of vehicles at all times; none is required if not given"""
    between_knots: Boolean = True
    """true if obstacles, separation and position boxes constrain every instant, false if only the
    knots"""
    disturbance: Disturbance | None = None
    """wind, estimation errors, and the feedback that counteracts them; none if not given"""
    requirements: tuple[KeepIn, ...] = ()
    """convex sets to which quantities of vehicles or pairs are confined; numbered from 1 in
    reports"""
    smoothing: Smoothing | None = None
    """moving averages with which plans are flown; if not given, they are flown as planned, with
    jumps of the acceleration"""
    hold_at_goal: Boolean | None = None
    """whether vehicles have to be able to hold at their goals indefinitely after the end, in any
    allowed wind: true makes it a requirement, false disables the check; if not given, reports note
    which vehicles with goals at rest cannot"""
    objective: Annotated[Objective, Field(exclude_if=_is_effort)] = dataclasses.field(
        default_factory=Objective
    )
    """cost that plans minimise; the sum of squared accelerations (13) if not given"""
    frame: Annotated[Frame | None, Field(exclude_if=_is_nothing)] = None
    """place of the origin on the Earth, for missions; plans do not depend on it"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            grid: Grid,
            vehicles: Sequence[Vehicle],
            limits: Limits = ...,
            obstacles: Sequence[Solid | Obstacle] = (),
            separation: Separation | None = None,
            between_knots: bool = True,
            disturbance: Disturbance | None = None,
            requirements: Sequence[KeepIn] = (),
            smoothing: Smoothing | None = None,
            hold_at_goal: bool | None = None,
            objective: Objective = ...,
            frame: Frame | None = None,
        ) -> None: ...

    def __str__(self) -> str:
        """Return a few lines: vehicles, limits, obstacles and wind, each with its numbers."""
        options = option_lines(
            self.separation,
            self.disturbance,
            self.smoothing,
            between_knots=self.between_knots,
            hold_at_goal=bool(self.hold_at_goal),
            objective=self.objective,
            frame=self.frame,
        )
        lines = (
            time_line(self.grid),
            *vehicle_lines(self.vehicles),
            *limit_lines(self.limits),
            *obstacle_lines(self.bodies),
            *requirement_lines(self.requirements),
            *options,
        )
        return in_columns(title_of(self.name, len(self.vehicles), len(self.obstacles)), lines)

    @cached_property
    def fleet(self) -> Fleet:
        """Vehicles as arrays."""
        distance = 0.0 if self.separation is None else self.separation.distance
        bodies = [body for _, body in self.avoided]
        starts = np.array([each.start.position for each in self.vehicles])
        reaches = np.maximum(
            self.objective.reach(self.grid, starts),
            reaches_of(self.requirements, self.vehicles, self.grid),
        )
        parts = distance, bodies, self.objective.misses_goals, reaches
        return Fleet(self.grid, self.vehicles, self.limits, *parts)

    @model_validator(mode="after")
    def _consistent(self, info: ValidationInfo[Context | None]) -> Self:
        under_way = context_of(info).under_way
        if (objective := self.objective.on_clock(self.grid)) is not self.objective:
            object.__setattr__(self, "objective", objective)
        check_names(self.vehicles)
        check_obstacles(self.obstacles, np.inf if under_way else self.grid.end, self.grid)
        check_maps(self.bodies, self.fleet)
        self.disturbance_or_calm.check(self.grid, self.lead)
        if not under_way:
            warn_of_scales(self.fleet, self.bodies)
        self.check_ends(under_way=under_way)
        earlier = self.lead if under_way else 0.0
        check_goal_sets(self.goal_sets, self.names, self.fleet)
        check_waypoints(self.fleet, self.grid, self.bodies, earlier)
        check_requirements(
            self.requirements, self.required, self.fleet, self.names, self.grid, under_way
        )
        if not under_way:
            check_objective(self.objective, self.vehicles, self.fleet, self.grid)
            check_gates(self.requirements, self.vehicles, self.fleet, self.grid)
        if self.hold_at_goal:
            check_goals_at_rest(self.vehicles)
            if not under_way:  # windows of a rolling horizon hold where they end
                expected = "0 with hold_at_goal: vehicles hold at goals"
                check_without(self.objective, TERMINAL, expected)
        if self.smoothing and not under_way:
            expected = "0 beside smoothing: plans are extended by rest at their goals"
            check_without(self.objective, TERMINAL, expected)
            tracking = self.disturbance_or_calm.tracking
            check_smoothing(self.smoothing, self.grid, self.vehicles, self.between_knots, tracking)
            check_limits_of_averages(self.fleet, self.vehicles, self.smoothing_margin)
            check_requirements_of_averages(
                self.required, self.fleet, self.names, self.grid, self.lead
            )
        return self

    @cached_property
    def goal_sets(self) -> tuple[KeepIn, ...]:
        """Goals that are convex sets, as requirements at the last knot."""
        return goal_sets(self.vehicles, self.grid) if self.fleet.open_end else ()

    @property
    def disturbance_or_calm(self) -> Disturbance:
        """The disturbance; without one, one of no wind and exact estimates."""
        return self.disturbance or CALM

    @cached_property
    def smoothing_margin(self) -> float:
        """Largest distance of the smooth motion from its plan under the limits [m]; 0 without one.

        It is also 0 if there is nothing to keep clear of.
        """
        clear_of = self.bodies or (self.separation is not None and len(self.vehicles) > 1)
        if not self.smoothing or not clear_of:
            return 0.0
        return self.smoothing.margin(float(largest_accelerations(self.fleet).max()))

    @property
    def lead(self) -> float:
        """Time by which the motion begins before the first knot and ends after the last [s].

        It is that of the smoothing, and 0 without one.
        """
        return self.smoothing.lead if self.smoothing else 0.0

    @property
    def averaging_width(self) -> float:
        """Width of the moving averages with which plans are flown [s]; 0 without a smoothing."""
        return self.smoothing.width if self.smoothing else 0.0

    def check_ends(self, *, under_way: bool = False) -> None:
        """Check that starts and goals satisfy limits and separation and are outside obstacles.

        Args:
            under_way: whether starts are states reached in flight, which are not checked.

        Raises:
            ScenarioError: a start or a goal violates one of these constraints.
        """
        parts = self.fleet, self.vehicles, self.grid, self.bodies, self.separation
        margin = self.smoothing_margin
        smoothing = (margin if margin < np.inf else 0.0, self.lead)
        check_ends(*parts, under_way=under_way, smoothing=smoothing)

    @cached_property
    def under_way(self) -> bool:
        """True for the remainder of a flight, in which the previous plan may be continued."""
        return False

    @cached_property
    def bodies(self) -> tuple[Obstacle, ...]:
        """Obstacles, each as an `Obstacle`."""
        return tuple(
            each if isinstance(each, Obstacle) else Obstacle(each) for each in self.obstacles
        )

    @cached_property
    def required(self) -> tuple[KeepIn, ...]:
        """Requirements, and those that waypoints and goals add, each with its interval of time."""
        required, goals = required_of(self.requirements, self.vehicles, self.grid), self.goal_sets
        return (*required, *goals) if goals else required

    @property
    def spheres(self) -> tuple[Sphere, ...]:
        """Obstacles as in (8) of the paper: certain spheres at rest, always known and active."""
        static = (each for each in self.bodies if each.is_steady and each.known_from <= 0.0)
        certain = (each.shape for each in static if not each.is_uncertain)
        return tuple(shape for shape in certain if isinstance(shape, Sphere))

    @cached_property
    def bodies_in_flight(self) -> tuple[Obstacle, ...]:
        """Obstacles on a clock that is 0 at the first knot."""
        return tuple(each.since(self.grid) for each in self.bodies)

    @cached_property
    def known(self) -> tuple[tuple[int, Obstacle], ...]:
        """Numbers, from 1, and obstacles that planners know at the first knot, 0 on their clock."""
        return known_at_start(self.bodies, self.bodies_in_flight, self.grid)

    @cached_property
    def avoided(self) -> tuple[tuple[int, Obstacle], ...]:
        """Known obstacles active in the flight; those always active have no interval."""
        return active_during(self.known, self.grid)

    @cached_property
    def penalties(self) -> dict[str, float]:
        """Penalties of the soft limits, by field; empty if all must hold."""
        return penalties_of(self.vehicles, self.obstacles, self.requirements)

    def with_hard_obstacles(self) -> Scenario:
        """Return the scenario without penalties of its obstacles."""
        return self.derived(obstacles=tuple(unchecked(o, penalty=None) for o in self.bodies))

    def without_penalties(self) -> Scenario:
        """Return the scenario with the limits that must hold only, obstacles numbered anew."""
        if not self.penalties:
            return self
        vehicles = (
            unchecked(each, waypoints=tuple(one for one in each.waypoints if one.penalty is None))
            for each in self.vehicles
        )
        return self.derived(
            vehicles=tuple(vehicles),
            obstacles=tuple(each for each in self.bodies if each.penalty is None),
            requirements=tuple(each for each in self.requirements if each.penalty is None),
        )

    def obstacle_name(self, number: int) -> str:
        """Return how reports refer to an obstacle: by its number from 1, and its name if any."""
        return self.bodies[number - 1].called(number)

    def limits_of(self, vehicle: Vehicle) -> Limits:
        """Return a vehicle's limits: its own where it has them, else the scenario's."""
        return self.limits.overridden_by(vehicle.limits)

    def without_obstacles(self) -> Scenario:
        """Return the scenario without obstacles (the paper's Examples 1 and 3)."""
        return self.derived(obstacles=())

    def without_waypoints(self) -> Scenario:
        """Return the scenario without waypoints, and without what is required between them."""
        vehicles = tuple(dataclasses.replace(each, waypoints=()) for each in self.vehicles)
        return self.with_vehicles(vehicles)

    def with_vehicles(self, vehicles: tuple[Vehicle, ...]) -> Scenario:
        """Return the scenario with other waypoints of its vehicles, without legs between others."""
        requirements = on_known_legs(self.requirements, vehicles)
        return self.derived(vehicles=vehicles, requirements=requirements)

    def on_grid(self, grid: Grid) -> Scenario:
        """Return the scenario on another grid.

        The feedback is sampled as often as before or, where that does not divide the grid's step,
        slightly more often; see `Disturbance.for_grid`. Averages are at most as wide as a step.

        Raises:
            ScenarioError: the scenario does not fit the grid.
        """
        return dataclasses.replace(self, **self._for_grid(grid))

    def ending_with(self, grid: Grid, vehicles: Sequence[Vehicle] | None = None) -> Scenario:
        """Return the scenario on a grid with another end, and with other waypoints if given.

        Obstacles keep their motion on the clock. One that would become known only after the end
        becomes known at the end instead. Since the goals are clear of it, this adds no constraint.

        Args:
            grid: the grid.
            vehicles: the same vehicles, with waypoints that fit the grid.
        """
        obstacles = tuple(
            each.known_by(grid.end) if isinstance(each, Obstacle) else each
            for each in self.obstacles
        )
        vehicles = self.vehicles if vehicles is None else tuple(vehicles)
        changes = self._for_grid(grid) | {"vehicles": vehicles, "obstacles": obstacles}
        return dataclasses.replace(self, **changes)

    def _for_grid(self, grid: Grid) -> dict[str, Any]:
        """Return the fields of the scenario that depend on a grid, for another one."""
        disturbance = self.disturbance and self.disturbance.for_grid(grid)
        smoothing = self.smoothing and self.smoothing.for_grid(grid)
        return {"grid": grid, "disturbance": disturbance, "smoothing": smoothing}

    def without_separation(self) -> Scenario:
        """Return the scenario without a separation."""
        return self.derived(separation=None)

    def with_disturbance(self, disturbance: Disturbance | None) -> Scenario:
        """Return the scenario with another disturbance, which has to fit the grid."""
        return self.derived(disturbance=disturbance)

    def derived(self, **changes: object) -> Scenario:
        """Return a copy with other values, which have to be valid and are not checked.

        Cached properties are passed on to the copy unless a field changes on which they depend;
        `changes` can include new values of these properties.
        """
        unaffected = {
            name: getattr(self, name)
            for name, sources in _COMPUTED_FROM.items()
            if not sources & changes.keys()
        }
        return unchecked(self, **(unaffected | changes))

    def of_vehicles(self, indices: Sequence[int]) -> Scenario:
        """Return the scenario of some of its vehicles only, not validated again."""
        vehicles = tuple(self.vehicles[index] for index in indices)
        requirements = parts_for(self.requirements, [vehicle.name for vehicle in vehicles])
        objective = self.objective.of_vehicles(indices, len(self.vehicles))
        return self.derived(vehicles=vehicles, requirements=requirements, objective=objective)

    @cached_property
    def held(self) -> tuple[int, ...]:
        """Indices of the vehicles with a goal at rest, which have to hold there."""
        if self.hold_at_goal is False:
            return ()
        return tuple(np.flatnonzero(self.fleet.rest_at_goals).tolist())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles, in their order."""
        return tuple(vehicle.name for vehicle in self.vehicles)

    def index_of(self, name: str) -> int:
        """Return the index in `vehicles` of the vehicle called `name`.

        Raises:
            ValueError: there is no such vehicle; the error suggests the nearest name.
        """
        if name not in self.names:
            raise ValueError(f"vehicle: got {name!r}, expected {one_of(self.names, name)}")
        return self.names.index(name)


_COMPUTED_FROM: dict[str, set[str]] = {
    "bodies": {"obstacles"},
    "bodies_in_flight": {"obstacles", "grid"},
    "fleet": {"grid", "vehicles", "limits", "objective", "obstacles", "separation"},
    "under_way": set(),
}
"""Cached properties that `Scenario.derived` passes on, with the fields on which each depends."""
