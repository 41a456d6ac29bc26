"""Scenes built around a known motion: each has a plan, so each without a found plan is missed.

A random smooth motion of one to three vehicles comes first. Limits are then a little more than what
it needs, and obstacles, at rest and in motion, are placed where it keeps clear of them, many of
them on the straight path.
"""

from __future__ import annotations

import dataclasses
import time
from statistics import median
from typing import Literal

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.fleets import Trial, findings, percent
from benchmarks.tables import Goal, Table
from benchmarks.worlds import plan_within
from drake_rho.campaigns.memory import peak_memory
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes.base import Shape

LIMIT = 15.0
"""Time limit beyond which a plan counts as missed [s]."""

MEMORY = 2000.0
"""Memory limit of the process [MB]."""

_FIRST = 500
"""First seed: earlier scenes were used to improve the planner."""

_DENSE = 24
"""Samples of each step at which obstacles are placed clear of the motion."""


@dataclasses.dataclass(frozen=True)
class KnownMotion:
    """Scene, and the motion that it was built around."""

    scenario: rho.Scenario
    """scenario"""
    plan: rho.Plan
    """plan that satisfies every constraint"""


def known_motion(seed: int) -> KnownMotion:
    """Return one scene; the same seed gives the same one."""
    rng = np.random.default_rng([24, seed])
    while True:
        scene = _drawn(rng, f"known motion, seed {seed}")
        if rho.verify(scene.plan).ok:
            return scene


def run(seeds: int = 500) -> Table:
    """Plan scenes one after the other."""
    drawn = range(_FIRST, _FIRST + seeds)
    trials = [_trial(seed) for seed in track(drawn, description="known motions")]
    missed, seconds = 100.0 - percent(trials), [trial.seconds for trial in trials]
    memory = max(trial.megabytes for trial in trials)
    return Table(
        name="known_motions",
        title="Scenes built around a known motion",
        columns=("scenes", "missed", "median_seconds", "worst_seconds", "peak_megabytes"),
        rows=((seeds, round(missed * seeds / 100.0), median(seconds), max(seconds), memory),),
        notes=(findings(trials), _WORK),
        goals=(
            Goal("scenes missed [%]", 0.5, missed),
            Goal("slowest [s]", LIMIT, max(seconds)),
            Goal("memory [MB]", MEMORY, memory),
        ),
    )


def _trial(seed: int) -> Trial:
    """Return the trial of one scene."""
    scenario, fault = known_motion(seed).scenario, ""
    began = time.perf_counter()
    try:
        if not rho.verify(plan_within(scenario, LIMIT)).ok:
            fault = "the plan does not hold"
    except (rho.DrakeRhoError, TimeoutError) as error:
        fault = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - began
    return Trial(scenario.name, len(scenario.vehicles), seconds, peak_memory(), fault=fault)


_WORK = f"""\
Random smooth motions of one to three vehicles on 8 to 40 knots, of centimetres to hundreds of
metres; boxes of positions, velocities and accelerations, and limits on norms, that they satisfy
with 2 to 60 % to spare, some that allow only forward motion and some in which a vehicle hardly
climbs; 2 to 20 obstacles of all shapes, a third of them in motion, most of them on the straight
path. The motion itself passes `verify`, which checks the plans as well. A plan that takes longer
than {LIMIT:g} s counts as missed. Memory is the largest of the process, the interpreter and Drake
included."""


def _drawn(rng: np.random.Generator, name: str) -> KnownMotion:
    """Return a scene whose motion satisfies it at all samples."""
    count, knots = int(rng.choice([1, 1, 2, 3])), int(rng.choice([8, 12, 20, 30, 40]))
    length, duration = 10.0 ** rng.uniform(-1.5, 2.5), 10.0 ** rng.uniform(-0.5, 1.3)
    grid = rho.Grid(duration / (knots - 1), knots)
    first = rng.uniform(-1.0, 1.0, 3) * length * rng.choice([0.0, 1.0, 10.0])
    accelerations = _accelerations(rng, count, grid, length)
    vehicles = list[rho.Vehicle]()
    radius, at_rest = float(rng.choice([0.0, 0.01, 0.03]) * length), rng.random() < 0.6
    ahead = np.zeros(3)
    if not at_rest and rng.random() < 0.5:
        ahead[rng.integers(3)] = rng.choice([-2.0, 2.0]) * length / duration
    for number, each in enumerate(accelerations):
        position = first + rng.uniform(-0.5, 0.5, 3) * length * (count > 1)
        velocity = np.zeros(3) if at_rest else ahead + rng.normal(0.0, 0.3, 3) * length / duration
        begun = rho.Vehicle(f"v{number}", rho.State(position, velocity), rho.State(position))
        flown = _flown(grid, (begun,), each[None])
        end = rho.State(flown.positions[0, -1], flown.velocities[0, -1])
        vehicles.append(rho.Vehicle(begun.name, begun.start, end, radius=radius))
    plan = _flown(grid, tuple(vehicles), accelerations)
    limits = _limits(rng, plan, length)
    separation = _separation(rng, plan)
    obstacles = _obstacles(rng, plan, radius, length)
    scenario = rho.Scenario(name, grid, vehicles, limits, obstacles, separation)
    return KnownMotion(scenario, rho.Plan.from_accelerations(scenario, accelerations))


def _flown(
    grid: rho.Grid, vehicles: tuple[rho.Vehicle, ...], accelerations: FloatArray
) -> rho.Plan:
    return rho.Plan.from_accelerations(rho.Scenario("motion", grid, vehicles), accelerations)


def _accelerations(
    rng: np.random.Generator, count: int, grid: rho.Grid, length: float
) -> FloatArray:
    """Draw accelerations of smooth motions of about a length, shape (N, K-1, 3).

    Velocities end as they begin, except for a drawn change. Half of all draws have an axis along
    which hardly anything happens, or one whose velocity changes so little that it never reverses.
    """
    steps = grid.knots - 1
    t = (np.arange(steps) + 0.5) / steps
    waves = np.array([np.cos(np.pi * k * t) for k in range(1, 5)])
    # without the mean, the velocity returns to its initial value
    waves -= waves.mean(axis=1, keepdims=True)
    weights = rng.normal(0.0, 1.0, (count, 3, 4)) / np.array([1.0, 1.5, 2.5, 4.0])
    sizes = rng.uniform(0.3, 1.0, 3)
    if rng.random() < 0.4:
        sizes[rng.integers(3)] *= 10.0 ** rng.uniform(-3.0, -1.0)
    accelerations = np.einsum("nax,xk->nka", weights * sizes[:, None], waves)
    scale: FloatArray = accelerations * 8.0 * length / grid.duration**2
    return scale


def _limits(rng: np.random.Generator, plan: rho.Plan, length: float) -> rho.Limits:
    """Return limits that the motion satisfies, with 2 to 60 % to spare."""
    motion = plan.motion()
    times = _times(plan)
    found: dict[str, object] = {}

    def around(values: FloatArray, least: float) -> rho.Box:
        lower, upper = values.min(axis=(0, 1)), values.max(axis=(0, 1))
        spare = np.maximum(upper - lower, least)
        return rho.Box(
            lower - rng.uniform(0.02, 0.6, 3) * spare, upper + rng.uniform(0.02, 0.6, 3) * spare
        )

    if rng.random() < 0.7:
        found["position"] = around(motion.at("position", times), 0.05 * length)
    velocities = motion.at("velocity", times)
    if rng.random() < 0.8:
        found["velocity"] = around(velocities, 1e-3 * length / plan.scenario.grid.duration)
    if rng.random() < 0.6:
        most = 1.0 + rng.uniform(0.02, 0.6)
        found["acceleration"] = rho.Box(
            *(sign * most * abs(plan.accelerations).max(axis=(0, 1)) for sign in (-1.0, 1.0))
        )
    if rng.random() < 0.25:
        most = 1.0 + rng.uniform(0.02, 0.6)
        found["max_speed"] = float(most * np.linalg.norm(velocities, axis=-1).max())
    if rng.random() < 0.25:
        most = 1.0 + rng.uniform(0.02, 0.6)
        found["max_acceleration"] = float(most * np.linalg.norm(plan.accelerations, axis=-1).max())
    return rho.Limits(**found)  # type: ignore[arg-type]


def _separation(rng: np.random.Generator, plan: rho.Plan) -> rho.Separation | None:
    """Return a separation that all pairs satisfy; None for one vehicle, sometimes for several."""
    x = plan.motion().at("position", _times(plan))
    if len(x) == 1 or rng.random() < 0.3:
        return None
    downwash = float(rng.choice([1.0, 2.0]))
    scaled = x / np.array([1.0, 1.0, downwash])
    least = min(
        float(np.linalg.norm(scaled[i] - scaled[j], axis=-1).min())
        for i in range(len(x))
        for j in range(i)
    )
    return rho.Separation(rng.uniform(0.5, 0.97) * least, downwash)


def _obstacles(
    rng: np.random.Generator, plan: rho.Plan, radius: float, length: float
) -> tuple[rho.Obstacle, ...]:
    """Return obstacles that the motion clears by a little, most of them on the straight path."""
    times = _times(plan)
    x = plan.motion().at("position", times)
    found = list[rho.Obstacle]()
    wanted = int(rng.integers(2, 21))
    for _ in range(40 * wanted):
        if len(found) == wanted:
            break
        who, when = rng.integers(len(x)), rng.uniform(0.1, 0.9)
        t = when * times[-1]
        straight = (1.0 - when) * x[who, 0] + when * x[who, -1]
        flown = x[who, round(when * (len(times) - 1))]
        part = rng.choice([0.0, 0.3, 0.6, 1.0], p=[0.4, 0.2, 0.2, 0.2])
        center = (1.0 - part) * straight + part * flown
        center = center + rng.normal(0.0, 0.15, 3) * length
        body = _moving(rng, _shape(rng, center, length), t, times[-1], length)
        margin = 10.0 ** rng.uniform(-2.5, -1.0) * length
        if float(body.distances(x, times).min()) > radius + body.deviation + margin:
            found.append(body)
    return tuple(found)


def _shape(rng: np.random.Generator, center: FloatArray, length: float) -> Shape:
    """Return a random shape around a centre."""
    size = length * 10.0 ** rng.uniform(-1.3, -0.3, 3)
    kind = int(rng.integers(6))
    if kind == 0:
        return rho.Sphere(center, size[0])
    if kind == 1:
        return rho.Ellipsoid(center, size)
    if kind == 2:
        return rho.Box(center - size, center + size)
    if kind == 3:
        axes: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
        return rho.Cylinder(center, size[0], 2.0 * size[1], axis=axes[rng.integers(3)])
    if kind == 4:
        return rho.Cylinder(center, size[0])
    return rho.Polytope(center + rng.normal(0.0, 1.0, (int(rng.integers(6, 12)), 3)) * size)


def _moving(
    rng: np.random.Generator, shape: Shape, t: float, duration: float, length: float
) -> rho.Obstacle:
    """Return the shape as an obstacle at a time t [s]; a third of the obstacles move."""
    drawn, center = rng.random(), np.array(shape.center)
    if drawn < 0.67:
        return rho.Obstacle(shape)
    speed = rng.normal(0.0, 0.5, 3) * length / duration
    if drawn < 0.85:
        return rho.Obstacle(_moved(shape, -speed * t), velocity=speed)
    count = int(rng.integers(2, 6))
    times = np.sort(rng.uniform(-0.2, 1.2, count)) * duration + np.arange(count) * 1e-3 * duration
    positions = center + rng.normal(0.0, 0.3, (count, 3)) * length
    deviation = float(rng.choice([0.0, 0.005])) * length
    return rho.Obstacle(shape, track=rho.Track(times, positions, deviation, after="rests"))


def _moved(shape: Shape, by: FloatArray) -> Shape:
    """Return the shape shifted."""
    if isinstance(shape, rho.Box):
        return rho.Box(shape.lower + by, shape.upper + by)
    if isinstance(shape, rho.Polytope):
        return rho.Polytope(shape.vertices + by)
    return dataclasses.replace(shape, center=shape.center + by)  # type: ignore[type-var]


def _times(plan: rho.Plan) -> FloatArray:
    """Return dense times of a flight since its first knot [s]."""
    grid = plan.scenario.grid
    times: FloatArray = np.linspace(0.0, grid.duration, (grid.knots - 1) * _DENSE + 1)
    return times
