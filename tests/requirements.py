"""Random scenes with requirements, and how far motions are outside of what they require."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import acceleration_outside, fleet

GRAVITY = 9.81
"""Acceleration of gravity [m/s²]."""

QUANTITIES = ("position", "velocity", "acceleration", "thrust", "jerk")


class Egg:
    """Ball around `centre`, as a user would write a set: functions of absolute positions."""

    def __init__(self, centre: Any, radius: float) -> None:
        self.centre, self.radius = np.asarray(centre, dtype=float), radius

    def support(self, n: FloatArray) -> FloatArray:
        """Return the largest n · x of the set."""
        return np.asarray(n @ self.centre + self.radius)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the surface."""
        return np.asarray(np.linalg.norm(x - self.centre, axis=-1) - self.radius)

    def outward(self, x: FloatArray) -> FloatArray:
        """Return directions away from the centre."""
        y = x - self.centre
        r = np.linalg.norm(y, axis=-1, keepdims=True)
        return np.asarray(np.where(r > 0.0, y / np.where(r > 0.0, r, 1.0), np.eye(3)[0]))


def random_set(rng: np.random.Generator, inside: FloatArray, size: float) -> Any:
    """Return a set of a random kind that contains a ball of a quarter of `size` around a value."""
    off = 0.5 * size * rng.uniform(-1.0, 1.0, 3) / np.sqrt(3.0)
    centre = inside + off
    along = rng.normal(size=3)
    along /= np.linalg.norm(along)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    angle = rng.uniform(0.5, 1.2)
    kinds: list[Any] = [
        lambda: rho.Ball(centre, size),
        lambda: rho.Box(centre - size, centre + size),
        lambda: rho.Ellipsoid(centre, size * rng.uniform(1.0, 2.0, 3)),
        lambda: rho.Cylinder(centre, size, 2.0 * size, rng.choice(["x", "y", "z"])),
        lambda: rho.Cylinder(centre, size, axis=rng.choice(["x", "y", "z"])),
        lambda: rho.Polytope(centre + size * corners @ turned),
        lambda: rho.HalfSpace(along, float(along @ inside) + 0.3 * size),
        lambda: rho.Cone(inside - size / np.sin(angle) * along, along, angle),
        lambda: Egg(centre, size),
    ]
    return kinds[rng.integers(len(kinds))]()


def random_scene(seed: int) -> rho.Scenario:
    """Return one to four vehicles with one to four requirements, which may not have a plan."""
    rng = np.random.default_rng(seed)
    count, knots = int(rng.integers(1, 5)), int(rng.integers(12, 30))
    lanes = np.stack([np.zeros(count), 4.0 * np.arange(count), np.full(count, 4.0)], axis=1)
    starts = lanes + rng.uniform(-1.4, 1.4, (count, 3))
    goals = rng.permutation(lanes) + np.array([15.0, 0.0, 0.0]) + rng.uniform(-1.4, 1.4, (count, 3))
    start = float(rng.choice([0.0, -3.7, 12.25]))
    grid = rho.Grid(8.0 / (knots - 1), knots, start)
    scenario = fleet(starts, goals, grid=grid, between_knots=bool(rng.random() < 0.8))
    if rng.random() < 0.6:
        scenario = dataclasses.replace(
            scenario, limits=rho.Limits(max_speed=12.0, max_acceleration=20.0)
        )
    motion = rho.plan(scenario).motion()
    requirements = list[rho.KeepIn]()
    for _ in range(int(rng.integers(1, 5))):
        requirements.append(_requirement(rng, scenario, motion))
    return dataclasses.replace(scenario, requirements=tuple(requirements))


def _requirement(rng: np.random.Generator, scenario: rho.Scenario, motion: Any) -> rho.KeepIn:
    """Return a requirement near a motion, active for a part of the flight, between its ends."""
    count, T = len(scenario.vehicles), scenario.grid.duration
    of: Any = rng.choice(QUANTITIES, p=[0.45, 0.25, 0.1, 0.1, 0.1])
    member = int(rng.integers(count))
    first = float(rng.uniform(0.1, 0.8)) * T
    last = first if rng.random() < 0.25 else first + float(rng.uniform(0.05, 0.15)) * T
    base = "acceleration" if of == "thrust" else of
    middle = np.array([(first + last) / 2.0])
    value = motion.at(base, middle)[member, 0]
    relative: str | rho.Track | None = None
    if count > 1 and rng.random() < 0.5:
        leader = int(rng.choice([i for i in range(count) if i != member]))
        value = value - motion.at(base, middle)[leader, 0]
        relative = scenario.vehicles[leader].name
    elif of in ("position", "velocity") and rng.random() < 0.3:
        times = scenario.grid.start + np.array([0.0, 0.45, 0.5, 1.0]) * T
        points = motion.at("position", times - scenario.grid.start)[member]
        relative = rho.Track(times, points + rng.normal(size=(4, 3)))
        value = np.zeros(3)
    if of == "thrust" and not isinstance(relative, str):
        value = value + np.array([0.0, 0.0, GRAVITY])
    size = {"position": 2.0, "velocity": 1.5, "acceleration": 3.0, "thrust": 3.0, "jerk": 9.0}[of]
    inside = value + 0.3 * size * rng.normal(size=3)
    return rho.KeepIn(
        random_set(rng, inside, size * float(rng.uniform(0.7, 1.5))),
        of=of,
        vehicles=scenario.vehicles[member].name,
        relative_to=relative,
        active=(scenario.grid.start + first, scenario.grid.start + last),
    )


def outside(plan: rho.Plan, number: int, samples: int = 2001) -> float:
    """Return how far a plan is outside the set of a requirement at any of many instants.

    States are summed here step by step; of the package, only the set's distance is used. Where the
    scenario requires no more, the instants are the knots.
    """
    scenario, asked = plan.scenario, plan.scenario.requirements[number]
    grid, names = scenario.grid, [each.name for each in scenario.vehicles]
    first, last = asked.active or (grid.start, grid.end)
    knots = grid.start + grid.step * np.arange(grid.knots)
    times: FloatArray = np.linspace(first, last, samples)
    if not scenario.between_knots and asked.of in ("position", "velocity") and first < last:
        times = np.asarray(knots[(knots >= first) & (knots <= last)], dtype=np.float64)
    asked_of = asked.vehicles or tuple(n for n in names if n != asked.relative_to)
    worst = -np.inf
    if len(times) == 0:
        return worst
    for name in asked_of:
        values = _values(plan, names.index(name), asked.of, times)
        if isinstance(asked.relative_to, str):
            values = values - _values(plan, names.index(asked.relative_to), asked.of, times)
        elif isinstance(asked.relative_to, rho.Track):
            values = values - of_track(asked.relative_to, asked.of, times)
        kept = ~np.isnan(values[:, 0])
        if kept.any():
            worst = max(worst, float(np.max(asked.set.signed_distance(values[kept]))))
    return worst


def _values(plan: rho.Plan, i: int, of: str, times: FloatArray) -> FloatArray:
    """Return values of a quantity of a vehicle at times, summed step by step."""
    grid, vehicle = plan.scenario.grid, plan.scenario.vehicles[i]
    h, a = grid.step, plan.accelerations[i]
    p, v = [vehicle.start.position], [vehicle.start.velocity]
    for each in a:
        p.append(p[-1] + h * v[-1] + h * h / 2.0 * each)
        v.append(v[-1] + h * each)
    ends = (acceleration_outside(each)[None] for each in (vehicle.start, vehicle.goal))
    jerks = np.diff(a, axis=0, prepend=next(ends), append=next(ends)) / h
    knot = np.floor((times - grid.start) / h + 1e-7).astype(int)
    k = np.clip(knot, 0, grid.knots - 2)
    s = (times - grid.start - h * k)[:, None]
    found: dict[str, FloatArray] = {
        "position": np.array(p)[k] + s * np.array(v)[k] + s * s / 2.0 * a[k],
        "velocity": np.array(v)[k] + s * a[k],
        "acceleration": a[k],
        "thrust": a[k] + [0.0, 0.0, GRAVITY],
        "jerk": jerks[np.clip(knot, 0, grid.knots - 1)],
    }
    return found[of]


def of_track(track: rho.Track, of: str, times: FloatArray) -> FloatArray:
    """Return positions or velocities of a track's point at times."""
    if of == "position":
        return np.stack([np.interp(times, track.times, x) for x in track.positions.T], axis=1)
    rates = np.diff(track.positions, axis=0) / np.diff(track.times)[:, None]
    piece = np.clip(np.searchsorted(track.times, times, side="right") - 1, 0, len(rates) - 1)
    return np.asarray(rates[piece])
