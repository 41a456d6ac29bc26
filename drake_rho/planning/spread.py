"""Fleets whose ways all meet, bent apart before they are restored.

Where many vehicles meet at one point, each is in the way of many others at once, and half-spaces
from all sides leave no room: what restoration makes of it may swing to and fro. References that
are bent aside smoothly, each vehicle's in another direction, meet in fewer places.
"""

from __future__ import annotations

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.keep_apart import separation_of
from drake_rho.scenario.fields import FloatArray

SPREADS = 5
"""Ways of spreading a fleet."""

_LEVELS = 5
"""Heights among which vehicles are divided in the first of them."""

_ASIDE = 2.0
"""How far vehicles are bent aside, in separations."""


def spread(plan: Plan, number: int) -> Plan:
    """The plan with every vehicle bent aside in the middle of the flight, and back.

    Args:
        plan: of a scenario with a separation.
        number: which spread, from 0: to different heights first, then in directions that have no
            order, but are always the same.
    """
    scenario = plan.scenario
    steps, T = scenario.grid.knots - 1, scenario.grid.duration
    middles = (np.arange(steps) + 0.5) / steps
    bend: FloatArray = 2.0 * (np.pi / T) ** 2 * np.cos(2.0 * np.pi * middles)
    aside = _directions(len(scenario.vehicles), number) * separation_of(scenario).shape.semi_axes
    accelerations = plan.accelerations + _ASIDE * aside[:, None] * bend[:, None]
    return Plan.from_accelerations(scenario, accelerations)


def _directions(count: int, number: int) -> FloatArray:
    """How far each vehicle is bent aside along each axis, shape (N, 3)."""
    if number > 0:
        return np.random.default_rng(number).normal(size=(count, 3))
    directions = np.zeros((count, 3))
    directions[:, 2] = np.arange(count) % _LEVELS - _LEVELS // 2
    return directions
