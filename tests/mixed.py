"""Random scenes that mix every kind of requirement, each around a motion that is known to hold.

A random smooth motion comes first. Then kinds of requirements are added one after the other, in a
random order, each so that the motion keeps it; one that it does not keep is left out. So each scene
has a plan, and a planner that finds none has missed it.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import drake_rho as rho
from tests.requirements import random_set
from tests.shapes import KINDS as SHAPES
from tests.shapes import random_shape

Array = np.ndarray
Rng = np.random.Generator

CLOCKS = (0.0, -3.7, 17.3, 1000.1, 1.0e5 + 0.3, 1.7e9 + 8.8)
"""Times of the first knot, up to today's Unix time [s]."""

GRAVITY = np.array([0.0, 0.0, 9.81])


@dataclasses.dataclass(frozen=True)
class Mixed:
    """Scene and the motion that it is drawn around."""

    scenario: rho.Scenario
    """the scene, in which waypoints may be without a time"""
    known: rho.Plan
    """plan of the same scene with all times given, which `verify` accepts"""

    @property
    def is_certain(self) -> bool:
        """True if a planner that keeps no margins has to find a plan: the known motion is one."""
        scenario = self.scenario
        return scenario.disturbance is None and scenario.smoothing is None


def mixed(
    seed: int, *, leave_out: tuple[str, ...] = (), most: int = 7, halts: bool = False
) -> Mixed:
    """Return one scene; the same seed gives the same one.

    Args:
        seed: seed of the scene.
        leave_out: names of kinds (`KINDS`) that are not drawn.
        most: largest number of kinds.
        halts: whether a motion from rest to rest is flown twice, with a rest between.
    """
    rng = np.random.default_rng([45, seed])
    scene = _motion(rng, f"mixed {seed}")
    scene = _twice(scene, 1 + seed % 4) if halts else scene
    names = [name for name in KINDS if name not in leave_out]
    drawn = rng.permutation(names)[: int(rng.integers(1, most + 1))]
    for name in sorted(drawn, key=names.index):
        for _ in range(3):
            tried = with_one(scene, KINDS[str(name)], rng)
            if tried is not None:
                scene = tried
                break
    return scene


def with_one(scene: Mixed, add: Callable[[Rng, Mixed], Any], rng: Rng) -> Mixed | None:
    """Return the scene with one more kind, if its motion keeps it, else None."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        try:
            scenario = add(rng, scene)
            known = rho.Plan.from_accelerations(
                timed(scenario, scene.known), scene.known.accelerations
            )
            return Mixed(scenario, known) if rho.verify(known).ok else None
        except rho.ScenarioError:
            return None


def timed(scenario: rho.Scenario, known: rho.Plan) -> rho.Scenario:
    """Return the scenario with the times at which a motion passes its waypoints."""
    vehicles = [
        dataclasses.replace(
            each,
            waypoints=tuple(
                way
                if way.time is not None
                else dataclasses.replace(way, time=passed(known, i, way))
                for way in each.waypoints
            ),
        )
        for i, each in enumerate(scenario.vehicles)
    ]
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


def passed(known: rho.Plan, vehicle: int, waypoint: rho.Waypoint) -> float:
    """Return when a motion passes a waypoint, from its position alone, or begins to rest [s]."""
    if waypoint.dwell > 0.0:
        return float(known.scenario.grid.times[rests(known, vehicle)[0]])
    times = dense(known)
    for _ in range(8):
        off = np.linalg.norm(known.at(times).positions[vehicle] - waypoint.position, axis=1)
        nearest = int(off.argmin())
        low, high = times[max(nearest - 1, 0)], times[min(nearest + 1, len(times) - 1)]
        times = np.linspace(low, high, 65)
    return float(times[32])


def dense(plan: rho.Plan, samples: int = 16) -> Array:
    """Return times of a flight on the scenario's clock, so many in each step [s]."""
    grid = plan.scenario.grid
    return np.linspace(grid.start, grid.end, (grid.knots - 1) * samples + 1)


# ---- the motion


def _motion(rng: Rng, name: str) -> Mixed:
    """Return a smooth motion of one to three vehicles, without any requirement."""
    count, knots = int(rng.choice([1, 1, 2, 3])), int(rng.choice([6, 8, 12, 16, 24]))
    length = 10.0 ** rng.uniform(-2.7, 3.0)
    duration = 10.0 ** rng.uniform(-0.3, 1.5) * (1.0 if length < 100.0 else 4.0)
    start = float(rng.choice(CLOCKS))
    step = duration / (knots - 1)
    if rng.random() < 0.6:  # as people write it
        step = max(float(f"{step:.1g}"), 0.01)
    grid = rho.Grid(step, knots, start)
    accelerations = _accelerations(rng, count, grid, length)
    at_rest = rng.random() < 0.65
    begun = list[rho.State]()
    around = rng.uniform(-1.0, 1.0, 3) * length * rng.choice([0.0, 1.0, 10.0])
    for _ in range(count):
        velocity = rng.normal(0.0, 0.4, 3) * length / grid.duration * (not at_rest)
        position = around + rng.uniform(-0.7, 0.7, 3) * length * (count > 1)
        begun.append(rho.State(position, velocity))
    vehicles = [rho.Vehicle(f"v{i}", each, each) for i, each in enumerate(begun)]
    flown = rho.Plan.from_accelerations(rho.Scenario(name, grid, vehicles), accelerations)
    ends = [
        rho.State(flown.positions[i, -1], np.zeros(3) if at_rest else flown.velocities[i, -1])
        for i in range(count)
    ]
    radius = float(rng.choice([0.0, 0.01, 0.03])) * length
    vehicles = [
        rho.Vehicle(f"v{i}", begun[i], ends[i], radius=radius, weight=float(rng.choice([1, 1, 4])))
        for i in range(count)
    ]
    scenario = rho.Scenario(name, grid, vehicles, between_knots=bool(rng.random() < 0.85))
    return Mixed(scenario, rho.Plan.from_accelerations(scenario, accelerations))


def _twice(scene: Mixed, steps: int) -> Mixed:
    """Return a motion from rest flown twice, with steps at rest between; others as they are."""
    scenario, a = scene.scenario, scene.known.accelerations
    if not all(each.goal.is_at_rest for each in scenario.vehicles):
        return scene
    a = np.concatenate([a, np.zeros((len(a), steps, 3)), a], axis=1)
    vehicles = [
        dataclasses.replace(each, goal=rho.State(2.0 * each.goal.position - each.start.position))
        for each in scenario.vehicles
    ]
    grid = dataclasses.replace(scenario.grid, knots=a.shape[1] + 1)
    scenario = dataclasses.replace(scenario, grid=grid, vehicles=tuple(vehicles))
    return Mixed(scenario, rho.Plan.from_accelerations(scenario, a))


def rests(known: rho.Plan, vehicle: int) -> Array:
    """Return the knots between start and goal at which a vehicle is at rest."""
    speeds = np.linalg.norm(known.velocities[vehicle], axis=1)
    at_rest = speeds <= 1e-9 * speeds.max()
    return np.asarray(1 + np.flatnonzero(at_rest[1:-1]))


def _accelerations(rng: Rng, count: int, grid: rho.Grid, length: float) -> Array:
    """Return smooth accelerations without a mean, (N, K-1, 3), so that velocities return."""
    steps = grid.knots - 1
    t = (np.arange(steps) + 0.5) / steps
    waves = np.array([np.cos(np.pi * k * t) for k in range(1, 5)])
    waves -= waves.mean(axis=1, keepdims=True)
    weights = rng.normal(0.0, 1.0, (count, 3, 4)) / np.array([1.0, 1.5, 2.5, 4.0])
    sizes = rng.uniform(0.3, 1.0, 3)
    if rng.random() < 0.3:
        sizes[rng.integers(3)] *= 10.0 ** rng.uniform(-3.0, -1.0)
    scale = 8.0 * length / grid.duration**2
    return np.asarray(np.einsum("nax,xk->nka", weights * sizes[:, None], waves) * scale)


# ---- the kinds: each returns the scenario with one more


def _size(scene: Mixed) -> float:
    """Return about how far vehicles fly [m]."""
    x = scene.known.positions
    return float(np.ptp(x, axis=1).max())


def _values(scene: Mixed, of: str) -> Array:
    """Return dense values of a quantity of the known motion, (N, T, 3); jerks with both ends."""
    plan, h = scene.known, scene.scenario.grid.step
    if of == "position":
        return plan.at(dense(plan)).positions
    if of == "velocity":
        return plan.at(dense(plan)).velocities
    a = plan.accelerations
    if of == "acceleration":
        return a
    if of == "thrust":
        return np.asarray(a + GRAVITY)
    rest = np.zeros((len(a), 1, 3))
    return np.asarray(np.diff(np.concatenate([rest, a, rest], axis=1), axis=1) / h)


def _more(rng: Rng, size: Any = None) -> Any:
    return 1.0 + rng.uniform(0.02, 0.6, size)


def _box_limits(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with boxes of positions, velocities, accelerations, jerks."""
    found: dict[str, Any] = {}
    for of in ("position", "velocity", "acceleration", "jerk"):
        if rng.random() < 0.5:
            x = _values(scene, of)
            low, high = x.min(axis=(0, 1)), x.max(axis=(0, 1))
            if of in ("acceleration", "jerk"):
                low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
            spare = np.maximum(high - low, 0.1 * (high - low).max())
            found[of] = rho.Box(
                low - spare * rng.uniform(0.02, 0.6, 3), high + spare * rng.uniform(0.02, 0.6, 3)
            )
    return dataclasses.replace(
        scene.scenario, limits=dataclasses.replace(scene.scenario.limits, **found)
    )


def _norm_limits(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with limits on norms and on the tilt."""
    found: dict[str, Any] = {}
    for field, of in (
        ("max_speed", "velocity"),
        ("max_acceleration", "acceleration"),
        ("max_jerk", "jerk"),
        ("max_thrust", "thrust"),
    ):
        if rng.random() < 0.4:
            found[field] = float(_more(rng) * np.linalg.norm(_values(scene, of), axis=-1).max())
    thrust = _values(scene, "thrust")
    tilt = np.arctan2(np.linalg.norm(thrust[..., :2], axis=-1), thrust[..., 2]).max()
    if rng.random() < 0.3 and tilt < 1.2:
        found["max_tilt"] = float(min(1.5, _more(rng) * tilt))
    return dataclasses.replace(
        scene.scenario, limits=dataclasses.replace(scene.scenario.limits, **found)
    )


def _obstacles(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with obstacles; some move, are active for a while, or uncertain."""
    scenario, known, size = scene.scenario, scene.known, _size(scene)
    grid, times = scenario.grid, dense(known)
    x, radius = known.at(times).positions, scenario.vehicles[0].radius
    found = list[rho.Obstacle]()
    for _ in range(30):
        if len(found) == 4:
            break
        who, when = int(rng.integers(len(x))), int(rng.integers(1, len(times) - 1))
        part = when / len(times)
        straight = (1 - part) * x[who, 0] + part * x[who, -1]
        centre = straight + rng.choice([0.0, 0.5, 1.0]) * (x[who, when] - straight)
        centre = centre + rng.normal(0.0, 0.15, 3) * size
        given: dict[str, Any] = {}
        drawn = rng.random()
        if drawn < 0.2:
            given["velocity"] = rng.normal(0.0, 0.5, 3) * size / grid.duration
            centre = centre - given["velocity"] * times[when]
        shape = random_shape(rng, str(rng.choice(list(SHAPES))), centre, 0.3 * size)
        if 0.2 <= drawn < 0.4:
            count = int(rng.integers(2, 5))
            corners = grid.start + np.sort(rng.uniform(-0.2, 1.2, count)) * grid.duration
            positions = np.array(shape.center) + rng.normal(0.0, 0.3, (count, 3)) * size
            after = str(rng.choice(["rests", "goes_on"]))
            deviation = float(rng.choice([0.0, 0.005])) * size
            given["track"] = rho.Track(corners, positions, deviation, after=after)  # type: ignore[arg-type]
        if rng.random() < 0.3:
            given["active"] = _interval(rng, grid)
        if rng.random() < 0.2:
            given["position_error"] = float(rng.uniform(0.0, 0.02)) * size
            given["velocity_error"] = float(rng.uniform(0.0, 0.02)) * size / grid.duration
            given["seen_at"] = grid.start
        body = rho.Obstacle(shape, **given)
        clear = float(body.distances(x, times).min())
        if clear > radius + body.deviation + size * 10.0 ** rng.uniform(-2.5, -1.0):
            found.append(body)
    return dataclasses.replace(scenario, obstacles=(*scenario.obstacles, *found))


def _map(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with voxels or triangles near the motion."""
    scenario, known, size = scene.scenario, scene.known, _size(scene)
    x, radius = known.at(dense(known)).positions, scenario.vehicles[0].radius
    cell = size * float(rng.uniform(0.05, 0.2))
    centre = x[rng.integers(len(x)), rng.integers(x.shape[1])]
    cells = rng.integers(-5, 5, (60, 3))
    middles = centre + (cells + 0.5) * cell
    off = np.linalg.norm(middles[:, None] - x.reshape(1, -1, 3), axis=-1).min(axis=1)
    free = off > radius + 0.9 * cell + 10.0 ** rng.uniform(-2.5, -1.0) * size
    if rng.random() < 0.5:
        solid: Any = rho.Voxels(cells[free], cell, centre)
    else:
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) - 0.25
        faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])[: rng.integers(2, 5)]
        bodies = [m + cell * corners for m in middles[free]]
        triangles = [faces + 4 * i for i in range(len(bodies))]
        solid = rho.Mesh(np.concatenate(bodies), np.concatenate(triangles))
    active = _interval(rng, scenario.grid) if rng.random() < 0.4 else None
    return dataclasses.replace(
        scenario, obstacles=(*scenario.obstacles, rho.Obstacle(solid, active=active))
    )


def _interval(rng: Rng, grid: rho.Grid) -> tuple[float, float]:
    """Return a part of a flight, in half of all draws between knots as one writes their times."""
    if rng.random() < 0.5:
        first, last = np.sort(rng.integers(0, grid.knots, 2))
        return round(grid.start + first * grid.step, 6), round(grid.start + last * grid.step, 6)
    first, last = np.sort(rng.uniform(0.0, 1.0, 2))
    if rng.random() < 0.2:
        last = first
    return grid.start + first * grid.duration, grid.start + last * grid.duration


def _requirements(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with one to three more convex sets."""
    for _ in range(int(rng.integers(1, 4))):
        scene = with_one(scene, _requirement, rng) or scene
    return scene.scenario


def _requirement(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with one requirement near its motion."""
    scenario, plan = scene.scenario, scene.known
    grid, names = scenario.grid, scenario.names
    of: Any = rng.choice(
        ["position", "velocity", "acceleration", "thrust", "jerk"], p=[0.4, 0.2, 0.15, 0.1, 0.15]
    )
    member = int(rng.integers(len(names)))
    active = _interval(rng, grid) if rng.random() < 0.8 else None
    first, last = active or (grid.start, grid.end)
    relative: Any = None
    values = _values(scene, of)
    if of in ("position", "velocity"):
        times = dense(plan)
        near = (times >= first - grid.step) & (times <= last + grid.step)
    else:
        knots = grid.start + grid.step * np.arange(values.shape[1])
        near = (knots >= first - 1.5 * grid.step) & (knots <= last + 1.5 * grid.step)
    own = values[member][near]
    if len(names) > 1 and rng.random() < 0.4:
        other = int(rng.choice([i for i in range(len(names)) if i != member]))
        own, relative = own - values[other][near], names[other]
    elif of == "position" and rng.random() < 0.25:
        corners = np.linspace(grid.start, grid.end, 4)
        points = plan.at(corners).positions[member] + rng.normal(size=(4, 3)) * 0.1 * _size(scene)
        relative = rho.Track(corners, points, after="rests")
        own = own - relative.at(times[near])
    middle = own[rng.integers(len(own))]
    reach = float(np.linalg.norm(own - middle, axis=1).max())
    size = max(reach * float(rng.uniform(0.5, 2.5)), 1e-2 * float(np.abs(values).max()))
    kept = rho.KeepIn(
        random_set(rng, middle, size),
        of=of,
        vehicles=names[member],
        relative_to=relative,
        active=active,
    )
    return dataclasses.replace(scenario, requirements=(*scenario.requirements, kept))


def _waypoints(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with waypoints on the motion, with and without times."""
    scenario, plan = scene.scenario, scene.known
    grid, size, vehicles = scenario.grid, _size(scene), list[rho.Vehicle]()
    for i, each in enumerate(scenario.vehicles):
        count = int(rng.integers(0, 4))
        parts = np.sort(rng.uniform(0.05, 0.95, count))
        ways = dict[float, rho.Waypoint]()
        free = bool(rng.random() < 0.6)
        for part in parts:
            time = float(grid.start + part * grid.duration)
            if rng.random() < 0.3:
                time = float(grid.times[1 + int(part * (grid.knots - 2))])
            at = plan.at([time]).positions[i, 0]
            within = float(rng.choice([0.0, 0.0, 0.02])) * size
            at = at + within * 0.4 * rng.uniform(-1.0, 1.0, 3)
            given = None if free and rng.random() < 0.8 else time
            ways.setdefault(time, rho.Waypoint(given, at, within))
        in_order = tuple(ways[time] for time in sorted(ways))
        vehicles.append(dataclasses.replace(each, waypoints=in_order))
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


def _separation(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with a separation a little less than the motion's."""
    scenario, plan = scene.scenario, scene.known
    x = plan.at(dense(plan)).positions
    downwash = float(rng.choice([1.0, 1.0, 2.0]))
    scaled = x / np.array([1.0, 1.0, downwash])
    pairs = [scaled[i] - scaled[j] for i in range(len(x)) for j in range(i)]
    if not pairs:
        return scenario
    least = min(float(np.linalg.norm(pair, axis=-1).min()) for pair in pairs)
    return dataclasses.replace(
        scenario, separation=rho.Separation(rng.uniform(0.5, 0.95) * least, downwash)
    )


def _smoothing(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with averages of up to a step, one to three."""
    width = scene.scenario.grid.step * float(rng.choice([0.1, 0.5, 1.0]))
    return dataclasses.replace(
        scene.scenario, smoothing=rho.Smoothing(width, int(rng.integers(1, 4)))
    )


def _disturbance(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with wind and errors of estimates that leave most of the limits."""
    grid = scene.scenario.grid
    force = float(np.linalg.norm(scene.known.accelerations, axis=-1).max())
    disturbance = rho.Disturbance(
        float(rng.uniform(0.002, 0.05)) * force,
        float(rng.choice([0.0, 1e-4])) * _size(scene),
        float(rng.choice([0.0, 1e-4])) * _size(scene) / grid.duration,
        grid.step / int(rng.integers(1, 6)),
        int(rng.integers(0, 2)),
        share=float(rng.uniform(0.2, 0.6)),
    )
    return dataclasses.replace(scene.scenario, disturbance=disturbance)


KINDS: dict[str, Callable[[Rng, Mixed], rho.Scenario]] = {
    "box limits": _box_limits,
    "norm limits": _norm_limits,
    "separation": _separation,
    "waypoints": _waypoints,
    "smoothing": _smoothing,
    "disturbance": _disturbance,
    "requirements": _requirements,
    "obstacles": _obstacles,
    "map": _map,
}
"""Kinds of requirements that a scene may have, in the order in which they are added."""
