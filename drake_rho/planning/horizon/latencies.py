"""Latency of a receding horizon: windows are planned while the previous one is flown."""

from __future__ import annotations

import dataclasses
import math

from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.scenario.records import Scenario


def latency_in_samples(scenario: Scenario, latency: float, replan_every: int) -> int:
    """Return the number of samples of the feedback that last as long as a latency, or longer.

    Args:
        scenario: scenario to fly.
        latency: time that planning a window takes [s].
        replan_every: number of steps flown of each window.

    Raises:
        ValueError: the latency is negative, or too long.
    """
    period = replan_every * scenario.grid.step
    if not 0.0 <= latency <= period * (1.0 + SAME_TIME):  # also true for NaN
        expected = f"0 to {period:g} s, the time for which a window is flown"
        raise ValueError(f"latency: got {latency!r}, expected {expected}")
    return math.ceil(latency / _sample(scenario) * (1.0 - SAME_TIME))


def known_later(scenario: Scenario, samples: int) -> Scenario:
    """Return the scenario in which what becomes known in flight does so a latency later.

    A window is planned from what is known when planning begins.

    Args:
        scenario: scenario to fly.
        samples: latency as a number of samples of the feedback.
    """
    start = max(scenario.grid.start, 0.0)
    late = [each for each in scenario.bodies if each.known_from > start]
    if samples == 0 or not late:
        return scenario
    latency = samples * _sample(scenario)
    obstacles = tuple(
        dataclasses.replace(
            each,
            known_from=each.known_from + latency,
            seen_at=each.errors_from if each.velocity_error > 0.0 else each.seen_at,
        )
        if isinstance(each, Obstacle) and each.known_from > start
        else each
        for each in scenario.obstacles
    )
    return dataclasses.replace(scenario, obstacles=obstacles)


def _sample(scenario: Scenario) -> float:
    """Return the time from one sample of the feedback to the next [s]."""
    around = scenario.disturbance or Disturbance(0.0)
    return around.sample(scenario.grid)
