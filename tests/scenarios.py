"""Scenarios for tests: a small one to change, and random ones."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import strategies as st

import drake_rho as rho


def box(half: float) -> rho.Box:
    """A cube around the origin."""
    return rho.Box([-half] * 3, [half] * 3)


def single(
    *,
    limits: rho.Limits | None = None,
    obstacles: tuple[rho.Sphere, ...] = (),
    grid: rho.Grid | None = None,
    start: rho.State | None = None,
    goal: rho.State | None = None,
) -> rho.Scenario:
    """One vehicle, 10 m from rest to rest in 8 s, unless told otherwise."""
    vehicle = rho.Vehicle(
        "solo", start or rho.State([0.0, 0.0, 0.0]), goal or rho.State([10.0, 4.0, -2.0])
    )
    return rho.Scenario(
        name="single",
        grid=grid or rho.Grid(0.5, 17),
        vehicles=(vehicle,),
        limits=limits or rho.Limits(),
        obstacles=obstacles,
    )


def mapped(
    scenario: rho.Scenario,
    turn: np.ndarray,
    shift: np.ndarray,
    length: float = 1.0,
    time: float = 1.0,
) -> rho.Scenario:
    """The scenario in other coordinates: p' = length (turn p + shift), t' = time t.

    `turn` is a signed permutation, so that boxes stay boxes.
    """
    speed, force, jerk = length / time, length / time**2, length / time**3

    def state(old: rho.State) -> rho.State:
        before = None if old.acceleration is None else force * turn @ old.acceleration
        return rho.State(
            length * (turn @ old.position + shift), speed * turn @ old.velocity, before
        )

    def bounds(old: rho.Box | None, scale: float, offset: np.ndarray) -> rho.Box | None:
        if old is None:
            return None
        corners = scale * np.stack([turn @ old.lower + offset, turn @ old.upper + offset])
        return rho.Box(corners.min(axis=0), corners.max(axis=0))

    def limits(old: rho.Limits | None) -> rho.Limits | None:
        if old is None:
            return None
        return rho.Limits(
            bounds(old.position, length, shift),
            bounds(old.velocity, speed, np.zeros(3)),
            bounds(old.acceleration, force, np.zeros(3)),
            bounds(old.jerk, jerk, np.zeros(3)),
        )

    return dataclasses.replace(
        scenario,
        grid=rho.Grid(time * scenario.grid.step, scenario.grid.knots),
        vehicles=tuple(
            rho.Vehicle(old.name, state(old.start), state(old.goal), limits(old.limits))
            for old in scenario.vehicles
        ),
        limits=limits(scenario.limits) or rho.Limits(),
        obstacles=tuple(
            rho.Sphere(length * (turn @ old.center + shift), length * old.radius)
            for old in scenario.obstacles
        ),
    )


@st.composite
def scenarios(draw: st.DrawFn, *, tight: bool = False) -> rho.Scenario:
    """Random scenarios of any scale.

    Args:
        draw: hypothesis' own.
        tight: with boxes that leave most of them without a plan, instead of few.
    """
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, duration = 10 ** rng.uniform(0, 4), 10 ** rng.uniform(0.5, 2.5)
    knots = int(rng.integers(4, 40))
    speed, force = size / duration, size / duration**2

    def maybe(half: float) -> rho.Box | None:
        return box(half) if rng.random() < 0.6 else None

    room = 0.2 if tight else 1.0
    limits = rho.Limits(
        position=maybe(size * rng.uniform(1, 1.5)),
        velocity=maybe(speed * rng.uniform(1.5, 6)),
        acceleration=maybe(room * force * rng.uniform(6, 40)),
        jerk=maybe(room * force / duration * rng.uniform(60, 400)),
    )
    obstacles = tuple(
        rho.Sphere(rng.uniform(-size, size, 3), size * rng.uniform(0.05, 0.4))
        for _ in range(rng.integers(0, 4))
    )

    def state(*, first: bool) -> rho.State:
        moving = rng.uniform(-speed, speed, 3) * rng.integers(0, 2)
        before = rng.uniform(-force, force, 3) if first and rng.random() < 0.5 else None
        while True:
            position = rng.uniform(-size, size, 3)
            if all(np.linalg.norm(position - s.center) > s.radius for s in obstacles):
                return rho.State(position, moving, before)

    vehicles = tuple(
        rho.Vehicle(f"v{number}", state(first=True), state(first=False))
        for number in range(rng.integers(1, 4))
    )
    return rho.Scenario(
        "random", rho.Grid(duration / (knots - 1), knots), vehicles, limits, obstacles
    )
