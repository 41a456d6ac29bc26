"""Initial guess of the non-convex peers: the motion of least index without obstacles and boxes."""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.peers.windows import roll_out
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True)
class Guess:
    """Motion of all vehicles."""

    positions: FloatArray
    """positions [m], shape (N, K, 3)"""
    velocities: FloatArray
    """velocities [m/s], shape (N, K, 3)"""
    accelerations: FloatArray
    """accelerations [m/s²], shape (N, K-1, 3)"""


def obstacle_free(scenario: Scenario) -> Guess:
    """Return the accelerations of least norm that satisfy the equalities (12), in closed form."""
    h, K, fleet = scenario.grid.step, scenario.grid.knots, scenario.fleet
    left = K - 1 - np.arange(K - 1)  # K - j of (10) and (11), at the last knot
    response = np.stack([h**2 / 2 * (2 * left - 1), np.full(K - 1, h)])
    drift = fleet.start_positions + h * (K - 1) * fleet.start_velocities
    missing = np.stack(
        [fleet.goal_positions - drift, fleet.goal_velocities - fleet.start_velocities], axis=1
    )
    a = np.einsum("ek,nei->nki", np.linalg.pinv(response).T, missing)
    p, v = roll_out(h, fleet.start_positions, fleet.start_velocities, a)
    return Guess(p, v, a)
