"""The plan in force, continued at rest or from measured states."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.flight import Window
from drake_rho.motion.plan import Plan
from drake_rho.planning.horizon.fallbacks import moved
from drake_rho.planning.horizon.waypoints_ahead import until
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.records import Scenario


def lasting_until(window: Window, knot: int) -> Window:
    """Return a window that is continued at rest until a knot of the flight, if it ends before."""
    steps = knot - window.first_knot
    own = continued_at_rest(window.plan, steps)
    if own is window.plan:
        return window
    reference = (
        own if window.reference is window.plan else continued_at_rest(window.reference, steps)
    )
    return unchecked(window, plan=own, reference=reference)


def continued_at_rest(plan: Plan, steps: int) -> Plan:
    """Return a plan continued at rest until it has a number of steps."""
    scenario, more = plan.scenario, steps - plan.accelerations.shape[1]
    if more <= 0:
        return plan
    longer = until(scenario, scenario.grid.from_knot(0, steps), scenario.vehicles)
    accelerations = np.pad(plan.accelerations, ((0, 0), (0, more), (0, 0)))
    return Plan.from_accelerations(longer, accelerations, plan.statistics)


def as_measured(remaining: Plan, scenario: Scenario) -> Plan:
    """Return the rest of the plan in force from measured states, to the same places.

    Args:
        remaining: the rest from the planned states.
        scenario: from the measured states.
    """
    own = remaining.scenario
    if np.array_equal(scenario.fleet.start_states, own.fleet.start_states):
        return remaining
    vehicles = tuple(
        unchecked(each, goal=before.goal, waypoints=before.waypoints)
        for each, before in zip(scenario.vehicles, own.vehicles, strict=True)
    )
    fleet = scenario.fleet.aimed(vehicles)
    same = scenario.derived(vehicles=vehicles, objective=own.objective, fleet=fleet)
    return moved(remaining, same)
