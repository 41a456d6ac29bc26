"""Upper bounds on the cost of a flight with a receding horizon, for any allowed disturbance."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.planning.horizon.measured_states import estimate_errors
from drake_rho.scenario.fields import FloatArray


def cost_bound(plan: Plan, replan_every: int, ahead: int = 0) -> float:
    """Return an upper bound on the cost of a plan and its later windows [m²/s⁴].

    In a horizon with bounded costs, no window costs more than the rest of the one before, moved to
    the measured states. By the triangle inequality, the root of the cost grows by at most the norm
    of the correcting accelerations. The bound is the square of the root of the plan's cost plus
    these norms.

    Args:
        plan: plan of a window.
        replan_every: number of steps flown of each window.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    steps = plan.accelerations.shape[1]
    corrections = sum(
        largest_correction(plan, steps - knot, ahead)
        for knot in range(replan_every, steps, replan_every)
    )
    return float((np.sqrt(plan.cost) + corrections) ** 2)


def largest_correction(plan: Plan, steps: int, ahead: int = 0) -> float:
    """Return the largest norm of the accelerations that correct the errors of a tube [m/s²].

    The norm is that of the cost: weighted, over all vehicles and steps. A last single step is never
    planned again, since errors of position and velocity cannot both be corrected in one step.

    Args:
        plan: plan of a window, with the tube.
        steps: number of steps in which the errors are corrected.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    scenario = plan.scenario
    if scenario.smoothing or steps < 2:
        return 0.0  # windows with a smoothing begin as planned
    estimates, own = estimate_errors(scenario, ahead), tube_of(scenario)
    renewed = dataclasses.replace(own, initial=estimates)
    first = round((scenario.grid.start - own.grid.start) / scenario.grid.step)
    count = scenario.grid.knots - 1
    worst = [tube.over_steps(since, count) for tube, since in ((own, first), (renewed, 0))]
    position = max(float(each.position.max()) for each in worst) + estimates[0]
    velocity = max(float(each.velocity.max()) for each in worst) + estimates[1]
    effort = effort_of_errors(steps, scenario.grid.step)
    each = effort[0, 0] * position**2 + 2.0 * abs(effort[0, 1]) * position * velocity
    each += effort[1, 1] * velocity**2
    return float(np.sqrt(float(scenario.fleet.weights.sum()) * each))


def effort_of_errors(steps: int, step: float) -> FloatArray:
    """Return the least effort of correcting an error on one axis, a quadratic form of (p, v).

    Accelerations that take x = (p, v) to zero in n steps have the least sum of squares
    x' P' (M M')⁻¹ P x, where P is the free response and M is the response to accelerations.

    Args:
        steps: n, at least 2.
        step: h [s].
    """
    after = np.arange(steps)[::-1]
    response = np.stack([step**2 * (after + 0.5), np.full(steps, step)])
    free = np.array([[1.0, steps * step], [0.0, 1.0]])
    effort: FloatArray = free.T @ np.linalg.solve(response @ response.T, free)
    return effort
