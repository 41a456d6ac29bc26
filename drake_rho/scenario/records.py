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
from pydantic import Field, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray, Name, locked, record, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.pairs import check_apart
from drake_rho.scenario.parts import (
    Box,
    Grid,
    Limits,
    Quantity,
    Separation,
    State,
    Vehicle,
)
from drake_rho.scenario.shapes import TOLERANCE, Sphere

__all__ = [
    "TOLERANCE",
    "Box",
    "Grid",
    "Limits",
    "Quantity",
    "Scenario",
    "Separation",
    "Sphere",
    "State",
    "Vehicle",
]


@record
class Scenario:
    """Everything a planner needs to know."""

    name: Name
    """shown in figures and reports"""
    grid: Grid
    """knots and step"""
    vehicles: Annotated[tuple[Vehicle, ...], Field(min_length=1)]
    """the vehicles, each with a name of its own"""
    limits: Limits = dataclasses.field(default_factory=Limits)
    """limits of every vehicle, box by box, unless it has its own"""
    obstacles: tuple[Sphere, ...] = ()
    """the spheres to keep out of; numbered from 1 in reports"""
    separation: Separation | None = None
    """how far every pair of vehicles keeps apart at all times; not at all if not given"""
    between_knots: bool = True
    """whether obstacles, separation and position boxes must hold at every instant, or at the
    knots only"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            grid: Grid,
            vehicles: Sequence[Vehicle],
            limits: Limits = ...,
            obstacles: Sequence[Sphere] = (),
            separation: Separation | None = None,
            between_knots: bool = True,
        ) -> None: ...

    @cached_property
    def fleet(self) -> Fleet:
        """The vehicles as arrays."""
        aside = 0.0 if self.separation is None else self.separation.distance
        return Fleet(self.grid, self.vehicles, self.limits, aside)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names: set[str] = set()
        for index, vehicle in enumerate(self.vehicles):
            if vehicle.name in names:
                expected = "a name no other vehicle has"
                raise ScenarioError(f"vehicles[{index}].name", vehicle.name, expected)
            names.add(vehicle.name)
        self.check_ends()
        return self

    def check_ends(self) -> None:
        """See that all starts and goals are in their boxes, outside the obstacles and apart.

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
            bounds = fleet.bounds(quantity)
            if bounds is not None:
                bounds.check(f"{end}.{quantity}", values)
            for limit in fleet.norms.values():
                if limit.quantity == quantity:
                    limit.check(f"{end}.{quantity}", values)
        for end, positions in (("start", fleet.start_positions), ("goal", fleet.goal_positions)):
            for number, sphere in enumerate(self.obstacles, start=1):
                self._check_outside(sphere, number, end, positions)
            if self.separation is not None:
                check_apart(self.separation, self.vehicles, f"{end}.position", positions)

    @staticmethod
    def _check_outside(sphere: Sphere, number: int, end: str, positions: FloatArray) -> None:
        distances = np.linalg.norm(positions - sphere.center, axis=1)
        inside = distances < sphere.radius - sphere.tolerance
        if np.any(inside):
            i = int(np.argmax(inside))
            expected = (
                f"a position outside obstacle {number} (center {sphere.center.tolist()}, "
                f"radius {sphere.radius:g} m; {distances[i]:g} m from the center)"
            )
            raise ScenarioError(f"vehicles[{i}].{end}.position", positions[i].tolist(), expected)

    def limits_of(self, vehicle: Vehicle) -> Limits:
        """The vehicle's own limits where it has them, else the scenario's."""
        return self.limits.overridden_by(vehicle.limits)

    def without_obstacles(self) -> Scenario:
        """This scenario with nothing in the way (the paper's Examples 1 and 3)."""
        return unchecked(self, obstacles=(), fleet=self.fleet)

    def without_separation(self) -> Scenario:
        """This scenario without a separation."""
        return dataclasses.replace(self, separation=None)

    def from_states(
        self, grid: Grid, positions: FloatArray, velocities: FloatArray, before: FloatArray
    ) -> Scenario:
        """This scenario from other states on another grid; boxes and pairs are not looked at.

        Args:
            grid: what is left of the flight.
            positions: p[1] [m], shape (N, 3).
            velocities: v[1] [m/s], shape (N, 3).
            before: accelerations just before [m/s²], shape (N, 3).

        Raises:
            ScenarioError: a position is inside an obstacle.
        """
        states = zip(locked(positions), locked(velocities), locked(before), strict=True)
        vehicles = tuple(
            unchecked(
                vehicle, start=unchecked(vehicle.start, position=p, velocity=v, acceleration=a)
            )
            for vehicle, (p, v, a) in zip(self.vehicles, states, strict=True)
        )
        for number, sphere in enumerate(self.obstacles, start=1):
            self._check_outside(sphere, number, "start", positions)
        fleet = self.fleet.started_at(grid, positions, velocities, before)
        return unchecked(self, grid=grid, vehicles=vehicles, fleet=fleet)

    def index_of(self, name: str) -> int:
        """The place of the vehicle called `name` in `vehicles`.

        Raises:
            ValueError: there is no such vehicle.
        """
        names = [vehicle.name for vehicle in self.vehicles]
        if name not in names:
            raise ValueError(f"vehicle: got {name!r}, expected one of {', '.join(names)}")
        return names.index(name)
