"""Latency of a receding horizon: windows are planned while the previous one is flown."""

from __future__ import annotations

import dataclasses

from drake_rho.planning.horizon.newer_maps import with_obstacles
from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock, steps_lasting


def latency_in_samples(scenario: Scenario, latency: float, replan_every: int) -> int:
    """Return a latency in samples of the feedback, rounded up.

    Args:
        scenario: scenario to fly.
        latency: time that planning a window takes [s].
        replan_every: number of steps flown of each window.

    Raises:
        ValueError: the latency is negative, or too long.
    """
    period = replan_every * scenario.grid.step
    if not (latency >= 0.0 and Clock.of(period).within(latency, (0.0, period))):  # also for NaN
        expected = f"0 to {period:g} s, the time for which a window is flown"
        raise ValueError(f"latency: got {latency!r}, expected {expected}")
    return steps_lasting(latency, _sample(scenario))


def time_ahead(scenario: Scenario, latency: int) -> float:
    """Return the time by which windows are planned ahead [s].

    With a smoothing, this includes `Scenario.lead`, since averages depend on later accelerations.

    Args:
        scenario: scenario to fly.
        latency: number of samples of the feedback.
    """
    return latency * _sample(scenario) + scenario.lead


def known_later(scenario: Scenario, ahead: float) -> Scenario:
    """Return the scenario in which obstacles become known later, by the time of planning ahead.

    A window avoids the obstacles that are known when planning begins. Errors of obstacles grow from
    the time of the sighting, as without a latency. Obstacles become known at the end at the latest.

    Args:
        scenario: scenario to fly.
        ahead: time by which windows are planned ahead [s], as by `time_ahead`.
    """
    end, late = scenario.grid.end, [each.is_late(scenario.grid) for each in scenario.bodies]
    if ahead == 0.0 or not any(late):
        return scenario
    obstacles = tuple(
        dataclasses.replace(
            each, known_from=min(each.known_from + ahead, end), seen_at=each.errors_from
        )
        if isinstance(each, Obstacle) and is_late
        else each
        for each, is_late in zip(scenario.obstacles, late, strict=True)
    )
    return dataclasses.replace(scenario, obstacles=obstacles)


def known_when_seen(scenario: Scenario, given: Scenario) -> Scenario:
    """Return the scenario of a flight in which obstacles become known at their declared times.

    Args:
        scenario: scenario of the windows, from `known_later`, with newer obstacles after the given.
        given: scenario that was given.
    """
    old, newer = scenario.obstacles[: len(given.bodies)], scenario.obstacles[len(given.bodies) :]
    obstacles = tuple(
        unchecked(each, known_from=own.known_from) if isinstance(each, Obstacle) else each
        for each, own in zip(old, given.bodies, strict=True)
    )
    same = all(one == other for one, other in zip(obstacles, old, strict=True))
    return scenario if same else with_obstacles(scenario, (*obstacles, *newer))


def _sample(scenario: Scenario) -> float:
    """Return the time from one sample of the feedback to the next [s]."""
    around = scenario.disturbance or Disturbance(0.0)
    return around.sample(scenario.grid)
