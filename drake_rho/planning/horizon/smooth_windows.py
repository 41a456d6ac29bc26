"""Windows of flights with a smoothing, which averages past and planned accelerations.

The average at a time needs the accelerations of the plan up to `lead` later. A window that changes
accelerations from a knot on must therefore be planned `lead` before that knot. Its averages change
from then on. They also depend on accelerations planned before, up to another `lead` back
(`State.flown`). All windows together are one plan, and the flight is its average: nothing jumps
where a window begins.

Windows begin on the plan of the window before, not at measured states, which would be a jump. The
error tube continues from the start of the flight.

A new window may accelerate up to the limits while averages near its first knot still depend on
positions planned before. All windows therefore keep the margin for the largest accelerations.
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
    """Return the states at which a window from a knot of a plan begins, shape (N, 6).

    These are the states at the knot or, with a smoothing, of the averages `lead` before it.

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
