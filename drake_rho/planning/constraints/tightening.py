"""Where a scenario leaves no room for its disturbance, seen before anything is planned."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.planning.constraints.close_pairs import most_beside
from drake_rho.planning.constraints.margins import Margins, PlanMargins, margins_of
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import UNITS, Quantity
from drake_rho.scenario.records import Scenario

_QUANTITIES: tuple[Quantity, ...] = ("position", "velocity", "acceleration")

_WHERE = {0: "start", -1: "goal"}
"""Knots that are given, and what they are called."""

NO_SLACK = "no room for the errors that the disturbance leads to"
"""Why there is no plan, where a scenario missing_slack room."""

TREATMENT = {
    "dynamics": "exact: nothing to tighten",
    "goals": "reached by the nominal motion; where flights end is noted in reports",
    "position": "half its width, starts and goals against the position's radius",
    "velocity": "half its width, starts and goals against the velocity's radius",
    "acceleration": "half its width against the feedback's radius",
    "jerk": "of the plan, which has no error: no margin",
    "max_speed": "its radius, starts and goals against the velocity's radius",
    "max_acceleration": "its radius against the feedback's radius",
    "max_thrust": "its radius against the feedback's radius",
    "max_tilt": "a cone has no middle: only programs tell",
    "max_jerk": "of the plan, which has no error: no margin",
    "waypoints": "the distance within which they are passed against the position's radius",
    "obstacles": "starts and goals against the position's radius",
    "moving obstacles": "as obstacles, where they are at the start and at the end",
    "late obstacles": "as obstacles, where they are known at the start",
    "active obstacles": "as obstacles, where they are active at the start or at the end",
    "separation": "half the distance of starts and goals against the position's radius",
    "disturbance": "the radii",
}
"""What is compared with the radii of errors, of every kind of requirement."""

_UNDER_WAY = 10.0
"""Tolerances by which there may be less room than is needed where a window begins. What a plan
keeps to one tolerance is where the next begins, and that may be a few away after some windows."""


@dataclasses.dataclass(frozen=True, eq=False)
class TighteningSlack:
    """How much room a constraint leaves all vehicles at one place, and how much is needed."""

    name: str
    """of the constraint"""
    where: str
    """start, goal, or what else is looked at"""
    quantity: Quantity
    """whose error needs the room"""
    room: FloatArray
    """how far from the constraint's boundary the vehicles are, below zero beyond it, in the
    quantity's unit, shape (N,)"""
    needed: FloatArray
    """the margin, in the quantity's unit, one for all or shape (N,)"""
    tolerances: FloatArray
    """one for all or shape (N,), in the quantity's unit"""

    def missing(self, tolerances: float) -> FloatArray:
        """Return by how much room is missing, at most zero where there is enough, shape (N,)."""
        missing: FloatArray = self.needed - self.room - tolerances * self.tolerances
        return missing

    def reason(self, vehicle: int) -> str:
        """Return the reason for one vehicle, in words."""
        unit, needed = UNITS[self.quantity], np.broadcast_to(self.needed, self.room.shape)
        room = float(self.room[vehicle])
        if needed[vehicle] <= 0.0:
            return f"{self.name} ({self.where} {-room:.3g} {unit} beyond)"
        if room < 0.0:
            inside = f"{needed[vehicle]:.3g} {unit} inside is needed"
            return f"{self.name} ({self.where} {-room:.3g} {unit} beyond; {inside})"
        return f"{self.name} ({self.where} {room:.3g} {unit} inside, of {needed[vehicle]:.3g})"


def check_tightening_slack(scenario: Scenario, margins: PlanMargins) -> None:
    """See that limits, starts and goals leave room for the disturbance, if there is one.

    What is left of a flight is not looked at: windows are judged when they are planned.

    Raises:
        InfeasibleError: they do not; it says how much of the disturbance they leave room for.
    """
    if scenario.disturbance is None or scenario.under_way:
        return
    if conflicts := missing_slack(scenario, margins):
        bearable = _largest_tolerable(scenario, margins)
        raise InfeasibleError(conflicts, scenario=scenario, bearable=bearable, because=NO_SLACK)


def missing_slack(
    scenario: Scenario, margins: PlanMargins, *, under_way: bool = False
) -> dict[str, tuple[str, ...]]:
    """Return for each vehicle without room what leaves it none.

    Args:
        scenario: what is asked.
        margins: how far inside of it plans keep.
        under_way: whether it begins with a measured state, which may be a little off.
    """
    found: dict[str, tuple[str, ...]] = {}
    for each in _slacks(scenario, margins.inner):
        measured = under_way and each.where == _WHERE[0]
        tolerances = _UNDER_WAY if measured else 1.0
        for vehicle in np.flatnonzero(each.missing(tolerances) > 0.0).tolist():
            name = scenario.vehicles[vehicle].name
            found[name] = (*found.get(name, ()), each.reason(vehicle))
    return found


def starts_beyond_limits(scenario: Scenario, margins: PlanMargins) -> bool:
    """Return whether a vehicle begins where its limits of position or velocity leave no room."""
    rooms = _of_state(scenario, margins.inner, 0)
    return any(np.any(each.missing(_UNDER_WAY) > 0.0) for each in rooms)


def _largest_tolerable(scenario: Scenario, margins: PlanMargins) -> float:
    """Return the largest wind there would be room for with the same feedback [m/s²].

    Radii are affine in the wind.
    """
    tube = tube_of(scenario)
    calm = unchecked(tube.disturbance, acceleration=0.0, tracking=tube.tracking)
    without = margins_of(scenario.with_disturbance(calm), margins.pieces)
    part = 1.0
    for windy, still in zip(
        _slacks(scenario, margins.inner), _slacks(scenario, without.inner), strict=True
    ):
        more = windy.needed - still.needed
        left = windy.room + windy.tolerances - still.needed
        share = np.divide(left, more, out=np.where(left < 0.0, 0.0, np.inf), where=more > 0.0)
        part = min(part, float(np.min(share)))
    return max(0.0, part) * tube.disturbance.acceleration


def _slacks(scenario: Scenario, margins: Margins) -> Iterator[TighteningSlack]:
    """Yield the room of every constraint, of limits as a whole and at both ends."""
    yield from _of_limits(scenario, margins)
    for end in _WHERE:
        yield from _of_end(scenario, margins, end)


def _of_end(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield the room of every constraint at one end."""
    yield from _of_state(scenario, margins, end)
    yield from _of_obstacles(scenario, margins, end)
    yield from _of_pairs(scenario, margins, end)


def _of_limits(scenario: Scenario, margins: Margins) -> Iterator[TighteningSlack]:
    """Yield boxes and balls, which errors on both sides must not fill."""
    fleet = scenario.fleet
    for quantity in _QUANTITIES:
        needed = margins.steps[quantity].max(keepdims=True)
        if (bounds := fleet.bounds(quantity)) is not None:
            half = np.min(bounds.upper - bounds.lower, axis=1) / 2.0
            tolerances = bounds.tolerances.min(axis=1)
            yield TighteningSlack(f"{quantity} box", "middle", quantity, half, needed, tolerances)
        for norm, limit in fleet.norms.items():
            if limit.kind.quantity == quantity and norm != "max_tilt":
                tolerances = limit.sets.tolerances
                yield TighteningSlack(
                    limit.kind.name, "middle", quantity, limit.limits, needed, tolerances
                )
    for number, waypoints in enumerate(fleet.waypoints, start=1):
        times = np.where(waypoints.present, waypoints.times - scenario.grid.start, 0.0)
        needed = np.where(waypoints.present, margins.exactly(times), 0.0)
        tolerances = waypoints.tolerances(fleet.scale("position"))
        name = f"waypoint {number}"
        yield TighteningSlack(name, "middle", "position", waypoints.within, needed, tolerances)


def _of_state(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield the room of position and velocity at one end, in their boxes and balls."""
    fleet = scenario.fleet
    states: dict[Quantity, FloatArray] = {"position": fleet.start_positions}
    states["velocity"] = fleet.start_velocities
    if end != 0:
        states = {"position": fleet.goal_positions, "velocity": fleet.goal_velocities}
    for quantity, values in states.items():
        needed = margins.knots[quantity][[end]]
        if (bounds := fleet.bounds(quantity)) is not None:
            room = np.minimum(values - bounds.lower, bounds.upper - values).min(axis=1)
            tolerances = bounds.tolerances.min(axis=1)
            yield TighteningSlack(
                f"{quantity} box", _WHERE[end], quantity, room, needed, tolerances
            )
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                room = -limit.sets.excess(np.arange(len(values)), values)
                tolerances = limit.sets.tolerances
                yield TighteningSlack(
                    limit.kind.name, _WHERE[end], quantity, room, needed, tolerances
                )


def _of_obstacles(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield the distances from obstacles at one end beyond those without a disturbance."""
    fleet = scenario.fleet
    positions, time = fleet.start_positions, 0.0
    if end != 0:
        positions, time = fleet.goal_positions, scenario.grid.duration
    needed = margins.knots["position"][[end]]
    for number, obstacle in scenario.known:
        distances = obstacle.distances(positions, np.array([time]))
        room = distances - fleet.radii - obstacle.deviation
        tolerance = fleet.obstacle_tolerances(obstacle.shape)
        name = scenario.obstacle_name(number)
        yield TighteningSlack(name, _WHERE[end], "position", room, needed, tolerance)


def _of_pairs(scenario: Scenario, margins: Margins, end: int) -> Iterator[TighteningSlack]:
    """Yield half of every vehicle's room to the closest other one, as each has an error."""
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    separation, fleet = scenario.separation, scenario.fleet
    if separation is None or len(scenario.vehicles) < 2:
        return
    positions = fleet.start_positions if end == 0 else fleet.goal_positions
    within = separation.distance + most_beside(separation, margins)
    near = cKDTree(separation.scaled(positions)).query_pairs(within, output_type="ndarray")
    distances = separation.shape.signed_distance(positions[near[:, 0]] - positions[near[:, 1]])
    room = np.full(len(positions), np.inf)
    for vehicles in near.T:
        np.minimum.at(room, vehicles, distances / 2.0)
    needed, tolerance = margins.knots["position"][[end]], np.array([separation.tolerance])
    yield TighteningSlack("separation", _WHERE[end], "position", room, needed, tolerance)


def enlarged_by_margins(scenario: Scenario, margins: PlanMargins) -> Scenario:
    """Return the undisturbed scenario with vehicles and separation larger by their margins.

    For looking for ways, on which margins need not be known over time. Vehicles are no larger than
    their starts and goals have room for.
    """
    steps = margins.steps
    if steps.most == 0.0:
        return scenario
    most = np.full(len(scenario.vehicles), steps.most)
    apart = most
    for end in _WHERE:
        for room in _of_obstacles(scenario, steps, end):
            most = np.minimum(most, np.maximum(room.room, 0.0))
        for room in _of_pairs(scenario, steps, end):
            apart = np.minimum(apart, np.maximum(room.room, 0.0))
    vehicles = tuple(
        unchecked(vehicle, radius=vehicle.radius + float(more))
        for vehicle, more in zip(scenario.vehicles, most, strict=True)
    )
    separation = scenario.separation
    if separation is not None:
        distance = separation.distance + 2.0 * float(apart.min())
        separation = dataclasses.replace(separation, distance=distance)
    larger = scenario.derived(vehicles=vehicles, separation=separation, disturbance=None)
    return larger.of_vehicles(range(len(vehicles)))
