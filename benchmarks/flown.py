"""Evaluation of a flight in wind by dense samples of the true motion.

Only the scenario and the record's states and commands are used, and no code of the package's
verifier. Between two times of the record the acceleration of a point mass is constant, so samples
in between are exact. Jerk, which belongs to the plan, thrust, tilt and waypoints are not evaluated.
"""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.clearance import clearance
from benchmarks.sampling import least_distance
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray

PARTS = 2
"""Samples between two times of a record, of which a sample of feedback has ten or more."""


@dataclasses.dataclass(frozen=True)
class Violations:
    """Largest violations of limits; negative for a margin."""

    obstacles: float
    """depth inside any obstacle beyond the required distance [m]"""
    pairs: float
    """violation of the separation by any pair [m]"""
    boxes: float
    """distance beyond any side of a box of position, velocity or command, over the side"""
    norms: float
    """speed or norm of a command beyond its limit, over the limit"""
    scale: float
    """longest side of the scene [m]"""

    @property
    def worst(self) -> float:
        """Largest of all as a fraction of the scale, of a side, or of a limit."""
        lengths = max(self.obstacles, self.pairs) / self.scale
        return max(lengths, self.boxes, self.norms)


def violations(simulation: Simulation) -> Violations:
    """Return the violations of a flight of point masses."""
    scenario = simulation.scenario
    times, positions, velocities = finer(simulation)
    boxes, norms = -np.inf, -np.inf
    for i, vehicle in enumerate(scenario.vehicles):
        limits = scenario.limits_of(vehicle)
        commands = simulation.commands[:-1, i]
        boxes = max(
            boxes,
            beyond(limits.position, positions[:, i]),
            beyond(limits.velocity, velocities[:, i]),
            beyond(limits.acceleration, commands),
        )
        norms = max(
            norms,
            above(limits.max_speed, velocities[:, i]),
            above(limits.max_acceleration, commands),
        )
    pairs = -np.inf
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        separation = scenario.separation
        pairs = separation.distance - least_distance(positions, separation)
    return Violations(
        -clearance(scenario, times, positions),
        pairs,
        boxes,
        norms,
        float(np.ptp(positions, axis=(0, 1)).max()),
    )


def finer(simulation: Simulation) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (S,), positions and velocities (S, N, 3), those of the record and between."""
    t, p, v = simulation.times, simulation.positions, simulation.velocities
    passed = np.diff(t)[:, None, None]
    a = np.diff(v, axis=0) / passed
    times, positions, velocities = [t[:1]], [p[:1]], [v[:1]]
    for part in np.arange(1, PARTS + 1) / PARTS:
        s = part * passed
        times.append(t[:-1] + part * np.diff(t))
        positions.append(p[:-1] + s * (v[:-1] + s / 2.0 * a))
        velocities.append(v[:-1] + s * a)
    return np.concatenate(times), np.concatenate(positions), np.concatenate(velocities)


def beyond(box: rho.Box | None, values: FloatArray) -> float:
    """Return how far values, shape (S, 3), are beyond a box, over its side."""
    if box is None:
        return -np.inf
    beyond = np.maximum(box.lower - values, values - box.upper)
    return float(np.max(beyond / np.maximum(box.upper - box.lower, 1e-9)))


def above(most: float | None, values: FloatArray) -> float:
    """Return how far norms of values, shape (S, 3), are above a limit, over it."""
    return -np.inf if most is None else float(np.linalg.norm(values, axis=1).max() / most - 1.0)
