"""Windows of flights with a smoothing, which average what was flown and what is planned.

Averages at a time need the accelerations of the plan up to `lead` later. So a window may change
accelerations from a knot on, if it is planned `lead` before that knot: until then the flight does
not depend on them. The averages that the window changes begin there. They reach as far back again,
to accelerations that were planned before (`State.flown`). All windows together are one plan, of
which the flight is the average: nothing jumps where a window begins.

Windows begin on the plan of the window before, not at measured states, which would be a jump. The
error tube goes on from the start of the flight.

A new window may accelerate as limits allow while averages near its first knot still reach
positions planned before. So all windows keep the margin of the accelerations that limits allow.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import REACHED
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import going_on


def resting_before(scenario: Scenario) -> Scenario:
    """Return the scenario of a first window: at rest before, with margins for later windows.

    Args:
        scenario: scenario of the flight, which is returned if it has no smoothing.
    """
    if scenario.smoothing is None:
        return scenario
    return going_on(scenario, np.zeros((len(scenario.vehicles), REACHED, 3)))


def states_at(plan: Plan, knot: int) -> FloatArray:
    """Return the states on which a window from a knot of a plan depends first, shape (N, 6).

    These are those of the knot or, with a smoothing, of its averages `lead` before.

    Args:
        plan: plan of the window before.
        knot: counted from 0.
    """
    smooth, scenario = plan.smooth(), plan.scenario
    if smooth is None:
        return plan.states(knot)
    begin = scenario.grid.elapsed[knot : knot + 1] - scenario.lead
    positions, velocities, _ = smooth.at(begin)
    return np.concatenate([positions[:, 0], velocities[:, 0]], axis=1)
