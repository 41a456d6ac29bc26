"""Distances of measured samples of a flight, drawn beside those of the planned motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.motion.deviations import Deviations
from drake_rho.motion.obstacle_clearances import required_distances
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.pairs import nearest_others
from drake_rho.scenario.records import Scenario, Separation


def distances(scenario: Scenario, obstacle: Obstacle, samples: Deviations) -> FloatArray:
    """Return distances from where an obstacle may be [m], (N, M).

    They are NaN for a vehicle that was not seen, and infinite while the obstacle is not active.
    """
    positions = np.nan_to_num(samples.positions)
    found = obstacle.since(scenario.grid).distances(positions, samples.elapsed)
    return np.where(samples.seen, found, np.nan)


def least_clearances(
    scenario: Scenario, obstacles: Sequence[Obstacle], samples: Deviations
) -> FloatArray:
    """Return the least clearances from several obstacles [m], (N, M), NaN where not seen."""
    clearances = [
        distances(scenario, each, samples) - required_distances(scenario, each)[:, None]
        for each in obstacles
    ]
    return np.asarray(np.min(clearances, axis=0))


def closest_two(separation: Separation, samples: Deviations) -> FloatArray:
    """Return distances of the closest two vehicles that were seen [m], (M,), NaN without two."""
    scaled, seen = separation.scaled(samples.positions), samples.seen
    least = np.full(len(samples.elapsed), np.nan)
    for m in np.flatnonzero(seen.sum(axis=0) > 1).tolist():
        away, _ = nearest_others(scaled[seen[:, m], m])
        least[m] = away.min()
    return least
