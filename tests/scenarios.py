"""Scenarios for tests: small ones to be modified, and random ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.shapes import Shape


def slow(*cases: Any) -> list[Any]:
    """Return parameter cases that `make test` leaves to `make test-all`."""
    return [pytest.param(case, marks=pytest.mark.slow) for case in cases]


def examples(few: int, many: int) -> settings:
    """Return how many examples `make test` draws, and the random ones of `make test-all`."""
    return settings(max_examples=few if settings.get_current_profile_name() == "same" else many)


def box(half: float) -> rho.Box:
    """Return a cube around the origin."""
    return rho.Box([-half] * 3, [half] * 3)


def single(
    *,
    limits: rho.Limits | None = None,
    obstacles: Sequence[Shape | rho.Obstacle] = (),
    grid: rho.Grid | None = None,
    start: rho.State | None = None,
    goal: rho.State | None = None,
    between_knots: bool = False,
    waypoints: Sequence[rho.Waypoint] = (),
) -> rho.Scenario:
    """Return one vehicle that flies 10 m from rest to rest in 8 s by default."""
    vehicle = rho.Vehicle(
        "solo",
        start or rho.State([0.0, 0.0, 0.0]),
        goal or rho.State([10.0, 4.0, -2.0]),
        waypoints=waypoints,
    )
    return rho.Scenario(
        name="single",
        grid=grid or rho.Grid(0.5, 17),
        vehicles=(vehicle,),
        limits=limits or rho.Limits(),
        obstacles=obstacles,
        between_knots=between_knots,
    )


def acceleration_outside(state: rho.State) -> np.ndarray:
    """Return the acceleration before a start or after a goal, zero at rest; NaN if not known."""
    if state.acceleration is not None:
        return state.acceleration
    return np.full(3, np.nan) if np.any(state.velocity) else np.zeros(3)


def mapped(
    scenario: rho.Scenario,
    turn: np.ndarray,
    shift: np.ndarray,
    length: float = 1.0,
    time: float = 1.0,
) -> rho.Scenario:
    """Return the scenario in other coordinates: p' = length (turn p + shift), t' = time t.

    `turn` is a signed permutation, so that boxes stay boxes, or any orthogonal matrix if there are
    no boxes; with a downwash or gravity it has to preserve z. Gravity requires `length` and `time`
    to be one. Obstacles are spheres at rest.
    """
    assert len(scenario.spheres) == len(scenario.obstacles)
    apart = scenario.separation
    if apart is not None:
        assert apart.downwash == 1.0 or abs(turn[2, 2]) == 1.0
        apart = rho.Separation(length * apart.distance, apart.downwash)
    speed, force, jerk = length / time, length / time**2, length / time**3

    def state(old: rho.State) -> rho.State:
        before = None if old.acceleration is None else force * turn @ old.acceleration
        return rho.State(
            length * (turn @ old.position + shift), speed * turn @ old.velocity, before
        )

    def bounds(old: rho.Box | None, scale: float, offset: np.ndarray) -> rho.Box | None:
        if old is None:
            return None
        assert np.count_nonzero(turn) == 3, "a rotated box is not a box"
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
            None if old.max_speed is None else speed * old.max_speed,
            None if old.max_acceleration is None else force * old.max_acceleration,
            old.max_thrust,
            old.max_tilt,
            None if old.max_jerk is None else jerk * old.max_jerk,
        )

    return dataclasses.replace(
        scenario,
        grid=rho.Grid(time * scenario.grid.step, scenario.grid.knots, time * scenario.grid.start),
        vehicles=tuple(
            rho.Vehicle(
                old.name,
                state(old.start),
                state(old.goal),
                limits(old.limits),
                length * old.radius,
                [
                    rho.Waypoint(
                        None if each.time is None else time * each.time,
                        length * (turn @ each.position + shift),
                        length * each.within,
                    )
                    for each in old.waypoints
                ],
            )
            for old in scenario.vehicles
        ),
        limits=limits(scenario.limits) or rho.Limits(),
        obstacles=tuple(
            rho.Sphere(length * (turn @ old.center + shift), length * old.radius)
            for old in scenario.spheres
        ),
        separation=apart,
    )


def scenarios(
    *, tight: bool = False, between_knots: bool = False
) -> st.SearchStrategy[rho.Scenario]:
    """Generate random scenarios of any scale; see `random_scenario`."""
    return st.integers(0, 2**32 - 1).map(
        lambda seed: random_scenario(seed, tight=tight, between_knots=between_knots)
    )


def random_scenario(seed: int, *, tight: bool = False, between_knots: bool = False) -> rho.Scenario:
    """Return a scenario of any scale, with obstacles that mostly lie on the straight path.

    Args:
        seed: seed of the scenario.
        tight: whether boxes are so small that most scenarios, instead of few, have no plan.
        between_knots: whether obstacles and position boxes have to hold at every instant.
    """
    rng = np.random.default_rng(seed)
    size, duration = 10 ** rng.uniform(0, 4), 10 ** rng.uniform(0.5, 2.5)
    knots = int(rng.integers(4, 40))
    speed, force = size / duration, size / duration**2
    room = 0.2 if tight else 1.0

    def maybe(least: float, most: float) -> rho.Box | None:
        """Return a box around the origin, each side at a random distance, or None."""
        if rng.random() < 0.4:
            return None
        return rho.Box(-rng.uniform(least, most, 3), rng.uniform(least, most, 3))

    limits = rho.Limits(
        position=maybe(size, 1.5 * size),
        velocity=maybe(1.2 * speed, 5 * speed),
        acceleration=maybe(5 * room * force, 30 * room * force),
        jerk=maybe(60 * room * force / duration, 400 * room * force / duration),
    )
    ends = [rng.uniform(-size, size, (2, 3)) for _ in range(rng.integers(1, 6))]
    obstacles: list[rho.Sphere] = []
    for _ in range(rng.integers(0, 5)):  # most of them on the path, none around an end
        first, last = ends[rng.integers(len(ends))]
        center = first + rng.uniform(0.2, 0.8) * (last - first) + 0.1 * size * rng.normal(size=3)
        free = min(float(np.linalg.norm(end - center)) for pair in ends for end in pair)
        obstacles.append(rho.Sphere(center, rng.uniform(0.1, 0.9) * min(free, 0.6 * size)))

    def state(position: np.ndarray, *, first: bool) -> rho.State:
        velocity = rng.uniform(-speed, speed, 3) * rng.integers(0, 2)
        before = rng.uniform(-force, force, 3) if first and rng.random() < 0.5 else None
        return rho.State(position, velocity, before)

    vehicles = [
        rho.Vehicle(f"v{number}", state(first, first=True), state(last, first=False))
        for number, (first, last) in enumerate(ends)
    ]
    return rho.Scenario(
        "random",
        rho.Grid(duration / (knots - 1), knots),
        vehicles,
        limits,
        obstacles,
        between_knots=between_knots,
    )


def fleet(
    starts: npt.ArrayLike,
    goals: npt.ArrayLike,
    *,
    separation: rho.Separation | None = None,
    grid: rho.Grid | None = None,
    limits: rho.Limits | None = None,
    obstacles: Sequence[Shape | rho.Obstacle] = (),
    between_knots: bool = True,
) -> rho.Scenario:
    """Return vehicles `v0`, `v1`, ... from rest to rest in 10 s, 1 m apart by default."""
    ends = zip(np.asarray(starts, float), np.asarray(goals, float), strict=True)
    return rho.Scenario(
        "fleet",
        grid or rho.Grid(0.5, 21),
        [
            rho.Vehicle(f"v{number}", rho.State(start), rho.State(goal))
            for number, (start, goal) in enumerate(ends)
        ],
        limits or rho.Limits(),
        obstacles,
        separation or rho.Separation(1.0),
        between_knots=between_knots,
    )


def straight(count: int, names: Sequence[str] | None = None) -> rho.Plan:
    """Return a plan for vehicles `v0`, `v1`, ... that ignores each other and every limit."""
    rng = np.random.default_rng(count)
    starts, goals = rng.uniform(0.0, 10.0, (2, count, 3))
    scenario = fleet(starts, goals, separation=rho.Separation(1e-6))
    scenario = dataclasses.replace(scenario, separation=None)
    if names is not None:
        named = zip(names, scenario.vehicles, strict=True)
        vehicles = tuple(dataclasses.replace(vehicle, name=name) for name, vehicle in named)
        scenario = dataclasses.replace(scenario, vehicles=vehicles)
    return rho.plan_convex(scenario)


def independent(scenario: rho.Scenario) -> rho.Plan:
    """Return the plan of vehicles that ignore each other."""
    alone = rho.plan_convex(scenario.without_separation())
    return rho.Plan.from_accelerations(scenario, alone.accelerations)


def through_the_middle(count: int, **options: Any) -> rho.Scenario:
    """Return vehicles on a circle of radius 5 m that swap sides: all meet in the centre."""
    angles = 2.0 * np.pi * np.arange(count) / count
    circle = 5.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    return fleet(circle, -circle, **options)


def random_fleet(seed: int, *, most: int = 6, between_knots: bool = True) -> rho.Scenario:
    """Return a fleet of any scale in a cube, starts and goals apart, some hovering or in a box.

    Args:
        seed: seed of the fleet.
        most: largest number of vehicles.
        between_knots: whether separation has to hold at every instant.
    """
    rng = np.random.default_rng(seed)
    size, duration = 10 ** rng.uniform(-1, 4), 10 ** rng.uniform(0, 4)
    count, knots = int(rng.integers(2, most + 1)), int(rng.integers(6, 30))
    downwash = float(rng.choice([0.5, 1.0, 2.0]))
    separation = rho.Separation(size * rng.uniform(0.1, 0.5), downwash)

    def places() -> np.ndarray:
        found: list[np.ndarray] = []
        while len(found) < count:
            place = rng.uniform(-size, size, 3)
            gaps = [np.linalg.norm(separation.scaled(place - other)) for other in found]
            if min(gaps, default=np.inf) >= separation.distance:
                found.append(place)
        return np.array(found)

    starts, goals = places(), places()
    kind = rng.integers(4)
    if kind == 0:  # all through one point
        goals = -starts
    elif kind == 1:  # they swap places, and some hover
        goals = starts[rng.permutation(count)]
    force = size / duration**2
    limits = rho.Limits(
        position=box(1.05 * size) if rng.random() < 0.5 else None,
        acceleration=box(40 * force) if rng.random() < 0.5 else None,
    )
    grid = rho.Grid(duration / (knots - 1), knots)
    return fleet(
        starts,
        goals,
        separation=separation,
        grid=grid,
        limits=limits,
        between_knots=between_knots,
    )


def sampled_separation(plan: rho.Plan, per_step: int = 400) -> float:
    """Return the least distance of any pair over its separation, integrated and sampled by hand.

    By (1) and (2) alone; no code of the library is used.
    """
    scenario = plan.scenario
    assert scenario.separation is not None
    h = scenario.grid.step
    p = np.array([vehicle.start.position for vehicle in scenario.vehicles])
    v = np.array([vehicle.start.velocity for vehicle in scenario.vehicles])
    s = np.linspace(0.0, h, per_step + 1 if scenario.between_knots else 2)[:, None, None]
    ellipsoid = scenario.separation.distance * np.array([1, 1, scenario.separation.downwash])
    least = np.inf
    for a in np.moveaxis(plan.accelerations, 1, 0):
        path = (p + s * v + s**2 / 2 * a) / ellipsoid
        for one in range(len(p)):
            for other in range(one):
                gap = np.linalg.norm(path[:, one] - path[:, other], axis=1)
                least = min(least, float(gap.min()))
        p, v = p + h * v + h**2 / 2 * a, v + h * a
    return least
