"""Least times of flights in which some waypoints have times and others have none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho

SPEED, ACCELERATION = 1.0, 0.5
"""Largest speed [m/s] and acceleration [m/s²] of each component."""

LIMITS = rho.Limits(
    velocity=rho.Box([-SPEED] * 3, [SPEED] * 3),
    acceleration=rho.Box([-ACCELERATION] * 3, [ACCELERATION] * 3),
)


def flight(places: np.ndarray, times: list[float | None], step: float) -> rho.Scenario:
    """Return the flight of one vehicle from the first place to the last, past the others."""
    waypoints = [rho.Waypoint(t, place) for t, place in zip(times, places[1:-1], strict=True)]
    vehicle = rho.Vehicle("a", rho.State(places[0]), rho.State(places[-1]), waypoints=waypoints)
    return rho.Scenario("times", rho.Grid(step, 41), [vehicle], LIMITS)


@pytest.mark.parametrize("seed", range(6))
def test_after_the_last_given_time_a_line_is_flown_at_full_speed(seed: int) -> None:
    """With time to spare before it, T is t + d / v + v / (2 a), but for a step that brakes less.

    Between a knot and the next the speed is linear. Where it falls from v along a slope of a, that
    costs the triangle below the corner, at most a h² / 8 of the way.
    """
    rng = np.random.default_rng(seed)
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(6.0, 12.0, 5))])
    places = np.stack([x, np.zeros(6), np.ones(6)], axis=1)
    last, times = int(rng.integers(1, 4)), list[float | None]([None] * 4)
    given = float(x[last + 1] / SPEED * rng.uniform(1.5, 4.0))
    times[last] = given
    if rng.integers(2):
        times[0] = float(given * rng.uniform(0.4, 0.5))
    known = given + (x[-1] - x[last + 1]) / SPEED + SPEED / (2.0 * ACCELERATION)
    plan = rho.plan_minimum_time(flight(places, times, step=float(rng.uniform(2.0, 8.0))))
    corner = ACCELERATION * plan.scenario.grid.step**2 / 8.0 / SPEED
    assert known * (1.0 - 1e-6) <= plan.scenario.grid.duration <= known * (1.0 + 1e-4) + corner
    assert rho.verify(plan).ok
    assert plan.statistics.converged


@pytest.mark.parametrize("seed", range(5))
def test_no_plan_in_less_time_is_found_otherwise(seed: int) -> None:
    rng = np.random.default_rng([7, seed])
    places = rng.uniform([0.0, 0.0, 0.0], [20.0, 20.0, 5.0], (4, 3))
    times: list[float | None] = [float(rng.uniform(40.0, 80.0)), None]
    if rng.integers(2):
        times.reverse()
    plan = rho.plan_minimum_time(flight(places, times, step=4.0))
    assert rho.verify(plan).ok
    grid = dataclasses.replace(plan.scenario.grid, step=0.98 * plan.scenario.grid.step)
    shorter = flight(places, times, grid.step)
    with pytest.raises((rho.InfeasibleError, rho.ScenarioError)):
        rho.plan(shorter)
