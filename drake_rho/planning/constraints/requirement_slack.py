"""Slack of requirements (`KeepIn`) for errors: in their sets, at starts and at goals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.constraints.slack import ENDS, TighteningSlack
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Shape


def sizes_of_requirements(scenario: Scenario, margins: Margins) -> Iterator[TighteningSlack]:
    """Yield half the least side of every required shape: the error tube has to fit into it."""
    for number, each in enumerate(scenario.requirements, start=1):
        if each.quantity != "jerk" and isinstance(each.set, Shape):
            half = np.full(len(scenario.vehicles), each.set.extent.min())
            yield _of_requirement(scenario, margins, number, "middle", half)


def ends_in_requirements(
    scenario: Scenario, margins: Margins, end: int
) -> Iterator[TighteningSlack]:
    """Yield the slack of positions and velocities in required sets at start or goal."""
    fleet, names, grid = scenario.fleet, scenario.names, scenario.grid
    states: dict[Quantity, FloatArray] = {"position": fleet.start_positions}
    states["velocity"] = fleet.start_velocities
    if end != 0:
        states = {"position": fleet.goal_positions, "velocity": fleet.goal_velocities}
    if scenario.smoothing is not None:  # averages have rest before the start and after the goal
        states["acceleration"] = np.zeros_like(fleet.goal_positions)
    now = grid.start if end == 0 else grid.end
    for number, each in enumerate(scenario.requirements, start=1):
        interval = each.longer(scenario.lead).interval(grid)
        if each.quantity not in states or interval is None or not grid.clock.within(now, interval):
            continue
        values, partner = states[each.quantity] - each.offset(np.array([now])), each.partner(names)
        if partner is not None:
            values = values - values[partner]
        inside = -np.asarray(each.set.signed_distance(values)) - each.deviation
        yield _of_requirement(scenario, margins, number, ENDS[end], inside, end)


def _of_requirement(
    scenario: Scenario,
    margins: Margins,
    number: int,
    where: str,
    available: FloatArray,
    end: int | None = None,
) -> TighteningSlack:
    """Return the slack of a requirement, half of it for each vehicle of a pair.

    Args:
        scenario: the scenario.
        margins: margins of its plans.
        number: number of the requirement, from 1.
        where: place of the comparison.
        available: distance inside the set's boundary of each vehicle, in its unit, shape (N,).
        end: index of the knot of the comparison; None for the whole flight.
    """
    asked, names = scenario.requirements[number - 1], scenario.names
    members, quantity = asked.members(names), asked.quantity
    needed = margins.steps[quantity].max(keepdims=True)
    if end is not None:
        needed = margins.knots[quantity][[end]]
    own, tolerances = np.full(len(names), np.inf), np.zeros(len(names))
    own[members] = available[members] / (1.0 if asked.leader is None else 2.0)
    tolerances[members] = asked.tolerances(scenario.fleet, names)
    return TighteningSlack(asked.called(number), where, quantity, own, needed, tolerances)
