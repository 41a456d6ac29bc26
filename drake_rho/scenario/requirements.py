"""`KeepIn`: requirement that a quantity of vehicles stays in a convex set."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import BeforeValidator, model_validator

from drake_rho.scenario.convex_sets import Balls, ConvexSets, Each, tolerances_of
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import (
    Finite,
    FloatArray,
    IntArray,
    Name,
    Positive,
    read_only,
    record,
    unchecked,
)
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.goals import Goal, set_in
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.parts import GOAL, START, UNITS, Grid, Quantity, Vehicle
from drake_rho.scenario.sets import PACKAGE_SET, AnySet, is_own
from drake_rho.scenario.shapes.quadrics import Sphere
from drake_rho.scenario.times import EXACT, Clock
from drake_rho.scenario.tracks import Track

if TYPE_CHECKING:
    from drake_rho.scenario.sets import ConvexSet

KeptQuantity = Literal["position", "velocity", "acceleration", "thrust", "jerk"]
"""Quantities that a requirement can keep in a set; thrust is a + g e_z, per unit mass."""


def _names(value: object) -> object:
    return (value,) if isinstance(value, str) else value


def _track_or_name(value: object) -> object:
    """Refuse a value that is neither a name nor a track, before pydantic tries both."""
    if value is None or isinstance(value, str | Track | dict):
        return value
    raise ScenarioError("", value, "the name of a vehicle, or a Track")


@record
class KeepIn:
    """Requirement that a quantity stays in a convex set, at every instant of an interval of time.

    The quantity is that of single vehicles, or its difference from that of another vehicle or of a
    moving point. So two vehicles that are to stay within 30 m of each other have a ball around
    zero, and a floor at 2 m is a half-space.

    Examples:
        >>> link = rho.KeepIn(rho.Sphere([0, 0, 0], 30.0), vehicles="relay", relative_to="base")
        >>> floor = rho.KeepIn(rho.HalfSpace([0, 0, -1], -2.0), name="floor")
        >>> floor.of, link.vehicles
        ('position', ('relay',))
    """

    set: AnySet
    """convex set, in the quantity's unit: one of the package's, or any object with the functions
    of `ConvexSet`"""
    _: dataclasses.KW_ONLY
    of: KeptQuantity = "position"
    """quantity: position, velocity, acceleration, jerk, or thrust, a + g e_z"""
    vehicles: Annotated[tuple[Name, ...] | None, BeforeValidator(_names)] = None
    """names of the vehicles, or a single one; all if not given, but for `relative_to`"""
    relative_to: Annotated[Name | Track | None, BeforeValidator(_track_or_name)] = None
    """name of another vehicle, or track of a moving point, from which the difference is taken"""
    active: tuple[Finite, Finite] | None = None
    """first and last time on the scenario's clock at which it is required, both included [s]; equal
    for an instant; all the time if not given"""
    name: Name | None = None
    """name shown in figures and reports, beside its number"""
    penalty: Positive | None = None
    """cost of each unit of the largest distance outside the set, times the vehicle's weight, or the
    mean weight of two [m²/s⁴ per unit]; values must not be outside if not given"""
    between: tuple[Name, Name] | None = None
    """names of two waypoints of each vehicle, in place of `active`: it is required from the time of
    the first to that of the second, both included; "start" and "goal" are the ends of the flight;
    without `vehicles`, those count that have both waypoints"""

    if TYPE_CHECKING:

        def __init__(
            self,
            set: ConvexSet,
            *,
            of: KeptQuantity = "position",
            vehicles: Sequence[str] | str | None = None,
            relative_to: str | Track | None = None,
            active: tuple[float, float] | None = None,
            name: str | None = None,
            penalty: float | None = None,
            between: tuple[str, str] | None = None,
        ) -> None: ...

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if self.vehicles is not None:
            if not self.vehicles or len(self.vehicles) > len({*self.vehicles}):
                raise ScenarioError("vehicles", list(self.vehicles), "names, each of them once")
            if self.relative_to in self.vehicles:
                expected = f"others than {self.relative_to!r}, which is never relative to itself"
                raise ScenarioError("vehicles", list(self.vehicles), expected)
        if self.track is not None and self.of not in ("position", "velocity"):
            expected = "position or velocity: a polyline in time has no acceleration"
            raise ScenarioError("of", self.of, expected)
        if self.active is not None and not self.active[0] <= self.active[1]:
            expected = "a first time and a last one that is not before it"
            raise ScenarioError("active", list(self.active), expected)
        if self.between is not None:
            first, last = self.between
            if self.active is not None:
                raise ScenarioError("between", list(self.between), "none beside active")
            if first in (last, GOAL) or last == START:
                expected = "the names of two waypoints, the earlier one first"
                raise ScenarioError("between", list(self.between), expected)
        return self

    @cached_property
    def label(self) -> str | None:
        """Name in reports of a requirement that follows from others; None for one that is given."""
        return None

    @cached_property
    def at_waypoint(self) -> bool:
        """Whether it follows from a waypoint's velocity or dwell, which its label says."""
        return False

    @cached_property
    def is_goal(self) -> bool:
        """Whether it is a goal (`goal_sets`), which its label says."""
        return False

    @cached_property
    def moves(self) -> bool:
        """Whether its interval begins or ends at waypoints, and moves with their times."""
        return False

    def called(self, number: int) -> str:
        """Return how reports refer to it: by its number from 1, and its name if any."""
        return self.label or f"requirement {number}" + (f" ({self.name})" if self.name else "")

    def check_storable(self) -> None:
        """Check that a file can hold the requirement.

        Raises:
            ScenarioError: its set is a user's own.
        """
        if is_own(self.set):
            raise ScenarioError("set", self.set, PACKAGE_SET)

    @property
    def quantity(self) -> Quantity:
        """Quantity of motions with values in the set, once `offset` is subtracted."""
        return "acceleration" if self.of == "thrust" else self.of

    @property
    def unit(self) -> str:
        """SI unit of the quantity."""
        return UNITS[self.quantity]

    @property
    def track(self) -> Track | None:
        """Track of the moving point for the difference; None if it is to a vehicle or absent."""
        return self.relative_to if isinstance(self.relative_to, Track) else None

    @property
    def leader(self) -> str | None:
        """Name of the other vehicle of the difference; None if there is none."""
        return self.relative_to if isinstance(self.relative_to, str) else None

    @property
    def deviation(self) -> float:
        """Largest distance of the moving point from its track [m], which tightens the set."""
        return self.track.deviation if self.track is not None and self.of == "position" else 0.0

    def members(self, names: Sequence[str]) -> IntArray:
        """Return the indices of the constrained vehicles, ascending, shape (M,)."""
        wanted = names if self.vehicles is None else self.vehicles
        return np.array([i for i, n in enumerate(names) if n in wanted and n != self.leader], int)

    def partner(self, names: Sequence[str]) -> int | None:
        """Return the index of the other vehicle of the difference; None if there is none."""
        return None if self.leader is None else list(names).index(self.leader)

    def offset(
        self, times: FloatArray, *, before: bool = False, clock: Clock = EXACT
    ) -> FloatArray:
        """Return the offset of values of `quantity` from those in the set, shape (M, 3).

        Args:
            times: on the scenario's clock [s], shape (M,).
            before: whether velocities are those just before the times, at corners of the track.
            clock: by which times are compared with those of corners.
        """
        if self.track is not None:
            if self.of == "position":
                return self.track.at(times)
            return self.track.velocities(times, before=before, clock=clock)
        offset = np.zeros((len(times), 3))
        if self.of == "thrust" and self.leader is None:
            offset[:, 2] = -GRAVITY
        return offset

    def relative(self, values: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the values in the set of the constrained vehicles, shape (M, 3).

        Args:
            values: of `quantity`, of all vehicles, shape (N, 3).
            times: on the scenario's clock [s], shape (N,).
            names: names of the vehicles.
        """
        members, partner = self.members(names), self.partner(names)
        relative: FloatArray = values[members] - self.offset(times[members])
        return relative if partner is None else relative - values[partner]

    @property
    def corners(self) -> FloatArray:
        """Times at which the interval begins or ends, or the moving point turns [s], (M,)."""
        corners = np.zeros(0) if self.track is None else self.track.times
        return corners if self.active is None else np.union1d(corners, self.active)

    def interval(self, grid: Grid) -> tuple[float, float] | None:
        """Return the part of the interval that is on a grid, on the scenario's clock [s].

        Returns:
            First and last time; None if the interval is over or has not begun.
        """
        first, last = self.active or (-np.inf, np.inf)
        if not grid.clock.overlap((first, last), (grid.start, grid.end)):
            return None
        return min(max(first, grid.start), grid.end), max(min(last, grid.end), grid.start)

    def tolerances(self, fleet: Fleet, names: Sequence[str]) -> FloatArray:
        """Return the distances outside that still count as inside, in its unit, of members (M,).

        A tolerance is `TOLERANCE` times the set's size, taken as at most the scale of the motion
        (of the larger of two), and at least a thousandth of it, which a solver can still resolve.
        Far from the origin it is at least the rounding of positions. A point has that of a goal.
        """
        members, partner = self.members(names), self.partner(names)
        scale = fleet.scale(self.quantity)
        scales, errors = scale[members], fleet.summed_errors[members]
        if partner is not None:
            scales = np.maximum(scales, scale[partner])
            errors = errors + fleet.summed_errors[partner]
        size = float(getattr(self.set, "size", np.inf)) or np.inf
        tolerances = tolerances_of(np.full(len(scales), size), np.zeros((len(scales), 3)), scales)
        return np.maximum(tolerances, errors) if self.of == "position" else tolerances

    def prices(self, fleet: Fleet, names: Sequence[str]) -> FloatArray | None:
        """Return the price of a unit outside for every vehicle, weights included, shape (N,).

        Returns:
            Prices in m²/s⁴ per unit; None without a penalty.
        """
        if self.penalty is None:
            return None
        partner = self.partner(names)
        others = fleet.weights if partner is None else fleet.weights[partner]
        return np.asarray(self.penalty * (fleet.weights + others) / 2.0)

    def sets(self, fleet: Fleet, names: Sequence[str]) -> ConvexSets:
        """Return the set for every vehicle; tolerances of others than members are 0."""
        tolerances, count = np.zeros(len(names)), len(names)
        tolerances[self.members(names)] = self.tolerances(fleet, names)
        if isinstance(self.set, Sphere) and self.track is None:
            center = self.set.center + self.offset(np.zeros(1))
            return Balls(np.tile(center, (count, 1)), tolerances, np.full(count, self.set.radius))
        return Required(np.zeros((count, 3)), tolerances, self.set, requirement=self)

    def of_vehicles(self, names: Sequence[str]) -> Self | None:
        """Return the requirement for some vehicles; None if it does not apply to them alone."""
        if self.leader is not None and self.leader not in names:
            return None
        if self.vehicles is None:
            return self
        members = tuple(each for each in self.vehicles if each in names)
        return self._with(vehicles=members) if members else None

    def longer(self, time: float) -> Self:
        """Return the requirement with an interval, if any, longer by a time on both sides [s]."""
        if self.active is None:
            return self
        return self._with(active=(self.active[0] - time, self.active[1] + time))

    def since(self, grid: Grid) -> Self:
        """Return the requirement on a clock that is 0 at a grid's first knot."""
        active = None if self.active is None else grid.interval_since_start(self.active)
        relative_to = self.relative_to
        if isinstance(relative_to, Track):
            relative_to = unchecked(relative_to, times=read_only(relative_to.times - grid.start))
        return self._with(active=active, relative_to=relative_to)

    def _with(self, **changes: object) -> Self:
        """Return the requirement with other values, which are not validated."""
        names = ("label", "at_waypoint", "is_goal", "moves")
        return unchecked(self, **({each: getattr(self, each) for each in names} | changes))


@dataclasses.dataclass(frozen=True, eq=False)
class Required(Each):
    """Set of a requirement, which moves with the requirement's track."""

    requirement: KeepIn = dataclasses.field(kw_only=True)
    """requirement on a clock that is 0 at the first knot"""

    def offset(
        self, times: FloatArray, *, before: bool = False, clock: Clock = EXACT
    ) -> FloatArray:
        """Return the track's values at times since the first knot [s], shape (R, 3)."""
        return self.requirement.offset(times, before=before, clock=clock)

    @property
    def corners(self) -> FloatArray:
        """Times since the first knot at which the track turns [s], ascending."""
        return np.zeros(0) if self.requirement.track is None else self.requirement.track.times

    @property
    def jumps(self) -> bool:
        """Whether values are relative to the track's velocity, which jumps at its corners."""
        return self.requirement.track is not None and self.requirement.of == "velocity"

    @property
    def deviation(self) -> float:
        """Deviation of the track [m]."""
        return self.requirement.deviation


def linked_groups(requirements: Sequence[KeepIn], names: Sequence[str], grid: Grid) -> IntArray:
    """Return the group number of each vehicle; vehicles linked by requirements share one, (N,).

    Requirements that are over on a grid do not link vehicles.
    """
    labels = np.arange(len(names))
    for each in requirements:
        partner = each.partner(names)
        if partner is not None and each.interval(grid) is not None:
            met = labels[np.append(each.members(names), partner)]
            labels[np.isin(labels, met)] = met.min()
    return labels


def goal_sets(vehicles: Sequence[Vehicle], grid: Grid) -> tuple[KeepIn, ...]:
    """Return the goals that are convex sets, as requirements at the last knot."""
    return tuple(
        unchecked(
            KeepIn(wanted, of=quantity, vehicles=vehicle.name, active=(grid.end, grid.end)),
            label=f"goal of {vehicle.name}",
            is_goal=True,
        )
        for vehicle in vehicles
        if isinstance(vehicle.goal, Goal)
        for quantity in ("position", "velocity")
        if (wanted := set_in(getattr(vehicle.goal, quantity))) is not None
    )


def reaches_of(
    requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle], grid: Grid
) -> FloatArray:
    """Return how far requirements send vehicles without an exact goal [m], shape (N,).

    A value at the start that is d outside of a set has to change by d within the flight's T, which
    takes a motion of about d for a position, d T for a velocity and d T² for an acceleration.
    Without an exact goal nothing else may tell how far a vehicle flies.
    """
    reaches, names = np.zeros(len(vehicles)), [each.name for each in vehicles]
    powers = {"position": 1.0, "velocity": grid.duration, "acceleration": grid.duration**2}
    free = [i for i, each in enumerate(vehicles) if isinstance(each.goal, Goal)]
    for each in requirements if free else ():
        interval = each.interval(grid)
        if interval is None or each.leader is not None or each.between is not None:
            continue
        places = each.offset(np.array(interval))
        for i in np.intersect1d(free, each.members(names)).tolist():
            start = getattr(vehicles[i].start, each.quantity, None)
            values = (np.zeros(3) if start is None else start) - places
            away = float(np.max(each.set.signed_distance(values)))
            reaches[i] = max(reaches[i], away * powers.get(each.quantity, 0.0))
    return reaches


def parts_for(requirements: Sequence[KeepIn], names: Sequence[str]) -> tuple[KeepIn, ...]:
    """Return the requirements that apply to some vehicles without the others."""
    own = (each.of_vehicles(names) for each in requirements)
    return tuple(each for each in own if each is not None)
