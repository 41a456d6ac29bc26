"""Least times of flights in which some waypoints have times and others have none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import slow

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


@pytest.mark.parametrize("seed", [1, *slow(0, *range(2, 8))])
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


def test_a_flight_ends_right_after_a_given_time_where_nothing_else_needs_longer() -> None:
    """The last waypoint is so close to the goal that 1 mm/s reaches it at once."""
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0 + 1e-7, 0.0, 0.0]])
    plan = rho.plan_minimum_time(flight(places, [40.0], step=2.0))
    assert 40.0 < plan.scenario.grid.duration <= 40.0 * (1.0 + 1e-5)
    assert rho.verify(plan).ok


def test_there_is_no_least_time_without_limits_though_a_time_is_given() -> None:
    places = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    scenario = dataclasses.replace(flight(places, [4.0], step=0.2), limits=rho.Limits())
    with pytest.raises(rho.ScenarioError, match="there is no least time"):
        rho.plan_minimum_time(scenario)


@pytest.mark.parametrize("seed", [1, *slow(0, 2, 3, 4)])
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


@pytest.mark.parametrize("seed", [2, *slow(0, 1, *range(3, 10))])
def test_where_a_motion_is_known_there_is_a_plan_and_none_takes_longer(seed: int) -> None:
    """The motion passes every waypoint when the least time without given times does, 1 % later."""
    rng = np.random.default_rng([11, seed])
    places = rng.uniform([0.0, 0.0, 0.0], [15.0, 15.0, 4.0], (int(rng.integers(4, 7)), 3))
    free = flight(places, [None] * (len(places) - 2), step=1.0)
    known = rho.plan_minimum_time(free).scenario
    found = [each.time or 0.0 for each in known.vehicles[0].waypoints]
    times = [1.01 * each if rng.integers(2) else None for each in found]
    mixed = flight(places, times, step=1.01 * known.grid.step)
    assert rho.verify(rho.plan(mixed)).ok
    plan = rho.plan_minimum_time(mixed)
    assert rho.verify(plan).ok
    assert plan.scenario.grid.duration <= mixed.grid.duration


@pytest.mark.parametrize("seed", [2, *slow(13, 20, 26)])
def test_waypoints_on_the_way_cost_nothing_if_their_times_are_free(seed: int) -> None:
    """A line is flown forwards, so it passes every place between start and goal at some time."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(2.0, 10.0, count + 1))])
    places = np.stack([x, np.zeros_like(x), np.ones_like(x)], axis=1)
    duration = float(rng.uniform(1.3, 3.0) * x[-1])
    known = int(rng.integers(count))
    part = np.clip(x[known + 1] / x[-1] + rng.uniform(-0.15, 0.2), 0.2, 0.8)
    times: list[float | None] = [None] * count
    times[known] = float(duration * part)
    speed, acceleration = 1.9 * x[-1] / duration, 20.0 * x[-1] / duration**2
    limits = rho.Limits(max_speed=speed, max_acceleration=acceleration)
    both = dataclasses.replace(flight(places, times, duration / 40), limits=limits)
    ends = places[[0, known + 1, -1]]
    alone = dataclasses.replace(
        flight(ends, times[known : known + 1], duration / 40), limits=limits
    )
    assert rho.plan(both).cost == pytest.approx(rho.plan(alone).cost, rel=1e-5)
