"""A plan as many positions a step: the independent twin of the exact checks.

Only the accelerations are taken from the plan. They are flown anew by (1) and (2), sampled, and
the distances of all pairs computed at every sample.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.distance import pdist

from benchmarks.peers.windows import roll_out
from drake_rho import Plan
from drake_rho.scenario.fields import FloatArray

SAMPLES = 100
"""Of every step."""


@dataclasses.dataclass(frozen=True)
class Sampled:
    """What the samples say."""

    metres: float
    """distance that all vehicles fly together [m]"""
    least: float
    """least distance of any two, with the separation's downwash [m]; infinite for one alone"""


def sample(plan: Plan) -> Sampled:
    """Fly a plan and look at it `SAMPLES` times a step."""
    scenario = plan.scenario
    h, fleet = scenario.grid.step, scenario.fleet
    p, v = roll_out(h, fleet.start_positions, fleet.start_velocities, plan.accelerations)
    times = np.linspace(0.0, h, SAMPLES + 1)[:, None, None]
    metres, least = 0.0, np.inf
    for k in range(scenario.grid.knots - 1):
        positions = p[:, k] + times * v[:, k] + times**2 / 2 * plan.accelerations[:, k]
        metres += float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=-1)))
        if len(p) > 1:
            least = min(least, _least(positions, plan))
    return Sampled(metres, least)


def _least(positions: FloatArray, plan: Plan) -> float:
    """Least distance of any two at any of some instants, positions of shape (S, N, 3)."""
    downwash = 1.0 if plan.scenario.separation is None else plan.scenario.separation.downwash
    scaled = positions / np.array([1.0, 1.0, downwash])
    return min(float(pdist(each).min()) for each in scaled)
