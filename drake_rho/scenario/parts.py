"""The parts of a scenario: grid, vehicles with start and goal, limits, separation.

Records are frozen and checked when made; a changed situation is a new record
(`dataclasses.replace`). SI units throughout; symbols of the paper stand in `docs/paper.md`.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, model_validator

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    NO_TRUTH,
    Finite,
    FloatArray,
    Margin,
    Name,
    Positive,
    Vector,
    locked,
    record,
    unchecked,
)
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.shapes.quadrics import Ellipsoid

Quantity = Literal["position", "velocity", "acceleration", "jerk"]
"""What a box can bound."""
Airframe = Literal["aircraft", "quadrotor"]
"""What a vehicle can be drawn as."""

_SAME = 1e-9
"""Part of a step by which times may differ that are meant as the same."""

_ROUNDINGS = 8.0
"""Roundings of the clock by which they may: sums of a few times, and a user's own arithmetic."""

GRAVITY = 9.81
"""g [m/s²]: a vehicle with acceleration a has the thrust a + g e_z for each kilogram, z upwards."""


@record
class Grid:
    """The knots k = 1..K of a flight and the step h between them.

    Examples:
        >>> grid = rho.Grid(step=0.5, knots=5)
        >>> grid.duration, grid.times.tolist()
        (2.0, [0.0, 0.5, 1.0, 1.5, 2.0])
    """

    step: Positive
    """h, the time from one knot to the next [s]"""
    knots: Annotated[int, Field(ge=2, le=100_000), NO_TRUTH]
    """K, the number of knots, the first and the last included"""
    start: Finite = 0.0
    """time of the first knot on the scenario's clock, on which obstacles move [s]"""

    @classmethod
    def lasting(cls, duration: float, *, step: float, start: float = 0.0) -> Self:
        """The grid of a flight of `duration` [s] in steps of `step` [s] that begins at `start` [s].

        Raises:
            ScenarioError: one is not positive, the step does not divide the duration, or there
                would be more knots than a grid can have.
        """
        for field, value in (("duration", duration), ("step", step)):
            if not 1.0 / LARGEST <= value <= LARGEST:  # nor with a NaN
                raise ScenarioError(field, value, "a time above 0 in seconds")
        steps = duration / step
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-9 * steps:
            raise ScenarioError("step", step, f"a step that divides the duration, {duration:g} s")
        return cls(duration / round(steps), round(steps) + 1, start)

    @property
    def duration(self) -> float:
        """T = (K - 1) h [s]."""
        return self.step * (self.knots - 1)

    @property
    def end(self) -> float:
        """Time of the last knot on the scenario's clock [s]."""
        return self.start + self.duration

    @property
    def times(self) -> FloatArray:
        """Time of every knot on the scenario's clock [s], shape (K,)."""
        return locked(self.start + self.elapsed)

    @property
    def elapsed(self) -> FloatArray:
        """Time of every knot since the first one [s], shape (K,)."""
        return locked(self.step * np.arange(self.knots))

    @property
    def rounding(self) -> float:
        """How far apart two times may be and still be meant as the same one [s].

        A clock far from 0 is rounded: at the Unix time of today to 2.4e-7 s.
        """
        largest = max(abs(self.start), abs(self.end))
        return max(_SAME * self.step, _ROUNDINGS * sys.float_info.epsilon * largest)

    def from_knot(self, knot: int) -> Grid:
        """What is left of the grid from a knot on, counted from 0."""
        start, passed = self._begun
        passed += knot
        return unchecked(
            self,
            knots=self.knots - knot,
            start=start + self.step * passed,
            _begun=(start, passed),
        )

    @cached_property
    def _begun(self) -> tuple[float, int]:
        """When the flight began that this grid is left of [s], and how many steps ago.

        So that starts of windows are the knots of the flight, however many went before.
        """
        return self.start, 0


@record
class State:
    """Where a vehicle is and how it moves at one knot.

    Examples:
        >>> rho.State([0, 0, 1]).velocity.tolist()  # at rest
        [0.0, 0.0, 0.0]
    """

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


def _no_degrees(value: object) -> object:
    """Return what may be a tilt, unless it is a number of degrees."""
    if isinstance(value, int | float) and np.pi / 2.0 <= value:
        radians = f"; {value:g}° are {np.radians(value):.4g} rad" if value < 90.0 else ""
        raise ScenarioError("", value, f"an angle in radians, less than a right angle{radians}")
    return value


@record
class Limits:
    """Boxes (4) to (7) and norms that a vehicle keeps to; what is left out is no limit.

    Thrust and tilt are those of a + g e_z, the acceleration that rotors have to make for the
    vehicle to fly with a: g = 9.81 m/s² (`GRAVITY`), e_z upwards. Hovering is always allowed.

    Examples:
        >>> slow = rho.Limits(max_speed=2.0)
        >>> rho.Limits(max_speed=4.0, max_tilt=0.5).overridden_by(slow).max_speed
        2.0
    """

    position: Box | None = None
    """the flyable volume (4) [m]"""
    velocity: Box | None = None
    """(6) [m/s]"""
    acceleration: Box | None = None
    """(5) [m/s²]"""
    jerk: Box | None = None
    """(7), j[k] = (a[k] - a[k-1]) / h [m/s³]"""
    max_speed: Positive | None = None
    """largest norm of the velocity, in any direction [m/s]"""
    max_acceleration: Positive | None = None
    """largest norm of the acceleration, in any direction [m/s²]"""
    max_thrust: (
        Annotated[float, Field(ge=GRAVITY, le=LARGEST, allow_inf_nan=False), NO_TRUTH] | None
    ) = None
    """largest norm of a + g e_z [m/s²], the thrust for each kilogram; at least g = 9.81 m/s², which
    it takes to hover"""
    max_tilt: (
        Annotated[
            float,
            Field(ge=1.0 / LARGEST, lt=np.pi / 2.0, allow_inf_nan=False),
            NO_TRUTH,
            BeforeValidator(_no_degrees),
        ]
        | None
    ) = None
    """largest angle of a + g e_z to the upright [rad], less than a right angle; as far as a
    multicopter tilts"""
    max_jerk: Positive | None = None
    """largest norm of the jerk j[k] = (a[k] - a[k-1]) / h, in any direction [m/s³]"""

    def overridden_by(self, own: Limits | None) -> Limits:
        """These limits with those that `own` has in place of them."""
        if own is None:
            return self
        limits = {
            field.name: getattr(own, field.name) or getattr(self, field.name)
            for field in dataclasses.fields(Limits)
        }
        return Limits(**limits)


@record
class Waypoint:
    """A place that a vehicle passes at a time, which need not be that of a knot.

    Examples:
        >>> rho.Waypoint(3.0, [5, 0, 2], within=0.2).within
        0.2
    """

    time: Finite
    """on the scenario's clock, after the first knot and before the last [s]"""
    position: Vector
    """where the vehicle is then [m]"""
    within: Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)] = 0.0
    """how far from there it may be [m]; 0 for exactly there"""

    if TYPE_CHECKING:

        def __init__(self, time: float, position: npt.ArrayLike, within: float = 0.0) -> None: ...


@record
class Vehicle:
    """A point mass with a start and a goal.

    Examples:
        >>> rho.Vehicle("", rho.State([0, 0, 1]), rho.State([4, 0, 1]))
        Traceback (most recent call last):
        drake_rho.scenario.errors.ScenarioError: vehicle.name: got '', expected at least 1 character
    """

    name: Name
    """unique within the scenario"""
    start: State
    """state at the first knot"""
    goal: State
    """state at the last knot"""
    limits: Limits | None = None
    """own limits, where they differ from the scenario's"""
    radius: Margin = 0.0
    """how far its position keeps from every obstacle [m]; from other vehicles it keeps the
    separation"""
    waypoints: tuple[Waypoint, ...] = ()
    """where it passes on its way, numbered from 1 in reports; no two at the same time"""
    airframe: Airframe | None = None
    """what it is drawn as, aircraft or quadrotor; by its limits if not given. No plan depends on
    it."""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            start: State,
            goal: State,
            limits: Limits | None = None,
            radius: float = 0.0,
            waypoints: Sequence[Waypoint] = (),
            airframe: Airframe | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _passes_one_place_at_a_time(self) -> Self:
        times: set[float] = set()
        for index, waypoint in enumerate(self.waypoints):
            if waypoint.time in times:
                expected = "a time that no other waypoint of the vehicle has"
                raise ScenarioError(f"waypoints[{index}].time", waypoint.time, expected)
            times.add(waypoint.time)
        return self

    @model_validator(mode="after")
    def _goal_has_no_acceleration(self) -> Self:
        if self.goal.acceleration is not None:
            raise ScenarioError(
                "goal.acceleration",
                self.goal.acceleration.tolist(),
                "no acceleration in a goal: none acts after the last knot",
            )
        return self


@record
class Separation:
    """How far every pair of vehicles keeps apart: norm((dx, dy, dz / downwash)) >= distance.

    Examples:
        >>> rho.Separation(0.35, downwash=2.0).shape.semi_axes.tolist()
        [0.35, 0.35, 0.7]
    """

    distance: Positive
    """least distance of two vehicles side by side [m]"""
    downwash: Annotated[float, Field(ge=1e-3, le=1e3, allow_inf_nan=False), NO_TRUTH] = 1.0
    """how many times as far apart two vehicles above each other must be; from a thousandth to a
    thousand, as a flatter or longer ellipsoid is a plane or a line to a solver"""

    @property
    def tolerance(self) -> float:
        """How much closer still counts as apart: `TOLERANCE` of the distance [m]."""
        return TOLERANCE * self.distance

    @cached_property
    def shape(self) -> Ellipsoid:
        """What the way from one vehicle to another keeps out of."""
        return Ellipsoid(np.zeros(3), self.distance * np.array([1.0, 1.0, self.downwash]))

    @property
    def is_round(self) -> bool:
        """Whether it is the same in all directions."""
        return self.downwash == 1.0

    def scaled(self, positions: FloatArray) -> FloatArray:
        """Positions where the distance of two is that of two vehicles: z divided by `downwash`.

        Args:
            positions: of vehicles, or differences of two [m], shape (..., 3).

        Returns:
            The same, perhaps the very array.
        """
        return positions if self.is_round else self.shape.scaled(positions)
