"""References bent aside smoothly, where restoration from what they are bent from comes to no end.

Fleets: where many vehicles meet at one point, each is in the way of many others at once, and
half-spaces from all sides leave no room; what restoration makes of it may swing to and fro. With
each vehicle bent in another direction they meet in fewer places. Single vehicles: where a way is
too long for the time there is, a motion may still get past what moves, or past a corner, at another
pace. Bends in which there is no order are always the same.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

SPREADS = 5
"""Ways of spreading a fleet."""

BENDS = 20
"""Bends of one vehicle's cheapest motion."""

_LEVELS = 5
"""Heights among which vehicles are divided in the first spread."""

_FURTHEST = 0.3, 5.0
"""How far single vehicles are bent aside, in parts of the largest obstacle."""


def bent(plan: Plan, along_sine: FloatArray, along_cosine: FloatArray) -> Plan:
    """The plan with accelerations of one period in the flight added; it need not end at its goals.

    Args:
        plan: of any scenario.
        along_sine: lengths of the order of which positions move, for accelerations that rise and
            fall as a sine: to one side all the time [m], shape (N, 3).
        along_cosine: the same for a cosine: aside, at most twice as far, and back [m], (N, 3).
    """
    grid = plan.scenario.grid
    angles = 2.0 * np.pi * (np.arange(grid.knots - 1) + 0.5) / (grid.knots - 1)
    waves = np.stack([np.sin(angles), np.cos(angles)]) * (2.0 * np.pi / grid.duration) ** 2
    aside = np.stack([along_sine, along_cosine], axis=1)
    accelerations = plan.accelerations + np.einsum("wk,nwx->nkx", waves, aside)
    return Plan.from_accelerations(plan.scenario, accelerations)


def bent_alone(scenario: Scenario, number: int) -> Plan:
    """The cheapest motion of one vehicle, obstacles and limits not looked at, bent at random.

    Args:
        scenario: of one vehicle, with obstacles.
        number: which bend, from 0.
    """
    motion, rng = MinimumEffort.of(scenario).motion, np.random.default_rng(number)
    cheapest = Plan.from_accelerations(scenario, motion.accelerations)
    size = max(body.shape.size for _, body in scenario.known)
    sine, cosine = size * rng.uniform(*_FURTHEST) * rng.normal(size=(2, 1, 3))
    return bent(cheapest, sine, 0.5 * cosine)
