"""Scenarios with a disturbance that are flown in wind by the thousand."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

import drake_rho as rho


def example_4() -> rho.Scenario:
    """Return the paper's Example 4 at every instant, with wind of a tenth of its acceleration."""
    paper = rho.load_scenario("paper")
    around = rho.Disturbance(
        2.0, position_error=0.5, velocity_error=0.2, feedback_every=0.25, delay=1, share=0.4
    )
    return dataclasses.replace(paper, between_knots=True, disturbance=around)


def gate() -> rho.Scenario:
    """Return two vehicles that pass a gate one after another, in a narrow room at low speed."""
    vehicles = [
        _vehicle("first", [0.0, 0.2, 1.0], [6.0, -0.2, 1.0]),
        _vehicle("second", [-1.0, -0.4, 1.2], [5.0, 0.4, 0.8]),
    ]
    return rho.Scenario(
        "gate",
        rho.Grid.lasting(6.5, step=0.25),
        vehicles,
        rho.Limits(
            position=rho.Box([-1.5, -1.0, 0.0], [6.5, 1.0, 2.0]),
            acceleration=rho.Box([-2.0] * 3, [2.0] * 3),
            max_speed=1.4,
        ),
        [
            rho.Box([2.5, -1.0, 0.0], [3.0, 0.25, 2.0]),
            rho.Box([2.5, 0.75, 0.0], [3.0, 1.0, 2.0]),
        ],
        rho.Separation(0.4),
        disturbance=rho.Disturbance(0.4, feedback_every=0.125, share=0.5),
    )


def crossing() -> rho.Scenario:
    """Return one vehicle whose path a sphere crosses, among two hovering ones."""
    ball = rho.Obstacle(rho.Sphere([3.0, -4.0, 1.0], 0.8), velocity=[0.0, 1.0, 0.0])
    return rho.Scenario(
        "crossing",
        rho.Grid.lasting(8.0, step=0.2),
        [_vehicle("vehicle", [0.0, 0.0, 1.0], [6.0, 0.0, 1.0])],
        rho.Limits(acceleration=rho.Box([-3.0] * 3, [3.0] * 3)),
        [ball, rho.Sphere([1.5, 0.8, 1.0], 0.5), rho.Sphere([4.5, -0.6, 1.2], 0.5)],
        disturbance=rho.Disturbance(
            0.5, position_error=0.01, velocity_error=0.02, feedback_every=0.1, delay=1, share=0.5
        ),
    )


def swap() -> rho.Scenario:
    """Return four vehicles that swap sides of a circle."""
    scenario = rho.circle_swap(
        4,
        radius=2.0,
        duration=8.0,
        step=0.2,
        limits=rho.Limits(max_acceleration=2.0, max_speed=1.5),
        separation=rho.Separation(0.5),
    )
    around = rho.Disturbance(0.3, position_error=0.005, velocity_error=0.01, share=0.5)
    return dataclasses.replace(scenario, disturbance=around)


def transitions() -> rho.Scenario:
    """Return four vehicles that swap places in 4 m³, as in `fleet_b1`, the box wider by a tenth."""
    volume = rho.flight_cube(4.0)
    limits = rho.Limits(
        position=rho.Box(volume.lower - 0.1, volume.upper + 0.1),
        acceleration=rho.Box([-1.0] * 3, [1.0] * 3),
    )
    scenario = rho.random_transitions(
        4, np.random.default_rng(1), duration=6.0, step=0.2, limits=limits, name="transitions"
    )
    return dataclasses.replace(
        scenario, disturbance=rho.Disturbance(0.15, feedback_every=0.1, share=0.4)
    )


WORLDS: dict[str, Callable[[], rho.Scenario]] = {
    "Example 4": example_4,
    "gate": gate,
    "crossing": crossing,
    "swap": swap,
    "transitions": transitions,
}
"""All of these scenarios, by their name in the table."""


def _vehicle(name: str, start: list[float], goal: list[float]) -> rho.Vehicle:
    """Return a vehicle from rest to rest."""
    return rho.Vehicle(name, rho.State(start), rho.State(goal))
