"""Random scenarios with a disturbance, and winds of every kind for them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

import drake_rho as rho
from tests.scenarios import box, fleet

Array = NDArray[np.float64]


def tracked(
    since: float, gains: tuple[float, float], position: float = 0.0, velocity: float = 0.0
) -> Any:
    """Return the feedback that has tracked a plan since a time, as a file describes it."""
    return {"since": since, "gains": gains, "position": position, "velocity": velocity}


def disturbed(seed: int, *, delay: int | None = None, errors: bool = True) -> rho.Scenario:
    """Return up to three vehicles in separate lanes, with spheres beside their paths.

    Args:
        seed: seed of the scenario.
        delay: delay of the feedback in samples; 0 to 2, at random, if not given.
        errors: whether estimates have errors.
    """
    rng = np.random.default_rng(seed)
    count, knots = int(rng.integers(1, 4)), int(rng.integers(9, 20))
    starts = np.array([[rng.uniform(-1, 1), 8.0 * i, rng.uniform(-1, 1)] for i in range(count)])
    goals = starts + rng.uniform([8, -1, -1], [12, 1, 1], (count, 3))
    spheres = [
        rho.Sphere(0.5 * (start + goal) + [0.0, rng.uniform(1.0, 3.0), 0.5], 0.8)
        for start, goal in zip(starts, goals, strict=True)
    ]
    step = 0.5
    scenario = fleet(
        starts,
        goals,
        separation=rho.Separation(0.5),
        grid=rho.Grid(step, knots, float(rng.choice([0.0, -3.7, 2.0 / 3.0]))),
        limits=rho.Limits(acceleration=box(8.0), velocity=box(20.0)),
        obstacles=spheres,
    )
    around = rho.Disturbance(
        acceleration=rng.uniform(0.1, 0.5),
        position_error=errors * rng.uniform(0.0, 0.02),
        velocity_error=errors * rng.uniform(0.0, 0.05),
        feedback_every=step / int(rng.integers(2, 8)),
        delay=int(rng.integers(0, 3)) if delay is None else delay,
        share=0.4,
    )
    return dataclasses.replace(scenario, disturbance=around)


def leaning(scenario: rho.Scenario) -> Any:
    """Return a wind within W that depends on the states: it pushes vehicles along and sideways."""
    assert scenario.disturbance is not None
    W = scenario.disturbance.acceleration

    def blow(time: float, positions: Array, velocities: Array) -> Array:
        push = np.tanh(velocities) + np.sin(positions + time)
        return np.asarray(W * push / (1.0 + np.linalg.norm(push, axis=1, keepdims=True)))

    return blow


def winds_for(scenario: rho.Scenario, seed: int) -> dict[str, Any]:
    """Return one wind of each kind."""
    rng = np.random.default_rng(seed)
    grid = scenario.grid
    middle = grid.start + rng.uniform(0.2, 0.9) * grid.duration
    return {
        "none": None,
        "constant": rho.winds.constant(scenario, rng.normal(size=3)),
        "gust": rho.winds.gust(scenario, rng.normal(size=3), begin=middle - 1.0, duration=1.3),
        "noise": rho.winds.coloured_noise(scenario, rng, intensity=1.0, correlation=0.3),
        "worst": rho.worst_case(scenario, rng.normal(size=3), middle),
        "leaning": leaning(scenario),
    }


KINDS = ("none", "constant", "gust", "noise", "worst", "leaning")


def crowded(seed: int) -> rho.Scenario:
    """Return vehicles that swap sides of a circle in a tight box, among spheres and boxes.

    Many of its windows have no plan of their own and keep the previous one.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    angles = 2.0 * np.pi * np.arange(count) / count + 0.1 * rng.normal(size=count)
    heights = rng.uniform(-0.3, 0.3, count)
    ends = np.stack([4.0 * np.cos(angles), 4.0 * np.sin(angles), 4.0 * heights], axis=1)
    obstacles: list[Any] = []
    for _ in range(rng.integers(0, 5)):
        centre, r = rng.uniform([-3.0, -3.0, -1.2], [3.0, 3.0, 1.2]), rng.uniform(0.3, 0.8)
        if np.linalg.norm(np.concatenate([ends, -ends]) - centre, axis=1).min() > r + 0.6:
            cube = rho.Box(centre - 0.7 * r, centre + 0.7 * r)
            obstacles.append(rho.Sphere(centre, r) if rng.random() < 0.6 else cube)
    step = float(rng.choice([0.25, 0.5]))
    scenario = fleet(
        ends,
        -ends,
        separation=rho.Separation(rng.uniform(0.3, 0.7), rng.choice([1.0, 2.0])),
        grid=rho.Grid(step, int(rng.uniform(6.0, 12.0) / step) + 1),
        limits=rho.Limits(rho.Box([-5, -5, -2], [5, 5, 2]), box(rng.uniform(1.2, 3.0)), box(3.0)),
        obstacles=obstacles,
    )
    W, E_p, E_v = rng.uniform([0.1, 0.0, 0.0], [0.4, 0.015, 0.03])
    parts, delay = int(rng.integers(2, 8)), int(rng.integers(0, 3))
    around = rho.Disturbance(W, E_p, E_v, step / parts, delay, share=0.4)
    return dataclasses.replace(scenario, disturbance=around)


def least_margin(simulation: rho.Simulation) -> float:
    """Return the least margin of all constraints at the times of a flight, computed by hand.

    The constraints are obstacles, separation and boxes; margins are in metres, m/s or m/s².
    """
    scenario = simulation.scenario
    p, v, a = simulation.positions, simulation.velocities, simulation.commands
    left = [np.inf]
    for obstacle in scenario.obstacles:
        if isinstance(obstacle, rho.Sphere):
            left.append(np.linalg.norm(p - obstacle.center, axis=2).min() - obstacle.radius)
        else:
            assert isinstance(obstacle, rho.Box)
            left.append(np.maximum(obstacle.lower - p, p - obstacle.upper).max(axis=2).min())
    apart = scenario.separation
    assert apart is not None
    for i in range(p.shape[1]):
        for j in range(i):
            way = (p[:, i] - p[:, j]) / [1.0, 1.0, apart.downwash]
            left.append(np.linalg.norm(way, axis=1).min() - apart.distance)
    limits = scenario.limits
    for values, bounds in ((p, limits.position), (v, limits.velocity), (a, limits.acceleration)):
        if bounds is not None:
            left.append(min((bounds.upper - values).min(), (values - bounds.lower).min()))
    return float(min(left))


def windy_room(seed: int) -> tuple[rho.Scenario, rho.winds.Wind]:
    """Return one or two vehicles in a room of some metres, with wind and no errors declared."""
    rng = np.random.default_rng(seed)
    step = float(rng.choice([0.02, 0.025, 0.04, 0.05, 0.08, 0.1]))
    grid = rho.Grid.lasting(2.0, step=step)
    most = float(rng.uniform(2.0, 5.0))
    vehicles = []
    for i in range(int(rng.integers(1, 3))):
        start = np.array([0.0, 1.5 * i, 1.0])
        goal = start + np.array([most * rng.uniform(0.1, 0.4), rng.uniform(-0.2, 0.2), 0.2])
        vehicles.append(rho.Vehicle(f"v{i}", rho.State(start), rho.State(goal)))
    scenario = rho.Scenario(
        "windy",
        grid,
        vehicles,
        rho.Limits(max_acceleration=most),
        separation=rho.Separation(0.5) if len(vehicles) > 1 else None,
        disturbance=rho.Disturbance(most * rng.uniform(0.05, 0.15)),
    )
    direction = rng.normal(size=3)
    if rng.random() < 0.5:
        return scenario, rho.winds.constant(scenario, direction)
    return scenario, rho.winds.gust(scenario, direction, begin=0.5, duration=1.0)
