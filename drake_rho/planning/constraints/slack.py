"""Slack of constraints for errors: available and needed distances inside their boundaries.

The verifier judges goals without a plan (`drake_rho.verification.rest`), so for vehicles that hold
at their goals after the end its margins are the slack. A pair of vehicles shares its slack.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.tube import ErrorTube
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import UNITS, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Shape
from drake_rho.verification.check import Column
from drake_rho.verification.rest import Rest

ENDS = {0: "start", -1: "goal"}
"""Names of the knots with given states, by index."""


@dataclasses.dataclass(frozen=True, eq=False)
class TighteningSlack:
    """Available and needed distances from the boundary of one constraint, for all vehicles."""

    name: str
    """name of the constraint"""
    where: str
    """place of the comparison: start, goal, or the middle of a set"""
    quantity: Quantity
    """quantity with the error"""
    available: FloatArray
    """distances of the vehicles inside the constraint's boundary, negative beyond it, in the
    quantity's unit, shape (N,)"""
    needed: FloatArray
    """needed margins, in the quantity's unit, shape (1,) or (N,)"""
    tolerances: FloatArray
    """tolerances of the constraint, in the quantity's unit, shape (1,) or (N,)"""

    def missing(self, tolerances: float) -> FloatArray:
        """Return the missing slack beyond a number of tolerances, at most 0 if none, shape (N,)."""
        missing: FloatArray = self.needed - self.available - tolerances * self.tolerances
        return missing

    def reason(self, vehicle: int) -> str:
        """Return a description of one vehicle's missing slack."""
        unit, needed = UNITS[self.quantity], np.broadcast_to(self.needed, self.available.shape)
        depth = float(self.available[vehicle])
        if needed[vehicle] <= 0.0:
            return f"{self.name} ({self.where} {-depth:.3g} {unit} beyond)"
        if depth < 0.0:
            inside = f"{needed[vehicle]:.3g} {unit} inside is needed"
            return f"{self.name} ({self.where} {-depth:.3g} {unit} beyond; {inside})"
        return f"{self.name} ({self.where} {depth:.3g} {unit} inside, of {needed[vehicle]:.3g})"


def of_given_ends(fleet: Fleet, quantity: Quantity, end: int, available: FloatArray) -> FloatArray:
    """Return slack at start or goal, infinite for vehicles without a given value there.

    Args:
        fleet: vehicles.
        quantity: quantity that is compared.
        end: 0 for the start, -1 for the goal.
        available: slack of each vehicle, shape (N,).
    """
    if end == 0 or quantity not in ("position", "velocity"):
        return available
    return np.where(fleet.fixed(quantity), available, np.inf)


def states_at(scenario: Scenario, end: int) -> dict[Quantity, FloatArray]:
    """Return the given states at start or goal; with a smoothing, accelerations are zero there."""
    fleet = scenario.fleet
    states: dict[Quantity, FloatArray] = {
        "position": fleet.start_positions if end == 0 else fleet.goal_positions,
        "velocity": fleet.start_velocities if end == 0 else fleet.goal_velocities,
    }
    if scenario.smoothing is not None:  # averages have rest before the start and after the goal
        states["acceleration"] = np.zeros_like(fleet.goal_positions)
    return states


def sizes_of_requirements(scenario: Scenario, margins: Margins) -> Iterator[TighteningSlack]:
    """Yield half the least side of every required shape: the error tube has to fit into it."""
    for number, each in enumerate(scenario.required, start=1):
        if each.penalty is None and each.quantity != "jerk" and isinstance(each.set, Shape):
            half = np.full(len(scenario.vehicles), each.set.extent.min())
            needed = margins.steps[each.quantity].max(keepdims=True)
            yield _of_requirement(scenario, number, "middle", half, needed)


def ends_in_requirements(
    scenario: Scenario, margins: Margins, end: int
) -> Iterator[TighteningSlack]:
    """Yield the slack of positions and velocities in required sets at start or goal."""
    names, grid, states = scenario.names, scenario.grid, states_at(scenario, end)
    now = grid.start if end == 0 else grid.end
    for number, each in enumerate(scenario.required, start=1):
        interval = each.longer(scenario.lead).interval(grid)
        inactive = interval is None or not grid.clock.within(now, interval)
        given = each.quantity in states and not each.is_goal
        if not given or inactive or each.penalty is not None:
            continue
        values, partner = states[each.quantity] - each.offset(np.array([now])), each.partner(names)
        if partner is not None:
            values = values - values[partner]
        inside = -np.asarray(each.set.signed_distance(values)) - each.deviation
        inside = of_given_ends(scenario.fleet, each.quantity, end, inside)
        if partner is not None and np.isinf(inside[partner]):
            inside = np.full_like(inside, np.inf)
        needed = margins.knots[each.quantity][[end]]
        yield _of_requirement(scenario, number, ENDS[end], inside, needed)


def _of_requirement(
    scenario: Scenario, number: int, where: str, available: FloatArray, needed: FloatArray
) -> TighteningSlack:
    """Return the slack of a requirement, half of it for each vehicle of a pair.

    Args:
        scenario: the scenario.
        number: number of the requirement, from 1.
        where: place of the comparison.
        available: distance inside the set's boundary of each vehicle, in its unit, shape (N,).
        needed: needed margins of each vehicle, in its unit, shape (1,).
    """
    requirement, names = scenario.required[number - 1], scenario.names
    members = requirement.members(names)
    own, tolerances = np.full(len(names), np.inf), np.zeros(len(names))
    own[members] = available[members] / (1.0 if requirement.leader is None else 2.0)
    tolerances[members] = requirement.tolerances(scenario.fleet, names)
    return TighteningSlack(
        requirement.called(number), where, requirement.quantity, own, needed, tolerances
    )


_WHERE = "held goal"
"""Place of the comparison, as in 'obstacle 1 (held goal 0.1 m inside, of 0.2)'."""

_QUANTITIES: dict[str, Quantity] = {unit: quantity for quantity, unit in UNITS.items()}

_AFTER_LIMITS = ("obstacles", "separation", "requirements")
"""Kinds that follow the limits in messages; limits are in the order of their quantities."""


def slacks_at_rest(scenario: Scenario, tube: ErrorTube | None) -> Iterator[TighteningSlack]:
    """Yield the slack of every constraint for vehicles that hold at their goals after the end.

    Args:
        scenario: the scenario.
        tube: error tube of plans at their end; None without a disturbance.
    """
    if not scenario.hold_at_goal or (rest := Rest.of(scenario, tube)) is None:
        return
    radii, required = rest.radii(), (each for each in rest.columns_without_errors() if each.asked)
    for column in sorted(required, key=_place):
        quantity = _QUANTITIES[column.unit]
        vehicles = 1.0 if column.partners is None else 2.0
        available = np.where(column.concerned, -column.excess / vehicles, np.inf)
        needed = np.where(np.isposinf(available), 0.0, radii[quantity])
        yield TighteningSlack(
            column.constraint, _WHERE, quantity, available, needed, column.tolerances
        )


def _place(column: Column) -> tuple[int, int]:
    """Return the sorting key of a constraint in messages."""
    if column.kind in _AFTER_LIMITS:
        return 1 + _AFTER_LIMITS.index(column.kind), 0
    return 0, list(_QUANTITIES).index(column.unit)
