"""Perturbed initial guesses of a single vehicle, for when restoration from paths fails.

If every path is too long for the duration, a motion with another time scaling may still pass a
moving obstacle or a corner. Random perturbations have fixed seeds, so they are always the same.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

PERTURBATIONS = 20
"""Number of perturbed initial guesses for a single vehicle."""

_FURTHEST = 0.3, 5.0
"""Least and largest scale of the perturbations of a single vehicle, in sizes of the largest
obstacle."""


def perturbed(plan: Plan, along_sine: FloatArray, along_cosine: FloatArray) -> Plan:
    """Return a plan with one period of a harmonic added to its accelerations.

    The result need not end at the goals.

    Args:
        plan: of any scenario.
        along_sine: amplitude of the displacement by accelerations that follow a sine, which moves
            vehicles to one side throughout [m], shape (N, 3).
        along_cosine: amplitude of the displacement by accelerations that follow a cosine, which
            moves vehicles aside, by up to twice the amplitude, and back [m], shape (N, 3).
    """
    grid = plan.scenario.grid
    angles = 2.0 * np.pi * (np.arange(grid.knots - 1) + 0.5) / (grid.knots - 1)
    waves = np.stack([np.sin(angles), np.cos(angles)]) * (2.0 * np.pi / grid.duration) ** 2
    offsets = np.stack([along_sine, along_cosine], axis=1)
    accelerations = plan.accelerations + np.einsum("wk,nwx->nkx", waves, offsets)
    return Plan.from_accelerations(plan.scenario, accelerations)


def perturbed_vehicle(scenario: Scenario, number: int) -> Plan:
    """Return a random perturbation of one vehicle's minimum effort, obstacles and limits ignored.

    Args:
        scenario: of one vehicle, with obstacles.
        number: of the perturbation, from 0.
    """
    motion, rng = MinimumEffort.of(scenario).motion, np.random.default_rng(number)
    cheapest = Plan.from_accelerations(scenario, motion.accelerations)
    size = max(body.shape.size for _, body in scenario.avoided)
    sine, cosine = size * rng.uniform(*_FURTHEST) * rng.normal(size=(2, 1, 3))
    return perturbed(cheapest, sine, 0.5 * cosine)
