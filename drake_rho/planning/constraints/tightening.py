"""Check before planning that constraints have room for the error tube."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.planning.constraints.close_pairs import max_pair_margin
from drake_rho.planning.constraints.margins import Margins, PlanMargins
from drake_rho.planning.constraints.slack import (
    ENDS,
    TighteningSlack,
    ends_in_requirements,
    of_given_ends,
    sizes_of_requirements,
    slacks_at_rest,
    states_at,
)
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

_QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration")

CANNOT_HOLD = "vehicles cannot hold at their goals"
"""Message for scenarios that are infeasible only because vehicles have to hold at their goals."""

NO_SLACK = "no room for the errors that the disturbance leads to"
"""Message for scenarios that are infeasible because of insufficient tightening slack."""

_MEASURED_START = 10.0
"""Allowed shortage of slack at a measured start, in tolerances. A window starts at a state that
meets its limits to one tolerance in the previous plan; after several windows it may be a few."""


def missing_slack(
    scenario: Scenario, margins: PlanMargins, *, under_way: bool = False, of_start: bool = False
) -> dict[str, tuple[str, ...]]:
    """Return the constraints with too little slack, by the vehicles' names.

    Args:
        scenario: the scenario to check.
        margins: the margins of plans.
        under_way: whether starts are measured states, which may deviate by a few tolerances.
        of_start: whether only constraints at starts are checked.
    """
    fleet = scenario.fleet
    starts, goals = fleet.start_positions, fleet.goal_positions
    if of_start:
        slacks = _end_slacks(_near(scenario, margins, [starts]), margins, 0)
    else:
        slacks = _slacks(_near(scenario, margins, [starts, goals]), margins)
    return _missing(scenario, slacks, under_way=under_way)


def _near(scenario: Scenario, margins: PlanMargins, places: Sequence[FloatArray]) -> Scenario:
    """Return a scenario without the obstacles surely far from the vehicles' places, (N, 3) each."""
    required = scenario.fleet.radii + float(margins.inner.knots["position"][list(ENDS)].max())
    near = tuple(
        each
        for each in scenario.avoided
        if not all(each[1].stays_beyond(own, required, 0.0) for own in places)
    )
    return scenario.derived(avoided=near, fleet=scenario.fleet)


def missing_slack_at_rest(scenario: Scenario) -> dict[str, tuple[str, ...]]:
    """Return the constraints with too little slack for holding at goals, by vehicles' names."""
    tube = None if scenario.disturbance is None else tube_of(scenario)
    return _missing(scenario, slacks_at_rest(scenario, tube))


def _missing(
    scenario: Scenario, slacks: Iterable[TighteningSlack], *, under_way: bool = False
) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for each in slacks:
        measured = under_way and each.where == ENDS[0]
        tolerances = _MEASURED_START if measured else 1.0
        for vehicle in np.flatnonzero(each.missing(tolerances) > 0.0).tolist():
            name = scenario.vehicles[vehicle].name
            found[name] = (*found.get(name, ()), each.reason(vehicle))
    return found


def starts_beyond_limits(scenario: Scenario, margins: PlanMargins) -> bool:
    """Return whether a start lacks slack in the limits of its position or velocity."""
    slacks = _state_slacks(scenario, margins.states, 0)
    return any(np.any(each.missing(_MEASURED_START) > 0.0) for each in slacks)


def has_room_for(scenario: Scenario, margins: PlanMargins, quantity: Quantity) -> bool:
    """Return whether margins leave room inside every limit of a quantity."""
    slacks = _limit_slacks(scenario, margins.states)
    return not any(np.any(each.missing(0.0) > 0.0) for each in slacks if each.quantity == quantity)


def without_wind(scenario: Scenario) -> Scenario:
    """Return a disturbed scenario without wind, with the same feedback."""
    tube = tube_of(scenario)
    calm = unchecked(tube.disturbance, acceleration=0.0, tracking=tube.tracking)
    return scenario.with_disturbance(calm)


def largest_tolerable_wind(scenario: Scenario, margins: PlanMargins, calm: PlanMargins) -> float:
    """Return the largest wind with sufficient slack for the same feedback [m/s²].

    The radii of the error tube are affine in the wind. If measurements may be lost they are convex
    in it, and the result may be less than the largest wind.

    Args:
        scenario: the disturbed scenario.
        margins: the margins of its plans.
        calm: the margins of the same scenario without wind.
    """
    part = 1.0
    for windy, still in zip(_slacks(scenario, margins), _slacks(scenario, calm), strict=True):
        with np.errstate(invalid="ignore"):  # unbounded errors, in any wind
            more = windy.needed - still.needed
        slack = windy.available + windy.tolerances - still.needed
        none = np.where(slack < 0.0, 0.0, np.inf)
        tolerable = np.divide(slack, more, out=none, where=more > 0.0)
        part = min(part, float(np.min(tolerable)))
    return max(0.0, part) * tube_of(scenario).disturbance.acceleration


def _slacks(scenario: Scenario, margins: PlanMargins) -> Iterator[TighteningSlack]:
    """Yield the slack of every constraint, in the middle of limits and at start and goal."""
    in_sets = margins.states
    yield from _limit_slacks(scenario, in_sets)
    for end in ENDS:
        yield from _end_slacks(scenario, margins, end)
    yield from slacks_at_rest(scenario, in_sets.tube)


def _end_slacks(scenario: Scenario, margins: PlanMargins, end: int) -> Iterator[TighteningSlack]:
    """Yield the slack of every constraint at start or goal."""
    in_sets = margins.states
    yield from _state_slacks(scenario, in_sets, end)
    yield from _obstacle_slacks(scenario, margins.inner, end)
    yield from _pair_slacks(scenario, margins.inner, end)
    yield from ends_in_requirements(scenario, in_sets, end)


def _limit_slacks(scenario: Scenario, margins: Margins) -> Iterator[TighteningSlack]:
    """Yield the slack in the middle of boxes and balls: the error tube has to fit into them."""
    fleet = scenario.fleet
    for quantity in _QUANTITIES:
        needed = margins.steps[quantity].max(keepdims=True)
        if (bounds := fleet.bounds(quantity)) is not None:
            half = np.min(bounds.upper - bounds.lower, axis=1) / 2.0
            tolerances = bounds.tolerances.min(axis=1)
            yield TighteningSlack(f"{quantity} box", "middle", quantity, half, needed, tolerances)
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                radii, tolerances = limit.kind.inner_radii(limit.limits), limit.sets.tolerances
                yield TighteningSlack(
                    limit.kind.name, "middle", quantity, radii, needed, tolerances
                )
    for waypoints in fleet.waypoints:
        times = np.where(waypoints.present, waypoints.times - scenario.grid.start, 0.0)
        required = waypoints.present & ~waypoints.soft
        needed = np.where(required, margins.pointwise.at("position", times), 0.0)
        tolerances = waypoints.tolerances(fleet.scale("position"))
        yield TighteningSlack(
            waypoints.called, "middle", "position", waypoints.within, needed, tolerances
        )
    yield from sizes_of_requirements(scenario, margins)


def _state_slacks(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield the slack of positions and velocities in their boxes and balls at start or goal."""
    fleet = scenario.fleet
    for quantity, values in states_at(scenario, end).items():
        needed = margins.knots[quantity][[end]]
        if (bounds := fleet.bounds(quantity)) is not None:
            available = np.minimum(values - bounds.lower, bounds.upper - values).min(axis=1)
            available = of_given_ends(fleet, quantity, end, available)
            tolerances = bounds.tolerances.min(axis=1)
            yield TighteningSlack(
                f"{quantity} box", ENDS[end], quantity, available, needed, tolerances
            )
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                available = -limit.sets.signed_distance(np.arange(len(values)), values)
                available = of_given_ends(fleet, quantity, end, available)
                tolerances = limit.sets.tolerances
                yield TighteningSlack(
                    limit.kind.name, ENDS[end], quantity, available, needed, tolerances
                )


def _obstacle_slacks(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield the slack of obstacles at start or goal, beyond distances without a disturbance."""
    fleet = scenario.fleet
    positions, time = fleet.start_positions, 0.0
    if end != 0:
        positions, time = fleet.goal_positions, scenario.grid.duration
    needed = margins.knots["position"][[end]]
    for number, obstacle in scenario.avoided:
        if obstacle.penalty is not None:
            continue
        distances = obstacle.distances(positions, np.array([time]))
        available = distances - fleet.radii - obstacle.deviation
        available = of_given_ends(fleet, "position", end, available)
        tolerance = fleet.obstacle_tolerances(obstacle.shape)
        name = scenario.obstacle_name(number)
        yield TighteningSlack(name, ENDS[end], "position", available, needed, tolerance)


def _pair_slacks(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield half the distance from the closest other vehicle at start or goal; both have errors."""
    from scipy.spatial import cKDTree  # slow to import, so deferred until needed

    separation, fleet = scenario.separation, scenario.fleet
    if separation is None or len(scenario.vehicles) < 2:
        return
    positions = fleet.start_positions if end == 0 else fleet.goal_positions
    within = separation.distance + max_pair_margin(separation, margins)
    near = cKDTree(separation.scaled(positions)).query_pairs(within, output_type="ndarray")
    available = np.full(len(positions), np.inf)
    if end != 0 and not fleet.fixed_positions.all():  # nominal goals are no places of vehicles
        near = near[fleet.fixed_positions[near].all(axis=1)]
    distances = separation.shape.local_distance(positions[near[:, 0]] - positions[near[:, 1]])
    for vehicles in near.T:
        np.minimum.at(available, vehicles, distances / 2.0)
    needed, tolerance = margins.knots["position"][[end]], np.array([separation.tolerance])
    yield TighteningSlack("separation", ENDS[end], "position", available, needed, tolerance)


def enlarged_by_margins(scenario: Scenario, margins: PlanMargins) -> Scenario:
    """Return a scenario with margins replaced by larger vehicles and a larger separation.

    It has neither disturbance nor smoothing. Path search uses it, since a path without times has no
    margins over time. Vehicles are enlarged only as far as obstacles and other vehicles at their
    starts and goals permit.
    """
    steps = margins.steps
    if steps.largest == 0.0:
        return scenario
    growth = np.full(len(scenario.vehicles), steps.largest)
    pair_growth = growth
    for end in ENDS:
        for slack in _obstacle_slacks(scenario, steps, end):
            growth = np.minimum(growth, np.maximum(slack.available, 0.0))
        for slack in _pair_slacks(scenario, steps, end):
            pair_growth = np.minimum(pair_growth, np.maximum(slack.available, 0.0))
    vehicles = tuple(
        unchecked(vehicle, radius=vehicle.radius + float(more))
        for vehicle, more in zip(scenario.vehicles, growth, strict=True)
    )
    separation = scenario.separation
    if separation is not None:
        distance = separation.distance + 2.0 * float(pair_growth.min())
        separation = dataclasses.replace(separation, distance=distance)
    larger = scenario.derived(
        vehicles=vehicles, separation=separation, disturbance=None, smoothing=None
    )
    return larger.of_vehicles(range(len(vehicles)))
