"""Random scenarios that are disturbed, and winds of every kind for them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

import drake_rho as rho
from tests.scenarios import box, fleet

Array = NDArray[np.float64]


def disturbed(seed: int, *, delay: int | None = None, errors: bool = True) -> rho.Scenario:
    """Up to three vehicles in lanes of their own, with spheres beside their ways.

    Args:
        seed: which one.
        delay: of the feedback; 0 to 2 samples if not given.
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
    asked = fleet(
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
    return dataclasses.replace(asked, disturbance=around)


def leaning(scenario: rho.Scenario) -> Any:
    """A wind that depends on the states: it pushes vehicles along and to the side, within W."""
    assert scenario.disturbance is not None
    W = scenario.disturbance.acceleration

    def blow(time: float, positions: Array, velocities: Array) -> Array:
        push = np.tanh(velocities) + np.sin(positions + time)
        return np.asarray(W * push / (1.0 + np.linalg.norm(push, axis=1, keepdims=True)))

    return blow


def winds_for(scenario: rho.Scenario, seed: int) -> dict[str, Any]:
    """One wind of each kind."""
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
