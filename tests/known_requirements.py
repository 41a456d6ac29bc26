"""Random scenes whose requirements a known motion keeps closely, and dense samples of motions.

Sets lie close around the values of the known motion, so that plans touch them, between the knots
too. Sizes are from millimetres to kilometres, clocks from 0 to Unix time.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

import drake_rho as rho
from tests.arrays import FloatArray

GRAVITY = np.array([0.0, 0.0, 9.81])
CLOCKS = (0.0, -3.7, 8.8, 1000.1, 100000.3, 5e8 + 0.1, 1.7e9, 1.7e9 + 1.2, 1.7e9 + 8.8)
"""Times of first knots [s]: many are no binary fractions, and far ones are rounded."""
STEPS = (0.025, 0.1, 0.3, 1.0 / 3.0, 0.4, 0.5, 0.7, 2.0)
QUANTITIES = ("position", "velocity", "acceleration", "thrust", "jerk")


@dataclasses.dataclass
class Known:
    """Motions of vehicles, summed step by step."""

    step: float
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    @classmethod
    def of(cls, p: FloatArray, v: FloatArray, a: FloatArray, step: float) -> Known:
        """Return motions from first positions and velocities (N, 3) and accelerations (N, K, 3)."""
        velocities = np.concatenate([v[:, None], step * a], axis=1).cumsum(axis=1)
        moved = step * velocities[:, :-1] + step**2 / 2.0 * a
        return cls(step, np.concatenate([p[:, None], moved], axis=1).cumsum(axis=1), velocities, a)

    @classmethod
    def planned(cls, plan: rho.Plan) -> Known:
        """Return the motions of a plan from its starts and accelerations alone."""
        starts = [each.start for each in plan.scenario.vehicles]
        p, v = (np.array([getattr(each, of) for each in starts]) for of in ("position", "velocity"))
        return cls.of(p, v, plan.accelerations, plan.scenario.grid.step)

    def values(self, of: str, i: int, times: FloatArray) -> FloatArray:
        """Return positions or velocities of a vehicle at times since the first knot."""
        steps = self.accelerations.shape[1]
        k = np.clip(np.floor(times / self.step + 1e-9).astype(int), 0, steps - 1)
        s, a = (times - self.step * k)[:, None], self.accelerations[i, k]
        if of == "velocity":
            return np.asarray(self.velocities[i, k] + s * a)
        return np.asarray(self.positions[i, k] + s * self.velocities[i, k] + s * s / 2.0 * a)

    def in_steps(self, of: str, i: int, vehicle: rho.Vehicle) -> FloatArray:
        """Return accelerations or thrusts of steps (K-1, 3), or jerks at knots (K, 3)."""
        a = self.accelerations[i]
        if of == "jerk":
            ends = (_outside(state)[None] for state in (vehicle.start, vehicle.goal))
            return np.asarray(np.diff(a, axis=0, prepend=next(ends), append=next(ends)) / self.step)
        return np.asarray(a + (GRAVITY if of == "thrust" else 0.0))


def _outside(state: rho.State) -> FloatArray:
    """Return the acceleration before a start or after a goal: NaN if none is known."""
    if state.acceleration is not None:
        return state.acceleration
    return np.full(3, np.nan) if np.any(state.velocity) else np.zeros(3)


def values_required(
    known: Known, scenario: rho.Scenario, asked: rho.KeepIn, samples: int = 2001
) -> FloatArray:
    """Return the values that have to be in a requirement's set, at knots and many instants."""
    grid, names = scenario.grid, list(scenario.names)
    h = grid.step
    near = max(1e-9 * h, 8.0 * 2.3e-16 * max(abs(grid.start), abs(grid.end)))
    knots: FloatArray = h * np.arange(grid.knots, dtype=np.float64)
    first, end = (0.0, knots[-1]) if asked.active is None else np.array(asked.active) - grid.start
    first, end = (float(_at_knot(each, knots, near)) for each in (first, end))
    members = [names.index((asked.vehicles or names)[0])]
    if isinstance(asked.relative_to, str):
        members.append(names.index(asked.relative_to))
    at_knots = knots[(knots >= first - near) & (knots <= end + near)]
    if asked.of in ("acceleration", "thrust", "jerk"):
        begins = knots if asked.of == "jerk" else knots[:-1]
        met = (begins <= end + near) & (begins + h > first + near)
        met[-1] |= end >= knots[-1] - near
        found = [known.in_steps(asked.of, i, scenario.vehicles[i])[met] for i in members]
        values = found[0] - found[1] if len(found) > 1 else found[0]
        return np.asarray(values[~np.isnan(values[:, 0])])  # jerks from unknown accelerations
    times = np.asarray(np.union1d(np.linspace(first, end, samples), at_knots))
    if not scenario.between_knots and first < end:
        times = at_knots
    values = known.values(asked.of, members[0], times)
    if len(members) > 1:
        values -= known.values(asked.of, members[1], times)
    elif isinstance(track := asked.relative_to, rho.Track):
        at = [np.interp(times, track.times - grid.start, x) for x in track.positions.T]
        values -= np.stack(at, axis=1)
    return values


def _at_knot(time: float, knots: FloatArray, near: float) -> float:
    """Return a time, or the knot that it equals."""
    nearest = float(knots[np.argmin(np.abs(knots - time))])
    return nearest if abs(nearest - time) <= near else float(time)


def beyond(plan: rho.Plan) -> float:
    """Return how many tolerances a plan is outside of a required set at the most."""
    scenario, known, worst = plan.scenario, Known.planned(plan), -np.inf
    for asked in scenario.requirements:
        values = values_required(known, scenario, asked, 8001)
        if len(values) > 0:
            tolerance = float(asked.tolerances(scenario.fleet, scenario.names).max())
            worst = max(worst, float(np.max(asked.set.signed_distance(values))) / tolerance)
    return worst


def known_scene(seed: int) -> rho.Scenario:
    """Return one to three vehicles, with one to three requirements that a known motion keeps."""
    rng = np.random.default_rng(seed)
    count, knots = int(rng.choice([1, 1, 2, 3])), int(rng.integers(5, 16))
    step, start = float(rng.choice(STEPS)), float(rng.choice(CLOCKS))
    size, T = 10.0 ** rng.uniform(-3.0, 3.3), step * (knots - 1)
    p, v = 2.0 * size * rng.normal(size=(2, count, 3))
    a = rng.choice([5.0, 15.0]) * size / T**2 * rng.normal(size=(count, knots - 1, 3))
    known = Known.of(p, v / T, a, step)
    starts = [
        rho.State(p[i], v[i] / T, a[i, 0] if rng.random() < 0.5 else None) for i in range(count)
    ]
    goals = [rho.State(known.positions[i, -1], known.velocities[i, -1]) for i in range(count)]
    vehicles = [rho.Vehicle(f"v{i}", starts[i], goals[i]) for i in range(count)]
    scenario = rho.Scenario(
        f"known {seed}",
        rho.Grid(step, knots, start),
        vehicles,
        between_knots=bool(rng.random() < 0.9),
    )
    requirements = [_requirement(rng, scenario, known, size) for _ in range(rng.integers(1, 4))]
    return dataclasses.replace(scenario, requirements=tuple(requirements))


def _requirement(
    rng: np.random.Generator, scenario: rho.Scenario, known: Known, size: float
) -> rho.KeepIn:
    """Return a requirement close around a known motion."""
    grid, count, T = scenario.grid, len(scenario.vehicles), scenario.grid.duration
    of: Any = rng.choice(QUANTITIES, p=[0.5, 0.2, 0.1, 0.1, 0.1])
    i = int(rng.integers(count))
    relative: str | rho.Track | None = None
    if count > 1 and rng.random() < 0.4:
        relative = f"v{rng.choice([j for j in range(count) if j != i])}"
    elif of == "position" and rng.random() < 0.3:
        times = T * np.array([0.0, rng.uniform(0.2, 0.8), 1.0])
        points = known.values("position", i, times) + 0.3 * size * rng.normal(size=(3, 3))
        relative = rho.Track(grid.start + times, points)
    asked = rho.KeepIn(
        rho.Ball([0, 0, 0], 1.0),
        of=of,
        vehicles=f"v{i}",
        relative_to=relative,
        active=_active(rng, grid),
    )
    values = values_required(known, dataclasses.replace(scenario, between_knots=True), asked)
    power = {"position": 0, "velocity": 1, "jerk": 3}.get(of, 2)
    if len(values) == 0:  # the first jerk of a vehicle whose acceleration before it is unknown
        return asked
    return dataclasses.replace(asked, set=set_around(rng, values, 1e-3 * size / T**power))


def _active(rng: np.random.Generator, grid: rho.Grid) -> tuple[float, float] | None:
    """Return an interval that begins and ends anywhere, at knots, or at both; or an instant."""
    T, kind = grid.duration, int(rng.integers(6))
    anywhere, knots = rng.uniform(0.0, T, 2), grid.step * rng.integers(0, grid.knots, 2)
    ends = (anywhere, knots, (anywhere[0], knots[1]), anywhere[[0, 0]], knots[[0, 0]], None)[kind]
    if ends is None:
        return None
    first, last = sorted(grid.start + np.array(ends))
    if kind in (1, 4):  # as they are written in a file
        first, last = round(first, 6), round(last, 6)
    first, last = np.clip([first, last], grid.start, grid.end).tolist()
    return first, last


def set_around(rng: np.random.Generator, x: FloatArray, least: float) -> Any:
    """Return a set of a random kind with all values x (M, 3) in it, and little more."""
    low, high = x.min(axis=0), x.max(axis=0)
    centre = (low + high) / 2.0
    size = max(float(np.ptp(x, axis=0).max()), 0.01 * float(np.abs(x).max()), least)
    more = size * 10.0 ** rng.uniform(-4.0, -0.7)
    along = rng.normal(size=3)
    along /= np.linalg.norm(along)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axis = int(rng.integers(3))
    name: Any = "xyz"[axis]
    across = np.delete(np.arange(3), axis)
    radius = np.linalg.norm((x - centre)[:, across], axis=1).max() + more
    stretch = 10.0 ** rng.uniform(-0.3, 0.3, 3)
    apex = centre + along * (((x - centre) @ along).min() - size)
    up = (x - apex) @ along
    wide = np.arctan2(np.linalg.norm(x - apex - up[:, None] * along, axis=1), up).max()
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    turned_low, turned_high = (x @ turned).min(axis=0) - more, (x @ turned).max(axis=0) + more
    ends = x[0] - 1e-6 * size, x[-1] + 1e-6 * size
    part = np.clip((x - ends[0]) @ (ends[1] - ends[0]) / np.sum((ends[1] - ends[0]) ** 2), 0, 1)
    beside = np.linalg.norm(x - ends[0] - part[:, None] * (ends[1] - ends[0]), axis=1)
    kinds: list[Any] = [
        lambda: rho.Box(low - more, high + more),
        lambda: rho.Ball(centre, np.linalg.norm(x - centre, axis=1).max() + more),
        lambda: rho.HalfSpace(along, float((x @ along).max() + more)),
        lambda: rho.Cone(apex, along, float(min(1.5, wide + more / size))),
        lambda: rho.Capsule(*ends, float(beside.max() + more)),
        lambda: rho.Polytope((turned_low + corners * (turned_high - turned_low)) @ turned.T),
        lambda: rho.Ellipsoid(
            centre, (np.linalg.norm((x - centre) / stretch, axis=1).max() + more) * stretch
        ),
        lambda: rho.Cylinder(
            centre, float(radius), float(np.ptp(x[:, axis]) + 2.0 * more), axis=name
        ),
    ]
    return kinds[rng.integers(len(kinds))]()
