"""Random scenes for flights with late plans, lost measurements and obstacles that are seen late."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import drake_rho as rho
from benchmarks.adversaries import unit_vectors
from benchmarks.clearance import displacement, distances
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.simulation.winds import Wind

COUNTS = (1, 1, 2, 2, 3, 4, 5, 6, 8)
"""Numbers of vehicles from which each scene's is drawn."""

_SHARING = 10
"""Scenes in a row that share grid, disturbance and feedback, since gains take long to optimise."""

_HEIGHT, _LENGTH = 2.0, 10.0
"""Height of the vehicles' middle, and length of their way [m]."""


@dataclasses.dataclass(frozen=True)
class Scene:
    """A flight to simulate."""

    scenario: rho.Scenario
    """what is known, and when"""
    horizon: dict[str, Any]
    """arguments of `rho.RecedingHorizon`"""
    wind: Wind
    """wind, estimation errors and lost measurements"""
    kind: str
    """kind of the wind"""


@dataclasses.dataclass(frozen=True, eq=False)
class Estimates:
    """Errors of the estimates, and lost measurements."""

    position_errors: FloatArray
    """[m], shape (J, N, 3)"""
    velocity_errors: FloatArray
    """[m/s], shape (J, N, 3)"""
    lost: BoolArray
    """whether each measurement is lost, shape (J, N)"""


@dataclasses.dataclass(frozen=True, eq=False)
class Chasing(Estimates):
    """Wind at full strength towards what is nearest to each vehicle: an obstacle or a vehicle."""

    scenario: rho.Scenario
    """obstacles and the strength of the wind"""

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind at one time [m/s²], shape (N, 3)."""
        around = self.scenario.disturbance or rho.Disturbance(0.0)
        far = np.full(len(positions), np.inf)
        ways = np.tile(np.eye(3)[0], (len(positions), 1))
        for body in self.scenario.bodies:
            there = positions - displacement(body, np.array([time]))[0]
            gap = distances(body.shape, there)
            nearer = gap < far
            out = body.shape.local_outward(there - body.shape.center)
            far, ways = np.where(nearer, gap, far), np.where(nearer[:, None], -out, ways)
        if self.scenario.separation is not None:
            gaps = np.linalg.norm(positions[:, None] - positions, axis=-1)
            np.fill_diagonal(gaps, np.inf)
            other, gap = np.argmin(gaps, axis=1), gaps.min(axis=1)
            ways = np.where((gap < far)[:, None], positions[other] - positions, ways)
        return np.asarray(around.acceleration * unit_vectors(ways))


@dataclasses.dataclass(frozen=True, eq=False)
class Blowing(Estimates):
    """Wind that is constant in each part of the time, different for each vehicle."""

    switching_times: FloatArray
    """times from which on it has the next value [s], shape (S,)"""
    winds: FloatArray
    """wind from each of them on [m/s²], shape (S, N, 3)"""

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind at one time, shape (N, 3)."""
        return np.asarray(self.over(np.array([time]), len(positions))[0])

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at times on the scenario's clock [m/s²], shape (M, N, 3)."""
        k = np.searchsorted(self.switching_times, times + 1e-9, side="right") - 1
        return np.where(k[:, None, None] >= 0, self.winds[k], 0.0)


WINDS = ("constant", "gusts", "noise", "switching", "worst case", "chasing")
"""Kinds of wind."""


def scene(number: int) -> Scene:
    """Return the scene of a number."""
    shared = np.random.default_rng((30, number // _SHARING))
    rng = np.random.default_rng((31, number))
    step = float(shared.choice([0.2, 0.25]))
    grid = rho.Grid(step, int(shared.integers(25, 42)), float(shared.choice([0.0, 17.3])))
    around = rho.Disturbance(
        acceleration=float(shared.uniform(0.05, 0.4)),
        position_error=float(shared.uniform(0.0, 0.02) * shared.integers(2)),
        velocity_error=float(shared.uniform(0.0, 0.03) * shared.integers(2)),
        feedback_every=step / int(shared.choice([2, 4, 5])),
        delay=int(shared.integers(0, 3)),
        dropouts=int(shared.integers(0, 4)),
        share=0.4,
    )
    boxed = bool(shared.integers(2))
    limits = rho.Limits(
        position=rho.Box([-2.0, -4.5, 0.0], [_LENGTH + 2.0, 4.5, 2.0 * _HEIGHT]),
        acceleration=rho.Box([-3.0] * 3, [3.0] * 3) if boxed else None,
        max_acceleration=None if boxed else 3.0,
        max_speed=3.5,
    )
    if shared.integers(3) == 0:
        limits = dataclasses.replace(limits, position=None)
    vehicles = _vehicles(grid, int(rng.choice(COUNTS)), rng)
    apart = rho.Separation(0.5, downwash=float(rng.choice([1.0, 1.5])))
    bodies = [_known(grid, rng) for _ in range(rng.integers(0, 4))]
    for _ in range(rng.integers(0, 4)):
        bodies += _late(grid, vehicles[rng.integers(len(vehicles))], rng)
    whole = rho.Scenario(
        f"late {number}",
        grid,
        vehicles,
        limits,
        separation=apart if len(vehicles) > 1 else None,
        disturbance=around,
    )
    scenario = _among(whole, bodies)
    every = int(rng.integers(2, 7))
    part = float(rng.choice([0.0, 0.8, rng.uniform(0.0, 0.8)]))
    slow = rng.integers(25) == 0
    horizon = {
        "replan_every": every,
        "latency": part * every * step,
        "contingencies": True,
        "bounded_cost": bool(rng.integers(5) == 0),
        "fallback": rho.plan if slow else None,
        "options": rho.Options(time_limit=0.2) if slow else None,
    }
    kind = WINDS[int(rng.integers(len(WINDS)))]
    return Scene(scenario, horizon, _wind(scenario, kind, rng), kind)


def _among(scenario: rho.Scenario, bodies: list[rho.Obstacle]) -> rho.Scenario:
    """Return a scenario with those obstacles that leave starts and goals free."""
    for each in bodies:
        try:
            scenario = dataclasses.replace(scenario, obstacles=(*scenario.obstacles, each))
        except rho.ScenarioError:
            continue
    return scenario


def _vehicles(grid: rho.Grid, count: int, rng: np.random.Generator) -> list[rho.Vehicle]:
    """Return vehicles side by side that cross to places on the other side, in another order."""
    sides = (np.arange(count) - (count - 1) / 2.0) * rng.uniform(0.85, 1.0)
    goals = rng.permutation(sides) if rng.integers(2) else sides
    size = float(rng.uniform(0.05, 0.2))
    heights = _HEIGHT + rng.uniform(-0.5, 0.5, (2, count))
    return [
        rho.Vehicle(
            f"v{i}",
            rho.State([0.0, sides[i], heights[0, i]]),
            rho.State([_LENGTH, goals[i], heights[1, i]]),
            radius=size,
        )
        for i in range(count)
    ]


def _shape(place: FloatArray, rng: np.random.Generator) -> rho.Sphere | rho.Box | rho.Cylinder:
    kind, size = rng.integers(3), float(rng.uniform(0.2, 0.7))
    if kind == 0:
        return rho.Sphere(place, size)
    if kind == 1:
        half = rng.uniform(0.1, 0.8, 3)
        return rho.Box(place - half, place + half)
    return rho.Cylinder(place, size, axis="z")


def _known(grid: rho.Grid, rng: np.random.Generator) -> rho.Obstacle:
    """Return an obstacle known from the start, between starts and goals."""
    place = np.array([*rng.uniform([2.0, -4.0], [8.0, 4.0]), rng.uniform(0.5, 3.5)])
    velocity = rng.normal(0.0, 0.3, 3) * rng.integers(2)
    errors = rng.uniform(0.0, [0.15, 0.04]) * rng.integers(2, size=2)
    return _obstacle(_shape(place, rng), place, grid.start, velocity, errors, 0.0, grid.start)


def _late(grid: rho.Grid, vehicle: rho.Vehicle, rng: np.random.Generator) -> list[rho.Obstacle]:
    """Return what is seen late about where a vehicle will be soon: an obstacle, or a door."""
    seen = grid.start + grid.duration * float(rng.uniform(0.05, 0.8))
    soon = (seen - grid.start + rng.uniform(0.2, 3.0)) / grid.duration
    part = 3.0 * min(soon, 1.0) ** 2 - 2.0 * min(soon, 1.0) ** 3
    start, goal = vehicle.start.position, vehicle.goal.position
    place = start + part * (goal - start) + rng.normal(0.0, [0.05, 0.4, 0.4])
    errors = rng.uniform(0.0, [0.15, 0.1]) * rng.integers(2, size=2)
    if rng.integers(5) == 0:
        gap, x, y = float(rng.uniform(0.8, 2.0)) / 2.0, float(place[0]), float(place[1])
        sides = (
            rho.Box([x, -20.0, -20.0], [x + 0.3, y - gap, 20.0]),
            rho.Box([x, y + gap, -20.0], [x + 0.3, 20.0, 20.0]),
        )
        still = np.zeros(3)
        return [_obstacle(each, each.center, seen, still, errors, seen, None) for each in sides]
    velocity = rng.normal(0.0, 0.4, 3) * rng.integers(2)
    since = None if rng.integers(2) else seen - float(rng.uniform(0.0, 1.0))
    return [_obstacle(_shape(place, rng), place, seen, velocity, errors, seen, since)]


def _obstacle(
    shape: rho.Sphere | rho.Box | rho.Cylinder,
    place: FloatArray,
    time: float,
    velocity: FloatArray,
    errors: FloatArray,
    known_from: float,
    seen_at: float | None,
) -> rho.Obstacle:
    """Return an obstacle that has its given place at a time."""
    back = time * velocity
    if isinstance(shape, rho.Box):
        shape = rho.Box(shape.lower - back, shape.upper - back)
    elif isinstance(shape, rho.Sphere):
        shape = rho.Sphere(place - back, shape.radius)
    else:
        shape = rho.Cylinder(place - back, shape.radius, axis=shape.axis)
    return rho.Obstacle(
        shape,
        velocity=velocity if velocity.any() else None,
        known_from=known_from,
        position_error=float(errors[0]),
        velocity_error=float(errors[1]),
        seen_at=seen_at,
    )


def _wind(scenario: rho.Scenario, kind: str, rng: np.random.Generator) -> Wind:
    """Return wind of a kind at full strength, with errors of the estimates and dropouts."""
    grid, count = scenario.grid, len(scenario.vehicles)
    around = scenario.disturbance or rho.Disturbance(0.0)
    samples, sample = around.samples(grid), around.sample(grid)
    ways = unit_vectors(rng.normal(size=(count, 3)))
    ways[:, 2] *= rng.integers(2)  # half of them level
    ways = unit_vectors(ways)
    signs = np.where((np.arange(samples) // rng.integers(1, samples)) % 2, -1.0, 1.0)
    estimates = _estimates(around, samples, ways, signs, rng)
    if kind == "chasing":
        return Chasing(*estimates, scenario)
    if kind == "worst case":
        body = scenario.bodies[rng.integers(len(scenario.bodies))] if scenario.bodies else None
        time = grid.start + grid.duration * float(rng.uniform(0.1, 0.9))
        way = ways[0]
        if body is not None:
            there = body.shape.center + displacement(body, np.array([time]))[0]
            way = unit_vectors((there - scenario.vehicles[0].start.position)[None])[0]
        case = rho.worst_case(scenario, way, time)
        return Blowing(
            np.repeat(case.position_errors[:, None], count, axis=1),
            np.repeat(case.velocity_errors[:, None], count, axis=1),
            np.repeat(case.lost[:, None], count, axis=1),
            case.switching_times,
            np.repeat(case.accelerations[:, None], count, axis=1),
        )
    times = grid.start + sample * np.arange(samples, dtype=np.float64)
    each = np.zeros((samples, count, 3))
    if kind == "switching":
        each = np.asarray(around.acceleration * signs[:, None, None] * ways)
    elif kind == "constant":
        each = np.broadcast_to(around.acceleration * ways, (samples, count, 3))
    elif kind == "gusts":
        begin, last = np.sort(rng.uniform(grid.start, grid.end, 2))
        blows = (times >= begin) & (times <= last)
        each = np.asarray(around.acceleration * blows[:, None, None] * ways)
    else:
        each = rng.normal(size=(samples, count, 3))
        for j in range(1, samples):
            each[j] = 0.8 * each[j - 1] + 0.6 * each[j]
        lengths = np.linalg.norm(each, axis=2, keepdims=True)
        each = np.asarray(around.acceleration * each / np.maximum(lengths, 1.0))
    return Blowing(*estimates, times, each)


def _estimates(
    around: rho.Disturbance,
    samples: int,
    ways: FloatArray,
    signs: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return errors of positions and velocities (J, N, 3), and lost measurements (J, N)."""
    count = len(ways)
    if rng.integers(2):  # with the wind or against it, at full size
        errors = [rng.choice([-1.0, 1.0]) * signs[:, None, None] * ways for _ in range(2)]
    else:
        drawn = rng.normal(size=(2, samples, count, 3))
        errors = list(drawn / np.linalg.norm(drawn, axis=3, keepdims=True))
    most = around.dropouts
    if rng.integers(2):  # as many as may be lost, then one arrives
        lost = (np.arange(samples)[:, None] + rng.integers(0, most + 1, count)) % (most + 1) < most
    else:
        losing, lost = rng.uniform(size=(samples, count)) < 0.7, np.zeros((samples, count), bool)
        for j in range(samples):
            run = lost[max(j - most, 0) : j].sum(axis=0) if j >= most else np.full(count, -1)
            lost[j] = losing[j] & (run < most)
    return around.position_error * errors[0], around.velocity_error * errors[1], lost
