"""Drake's graphs of convex sets on one draw: time, index, and verdict on the curve."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

import drake_rho as rho
from benchmarks.clearance import clearance
from benchmarks.fleets import TOUCHING
from benchmarks.peers import drake_gcs
from benchmarks.peers.bezier import Curve
from benchmarks.stopwatch import Stopwatch, Taken

GCS = "Drake's GcsTrajectoryOptimization"

SAMPLES = 5000
"""Samples of a curve."""

Verdict = Literal["kept", "breaks limits", "too close", "none"]


@dataclasses.dataclass(frozen=True)
class Lap:
    """Result of one draw."""

    taken: Taken
    """time from the scenario record to the curve, or to the failure"""
    verdict: Verdict
    """verdict: every limit is satisfied, or the one that is not"""
    index: float = np.nan
    """(1/h) times the integral of the squared acceleration [m²/s⁴]; NaN without a curve"""

    @property
    def counts(self) -> bool:
        """True if there is a curve that satisfies every limit."""
        return self.verdict == "kept"


def fly(scenario: rho.Scenario, seed: int) -> Lap:
    """Find a curve and verify it."""
    watch = Stopwatch()
    curve = drake_gcs.solve(scenario, np.random.default_rng(seed))
    taken = watch.taken()
    if curve is None:
        return Lap(taken, "none")
    return Lap(taken, _verify(scenario, curve), curve.cost(scenario.grid.step))


def _verify(scenario: rho.Scenario, curve: Curve) -> Verdict:
    times = np.linspace(0.0, scenario.grid.duration, SAMPLES)
    at = scenario.grid.start + times
    if clearance(scenario, at, curve.at(times)[:, None]) < -TOUCHING:
        return "too close"
    limits = scenario.limits
    for order, box in enumerate((limits.position, limits.velocity, limits.acceleration)):
        if box is not None:
            values, allowed = curve.at(times, order), TOUCHING * (box.upper - box.lower)
            if np.any((values < box.lower - allowed) | (values > box.upper + allowed)):
                return "breaks limits"
    return "kept"
