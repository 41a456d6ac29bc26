"""Distances of plans from the sets in which they keep positions, independent of the package's.

Only the accelerations are taken from the plan. They are integrated anew by (1) and (2) and sampled.
"""

from __future__ import annotations

import numpy as np

import drake_rho as rho
from benchmarks.clearance import distances
from benchmarks.peers.windows import roll_out
from drake_rho.scenario.fields import FloatArray

SAMPLES = 100
"""Samples of every step."""


def outside(plan: rho.Plan) -> float:
    """Return the largest distance by which positions are outside of a required set [m].

    Where the scenario requires no more, only knots count. Negative if all are inside, and -inf
    without requirements.

    Raises:
        TypeError: a requirement is about another quantity, or relative to a track.
    """
    grid, names = plan.scenario.grid, list(plan.scenario.names)
    samples = SAMPLES if plan.scenario.between_knots else 1
    positions = dense_positions(plan, samples)
    times = grid.start + grid.step / samples * np.arange(positions.shape[1])
    worst = -np.inf
    for asked in plan.scenario.requirements:
        if asked.of != "position" or isinstance(asked.relative_to, rho.Track):
            raise TypeError(f"requirement: got {asked}, expected positions, relative to no track")
        first, last = asked.active or (grid.start, grid.end)
        when = (times >= first - 1e-9 * grid.step) & (times <= last + 1e-9 * grid.step)
        moved = positions[:, when]
        if asked.relative_to is not None:
            moved = moved - moved[names.index(asked.relative_to)]
        asked_of = asked.vehicles or [each for each in names if each != asked.relative_to]
        of_these = moved[[names.index(each) for each in asked_of]]
        worst = max(worst, float(np.max(distances(asked.set, of_these), initial=-np.inf)))
    return worst


def dense_positions(plan: rho.Plan, samples: int = SAMPLES) -> FloatArray:
    """Return positions of all vehicles `samples` times a step and at the last knot, (N, S, 3)."""
    scenario, accelerations = plan.scenario, plan.accelerations
    h, fleet = scenario.grid.step, scenario.fleet
    p, v = roll_out(h, fleet.start_positions, fleet.start_velocities, accelerations)
    s = (h / samples * np.arange(samples))[:, None]
    a = accelerations[:, :, None]
    inner = p[:, :-1, None] + s * v[:, :-1, None] + s**2 / 2.0 * a
    return np.concatenate([inner.reshape(len(p), -1, 3), p[:, -1:]], axis=1)
