"""Dense samples of a plan: the independent twin of the exact checks.

Only the accelerations are taken from the plan. They are integrated anew by (1) and (2) and sampled;
the distances of all pairs and from all obstacles, and the violations of the boxes, are computed at
every sample.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from benchmarks.clearance import clearance
from benchmarks.peers.windows import roll_out
from drake_rho import Box, Plan, Separation
from drake_rho.scenario.fields import FloatArray

SAMPLES = 100
"""Usual samples of every step."""

MANY = 1000
"""Vehicles beyond which there are a tenth of the samples, and not every pair is visited."""


@dataclasses.dataclass(frozen=True)
class Sampled:
    """Evaluation of the samples."""

    metres: float
    """total distance flown by all vehicles [m]"""
    least: float
    """least distance of any pair, with the separation's downwash [m]; infinite for one vehicle"""
    clearance: float
    """least distance from any obstacle beyond the required one [m]; infinite without obstacles"""
    beyond: float
    """largest violation of a box of positions, velocities, accelerations or jerks, over its side;
    negative for a margin"""


def sample(plan: Plan, per_step: int = SAMPLES) -> Sampled:
    """Integrate a plan and evaluate it so many times a step, a tenth for many vehicles."""
    scenario = plan.scenario
    h, fleet = scenario.grid.step, scenario.fleet
    p, v = roll_out(h, fleet.start_positions, fleet.start_velocities, plan.accelerations)
    samples = per_step if len(p) <= MANY else per_step // 10
    elapsed = np.linspace(0.0, h, samples + 1)
    times = elapsed[:, None, None]
    metres, least, clear = 0.0, np.inf, np.inf
    beyond = max(_beyond(plan, i, p[i], v[i]) for i in range(len(p)))
    boxes = [scenario.limits_of(vehicle).position for vehicle in scenario.vehicles]
    for k in range(scenario.grid.knots - 1):
        positions = p[:, k] + times * v[:, k] + times**2 / 2 * plan.accelerations[:, k]
        metres += float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=-1)))
        clear = min(clear, clearance(scenario, scenario.grid.times[k] + elapsed, positions))
        for i, box in enumerate(boxes):
            beyond = max(beyond, _excess(positions[:, i], box))
        if len(p) > 1:
            least = min(least, least_distance(positions, scenario.separation))
    return Sampled(metres, least, clear, beyond)


def _beyond(plan: Plan, i: int, positions: FloatArray, velocities: FloatArray) -> float:
    """Return the largest violation of the boxes of vehicle i at its knots, over a box's side."""
    scenario, accelerations = plan.scenario, plan.accelerations[i]
    vehicle = scenario.vehicles[i]
    limits = scenario.limits_of(vehicle)
    ends = vehicle.start.acceleration_outside, vehicle.goal.acceleration_outside
    jerks = np.diff(np.vstack([ends[0], accelerations, ends[1]]), axis=0) / scenario.grid.step
    return max(
        _excess(positions, limits.position),
        _excess(velocities, limits.velocity),
        _excess(accelerations, limits.acceleration),
        _excess(jerks[~np.isnan(jerks[:, 0])], limits.jerk),
    )


def _excess(values: FloatArray, box: Box | None) -> float:
    """Return how far values, shape (M, 3), are beyond a box at most, over its side."""
    if box is None or len(values) == 0:
        return -np.inf
    sides = np.maximum(box.upper - box.lower, 1e-9)
    return float(np.max(np.maximum(box.lower - values, values - box.upper) / sides))


def least_distance(positions: FloatArray, separation: Separation | None) -> float:
    """Return the least distance of any pair at any instant, positions of shape (S, N, 3) [m]."""
    downwash = 1.0 if separation is None else separation.downwash
    scaled = positions / np.array([1.0, 1.0, downwash])
    if positions.shape[1] <= MANY:
        return min(float(pdist(each).min()) for each in scaled)
    return min(float(cKDTree(each).query(each, k=2)[0][:, 1].min()) for each in scaled)
