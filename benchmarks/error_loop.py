"""Random disturbances, and errors integrated step by step: a twin of the tube's closed forms.

The loop uses p'' = u + w and the feedback's samples, and no code of the tube.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray


def scenario_with(disturbance: rho.Disturbance, grid: rho.Grid) -> rho.Scenario:
    """Return one vehicle from rest to rest, with a disturbance and no limits."""
    vehicle = rho.Vehicle("vehicle", rho.State([0, 0, 0]), rho.State([1, 0, 0]))
    return rho.Scenario("errors of one", grid, [vehicle], disturbance=disturbance)


def random_tube(rng: np.random.Generator, most_delay: int = 5) -> rho.ErrorTube:
    """Return a tube with random stable gains, sample, delay, estimation and initial errors.

    Half of them predict the state, and may lose up to three measurements in a row.
    """
    sample, delay = 10.0 ** rng.uniform(-2.0, 0.5), int(rng.integers(0, most_delay + 1))
    knots, parts = int(rng.integers(3, 9)), int(rng.integers(1, 6))
    predicted = bool(rng.integers(2))
    dropouts = int(rng.integers(0, 4)) if predicted else 0
    gains = stable_gains(rng, 0 if predicted else delay)
    W = 10.0 ** rng.uniform(-2.0, 1.0)
    E_p, E_v, r_p, r_v = (
        W * rng.uniform(0.0, 1.5, 4) * (rng.random(4) < 0.75) * sample ** np.array([2, 1, 2, 1])
    )
    around = rho.Disturbance(W, E_p, E_v, sample, delay, dropouts=dropouts, prediction=predicted)
    grid = rho.Grid(sample * parts, knots, rng.uniform(-5.0, 5.0))
    scaled = gains[0] / sample**2, gains[1] / sample
    return rho.error_tube(scenario_with(around, grid), (r_p, r_v), gains=scaled)


def stable_gains(rng: np.random.Generator, delay: int) -> tuple[float, float]:
    """Draw α = k_p δ² and β = k_v δ with the roots of the error dynamics in the unit disc.

    The roots are those of z^d (z - 1)² + (α/2 + β) z + α/2 - β, with d = 0 for a prediction.
    """
    while True:
        alpha, beta = rng.uniform(0.0, 2.0, 2) / (1.0 + delay) ** np.array([2, 1])
        polynomial = np.concatenate([[1.0, -2.0, 1.0], np.zeros(delay)])
        polynomial[-2:] += alpha / 2.0 + beta, alpha / 2.0 - beta
        if np.abs(np.roots(polynomial)).max() < 0.999:
            return float(alpha), float(beta)


@dataclasses.dataclass(frozen=True)
class Flown:
    """Errors of a flight at the samples and at switching times of the wind."""

    times: FloatArray
    """times on the scenario's clock [s], shape (B,)"""
    positions: FloatArray
    """errors of position [m], shape (B, 3)"""
    velocities: FloatArray
    """errors of velocity [m/s], shape (B, 3)"""
    feedback: FloatArray
    """feedback in each sample [m/s²], shape (J, 3)"""


def fly(tube: rho.ErrorTube, case: rho.WorstCase, also: float) -> Flown:
    """Integrate the errors that a worst case causes.

    Args:
        tube: its gains, sample, delay, prediction and first knot are used.
        case: the wind, the errors of the estimates, the lost measurements and the initial errors.
        also: additional time at which errors are recorded [s].
    """
    samples = np.asarray(tube.grid.start + tube.sample * np.arange(tube.samples + 1))
    times = _merged(samples, np.append(case.switching_times, also), 1e-9 * tube.sample)
    k_p, k_v = tube.gains
    p, v = case.first_position, case.first_velocity
    positions, velocities = [p], [v]
    measured, feedback = list[tuple[FloatArray, FloatArray]](), list[FloatArray]()
    still = np.zeros((1, 3))
    for time, after in pairwise(times):
        j = len(feedback)
        if j < tube.samples and time == samples[j]:
            measured.append((p + case.position_errors[j], v + case.velocity_errors[j]))
            arrived = np.flatnonzero(~case.lost[: max(0, j - tube.disturbance.delay + 1)])
            x, y = measured[arrived[-1]] if len(arrived) else (np.zeros(3), np.zeros(3))
            since = feedback[arrived[-1] :] if len(arrived) and tube.measurements.predicted else []
            for u in since:
                x, y = x + tube.sample * y + tube.sample**2 / 2.0 * u, y + tube.sample * u
            feedback.append(-k_p * x - k_v * y)
        s, a = after - time, feedback[-1] + case(time, still, still)[0]
        p, v = p + s * v + s**2 / 2.0 * a, v + s * a
        positions.append(p)
        velocities.append(v)
    return Flown(times, np.array(positions), np.array(velocities), np.array(feedback))


def _merged(samples: FloatArray, others: FloatArray, same: float) -> FloatArray:
    """Return all samples, exactly, and the other times that do not equal one of them."""
    apart = np.abs(others[:, None] - samples).min(axis=1) > same
    inside = apart & (others > samples[0]) & (others < samples[-1])
    return np.unique(np.concatenate([samples, others[inside]]))
