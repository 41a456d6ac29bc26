"""Random scenes with every term of an objective, for the benchmarks of costs."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho

TERMS = ("effort", "jerk", "snap", "position", "velocity", "terminal_position", "terminal_velocity")


def convex(seed: int) -> rho.Scenario:
    """Return one to six vehicles with limits and requirements, and random weights of terms.

    The first seven seeds of ten have one term beside a little effort each, the others several.
    """
    rng = np.random.default_rng([48, seed])
    knots, T = int(rng.integers(10, 61)), float(rng.uniform(2.0, 20.0))
    size, count = float(10.0 ** rng.uniform(0.5, 2.0)), int(rng.integers(1, 7))
    grid = rho.Grid(T / (knots - 1), knots, float(rng.choice([0.0, 1000.0])))
    vehicles = [_vehicle(rng, number, size, T) for number in range(count)]
    speed, acceleration = 4.0 * size / T, 16.0 * size / T**2
    limits = rho.Limits(
        velocity=rho.Box([-speed] * 3, [speed] * 3),
        max_acceleration=acceleration if rng.random() < 0.5 else None,
        max_jerk=40.0 * size / T**3 * knots / 10.0 if rng.random() < 0.3 else None,
    )
    requirements = []
    if rng.random() < 0.5:
        requirements.append(rho.KeepIn(rho.Ball([0.0] * 3, 2.2 * size)))
    if count > 1 and rng.random() < 0.3:
        ball = rho.Ball([0.0] * 3, 4.0 * size)
        requirements.append(rho.KeepIn(ball, vehicles="v1", relative_to="v0"))
    return rho.Scenario(
        f"terms, seed {seed}",
        grid,
        vehicles,
        limits=limits,
        requirements=requirements,
        objective=_objective(rng, seed, grid, size, count),
        between_knots=False,
    )


def _vehicle(rng: np.random.Generator, number: int, size: float, T: float) -> rho.Vehicle:
    def state() -> rho.State:
        position, v = rng.uniform(-size, size, 3), rng.uniform(-1.0, 1.0, 3) * size / T
        a = rng.uniform(-1.0, 1.0, 3) * size / T**2
        return rho.State(position, *[(), (v,), (v, a)][rng.integers(3)])

    return rho.Vehicle(f"v{number}", state(), state(), weight=float(10 ** rng.uniform(-1, 1)))


def _objective(
    rng: np.random.Generator, seed: int, grid: rho.Grid, size: float, count: int
) -> rho.Objective:
    t = grid.duration / 6.0  # makes every term about as large as the effort
    scales = (1.0, t**2, t**4, t**-4, t**-2, 10 * t**-4, 10 * t**-2)
    weights = {
        term: float(s * 10 ** rng.uniform(-1, 1)) for term, s in zip(TERMS, scales, strict=True)
    }
    which = seed % 10
    used = {TERMS[which]} if which < len(TERMS) else {*rng.choice(TERMS, 4, replace=False)}
    chosen = {term: weight for term, weight in weights.items() if term in used}
    chosen.setdefault("effort", 0.01)
    times = np.linspace(grid.start, grid.end, 6)
    paths = [rho.Track(times, rng.uniform(-size, size, (6, 3))) for _ in range(count)]
    return rho.Objective(**chosen, reference=paths)


def with_goals(seed: int) -> rho.Scenario:
    """Return the vehicles and limits of `convex` with goals that are sets, free or exact."""
    scenario, rng = convex(seed), np.random.default_rng([49, seed])
    size, speed = 10.0 ** rng.uniform(0.0, 1.0), 10.0 ** rng.uniform(-2.0, 0.0)
    vehicles = []
    for each in scenario.vehicles:
        x = each.goal.position
        places = [x, None, rho.Ball(x, size), rho.Box(x - size, x + size)]
        velocities = [np.zeros(3), None, rho.Ball(np.zeros(3), speed)]
        place, velocity = places[rng.integers(4)], velocities[rng.integers(3)]
        goal = rho.Goal(place, velocity=velocity)
        vehicles.append(dataclasses.replace(each, goal=goal))
    return dataclasses.replace(
        scenario,
        name=f"goals, seed {seed}",
        vehicles=tuple(vehicles),
        limits=dataclasses.replace(scenario.limits, max_jerk=None),
        objective=rho.Objective(),
    )


def to_a_region(seed: int) -> rho.Scenario:
    """Return one vehicle past two to six balls to a region, at rest or with any velocity."""
    rng = np.random.default_rng([50, seed])
    middle, size = np.array([8.0, *rng.uniform([-2.0, 0.0], 2.0)]), float(rng.uniform(0.5, 2.0))
    sides = size * rng.uniform(0.3, 1.0, (2, 3))
    region = rho.Ball(middle, size) if seed % 2 else rho.Box(middle - sides[0], middle + sides[1])
    start = np.array([0.0, 0.0, 1.0])
    balls = list[rho.Sphere]()
    while len(balls) < 2 + seed % 5:
        ball = rho.Sphere(rng.uniform([2.0, -3.0, -1.0], [9.0, 3.0, 3.0]), rng.uniform(0.4, 1.5))
        if np.linalg.norm(ball.center - start) > ball.radius + 0.3:
            balls.append(ball)
    goal = rho.Goal(region, velocity=None) if seed % 4 < 2 else rho.Goal(region)
    return rho.Scenario(
        f"region, seed {seed}",
        rho.Grid.lasting(6.0, step=0.25),
        [rho.Vehicle("solo", rho.State(start), goal, radius=0.2)],
        limits=rho.Limits(max_speed=4.0),
        obstacles=balls,
    )


def among_obstacles(seed: int) -> rho.Scenario:
    """Return one vehicle past one to three balls with least jerk, or along a path through them."""
    rng = np.random.default_rng([84, seed])
    T, knots = float(rng.uniform(5.0, 12.0)), 41
    grid = rho.Grid(T / (knots - 1), knots)
    goal = np.array([10.0, *rng.uniform(-2.0, 2.0, 2)])
    middles = rng.uniform(0.25, 0.75, (int(rng.integers(1, 4)), 1)) * goal
    balls = [
        rho.Sphere(middle + rng.normal(0.0, 0.6, 3), float(rng.uniform(0.5, 1.2)))
        for middle in middles
    ]
    times = np.linspace(0.0, T, 4)
    path = rho.Track(times, np.linspace(np.zeros(3), goal, 4) + rng.normal(0.0, 0.5, (4, 3)))
    objective = (
        rho.Objective(effort=0.0, jerk=1.0)
        if seed % 2
        else rho.Objective(effort=0.1, position=(6.0 / T) ** 4, reference=path)
    )
    ends = rho.State([0.0, 0.0, 0.0]), rho.State(goal)
    name = f"among obstacles, seed {seed}"
    clear = [each for each in balls if _is_clear(each, ends)]
    return rho.Scenario(
        name,
        grid,
        [rho.Vehicle("solo", *ends)],
        obstacles=clear or [rho.Sphere(goal / 2.0, 1.0)],
        objective=objective,
        between_knots=False,
    )


def _is_clear(ball: rho.Sphere, ends: tuple[rho.State, rho.State]) -> bool:
    return all(np.linalg.norm(each.position - ball.center) > 1.1 * ball.radius for each in ends)
