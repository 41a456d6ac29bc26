"""Limits of a scenario as adjustable numbers: `adjustable_numbers`.

Each can be removed from the scenario, measured on a motion without it, and set to any value in
between.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.kinds import LIMITS
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.parts import UNITS, Quantity, Vehicle, Waypoint
from drake_rho.scenario.records import Box, HalfSpace, KeepIn, Limits, Scenario, Sphere
from drake_rho.verification.verify import verify

_MORE = 0.02
"""Relative allowance on the numbers that a motion needs."""

_BELOW = 1e-6
"""Distance of the largest number to suggest from a limit's least upper bound, in its unit."""

_LITTLE = 1e-3
"""Least distance or radius to suggest, as a part of the scenario's."""

_SAMPLES = 8
"""Number of samples of a step at which positions are compared with the sides of a box."""


@dataclasses.dataclass(frozen=True, eq=False)
class Adjustable:
    """Numbers of one limit of a scenario."""

    limit: str
    """name of the field, such as 'max_speed', with the vehicle if the limit is its own"""
    name: str
    """name of the constraint in conflicts"""
    vehicles: tuple[str, ...]
    """names of the vehicles that they bound"""
    unit: str
    """unit of the numbers"""
    now: FloatArray
    """numbers in the scenario, shape (M,); the lower and then the upper bounds of a box"""
    changed: Callable[[Scenario, FloatArray], Scenario]
    """function that returns a scenario with other numbers"""
    without: Callable[[Scenario], Scenario]
    """function that returns a scenario without the limit"""
    excess: Callable[[Plan], FloatArray]
    """function that returns by how much a motion exceeds the numbers, at least 0, shape (M,)"""
    bounds: tuple[float, float] = (-np.inf, np.inf)
    """least and largest value of a number"""

    def needed(self, plan: Plan) -> FloatArray:
        """Return numbers that a motion satisfies, none tighter than the present ones."""
        return np.clip(self.now + (1.0 + _MORE) * self.excess(plan), *self.bounds)


def adjustable_numbers(scenario: Scenario, vehicles: Sequence[str]) -> list[Adjustable]:
    """Return the numbers of a scenario that bound the motions of some vehicles."""
    found = [each for field in LIMITS for each in _of_field(scenario, field, vehicles)]
    found += [
        _of_requirement(scenario, number, each, each.set)
        for number, each in enumerate(scenario.requirements, start=1)
        if isinstance(each.set, Box | Sphere | HalfSpace) and each.penalty is None
    ]
    found += [
        _of_waypoint(scenario, vehicle.name, number, waypoint)
        for vehicle in scenario.vehicles
        for number, waypoint in enumerate(vehicle.waypoints, start=1)
        if vehicle.name in vehicles and waypoint.time is not None and waypoint.penalty is None
    ]
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        found.append(_of_separation(scenario))
    return found + _of_radii(scenario, vehicles)


def _of_field(scenario: Scenario, field: str, vehicles: Sequence[str]) -> list[Adjustable]:
    """Return the fleet's limit and the vehicles' own limits of one field of `Limits`."""
    own, shared = list[Adjustable](), list[str]()
    for vehicle in scenario.vehicles:
        if vehicle.limits is None or getattr(vehicle.limits, field) is None:
            shared.append(vehicle.name)
        elif vehicle.name in vehicles:
            own.append(_limit(scenario, field, vehicle.name, (vehicle.name,)))
    if set(shared) & set(vehicles) and getattr(scenario.limits, field) is not None:
        own.insert(0, _limit(scenario, field, None, tuple(shared)))
    return own


def _limit(scenario: Scenario, field: str, owner: str | None, members: Sequence[str]) -> Adjustable:
    """Return one field of `Limits`, of the scenario or of a vehicle."""
    limits = _limits_of(scenario, owner)
    if field in NORMS:
        kind = NORMS[field]
        name, unit, largest = kind.name, kind.unit, kind.largest
        excess = partial(_violated, scenario, field, members, name)
    else:
        quantity = cast(Quantity, field)
        name, unit, largest = f"{quantity} box", UNITS[quantity], np.inf
        excess = partial(_outside_box, scenario, quantity, members)
    return Adjustable(
        limit=field if owner is None else f"{field} of {owner}",
        name=name,
        vehicles=tuple(members),
        unit=unit,
        now=_numbers(getattr(limits, field)),
        changed=partial(_with_limit, field, owner),
        without=lambda other: _with_limit(field, owner, other, None),
        excess=excess,
        bounds=(-np.inf, largest - _BELOW),
    )


def _limits_of(scenario: Scenario, owner: str | None) -> Limits:
    if owner is None:
        return scenario.limits
    return scenario.vehicles[scenario.index_of(owner)].limits or Limits()


def _numbers(limit: float | Box) -> FloatArray:
    if isinstance(limit, Box):
        return np.concatenate([limit.lower, limit.upper])
    return np.array([limit])


def _of_numbers(numbers: FloatArray) -> float | Box:
    """Return the limit with these numbers, as `_numbers` lists them."""
    return Box(numbers[:3], numbers[3:]) if len(numbers) == 6 else float(numbers[0])


def _with_vehicles(
    scenario: Scenario, names: Sequence[str], changed: Callable[[Vehicle], Vehicle]
) -> Scenario:
    """Return a scenario with some of its vehicles changed."""
    vehicles = (changed(each) if each.name in names else each for each in scenario.vehicles)
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


def _with_limit(
    field: str, owner: str | None, scenario: Scenario, numbers: FloatArray | None
) -> Scenario:
    """Return a scenario with a new limit, shared or of one vehicle; None for no limit."""
    changed: dict[str, Any] = {field: None if numbers is None else _of_numbers(numbers)}
    limits = dataclasses.replace(_limits_of(scenario, owner), **changed)
    if owner is None:
        return dataclasses.replace(scenario, limits=limits)
    if numbers is None and getattr(scenario.limits, field) is not None:  # it would hold instead
        shared = dataclasses.replace(scenario.limits, **{field: None})
        limits = shared.overridden_by(limits)
        own = tuple(
            dataclasses.replace(each, limits=scenario.limits_of(each)) for each in scenario.vehicles
        )
        scenario = dataclasses.replace(scenario, limits=shared, vehicles=own)
    return _with_vehicles(scenario, (owner,), lambda each: dataclasses.replace(each, limits=limits))


def _outside_box(
    scenario: Scenario, field: Quantity, members: Sequence[str], plan: Plan
) -> FloatArray:
    """Return the excursion beyond each side of a box, negative at lower sides, shape (6,)."""
    who, motion = np.array([scenario.index_of(name) for name in members]), plan.motion()
    box = getattr(scenario.limits_of(scenario.vehicles[who[0]]), field)
    if field == "position":
        steps = _SAMPLES * (scenario.grid.knots - 1)
        values = motion.at("position", np.linspace(0.0, scenario.grid.duration, steps + 1))
    else:
        values = motion.jerks() if field == "jerk" else motion.values(field)
    values = values[who].reshape(-1, 3)
    below = np.minimum(np.nanmin(values, axis=0) - box.lower, 0.0)
    above = np.maximum(np.nanmax(values, axis=0) - box.upper, 0.0)
    return _evenly(box, np.nan_to_num(np.concatenate([below, above]), posinf=0.0, neginf=0.0))


def _evenly(box: Box, excess: FloatArray) -> FloatArray:
    """Return moves of the sides, equal on axes that are symmetric and equally wide, (6,)."""
    further = np.maximum(-excess[:3], excess[3:])
    symmetric = -box.lower == box.upper
    for width in np.unique(box.upper[symmetric]):
        equal = symmetric & (box.upper == width)
        excess[3:][equal] = further[equal].max()
        excess[:3][equal] = -further[equal].max()
    return excess


def _violated(
    scenario: Scenario, kind: str, members: Sequence[str], name: str, plan: Plan
) -> FloatArray:
    """Return a motion's violation of a constraint of some vehicles, shape (1,)."""
    report = verify(Plan.from_accelerations(scenario, plan.accelerations))
    excess = [
        each.excess
        for each in report.checks
        if each.kind == kind and each.vehicle in members and each.constraint.startswith(name)
    ]
    return np.array([max([0.0, *excess])])


def _of_requirement(
    scenario: Scenario, number: int, required: KeepIn, whole: Box | Sphere | HalfSpace
) -> Adjustable:
    """Return the size of a requirement's set: sides, radius or offset.

    Args:
        scenario: the scenario.
        number: number of the requirement, from 1.
        required: the requirement.
        whole: its set.
    """
    name, outward = required.called(number), np.ones(1)
    if isinstance(whole, Box):
        field, now, outward = "sides", _numbers(whole), np.repeat([-1.0, 1.0], 3)
    elif isinstance(whole, Sphere):
        field, now = "radius", _numbers(whole.radius)
    else:
        field, now = "offset", _numbers(whole.offset)
        outward = outward * float(np.linalg.norm(whole.normal))

    def changed(other: Scenario, numbers: FloatArray) -> Scenario:
        size, sets = _of_numbers(numbers), list(other.requirements)
        changes: dict[str, Any] = {field: size}
        new = size if isinstance(size, Box) else dataclasses.replace(whole, **changes)
        sets[number - 1] = dataclasses.replace(required, set=new)
        return dataclasses.replace(other, requirements=tuple(sets))

    def without(other: Scenario) -> Scenario:
        far = 1e3 * (1.0 + float(np.abs(now).max()) + float(scenario.fleet.lengths.max()))
        return changed(other, now + far * outward)

    return Adjustable(
        limit=f"{field} of {name}",
        name=name,
        vehicles=tuple(scenario.names[index] for index in required.members(scenario.names)),
        unit=required.unit,
        now=now,
        changed=changed,
        without=without,
        excess=lambda plan: (
            outward * _violated(scenario, "requirements", scenario.names, name, plan)
        ),
    )


def _of_waypoint(scenario: Scenario, owner: str, number: int, waypoint: Waypoint) -> Adjustable:
    """Return the tolerance of a waypoint, by its vehicle and its number from 1."""
    name, far = f"waypoint {number}", np.array([10.0 * float(scenario.fleet.lengths.max())])

    def changed(other: Scenario, numbers: FloatArray) -> Scenario:
        def replaced(each: Vehicle) -> Vehicle:
            waypoints = list(each.waypoints)
            within = float(numbers[0])
            waypoints[number - 1] = dataclasses.replace(waypoints[number - 1], within=within)
            return dataclasses.replace(each, waypoints=tuple(waypoints))

        return _with_vehicles(other, (owner,), replaced)

    return Adjustable(
        limit=f"within of {name} of {owner}",
        name=name,
        vehicles=(owner,),
        unit="m",
        now=np.array([waypoint.within]),
        changed=changed,
        without=lambda other: changed(other, far),
        excess=partial(_violated, scenario, "waypoints", (owner,), name),
    )


def _of_separation(scenario: Scenario) -> Adjustable:
    """Return the distance of the separation."""
    apart = scenario.separation
    assert apart is not None  # noqa: S101  # callers have looked

    def changed(other: Scenario, numbers: FloatArray) -> Scenario:
        nearer = dataclasses.replace(apart, distance=float(numbers[0]))
        return dataclasses.replace(other, separation=nearer)

    return Adjustable(
        limit="distance of separation",
        name="separation",
        vehicles=scenario.names,
        unit="m",
        now=np.array([apart.distance]),
        changed=changed,
        without=lambda other: other.without_separation(),
        excess=lambda plan: -_violated(scenario, "separation", scenario.names, "separation", plan),
        bounds=(_LITTLE * apart.distance, np.inf),
    )


def _of_radii(scenario: Scenario, vehicles: Sequence[str]) -> list[Adjustable]:
    """Return the radius of some vehicles, if it is the same and there are obstacles."""
    radii = dict.fromkeys(each.radius for each in scenario.vehicles if each.name in vehicles)
    if not scenario.avoided or len(radii) != 1 or 0.0 in radii:
        return []
    (radius,), names = radii, ", ".join(vehicles)

    def changed(other: Scenario, numbers: FloatArray) -> Scenario:
        smaller = float(numbers[0])
        return _with_vehicles(
            other, vehicles, lambda each: dataclasses.replace(each, radius=smaller)
        )

    return [
        Adjustable(
            limit="radius" if len(vehicles) == len(scenario.vehicles) else f"radius of {names}",
            name="obstacle",
            vehicles=tuple(vehicles),
            unit="m",
            now=np.array([radius]),
            changed=changed,
            without=lambda other: changed(other, np.array([_LITTLE * radius])),
            excess=lambda plan: -_violated(scenario, "obstacles", vehicles, "obstacle", plan),
            bounds=(_LITTLE * radius, np.inf),
        )
    ]
