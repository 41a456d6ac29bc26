"""Parts of a scenario: grid, vehicles with start and goal, limits, separation.

Records are immutable and validated when created; a change makes a new record
(`dataclasses.replace`). All units are SI; `docs/paper.md` lists the paper's symbols.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    model_serializer,
    model_validator,
)

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    LARGEST,
    NOT_BOOLEAN,
    Colour,
    Finite,
    FloatArray,
    Margin,
    Name,
    Positive,
    Vector,
    read_only,
    record,
    unchecked,
)
from drake_rho.scenario.goals import FreeOrVector, Goal, as_goal, goal_kind, set_in, with_absent
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.sets import PACKAGE_SET, ConvexSet, ValueOrSet, is_own
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.shapes.quadrics import Ellipsoid
from drake_rho.scenario.times import Clock, divides

if TYPE_CHECKING:
    from drake_rho.scenario.sets import ConvexSet

Quantity = Literal["position", "velocity", "acceleration", "jerk"]
"""Quantities that a box can bound."""
Airframe = Literal["aircraft", "quadrotor"]
"""Airframes as which a vehicle can be drawn."""

UNITS: dict[Quantity, str] = {
    "position": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "jerk": "m/s³",
}
"""SI units of the quantities."""

MOST_KNOTS = 100_000
"""Largest number of knots of a grid."""

REACHED = 4
"""Number of steps before the first knot and after the last that enter a smoothing: averages begin
up to one and a half steps early, extend as far back again, and include the knot before."""


@record
class Grid:
    """Time grid of a flight: knots k = 1..K with the step h between them.

    Examples:
        >>> grid = rho.Grid(step=0.5, knots=5)
        >>> grid.duration, grid.times.tolist()
        (2.0, [0.0, 0.5, 1.0, 1.5, 2.0])
    """

    step: Positive
    """h, the time from one knot to the next [s]"""
    knots: Annotated[int, Field(ge=2, le=MOST_KNOTS), NOT_BOOLEAN]
    """K, the number of knots, including the first and the last"""
    start: Finite = 0.0
    """time of the first knot on the scenario's clock, to which the times of obstacles refer [s]"""

    @classmethod
    def lasting(cls, duration: float, *, step: float, start: float = 0.0) -> Self:
        """Return the grid of a flight of `duration` [s] with steps of `step` [s] from `start` [s].

        Raises:
            ScenarioError: the duration or the step is not positive, the step does not divide the
                duration, or there would be more knots than a grid can have.
        """
        for field, value in (("duration", duration), ("step", step)):
            if not 1.0 / LARGEST <= value <= LARGEST:  # also true for NaN
                raise ScenarioError(field, value, "a time above 0 in seconds")
        if not divides(step, duration):
            raise ScenarioError("step", step, f"a step that divides the duration, {duration:g} s")
        steps = round(duration / step)
        return cls(duration / steps, steps + 1, start)

    @cached_property
    def duration(self) -> float:
        """Duration T = (K - 1) h [s]."""
        return self.step * (self.knots - 1)

    @property
    def end(self) -> float:
        """Time of the last knot on the scenario's clock [s]."""
        return self.start + self.duration

    @cached_property
    def times(self) -> FloatArray:
        """Times of the knots on the scenario's clock [s], shape (K,)."""
        return read_only(self.start + self.elapsed)

    @cached_property
    def elapsed(self) -> FloatArray:
        """Times of the knots since the first one [s], shape (K,)."""
        return read_only(self.step * np.arange(self.knots))

    @cached_property
    def clock(self) -> Clock:
        """Clock for comparing times of the flight, also times since its first knot."""
        first, _ = self._origin
        return Clock.of(self.step, first, self.end)

    def beginning_at(self, start: float) -> Self:
        """Return the grid with its first knot at another time [s] and with the same clock.

        Times since the first knot, on a clock that is 0 there, are as coarse as those on the clock
        from which they were computed.
        """
        return unchecked(self, start=start, clock=self.clock)

    def since_start(self, times: npt.ArrayLike) -> FloatArray:
        """Return times on the scenario's clock as times since the first knot [s], of any shape.

        A time that equals a knot's but for rounding becomes exactly the knot's, so that beginnings,
        ends and corners at a knot stay there on a clock far from 0, too.
        """
        elapsed = np.asarray(times, dtype=np.float64) - self.start
        knots = self.step * np.clip(np.rint(elapsed / self.step), 0, self.knots - 1)
        return np.where(self.clock.same(elapsed, knots), knots, elapsed)

    def interval_since_start(self, interval: tuple[float, float]) -> tuple[float, float]:
        """Return the ends of an interval as `since_start` does."""
        first, last = self.since_start(interval).tolist()
        return first, last

    def from_knot(self, knot: int, steps: int | None = None) -> Grid:
        """Return the remainder of the grid from a knot on, counted from 0.

        Args:
            knot: first knot of the result.
            steps: number of its steps, which may go beyond the end; the remaining ones if not
                given.
        """
        start, passed = self._origin
        passed += knot
        return unchecked(
            self,
            knots=self.knots - knot if steps is None else steps + 1,
            start=start + self.step * passed,
            _origin=(start, passed),
        )

    @cached_property
    def _origin(self) -> tuple[float, int]:
        """Start of the whole flight [s], and the steps from there to this remainder of it.

        It keeps the starts of all windows bit-equal to knots of the whole flight.
        """
        return self.start, 0


_AT_REST, _UNKNOWN = read_only(np.zeros(3)), read_only(np.full(3, np.nan))
"""Accelerations before a start, or after a goal, that are not given [m/s²]: at rest, in motion."""


@record
class State:
    """Position, velocity and acceleration of a vehicle at one knot.

    Examples:
        >>> rho.State([0, 0, 1]).velocity.tolist()  # at rest
        [0.0, 0.0, 0.0]
        >>> rho.State([0, 0, 1]).acceleration_outside.tolist()
        [0.0, 0.0, 0.0]
    """

    position: Vector
    """p [m]"""
    velocity: FreeOrVector = dataclasses.field(default_factory=lambda: read_only(np.zeros(3)))
    """v [m/s]; at rest if not given; None for a goal to be reached with any velocity"""
    acceleration: Vector | None = None
    """acceleration just before the first knot or, of a goal, just after the last one [m/s²], from
    which and to which jerks (7) are limited; if not given it is zero at rest, and in motion it is
    unknown, so that the jerk there is not limited"""

    if TYPE_CHECKING:  # the constructor also accepts lists, the fields are arrays

        def __init__(
            self,
            position: npt.ArrayLike,
            velocity: npt.ArrayLike | None = ...,
            acceleration: npt.ArrayLike | None = None,
        ) -> None: ...

    _with_absent = model_serializer(mode="wrap")(with_absent)

    @model_validator(mode="after")
    def _has_an_acceleration_with_a_velocity_only(self) -> Self:
        if self.velocity is None and self.acceleration is not None:
            expected = "none beside a free velocity"
            raise ScenarioError("acceleration", self.acceleration.tolist(), expected)
        return self

    @property
    def is_at_rest(self) -> bool:
        """Whether it has no velocity, and no acceleration before a start or after a goal."""
        moving = self.velocity is None or self.velocity.any()
        return not (moving or np.any(self.acceleration_outside))

    @property
    def acceleration_outside(self) -> FloatArray:
        """Acceleration before a start or after a goal [m/s²], shape (3,); NaN where unknown."""
        if self.acceleration is not None:
            return self.acceleration
        return _UNKNOWN if self.velocity is None or self.velocity.any() else _AT_REST

    @cached_property
    def flown(self) -> FloatArray | None:
        """Accelerations before the first knot that enter the averages [m/s²], (REACHED, 3).

        They are given in a flight in windows with a smoothing; None elsewhere, where averages begin
        at rest.
        """
        return None

    @cached_property
    def jerk_before(self) -> FloatArray | None:
        """Jerk at the knot before the first one [m/s³], (3,), from which a snap begins.

        It is given in the remainder of a flight; None elsewhere.
        """
        return None


START, GOAL = "start", "goal"
"""Words for the first and the last knot where names of waypoints are expected."""


def _any_of(schema: dict[str, Any]) -> None:
    """Let a JSON schema accept what several kinds describe: a `Goal` may be a state, too."""
    schema["anyOf"] = schema.pop("oneOf")


def _exact_if_possible(goal: State | Goal) -> State | Goal:
    """Return a goal as a state if its position is given, and its velocity is given or free."""
    velocity, known = goal.velocity, isinstance(goal.position, np.ndarray)
    if isinstance(goal, Goal) and known and set_in(velocity) is None:
        return State(goal.position, velocity)
    return goal


if TYPE_CHECKING:  # goals are mostly states: code that reads them should not have to check
    AnyGoal = Any
else:
    AnyGoal = Annotated[
        Annotated[State, Tag("State")] | Annotated[Goal, Tag("Goal")],
        Discriminator(goal_kind),
        BeforeValidator(as_goal),
        AfterValidator(_exact_if_possible),
        Field(json_schema_extra=_any_of),
    ]
    """State, or a `Goal` that is none, from anything that a user gives as a goal."""


@record
class Waypoint:
    """Position that a vehicle passes at a given time, which need not be that of a knot.

    If no time is given, planning finds it. Waypoints without times are passed in their order. A
    gate has a direction, given by the velocity there; at a stop the vehicle dwells.

    Examples:
        >>> rho.Waypoint(3.0, [5, 0, 2], within=0.2).within
        0.2
        >>> rho.Waypoint(None, [5, 0, 2]).time  # found
        >>> forwards = rho.Cone([0, 0, 0], [1, 0, 0], 0.2)  # within 0.2 rad of the direction
        >>> gate = rho.Waypoint(3.0, [5, 0, 2], velocity=forwards, name="gate")
        >>> stop = rho.Waypoint(6.0, [9, 0, 2], dwell=2.0)
    """

    time: Finite | None = None
    """time on the scenario's clock, after the first knot and before the last [s]; found if not
    given"""
    position: Vector = Field(...)
    """position of the vehicle at that time [m]"""
    within: Annotated[float, Field(ge=0.0, le=LARGEST, allow_inf_nan=False)] = 0.0
    """largest distance of the vehicle from the position [m]; 0 to pass it exactly"""
    _: dataclasses.KW_ONLY
    velocity: ValueOrSet | None = None
    """velocity at that time [m/s]: a vector, or a convex set of velocities such as a cone around a
    direction; any if not given. With a dwell it is a set that contains zero, for all of this time;
    in wind it says what counts as rest, and the position stays `within`"""
    dwell: Annotated[
        float,
        Field(ge=0.0, le=LARGEST, allow_inf_nan=False, exclude_if=lambda time: time == 0.0),
        NOT_BOOLEAN,
    ] = 0.0
    """least time at rest from that time on [s]: velocity and acceleration are zero in all steps of
    the grid that it meets"""
    name: Name | None = None
    """name shown in figures and reports, and used by `KeepIn.between`; unique for the vehicle"""
    penalty: Positive | None = None
    """cost of each metre by which the vehicle passes further away, times its weight [m/s⁴]; it must
    not if not given"""
    colour: Annotated[Colour | None, Field(exclude_if=lambda colour: colour is None)] = None
    """colour of the vehicle's light there, as #rrggbb, which exports to Skybrush (skyc) have; plans
    do not depend on it"""

    if TYPE_CHECKING:

        def __init__(
            self,
            time: float | None,
            position: npt.ArrayLike,
            within: float = 0.0,
            *,
            velocity: npt.ArrayLike | ConvexSet | None = None,
            dwell: float = 0.0,
            name: str | None = None,
            penalty: float | None = None,
            colour: str | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if self.time is None and self.penalty is not None:
            expected = "none without a time: the search for times passes every waypoint"
            raise ScenarioError("penalty", self.penalty, expected)
        if self.name in (START, GOAL):
            raise ScenarioError("name", self.name, "another name: this is an end of the flight")
        if self.dwell > 0.0 and self.velocity is not None and not self._may_rest:
            expected = "0 at a waypoint with a velocity: a vehicle dwells at rest"
            raise ScenarioError("dwell", self.dwell, expected)
        return self

    @property
    def _may_rest(self) -> bool:
        """Whether its velocity may be zero."""
        if isinstance(self.velocity, np.ndarray):
            return not self.velocity.any()
        return self.velocity is None or float(self.velocity.signed_distance(np.zeros(3))) <= 0.0

    def called(self, number: int) -> str:
        """Return how reports refer to it: by its number from 1, and its name if any."""
        return f"waypoint {number}" + (f" ({self.name})" if self.name else "")

    def check_storable(self) -> None:
        """Check that a file can hold the waypoint.

        Raises:
            ScenarioError: the set of its velocities is a user's own.
        """
        if not isinstance(self.velocity, np.ndarray) and is_own(self.velocity):
            raise ScenarioError("velocity", self.velocity, PACKAGE_SET)


@record
class Vehicle:
    """Point mass with a start and a goal.

    Examples:
        >>> rho.Vehicle("", rho.State([0, 0, 1]), rho.State([4, 0, 1]))
        Traceback (most recent call last):
        drake_rho.scenario.errors.ScenarioError: vehicle.name: got '', expected at least 1 character
    """

    name: Name
    """name, unique within the scenario"""
    start: State
    """state at the first knot"""
    goal: AnyGoal
    """state at the last knot, `State(position, velocity=None)` for any velocity there; a convex set
    of positions to be at rest in; a `Goal`, with sets of positions or velocities; None for anywhere
    with any velocity"""
    limits: Limits | None = None
    """limits that override the scenario's, field by field"""
    radius: Margin = 0.0
    """least distance of its position from every obstacle [m]; the separation applies to other
    vehicles"""
    waypoints: tuple[Waypoint, ...] = ()
    """positions to pass during the flight, numbered from 1 in reports; no two at the same time"""
    airframe: Airframe | None = None
    """airframe as which it is drawn, aircraft or quadrotor; chosen by its limits if not given; it
    has no effect on plans"""
    weight: Annotated[float, Field(ge=1e-3, le=1e3, allow_inf_nan=False), NOT_BOOLEAN] = 1.0
    """weight of its squared accelerations in the cost of all vehicles, from 0.001 to 1000,
    which solvers resolve: of two vehicles that meet, the one with the smaller weight deviates
    more"""

    if TYPE_CHECKING:

        def __init__(
            self,
            name: str,
            start: State,
            goal: State | Goal | ConvexSet | None,
            limits: Limits | None = None,
            radius: float = 0.0,
            waypoints: Sequence[Waypoint] = (),
            airframe: Airframe | None = None,
            weight: float = 1.0,
        ) -> None: ...

    @model_validator(mode="after")
    def _start_has_a_velocity(self) -> Self:
        if self.start.velocity is None:
            raise ScenarioError("start.velocity", None, "a velocity: only goals can leave it free")
        return self

    @model_validator(mode="after")
    def _waypoint_times_are_distinct(self) -> Self:
        times: set[float] = set()
        for index, waypoint in enumerate(self.waypoints):
            if waypoint.time is None:
                continue
            if waypoint.time in times:
                expected = "a time that no other waypoint of the vehicle has"
                raise ScenarioError(f"waypoints[{index}].time", waypoint.time, expected)
            times.add(waypoint.time)
        return self

    @model_validator(mode="after")
    def _waypoint_names_are_distinct(self) -> Self:
        names: set[str] = set()
        for index, waypoint in enumerate(self.waypoints):
            if waypoint.name in names:
                expected = "a name that no other waypoint of the vehicle has"
                raise ScenarioError(f"waypoints[{index}].name", waypoint.name, expected)
            if waypoint.name is not None:
                names.add(waypoint.name)
        return self

    @model_validator(mode="after")
    def _free_waypoints_can_be_passed_in_order(self) -> Self:
        if all(each.time is not None for each in self.waypoints):
            return self
        last, before = -np.inf, None
        for index, each in enumerate(self.waypoints):
            if each.time is not None:
                if each.time < last:
                    expected = f"a time after {last:g} s: waypoints are passed in their order"
                    raise ScenarioError(f"waypoints[{index}].time", each.time, expected)
                last = each.time
            if before is not None and np.array_equal(before.position, each.position):
                expected = "another position than that of the waypoint before"
                where = f"waypoints[{index}].position"
                raise ScenarioError(where, each.position.tolist(), expected)
            before = each
        return self


@record
class Separation:
    """Required separation of every pair of vehicles: norm((dx, dy, dz / downwash)) >= distance.

    Examples:
        >>> rho.Separation(0.35, downwash=2.0).shape.semi_axes.tolist()
        [0.35, 0.35, 0.7]
    """

    distance: Positive
    """least distance of two vehicles side by side [m]"""
    downwash: Annotated[float, Field(ge=1e-3, le=1e3, allow_inf_nan=False), NOT_BOOLEAN] = 1.0
    """ratio of the least vertical to the least horizontal distance, from a thousandth to a
    thousand: to a solver, a flatter or longer ellipsoid is a plane or a line"""

    @property
    def tolerance(self) -> float:
        """Violation of the distance that is still accepted: `TOLERANCE` times the distance [m]."""
        return TOLERANCE * self.distance

    @cached_property
    def shape(self) -> Ellipsoid:
        """Ellipsoid that the relative position of two vehicles must not enter."""
        return Ellipsoid(np.zeros(3), self.distance * np.array([1.0, 1.0, self.downwash]))

    @property
    def is_round(self) -> bool:
        """True if the required distance is the same in all directions."""
        return self.downwash == 1.0

    def scaled(self, positions: FloatArray) -> FloatArray:
        """Return positions with z divided by `downwash`, so that the separation is a sphere.

        Args:
            positions: of vehicles, or differences of two [m], shape (..., 3).

        Returns:
            The scaled positions; the array itself, not a copy, if the downwash is 1.
        """
        if self.is_round:
            return positions
        scaled = np.array(positions, dtype=np.float64, order="C")
        scaled[..., 2] *= self.shape.scales[2]  # several times as fast as a product by all scales
        return scaled
