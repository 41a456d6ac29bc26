"""Requirements at waypoints: velocities, dwells, and requirements between two of them.

Each is a `KeepIn` with an interval of time, once the times of waypoints are known. `required_of` is
the one place where they become such; planners and the verifier know nothing of gates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drake_rho.scenario.errors import ScenarioError, one_of
from drake_rho.scenario.fields import FloatArray, read_only, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import GOAL, REACHED, START, Grid, Vehicle, Waypoint
from drake_rho.scenario.requirements import KeepIn, parts_for
from drake_rho.scenario.shapes.quadrics import Sphere
from drake_rho.scenario.shapes.unbounded import Cone, HalfSpace
from drake_rho.scenario.waypoints import rests

_PROJECTIONS = 200
"""Number of projections onto two convex sets after which a plane between them is tried."""

_APART = 1e-6
"""Least distance of two sets that counts as one, relative to the largest allowed velocity."""

_POINT = Sphere(np.zeros(3), 1.0)


def have_gates(vehicles: Sequence[Vehicle]) -> bool:
    """Return whether a waypoint of some vehicles has a velocity or a dwell."""
    ways = [way for vehicle in vehicles for way in vehicle.waypoints]
    return any(way.velocity is not None or way.dwell > 0.0 for way in ways)


def required_of(
    requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle], grid: Grid
) -> tuple[KeepIn, ...]:
    """Return the requirements of a flight, each with its interval of time.

    Those at waypoints without a time are left out. In the rest of a flight, the waypoints that have
    been passed are missing: what is required from there on, is required from the beginning.

    Args:
        requirements: those of the scenario, numbered from 1.
        vehicles: the vehicles, with their waypoints.
        grid: first and last knot.
    """
    if all(each.between is None for each in requirements) and not have_gates(vehicles):
        return tuple(requirements)
    found = list[KeepIn]()
    for number, each in enumerate(requirements, start=1):
        given = [each] if each.between is None else on_legs(each, vehicles, grid)
        moves = each.between is not None
        found += [unchecked(own, label=each.called(number), moves=moves) for own in given]
    for vehicle in vehicles:
        for number, waypoint in enumerate(vehicle.waypoints, start=1):
            found += _at_waypoint(vehicle, number, waypoint, grid)
    return tuple(found)


def on_known_legs(
    requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle]
) -> tuple[KeepIn, ...]:
    """Return the requirements without those between waypoints that vehicles do not have."""
    return tuple(own for each in requirements for own in _on_known_legs(each, vehicles))


def _on_known_legs(requirement: KeepIn, vehicles: Sequence[Vehicle]) -> Iterator[KeepIn]:
    """Yield a requirement for those of its vehicles that have the waypoints, if any has."""
    concerned, names = on_leg(requirement, vehicles), {*(requirement.between or ())} - {START, GOAL}
    known = [each for each in concerned if names <= {own.name for own in each.waypoints}]
    if requirement.between is None or (known and len(known) == len(concerned)):
        yield requirement
    elif known:
        yield unchecked(requirement, vehicles=tuple(each.name for each in known))


def is_scale_free(vehicles: Sequence[Vehicle]) -> bool:
    """Return whether a slower motion along the same path has allowed velocities at waypoints.

    Sets with zero inside allow this, and cones and half-spaces with zero at their boundary: these
    are directions.
    """
    sets = (velocities_at(each) for own in vehicles for each in own.waypoints)
    return all(each is None or _is_cone(each) or has_rest_inside(each) for each in sets)


def has_rest_inside(convex_set: Any) -> bool:
    """Return whether zero is inside a set, which limits velocities like any other limit."""
    return bool(convex_set.signed_distance(np.zeros(3)) < 0.0)


def _is_cone(convex_set: object) -> bool:
    """Return whether a set has every positive multiple of its elements."""
    match convex_set:
        case Cone():
            return not convex_set.apex.any()
        case HalfSpace():
            return convex_set.offset == 0.0
        case Sphere():
            return convex_set.radius == 0.0 and not convex_set.center.any()
    return False


@dataclasses.dataclass(frozen=True, eq=False)
class Gates:
    """Requirements at waypoints whose times are found."""

    vehicles: tuple[Vehicle, ...]
    """vehicles with waypoints, which need no times"""
    legs: tuple[KeepIn, ...]
    """requirements between waypoints"""

    @classmethod
    def of(cls, requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle]) -> Gates | None:
        """Return the requirements at the waypoints of vehicles; None if there are none."""
        legs = tuple(each for each in requirements if each.between is not None)
        return cls(tuple(vehicles), legs) if legs or have_gates(vehicles) else None

    def of_vehicles(self, indices: Sequence[int]) -> Gates:
        """Return those of some vehicles."""
        return Gates(tuple(self.vehicles[index] for index in indices), self.legs)

    def required(self, times: FloatArray, grid: Grid, names: Sequence[str]) -> tuple[KeepIn, ...]:
        """Return the requirements with the waypoints at some times.

        Args:
            times: of all waypoints, since the first knot [s], shape (W,).
            grid: first and last knot.
            names: vehicles of the motion; requirements relative to others are left out.
        """
        left, vehicles = iter((grid.start + times).tolist()), list[Vehicle]()
        for each in self.vehicles:
            placed = tuple(unchecked(own, time=next(left)) for own in each.waypoints)
            vehicles.append(unchecked(each, waypoints=placed))
        legs = on_known_legs(self.legs, vehicles)
        return parts_for(required_of(legs, vehicles, grid), names)


def point(value: FloatArray) -> Sphere:
    """Return the set of a single value, a ball of radius zero."""
    return unchecked(_POINT, center=read_only(value), radius=0.0)


def _at_waypoint(vehicle: Vehicle, number: int, waypoint: Waypoint, grid: Grid) -> Iterator[KeepIn]:
    """Yield what a waypoint with a time requires besides its position then."""
    time, velocities, name = waypoint.time, velocities_at(waypoint), waypoint.called(number)
    if time is None or velocities is None:
        return
    if waypoint.dwell == 0.0:
        yield _of_one(_VELOCITY, velocities, vehicle, (time, time), f"velocity at {name}")
        return
    first, last = rests(waypoint, grid)
    resting = (grid.start + grid.step * first, grid.start + grid.step * last)
    yield _of_one(_VELOCITY, velocities, vehicle, resting, f"dwell at {name}")
    if not is_point(velocities):
        ball = unchecked(_POINT, center=waypoint.position, radius=waypoint.within)
        yield _of_one(_POSITION, ball, vehicle, resting, f"place of the dwell at {name}")


def velocities_at(waypoint: Waypoint) -> Any:
    """Return the convex set of velocities at a waypoint; None if all are allowed."""
    if isinstance(waypoint.velocity, np.ndarray):
        return point(waypoint.velocity)
    if waypoint.velocity is None and waypoint.dwell > 0.0:
        return point(np.zeros(3))
    return waypoint.velocity


def is_point(convex_set: object) -> bool:
    """Return whether a set is a single value."""
    return isinstance(convex_set, Sphere) and convex_set.radius == 0.0


def _of_one(
    like: KeepIn, convex_set: object, vehicle: Vehicle, active: tuple[float, float], label: str
) -> KeepIn:
    """Return a requirement with another set, of one vehicle for an interval [s]."""
    return unchecked(
        like,
        set=convex_set,
        vehicles=(vehicle.name,),
        active=active,
        label=label,
        at_waypoint=True,
        moves=True,
    )


_POSITION, _VELOCITY = KeepIn(_POINT), KeepIn(_POINT, of="velocity")


def on_legs(requirement: KeepIn, vehicles: Sequence[Vehicle], grid: Grid) -> Iterator[KeepIn]:
    """Yield a requirement between waypoints for each of its vehicles with known times there."""
    assert requirement.between is not None  # noqa: S101  # callers check this
    for vehicle in on_leg(requirement, vehicles):
        first, last = (_time_of(name, vehicle, grid) for name in requirement.between)
        if np.isneginf(first):
            first = min(grid.start, last) - REACHED * grid.step
        if first <= last and last > -np.inf:  # never with a NaN
            own = (vehicle.name,)
            yield unchecked(requirement, between=None, vehicles=own, active=(first, last))


def _time_of(name: str, vehicle: Vehicle, grid: Grid) -> float:
    """Return the time of a vehicle's waypoint, or of an end of the flight [s].

    It is NaN if it is not known yet, and minus infinity if the waypoint has been passed.
    """
    if name in (START, GOAL):
        return grid.start if name == START else grid.end
    for each in vehicle.waypoints:
        if each.name == name:
            return np.nan if each.time is None else each.time
    return -np.inf


def bound_to_vehicles(
    requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle]
) -> tuple[KeepIn, ...]:
    """Return requirements between waypoints with their vehicles by name.

    In the rest of a flight, passed waypoints no longer tell which vehicles these are.
    """
    return tuple(
        each
        if each.between is None or each.vehicles is not None
        else unchecked(each, vehicles=tuple(own.name for own in on_leg(each, vehicles)))
        for each in requirements
    )


def on_leg(requirement: KeepIn, vehicles: Sequence[Vehicle]) -> list[Vehicle]:
    """Return the vehicles for which a requirement holds between two of their waypoints."""
    wanted, names = requirement.vehicles, {*(requirement.between or ())} - {START, GOAL}
    if wanted is not None:
        return [each for each in vehicles if each.name in wanted]
    having = [each for each in vehicles if names <= {own.name for own in each.waypoints}]
    return [each for each in having if each.name != requirement.leader]


def check_gates(
    requirements: Sequence[KeepIn], vehicles: Sequence[Vehicle], fleet: Fleet, grid: Grid
) -> None:
    """Check that limits allow the velocities at waypoints, that dwells fit, and names of legs.

    Args:
        requirements: those of the scenario.
        vehicles: the vehicles.
        fleet: these as arrays.
        grid: first and last knot.

    Raises:
        ScenarioError: one of these is wrong; the error names the field.
    """
    for index, requirement in enumerate(requirements):
        if requirement.between is not None:
            _check_leg(requirement, f"requirements[{index}]", vehicles)
    for i, vehicle in enumerate(vehicles):
        if have_gates([vehicle]):
            for k, waypoint in enumerate(vehicle.waypoints):
                where = f"vehicles[{i}].waypoints[{k}]"
                _check_velocity(waypoint, where, i, fleet)
                _check_dwell(waypoint, where, vehicle, grid)


def _check_leg(requirement: KeepIn, where: str, vehicles: Sequence[Vehicle]) -> None:
    """Check that the vehicles of a requirement pass its two waypoints in their order."""
    assert requirement.between is not None  # noqa: S101  # callers check this
    known = [each.name for own in vehicles for each in own.waypoints if each.name is not None]
    value, concerned = list(requirement.between), on_leg(requirement, vehicles)
    for name in requirement.between:
        if name not in (*known, START, GOAL):
            raise ScenarioError(f"{where}.between", name, one_of((*known, START, GOAL), name))
    if not concerned:
        raise ScenarioError(f"{where}.between", value, "two waypoints of one vehicle")
    for vehicle in concerned:
        own = [START, *(each.name for each in _in_flight(vehicle)), GOAL]
        for name in requirement.between:
            if name not in own:
                expected = f"waypoints of {vehicle.name}, one of the requirement's vehicles"
                raise ScenarioError(f"{where}.between", name, expected)
        first, last = map(own.index, requirement.between)
        if first >= last:
            expected = f"waypoints in the order in which {vehicle.name} passes them"
            raise ScenarioError(f"{where}.between", value, expected)


def _in_flight(vehicle: Vehicle) -> list[Waypoint]:
    """Return the waypoints in the order in which a vehicle passes them."""
    if any(each.time is None for each in vehicle.waypoints):
        return list(vehicle.waypoints)
    return sorted(vehicle.waypoints, key=lambda each: each.time or 0.0)


def _check_velocity(waypoint: Waypoint, where: str, i: int, fleet: Fleet) -> None:
    """Check that no limit of a vehicle excludes all velocities at a waypoint."""
    if waypoint.velocity is None:
        return
    allowed, of_value = velocities_at(waypoint), isinstance(waypoint.velocity, np.ndarray)
    limits = list[tuple[str, object]]()
    if (bounds := fleet.bounds("velocity")) is not None and np.isfinite(bounds.lower[i]).all():
        limits.append(("the velocity box", _Sides(bounds.lower[i], bounds.upper[i])))
    for norm in fleet.norms.values():
        if norm.kind.quantity == "velocity" and np.isfinite(norm.limits[i]):
            limits.append((f"the {norm.kind.name}", Sphere(np.zeros(3), float(norm.limits[i]))))
    for name, limit in limits:
        if _are_apart(allowed, limit):
            value = np.asarray(waypoint.velocity).tolist() if of_value else waypoint.velocity
            expected = f"a velocity, or a set of them, that {name} allows"
            raise ScenarioError(f"{where}.velocity", value, expected)


class _Sides:
    """Box of velocities, which may be flat."""

    def __init__(self, lower: FloatArray, upper: FloatArray) -> None:
        self._lower, self._upper = lower, upper

    def signed_distance(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(x - np.clip(x, self._lower, self._upper), axis=-1))

    def outward(self, x: FloatArray) -> FloatArray:
        away = x - np.clip(x, self._lower, self._upper)
        length = np.linalg.norm(away, axis=-1, keepdims=True)
        return np.asarray(away / np.where(length > 0.0, length, 1.0))

    def support(self, n: FloatArray) -> FloatArray:
        return np.asarray(np.sum(np.maximum(n * self._lower, n * self._upper), axis=-1))


def _are_apart(one: object, other: object) -> bool:
    """Return whether a plane between two convex sets has been found, so that they do not meet."""
    sets = one, other
    x = y = np.zeros(3)
    for _ in range(_PROJECTIONS):
        x = _nearest(sets[0], y)
        y = _nearest(sets[1], x)
    gap = float(np.linalg.norm(y - x))
    if gap <= _APART * (1.0 + float(np.linalg.norm(y))):
        return False
    n = (y - x) / gap
    between = -sets[1].support(-n) - sets[0].support(n)  # type: ignore[attr-defined]
    return bool(between > 0.0)


def _nearest(convex_set: object, x: FloatArray) -> FloatArray:
    """Return the point of a convex set nearest to another."""
    distance = float(convex_set.signed_distance(x))  # type: ignore[attr-defined]
    if distance <= 0.0:
        return x
    return np.asarray(x - distance * convex_set.outward(x))  # type: ignore[attr-defined]


def _check_dwell(waypoint: Waypoint, where: str, vehicle: Vehicle, grid: Grid) -> None:
    """Check that a vehicle can rest at a waypoint with a time, before the next and the goal."""
    if waypoint.dwell == 0.0 or waypoint.time is None:
        return
    first, last = rests(waypoint, grid)
    if last > grid.knots - 1:
        expected = f"a time at rest that ends before {grid.end:g} s"
        raise ScenarioError(f"{where}.dwell", waypoint.dwell, expected)
    begin, end = (grid.start + grid.step * knot for knot in (first, last))
    for other in vehicle.waypoints:
        if other is not waypoint and other.time is not None:
            near = np.linalg.norm(other.position - waypoint.position)
            apart = near > waypoint.within + other.within
            if apart and grid.clock.within(other.time, (begin, end)):
                expected = (
                    f"a time at rest that ends before the next waypoint at {other.time:g} s; "
                    f"it covers whole steps, from {begin:g} s to {end:g} s"
                )
                raise ScenarioError(f"{where}.dwell", waypoint.dwell, expected)
