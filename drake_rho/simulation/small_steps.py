"""Smooth motions in small steps of constant acceleration, for simulation."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting

_PARTS = 32
"""Least number of steps in the width of an average."""


def in_small_steps(plan: Plan) -> Plan:
    """Return a smoothed plan as a plan in small steps without smoothing; others unchanged.

    It begins when the smooth motion begins. Its velocities at knots are those of the smooth motion,
    and its last position is the goal; in between, positions differ by about δ² a / 12 where the
    acceleration is a and the small step δ.

    With a disturbance a feedback sample is a whole number of small steps, so the flight may end
    with less than a small step at the goal. The feedback is that of the plan's error tube.
    """
    scenario = plan.scenario
    if not scenario.smoothing:
        return plan
    step = small_step(scenario)
    if not scenario.disturbance:  # the flight is a whole number of steps
        lasting = _lasting(scenario)
        step = lasting / math.ceil(lasting / scenario.averaging_width * _PARTS)
    return averaged_in(small_scenario(scenario, step), plan)


def small_step(scenario: Scenario) -> float:
    """Return a small step that divides the feedback sample [s]."""
    sample = scenario.disturbance_or_calm.sample(scenario.grid)
    return sample / math.ceil(sample / scenario.averaging_width * _PARTS)


def small_scenario(scenario: Scenario, step: float) -> Scenario:
    """Return a scenario without its smoothing, on a grid of small steps [s].

    It begins when the smooth motion begins.
    """
    steps = steps_lasting(_lasting(scenario), step)
    grid, disturbance = Grid(step, steps + 1, scenario.grid.start - scenario.lead), None
    if scenario.disturbance is not None:
        tube = tube_of(scenario)
        disturbance = dataclasses.replace(
            scenario.disturbance, feedback_every=tube.sample, tracking=tube.tracking
        )
    return dataclasses.replace(scenario, grid=grid, smoothing=None, disturbance=disturbance)


def averaged_in(small: Scenario, plan: Plan) -> Plan:
    """Return a smooth motion as a plan in small steps that ends at the same state.

    Args:
        small: scenario in small steps, from the beginning of the smooth motion.
        plan: plan with smoothing.
    """
    lasting, lead, grid = _lasting(plan.scenario), plan.scenario.lead, small.grid
    samples = plan.sampled(np.minimum(grid.elapsed, lasting) - lead)
    accelerations = np.diff(samples.velocities, axis=1) / grid.step
    first = Plan.from_accelerations(small, accelerations, plan.statistics)
    ends = samples.positions[:, -1], samples.velocities[:, -1]
    return Plan.from_accelerations(small, accelerations + _closing(first, *ends), plan.statistics)


def _lasting(scenario: Scenario) -> float:
    """Return the duration of a smooth motion [s]."""
    return scenario.grid.duration + 2.0 * scenario.lead


def _closing(plan: Plan, positions: FloatArray, velocities: FloatArray) -> FloatArray:
    """Return the least change of accelerations to end at states (N, 3) [m/s²], (N, K-1, 3)."""
    grid = plan.scenario.grid
    remaining = grid.duration - grid.step * (np.arange(grid.knots - 1) + 0.5)
    rows = grid.step * np.stack([remaining / grid.duration, np.ones(len(remaining))])
    missing = np.stack(
        [
            (positions - plan.positions[:, -1]) / grid.duration,
            velocities - plan.velocities[:, -1],
        ]
    )
    weights = np.linalg.solve(rows @ rows.T, missing.reshape(2, -1)).reshape(missing.shape)
    return np.asarray(np.einsum("ek,enx->nkx", rows, weights))
