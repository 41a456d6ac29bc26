"""Random fleets on two sides of a wall with a gap, each built around a known motion.

Vehicles pass the gap one after the other, or above each other. Motions are drawn first: motions of
least effort through places in the gap at given times, vehicle by vehicle, each clear of those
before it. The limits are what these motions need. So every scene has a plan.
"""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from drake_rho.motion.dynamics import roll_out
from drake_rho.scenario.fields import FloatArray

KINDS = ("door", "two doors", "window")
"""Openings of the wall: from the floor to the ceiling, or with four sides."""

_TRIES = 300
"""Draws of a vehicle's ends, and of its motion, before the scene is drawn anew."""

_WIDER = 1.02
"""Distance of drawn motions where they are sampled, over the separation."""

_BETWEEN = np.array([0.0, 0.25, 0.5, 0.75])
"""Samples of a step."""


@dataclasses.dataclass(frozen=True)
class GapScene:
    """Scenario and a plan of it."""

    kind: str
    """one of `KINDS`"""
    scenario: rho.Scenario
    """scenario"""
    known: rho.Plan
    """plan that satisfies every constraint"""


def gap_scene(kind: str, count: int, rng: np.random.Generator) -> GapScene:
    """Return a random scene.

    Args:
        kind: one of `KINDS`.
        count: number of vehicles.
        rng: source of randomness; the same state gives the same scene.
    """
    while True:
        wall = _Wall.drawn(kind, rng)
        motions = _motions(wall, count, rng)
        if motions is None:
            continue
        scene = _scene(wall, motions, rng)
        if rho.verify(scene.known).ok:
            return scene


@dataclasses.dataclass(frozen=True)
class _Wall:
    """Wall across the x axis in a room, and the vehicles that pass it."""

    kind: str
    half: float
    """half its thickness [m]"""
    openings: tuple[rho.Box, ...]
    """openings through the wall"""
    room: FloatArray
    """half the sides of the room [m], shape (3,)"""
    separation: rho.Separation
    grid: rho.Grid

    @classmethod
    def drawn(cls, kind: str, rng: np.random.Generator) -> _Wall:
        """Return a random wall."""
        size = rng.uniform(1.0, 3.0)
        room = size * np.array([rng.uniform(3.0, 6.0), *rng.uniform(2.0, 3.5, 2)])
        half = size * rng.uniform(0.1, 0.5)
        wide, high = size * rng.uniform(0.2, 0.8, 2)
        low = -room[2] if kind != "window" else -high
        middles: tuple[float, ...] = (0.0,)
        if kind == "two doors":
            aside = rng.uniform(wide + 0.2 * size, room[1] - wide)
            middles = (-aside, aside)
        openings = tuple(
            rho.Box([-half, middle - wide, low], [half, middle + wide, -low]) for middle in middles
        )
        distance = size * rng.uniform(0.3, 0.7)
        separation = rho.Separation(distance, downwash=float(rng.choice([1.0, 1.5, 2.0, 3.0])))
        knots = int(rng.integers(15, 41))
        grid = rho.Grid(step=rng.uniform(4.0, 10.0) / (knots - 1), knots=knots)
        return cls(kind, half, openings, room, separation, grid)

    @property
    def boxes(self) -> list[rho.Box]:
        """Return the wall without its openings; it is longer than the room."""
        x, far = self.half, 3.0 * float(self.room.max())
        edges = sorted(
            {-far, far, *(y for box in self.openings for y in (box.lower[1], box.upper[1]))}
        )
        closed = zip(edges[::2], edges[1::2], strict=True)
        boxes = [rho.Box([-x, y0, -far], [x, y1, far]) for y0, y1 in closed]
        if self.kind == "window":
            (window,) = self.openings
            y0, y1, z0, z1 = window.lower[1], window.upper[1], window.lower[2], window.upper[2]
            boxes += [rho.Box([-x, y0, -far], [x, y1, z0]), rho.Box([-x, y0, z1], [x, y1, far])]
        return boxes


def _motions(wall: _Wall, count: int, rng: np.random.Generator) -> FloatArray | None:
    """Return starts and accelerations of vehicles clear of each other, (count, K, 3), or None."""
    found, sampled = list[FloatArray](), np.zeros((0, 0, 3))
    for _ in range(count):
        for _ in range(_TRIES):
            start, accelerations = _motion(wall, rng)
            positions = _sampled(wall.grid, start, accelerations)
            if not _is_clear(wall, positions):
                continue
            apart = (
                wall.separation.scaled(sampled - positions)
                if len(found) > 0
                else np.zeros((0, 1, 3))
            )
            if np.all(np.linalg.norm(apart, axis=-1) > _WIDER * wall.separation.distance):
                break
        else:
            return None
        found.append(np.concatenate([start[None], accelerations]))
        sampled = np.concatenate([sampled.reshape(-1, *positions.shape), positions[None]])
    return np.array(found)


def _motion(wall: _Wall, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return the start, and accelerations of least effort through an opening to a goal at rest."""
    low = np.array([wall.half + 0.15 * wall.room[0], -wall.room[1], -wall.room[2]])
    start, goal = rng.uniform(0.95 * low, 0.95 * wall.room, (2, 3))
    start[0] = -start[0]
    opening = wall.openings[rng.integers(len(wall.openings))]
    place = rng.uniform(opening.lower, opening.upper)
    knots, h = wall.grid.knots, wall.grid.step
    inside = int(rng.integers(2, max(3, knots // 5)))
    enters = int(rng.integers(3, knots - inside - 3))
    # unit responses of positions at some knots, and of the last velocity, to accelerations
    responses = np.zeros((4, knots - 1))
    for row, k in enumerate((enters, enters + inside, knots - 1)):
        responses[row, :k] = h**2 * (k - np.arange(k) - 0.5)
    responses[3] = h
    edges = np.array([place, place])
    edges[:, 0] = -1.1 * wall.half, 1.1 * wall.half
    targets = np.concatenate([edges - start, [goal - start], np.zeros((1, 3))])
    return start, np.linalg.pinv(responses) @ targets


def _sampled(grid: rho.Grid, start: FloatArray, accelerations: FloatArray) -> FloatArray:
    """Return positions of a vehicle from rest in every step, shape (S, 3)."""
    x, v = roll_out(start[None], np.zeros((1, 3)), accelerations[None], grid.step)
    s = grid.step * _BETWEEN[:, None, None]
    positions: FloatArray = x[0, :-1] + s * v[0, :-1] + s**2 / 2.0 * accelerations
    return np.concatenate([positions.reshape(-1, 3), x[0, -1:]])


def _is_clear(wall: _Wall, positions: FloatArray) -> bool:
    """Return whether positions are in the room and, within the wall, in an opening."""
    if np.any(np.abs(positions) > wall.room):
        return False
    inside = positions[np.abs(positions[:, 0]) < 1.02 * wall.half]
    through = np.zeros(len(inside), dtype=bool)
    for box in wall.openings:
        through |= np.all((inside > box.lower)[:, 1:] & (inside < box.upper)[:, 1:], axis=1)
    return bool(through.all())


def _scene(wall: _Wall, motions: FloatArray, rng: np.random.Generator) -> GapScene:
    """Return the scenario that has the motions as a plan; limits exceed their needs a little."""
    starts, accelerations = motions[:, 0], motions[:, 1:]
    x, v = roll_out(starts, np.zeros_like(starts), accelerations, wall.grid.step)
    more = 1.0 + rng.choice([1e-6, 0.1, 0.3])
    speed = more * float(np.linalg.norm(v, axis=2).max())
    limits = rho.Limits(
        position=rho.Box(-wall.room, wall.room),
        max_acceleration=more * float(np.linalg.norm(accelerations, axis=2).max()),
        max_speed=speed if rng.uniform() < 0.5 else None,
    )
    rest = np.zeros(3)
    vehicles = tuple(
        rho.Vehicle(f"v{number}", rho.State(start, rest), rho.State(goal, rest))
        for number, (start, goal) in enumerate(zip(starts, x[:, -1], strict=True))
    )
    scenario = rho.Scenario(
        f"{wall.kind} of {len(vehicles)}",
        wall.grid,
        vehicles,
        limits,
        wall.boxes,
        separation=wall.separation,
    )
    return GapScene(wall.kind, scenario, rho.Plan.from_accelerations(scenario, accelerations))
