"""Smooth motions in small steps of constant acceleration, as simulations fly them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import SAME_TIME, Grid

_PARTS = 32
"""Least number of steps in the width of an average."""


def in_small_steps(plan: Plan) -> Plan:
    """Return a plan with smoothing as one without, in small steps, or the plan if it has none.

    It begins when the smooth motion begins. Its velocities at knots are those of the smooth motion,
    and its last position is the goal; in between, positions differ by about δ² a / 12 where the
    acceleration is a and the small step δ.

    With a disturbance a whole number of small steps is a sample of the feedback, so that the flight
    may end with less than a small step at the goal. The feedback is that of the plan's error tube.
    """
    scenario, smoothing = plan.scenario, plan.scenario.smoothing
    if smoothing is None:
        return plan
    lasting, disturbance = scenario.grid.duration + 2.0 * scenario.lead, scenario.disturbance
    if disturbance is None:
        steps = math.ceil(lasting / smoothing.width * _PARTS)
        step = lasting / steps
    else:
        tube = tube_of(scenario)
        step = tube.sample / math.ceil(tube.sample / smoothing.width * _PARTS)
        steps = math.ceil(lasting / step * (1.0 - SAME_TIME))
        disturbance = dataclasses.replace(
            disturbance, feedback_every=tube.sample, tracking=tube.tracking
        )
    grid = Grid(step, steps + 1, scenario.grid.start - scenario.lead)
    elapsed = np.minimum(grid.elapsed, lasting) - scenario.lead
    accelerations = np.diff(plan.sampled(elapsed).velocities, axis=1) / grid.step
    stepwise = dataclasses.replace(scenario, grid=grid, smoothing=None, disturbance=disturbance)
    first = Plan.from_accelerations(stepwise, accelerations, plan.statistics)
    return Plan.from_accelerations(stepwise, accelerations + _closing(first), plan.statistics)


def _closing(plan: Plan) -> FloatArray:
    """Return the least change of accelerations that leads to the goals [m/s²], (N, K-1, 3)."""
    fleet, grid = plan.scenario.fleet, plan.scenario.grid
    remaining = grid.duration - grid.step * (np.arange(grid.knots - 1) + 0.5)
    rows = grid.step * np.stack([remaining / grid.duration, np.ones(len(remaining))])
    missing = np.stack(
        [
            (fleet.goal_positions - plan.positions[:, -1]) / grid.duration,
            fleet.goal_velocities - plan.velocities[:, -1],
        ]
    )
    weights = np.linalg.solve(rows @ rows.T, missing.reshape(2, -1)).reshape(missing.shape)
    return np.asarray(np.einsum("ek,enx->nkx", rows, weights))
