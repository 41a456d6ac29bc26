"""What is asked: the grid, the vehicles, their limits and the obstacles. SI units throughout.

Records are frozen and checked when made; a changed situation is a new record
(`dataclasses.replace`). Symbols of the paper stand in `docs/paper.md`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import Count, FloatArray, Name, Positive, Vector, locked, record

TOLERANCE = 1e-6
"""Relative tolerance to which a constraint counts as held, everywhere in the package: of a
sphere's radius, of the length scale of a vehicle's motion, of a box's side if that is less."""

Quantity = Literal["position", "velocity", "acceleration", "jerk"]
"""What a box can bound."""


@record
class Grid:
    """The knots k = 1..K of a flight and the step h between them."""

    step: Positive
    """h, the time from one knot to the next [s]"""
    knots: Annotated[Count, Field(ge=2, le=100_000)]
    """K, the number of knots, the first and the last included"""

    @property
    def duration(self) -> float:
        """T = (K - 1) h [s]."""
        return self.step * (self.knots - 1)

    @property
    def times(self) -> FloatArray:
        """Time of every knot from the first one on [s], shape (K,)."""
        return locked(self.step * np.arange(self.knots))


@record
class State:
    """Where a vehicle is and how it moves at one knot."""

    position: Vector
    """p [m]"""
    velocity: Vector = dataclasses.field(default_factory=lambda: locked(np.zeros(3)))
    """v [m/s]; at rest if not given"""
    acceleration: Vector | None = None
    """acceleration just before the first knot [m/s²], for the jerk limit (7) there; if not
    given, the first acceleration is free of it. Has no meaning in a goal."""

    if TYPE_CHECKING:  # what is made of lists too is read as arrays

        def __init__(
            self,
            position: npt.ArrayLike,
            velocity: npt.ArrayLike = ...,
            acceleration: npt.ArrayLike | None = None,
        ) -> None: ...


@record
class Box:
    """Lower and upper bound on each axis."""

    lower: Vector
    """least x, y and z"""
    upper: Vector
    """greatest x, y and z"""

    if TYPE_CHECKING:

        def __init__(self, lower: npt.ArrayLike, upper: npt.ArrayLike) -> None: ...

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not np.all(self.lower <= self.upper):
            expected = f"no component above upper {self.upper.tolist()}"
            raise ScenarioError("lower", self.lower.tolist(), expected)
        return self

    def tolerance(self, scale: float) -> FloatArray:
        """How far outside still counts as inside on each axis, shape (3,).

        `TOLERANCE` of the side, but no more than of `scale`, so that a side made wide to be no
        limit does not loosen the other, and no less than of a thousandth of it, which a solver
        can still tell.
        """
        return TOLERANCE * np.clip(self.upper - self.lower, 1e-3 * scale, scale)


@record
class Limits:
    """Boxes (4) to (7) that a vehicle keeps to; a box left out is no limit."""

    position: Box | None = None
    """the flyable volume (4) [m]"""
    velocity: Box | None = None
    """(6) [m/s]"""
    acceleration: Box | None = None
    """(5) [m/s²]"""
    jerk: Box | None = None
    """(7), j[k] = (a[k] - a[k-1]) / h [m/s³]"""

    def overridden_by(self, own: Limits | None) -> Limits:
        """These limits with the boxes that `own` has in place of them."""
        if own is None:
            return self
        boxes = {
            field.name: getattr(own, field.name) or getattr(self, field.name)
            for field in dataclasses.fields(Limits)
        }
        return Limits(**boxes)


@record
class Vehicle:
    """A point mass with a start and a goal."""

    name: Name
    """unique within the scenario"""
    start: State
    """state at the first knot"""
    goal: State
    """state at the last knot"""
    limits: Limits | None = None
    """own limits, where they differ from the scenario's"""

    @model_validator(mode="after")
    def _goal_has_no_acceleration(self) -> Self:
        if self.goal.acceleration is not None:
            raise ScenarioError(
                "goal.acceleration",
                self.goal.acceleration.tolist(),
                "no acceleration in a goal: none acts after the last knot",
            )
        return self

    def length_scale(self, duration: float) -> float:
        """Length scale of the motion [m], for tolerances and for the numbers a solver sees.

        The largest of the way to go and the ways that the given velocities and acceleration
        cover in `duration` [s], but no less than a millionth of the coordinates, which is what
        their rounding leaves room for; 1 m for a vehicle that stays at the origin.
        """
        ways = [self.goal.position - self.start.position]
        ways += [1e-6 * state.position for state in (self.start, self.goal)]
        ways += [duration * state.velocity for state in (self.start, self.goal)]
        if self.start.acceleration is not None:
            ways.append(duration**2 * self.start.acceleration)
        return max(float(np.linalg.norm(way)) for way in ways) or 1.0


@record
class Sphere:
    """An obstacle (8) that stands still."""

    center: Vector
    """p_m [m]"""
    radius: Positive
    """R_m [m]"""

    if TYPE_CHECKING:

        def __init__(self, center: npt.ArrayLike, radius: float) -> None: ...

    @property
    def tolerance(self) -> float:
        """How deep inside still counts as outside: `TOLERANCE` of the radius [m]."""
        return TOLERANCE * self.radius


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
    separation: None = None
    """reserved: vehicles are planned without regard to each other in this version"""
    between_knots: bool = True
    """whether obstacles and position boxes must hold at every instant, or at the knots only"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            grid: Grid,
            vehicles: Sequence[Vehicle],
            limits: Limits = ...,
            obstacles: Sequence[Sphere] = (),
            separation: None = None,
            between_knots: bool = True,
        ) -> None: ...

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [vehicle.name for vehicle in self.vehicles]
        for index, vehicle in enumerate(self.vehicles):
            where = f"vehicles[{index}]"
            if vehicle.name in names[:index]:
                raise ScenarioError(f"{where}.name", vehicle.name, "a name no other vehicle has")
            for end in ("start", "goal"):
                self._check_state(vehicle, getattr(vehicle, end), f"{where}.{end}")
        return self

    def _check_state(self, vehicle: Vehicle, state: State, where: str) -> None:
        limits = self.limits_of(vehicle)
        quantities: tuple[Quantity, ...] = ("position", "velocity", "acceleration")
        for quantity in quantities:
            value, box = getattr(state, quantity), getattr(limits, quantity)
            if value is None or box is None:
                continue
            room = box.tolerance(self.scale(vehicle, quantity))
            if np.any(value < box.lower - room) or np.any(value > box.upper + room):
                expected = f"a {quantity} within {box.lower.tolist()} to {box.upper.tolist()}"
                raise ScenarioError(f"{where}.{quantity}", value.tolist(), expected)
        for number, sphere in enumerate(self.obstacles, start=1):
            distance = float(np.linalg.norm(state.position - sphere.center))
            if distance < sphere.radius - sphere.tolerance:
                expected = (
                    f"a position outside obstacle {number} (center {sphere.center.tolist()}, "
                    f"radius {sphere.radius:g} m; {distance:g} m from the center)"
                )
                raise ScenarioError(f"{where}.position", state.position.tolist(), expected)

    def limits_of(self, vehicle: Vehicle) -> Limits:
        """The vehicle's own limits where it has them, else the scenario's."""
        return self.limits.overridden_by(vehicle.limits)

    def scale(self, vehicle: Vehicle, quantity: Quantity) -> float:
        """What is large for a quantity of the vehicle's motion, in the quantity's SI unit.

        L, L/T, L/T² and L/(T² h) with the motion's length scale L.
        """
        h, T = self.grid.step, self.grid.duration
        powers = {"position": 1.0, "velocity": T, "acceleration": T**2, "jerk": T**2 * h}
        return vehicle.length_scale(T) / powers[quantity]

    def without_obstacles(self) -> Scenario:
        """The same scenario with nothing in the way (the paper's Examples 1 and 3)."""
        return dataclasses.replace(self, obstacles=())

    def index_of(self, name: str) -> int:
        """Where the vehicle called `name` stands in `vehicles`.

        Raises:
            ValueError: there is no such vehicle.
        """
        names = [vehicle.name for vehicle in self.vehicles]
        if name not in names:
            raise ValueError(f"vehicle: got {name!r}, expected one of {', '.join(names)}")
        return names.index(name)
