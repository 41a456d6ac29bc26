"""Missions in which more becomes known in flight, flown with horizons that roll or shrink."""

from __future__ import annotations

import dataclasses
import gc
import math
import time

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import BoolArray, FloatArray

STEP, EVERY, HORIZON = 0.1, 2, 3.0
"""Step of the grid [s], steps flown of each window, and time that windows plan ahead [s]."""

RADIUS, SPEED, ACCELERATION, SEEN = 0.2, 3.0, 6.0, 6.0
"""Of the vehicle [m], its limits [m/s, m/s²], and the distance within which it sees [m]."""

LOWER, UPPER, CELL = np.array([-12.0, -12.0, 0.3]), np.array([12.0, 12.0, 2.7]), 0.25
"""Corners of the flyable volume [m], and the side of a map's cells [m]."""

LIMITS = rho.Limits(rho.Box(LOWER, UPPER), max_speed=SPEED, max_acceleration=ACCELERATION)

_INSTANTS = 101
"""Samples of every step, 1 ms apart."""


@dataclasses.dataclass(frozen=True)
class World:
    """Pillars of a mission, all as high as the volume."""

    pillars: FloatArray
    """places and radii [m], shape (B, 3)"""
    since: FloatArray
    """times from which they are there [s], shape (B,)"""
    as_map: bool
    """whether the vehicle sees them as cells of a map"""

    @classmethod
    def drawn(cls, rng: np.random.Generator, start: FloatArray, *, as_map: bool) -> World:
        """Return 40 pillars, clear of a start."""
        pillars = list[FloatArray]()
        while len(pillars) < 40:
            one = np.array([*rng.uniform(-11.0, 11.0, 2), rng.uniform(0.3, 0.8)])
            if np.hypot(*(one[:2] - start[:2])) > one[2] + 1.0:
                pillars.append(one)
        return cls(np.array(pillars), np.zeros(len(pillars)), as_map)

    def clearance(self, places: FloatArray, clock: float = math.inf) -> FloatArray:
        """Return distances from the nearest pillar there is, beyond the radius [m], (M,)."""
        there = self.pillars[self.since <= clock]
        away = np.linalg.norm(places[:, None, :2] - there[:, :2], axis=2)
        found: FloatArray = (away - there[:, 2]).min(axis=1) - RADIUS
        return found

    def free_place(self, rng: np.random.Generator) -> FloatArray:
        """Return a place from which all pillars are far."""
        while True:
            place = rng.uniform(LOWER + 1.0, UPPER - 1.0)
            if self.clearance(place[None])[0] > 0.5:
                return np.array([*place[:2], rng.uniform(0.8, 2.2)])

    def with_one_more(self, rng: np.random.Generator, clock: float, far_from: FloatArray) -> World:
        """Return the world with a pillar that appears, at least 3 m from places (M, 3)."""
        for _ in range(100):
            one = np.array([*rng.uniform(-11.0, 11.0, 2), rng.uniform(0.3, 0.6)])
            if np.hypot(*(far_from[:, :2] - one[:2]).T).min() > one[2] + 3.0:
                pillars, since = np.vstack([self.pillars, one]), np.append(self.since, clock)
                return dataclasses.replace(self, pillars=pillars, since=since)
        return self


class Eyes:
    """What a vehicle has seen of a world."""

    def __init__(self, world: World) -> None:
        self.world, self._seen = world, dict[int, rho.Obstacle]()
        sides = np.arange(-48, 48)
        grid = np.stack(np.meshgrid(sides, sides, indexing="ij"), axis=-1).reshape(-1, 2)
        self._cells, self._known = grid, np.zeros(len(grid), dtype=bool)
        self._occupied = self._meet_pillars() if world.as_map else self._known

    def look(self, place: FloatArray) -> bool:
        """Return whether there is anything new within sight of a place."""
        if self.world.as_map:
            near = np.hypot(*((self._cells + 0.5) * CELL - place[:2]).T) < SEEN
            new = near & ~self._known & self._occupied
            self._known |= new
            return bool(new.any())
        x, y, size = self.world.pillars.T
        near = np.hypot(x - place[0], y - place[1]) < SEEN + size
        new = set(np.flatnonzero(near).tolist()) - set(self._seen)
        for i in new:
            pillar = rho.Cylinder([x[i], y[i], 1.5], size[i], 3.0)
            self._seen[i] = rho.Obstacle(pillar, name=f"pillar {i}")
        return bool(new)

    def _meet_pillars(self) -> BoolArray:
        """Return flags of cells that a pillar meets; their circumcircle counts."""
        away = (self._cells + 0.5) * CELL
        distances = np.linalg.norm(away[:, None] - self.world.pillars[:, :2], axis=2)
        found: BoolArray = (distances < self.world.pillars[:, 2] + 0.71 * CELL).any(axis=1)
        return found

    @property
    def obstacles(self) -> list[rho.Obstacle]:
        """Obstacles seen so far."""
        if not self.world.as_map:
            return list(self._seen.values())
        columns = self._cells[self._known]
        if len(columns) == 0:
            return []
        levels = np.tile(np.arange(12), len(columns))
        cells = np.column_stack([np.repeat(columns, 12, axis=0), levels])
        return [rho.Obstacle(rho.Voxels(cells, CELL), name="map")]


@dataclasses.dataclass(frozen=True)
class Lap:
    """One mission as it was flown."""

    arrived: float
    """time from the last change of the goal to the arrival there [s]; infinite without one"""
    least: float
    """lower bound of this time, of the straight line [s]"""
    clearance: float
    """least distance from any pillar that was seen, beyond the radius, by dense samples [m]"""
    beyond: float
    """largest excess over a limit of positions, speeds or accelerations, in SI units"""
    verified: bool
    """whether the reports on all flights are clean"""
    flights: int
    """number of flights in which the mission is recorded"""
    without_plan: int
    """number of windows without a new plan"""
    seconds: tuple[float, ...]
    """processor time of each window [s]"""
    cost: float
    """cost of the mission [m²/s⁴]"""


def mission(seed: int) -> Lap:
    """Return a mission of 60 to 300 s whose goals change, flown with a horizon that rolls.

    As the guide recommends, the collector of garbage waits until the vehicle has landed.
    """
    gc.disable()
    try:
        return _mission(seed)
    finally:
        gc.enable()
        gc.collect()


def _mission(seed: int) -> Lap:
    """Return the mission."""
    rng = np.random.default_rng([49, seed])
    start, duration = np.array([-11.0, -11.0, 1.5]), rng.uniform(60.0, 300.0)
    world = World.drawn(rng, start, as_map=seed % 2 == 1)
    eyes, changes = Eyes(world), [0.0]
    while changes[-1] < duration - 60.0:
        changes.append(changes[-1] + rng.uniform(5.0, 30.0))
    goals = [world.free_place(rng) for _ in changes]
    appears = sorted(rng.uniform(5.0, duration - 40.0, 3)) if not world.as_map else []

    def now(number: int) -> rho.Scenario:
        vehicle = rho.Vehicle("scout", rho.State(start), rho.State(goals[number]), radius=RADIUS)
        grid = rho.Grid(STEP, 11)
        return rho.Scenario("mission", grid, [vehicle], LIMITS, obstacles=eyes.obstacles)

    eyes.look(start)
    horizon = rho.RecedingHorizon(now(0), horizon=HORIZON, replan_every=EVERY, fallback=None)
    seconds, failed, arrived, number, begun = list[float](), 0, math.inf, 0, start
    for knot in range(0, round(duration / STEP), EVERY):
        clock, states = knot * STEP, horizon.planned(knot)
        if appears and clock >= appears[0]:
            appears.pop(0)
            far = np.array([states[0, :3], *goals])
            eyes.world = eyes.world.with_one_more(rng, clock, far)
        changed = eyes.look(states[0, :3])
        if number + 1 < len(changes) and clock >= changes[number + 1]:
            number, changed, begun = number + 1, True, states[0, :3]
        told = now(number) if changed and knot > 0 else None
        began = time.process_time()
        window = horizon.step(states, clock, scenario=told)
        seconds.append(time.process_time() - began)
        failed += bool(window.infeasible)
        there = np.abs(states[0] - [*goals[number], 0, 0, 0]).max() < 1e-3
        if number == len(changes) - 1 and there and math.isinf(arrived):
            arrived = clock - changes[-1]
    least = least_time(float(np.linalg.norm(goals[-1] - begun)))
    return judged(horizon, eyes.world, arrived, least, tuple(seconds), failed)


def least_time(distance: float) -> float:
    """Return a lower bound of the time to rest at a distance [m], from any velocity allowed [s]."""
    braking = SPEED**2 / (2.0 * ACCELERATION)
    if distance <= braking:
        return math.sqrt(2.0 * distance / ACCELERATION)
    return (distance - braking) / SPEED + SPEED / ACCELERATION


def judged(
    horizon: rho.RecedingHorizon,
    world: World,
    arrived: float,
    least: float,
    seconds: tuple[float, ...],
    failed: int,
) -> Lap:
    """Return a mission judged by its own integration of the accelerations, 1000 times a second."""
    scenario = horizon.flights[0].scenario
    first, limits = scenario.fleet, scenario.limits.position
    if limits is None:
        raise ValueError("limits.position: got None, expected a box")
    p, v = first.start_positions[0], first.start_velocities[0]
    parts = np.linspace(0.0, STEP, _INSTANTS)[:, None]
    clearance, beyond = math.inf, 0.0
    for flight in horizon.flights:
        for clock, a in zip(flight.plan.times, flight.plan.accelerations[0], strict=False):
            x = p + parts * v + parts**2 / 2.0 * a
            clearance = min(clearance, float(world.clearance(x, clock + STEP / 2.0).min()))
            p, v = p + STEP * v + STEP**2 / 2.0 * a, v + STEP * a
            out = max(float((limits.lower - x).max()), float((x - limits.upper).max()))
            fast = float(np.linalg.norm(v)) - SPEED
            beyond = max(beyond, out, fast, float(np.linalg.norm(a)) - ACCELERATION)
    verified = all(rho.verify(each).ok for each in horizon.flights)
    cost = sum(each.cost for each in horizon.flights)
    flights = len(horizon.flights)
    return Lap(arrived, least, clearance, beyond, verified, flights, failed, seconds, cost)


def either_way(seed: int) -> tuple[Lap, Lap]:
    """Return a mission of about 50 s by windows that roll and by windows that shrink.

    The world is known: a strip of 140 m by 10 m with 60 pillars. Windows that shrink arrive at the
    earliest knot for which they find a plan.
    """
    rng = np.random.default_rng([50, seed])
    start, goal = np.array([2.0, 0.0, 1.5]), np.array([138.0, rng.uniform(-3.0, 3.0), 1.5])
    places = rng.uniform([8.0, -5.0, 0.4], [132.0, 5.0, 0.9], (60, 3))
    world = World(places, np.zeros(len(places)), as_map=False)
    pillars = [rho.Cylinder([x, y, 1.5], size, 3.0) for x, y, size in places]
    vehicle = rho.Vehicle("scout", rho.State(start), rho.State(goal), radius=RADIUS)
    strip = rho.Limits(
        rho.Box([0.0, -6.0, 0.3], [140.0, 6.0, 2.7]),
        max_speed=SPEED,
        max_acceleration=ACCELERATION,
    )
    grid = rho.Grid.lasting(60.0, step=STEP)
    scenario = rho.Scenario("either way", grid, [vehicle], strip, obstacles=pillars)
    rolling = rho.RecedingHorizon(scenario, horizon=HORIZON, replan_every=EVERY, fallback=None)
    shrinking = rho.RecedingHorizon(scenario, free_final_time=True, replan_every=10)
    return _flown(rolling, world, goal), _flown(shrinking, world, goal)


def _flown(horizon: rho.RecedingHorizon, world: World, goal: FloatArray) -> Lap:
    """Return a mission to a goal, until the vehicle rests there."""
    seconds, failed, arrived = list[float](), 0, math.inf
    for knot in horizon.knots:
        states = horizon.planned(knot)
        if np.abs(states[0] - [*goal, 0, 0, 0]).max() < 1e-3:
            arrived = knot * STEP
            break
        began = time.process_time()
        failed += bool(horizon.step(states, knot * STEP).infeasible)
        seconds.append(time.process_time() - began)
    return judged(horizon, world, arrived, 0.0, tuple(seconds), failed)
