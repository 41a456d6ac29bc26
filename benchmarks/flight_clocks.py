"""Moving obstacles on clocks that are not representable, and vehicles that nearly hover."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.tables import Goal, Table
from drake_rho.scenario.fields import FloatArray

SCENES, HOVERING = 500, 300
"""Number of scenes of each kind."""

CLOCKS = (0.0, 1e3, 1.7e9)
"""Begins of flights, except for tenths of a second [s]: the last is the Unix time of today."""

PLACES = (0.0, 0.1, 1e3, 1e6)
"""Distances from the origin of hovering vehicles [m]."""

_DENSE = 200
"""Samples of a step."""

_VIOLATED = 2e-6
"""Depth beyond which a plan is wrong, over the obstacle's size: twice the package's tolerance."""


@dataclasses.dataclass(frozen=True)
class SceneResult:
    """Result of one scene."""

    planned: bool
    """true if it has a plan"""
    deepest: float
    """largest depth of a vehicle inside an obstacle, over its size; negative for a clearance"""
    verified: bool
    """true if `rho.verify` accepts the plan"""
    is_known: bool = False
    """true if a motion that satisfies every constraint is known"""


def run() -> Table:
    """Plan all scenes on all cores."""
    moving = on_all_cores(on_a_clock, range(SCENES), "moving obstacles")
    hovering = on_all_cores(somewhere, range(HOVERING), "hovering")
    known = [each for each in hovering if each.is_known]
    return Table(
        name="flight_clocks",
        title="Any clock, any place",
        columns=("scenes", "count", "planned", "deepest", "refused_by_verify"),
        rows=(_row("moving obstacles", moving), _row("hovering", hovering)),
        notes=(f"{_ABOUT} A motion is known for {len(known)} of those that hover.",),
        goals=(
            Goal("plans that are wrong", 0.0, sum(map(_is_wrong, moving + hovering))),
            Goal("known motions that are missed", 0.0, sum(not each.planned for each in known)),
        ),
    )


def _is_wrong(scene: SceneResult) -> bool:
    return scene.planned and (scene.deepest > _VIOLATED or not scene.verified)


def _row(name: str, found: list[SceneResult]) -> tuple[str, int, int, float, int]:
    return (
        name,
        len(found),
        sum(each.planned for each in found),
        max(each.deepest for each in found),
        sum(each.planned and not each.verified for each in found),
    )


def on_a_clock(number: int) -> SceneResult:
    """Plan one or two vehicles among obstacles with corners at odd times, drawn by the number."""
    rng = np.random.default_rng(number)
    tenths, knots = int(rng.integers(0, 100)), int(rng.integers(5, 14))
    step = float(rng.choice([0.1, 0.3, 0.5, 1.0, 1.0 / 3.0]))
    grid = rho.Grid(step, knots, CLOCKS[number % len(CLOCKS)] + 0.1 * tenths)
    way = 4.0 * grid.duration / 5.0
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([0.0, 8.0 * i, 0.0]), rho.State([way, 8.0 * i, 0.0]))
        for i in range(int(rng.integers(1, 3)))
    ]
    obstacles = []
    for i in range(int(rng.integers(1, 4))):
        corners = np.sort(rng.choice(np.arange(1, 10 * knots), 4, replace=False))
        times = grid.start + 0.1 * step * np.concatenate([[-10.0], corners])
        if i % 2:  # times added up as by a user
            times = np.cumsum(np.concatenate([[times[0]], np.diff(times)]))
        places = rng.uniform([0.1 * way, -4.0, -1.0], [0.9 * way, 4.0, 1.0], (len(times), 3))
        places[:, 1] += 8.0 * int(rng.integers(len(vehicles)))
        shape = rho.Sphere([0, 0, 0], 0.3) if rng.integers(2) else rho.Box([-0.3] * 3, [0.3] * 3)
        obstacles.append(rho.Obstacle(shape, track=rho.Track(times, places, after="rests")))
    try:
        scenario = rho.Scenario("clock", grid, vehicles, obstacles=obstacles)
        flown = rho.plan(scenario) if number % 2 else rho.plan_rho(scenario, replan_every=3)
    except (rho.ScenarioError, rho.InfeasibleError):
        return SceneResult(False, -np.inf, True)
    plan = flown.plan if isinstance(flown, rho.Flight) else flown
    return SceneResult(True, deepest(plan), rho.verify(flown).ok)


def somewhere(number: int) -> SceneResult:
    """Plan a vehicle that hovers, or nearly, while an obstacle passes, drawn by the number.

    The known motion moves to one side and back, with an acceleration in four pieces.
    """
    rng = np.random.default_rng(number)
    knots, step = 4 * int(rng.integers(2, 6)) + 1, float(rng.choice([0.25, 0.5]))
    grid = rho.Grid(step, knots, float(rng.choice([0.0, 0.1, 1.7e9])))
    at = rng.normal(size=3) + PLACES[number % len(PLACES)] * rng.choice([-1.0, 0.0, 1.0], 3)
    hop = float(rng.choice([0.0, 1e-6, 1e-3, 0.1])) * rng.normal(size=3)
    T, radius = grid.duration, float(rng.uniform(0.05, 0.5))
    side, passes = rng.uniform(0.0, 0.8) * radius, rng.uniform(0.3, 0.7) * T
    far = 3.0 + 2.0 * radius
    places = at + np.array([[side, -far, 0.0], [side, 0.0, 0.0], [side, far, 0.0]])
    track = rho.Track(grid.start + np.array([0.0, passes, T]), places)
    scenario = rho.Scenario(
        "hover",
        grid,
        [rho.Vehicle("v", rho.State(at), rho.State(at + hop))],
        obstacles=[rho.Obstacle(rho.Sphere(at, radius), track=track)],
    )
    known = _aside(scenario, 4.0 * radius)
    is_known = known is not None and rho.verify(known).ok
    try:
        plan = rho.plan(scenario)
    except rho.InfeasibleError:
        return SceneResult(False, -np.inf, True, is_known)
    return SceneResult(True, deepest(plan), rho.verify(plan).ok, is_known)


def _aside(scenario: rho.Scenario, far: float) -> rho.Plan | None:
    """Return the motion `far` [m] to one side and back while going to the goal."""
    grid, vehicle = scenario.grid, scenario.vehicles[0]
    quarter = (grid.knots - 1) // 4
    pieces = np.repeat([-1.0, 1.0, 1.0, -1.0], quarter)
    a = np.zeros((1, grid.knots - 1, 3))
    a[0, :, 0] = pieces * far / (quarter * grid.step) ** 2
    way = vehicle.goal.position - vehicle.start.position
    half = (grid.knots - 1) // 2
    a[0, :half] += way / (half * grid.step) ** 2
    a[0, half:] -= way / (half * grid.step) ** 2
    return rho.Plan.from_accelerations(scenario, a)


def deepest(plan: rho.Plan) -> float:
    """Return the largest depth inside an obstacle over its size, by dense samples.

    Times are measured from the first knot, also those of the obstacles' tracks.
    """
    scenario, worst = plan.scenario, -np.inf
    h, (p, v, a) = scenario.grid.step, (plan.positions, plan.velocities, plan.accelerations)
    parts = h * np.arange(_DENSE + 1)[:, None] / _DENSE
    x = p[:, :-1, None] + parts * (v[:, :-1, None] + parts / 2.0 * a[:, :, None])
    times = (scenario.grid.elapsed[:-1, None] + parts[:, 0]).reshape(-1)
    for body in scenario.bodies:
        track = body.track
        if track is None:
            continue
        since = track.times - scenario.grid.start
        center = np.stack([np.interp(times, since, axis) for axis in track.positions.T], axis=-1)
        distances = _distances(body.shape, x.reshape(len(x), -1, 3) - center)
        worst = max(worst, float(-distances.min()) / body.shape.size)
    return worst


def _distances(shape: object, x: FloatArray) -> FloatArray:
    """Return distances from a ball or a cube, without the package's own."""
    if isinstance(shape, rho.Sphere):
        return np.asarray(np.linalg.norm(x, axis=-1) - shape.radius)
    beyond = np.abs(x) - 0.3
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


_ABOUT = f"""\
Moving obstacles: one or two vehicles and up to three balls and cubes with four corners in their
tracks, at multiples of a tenth of a step, on clocks that begin at tenths of a second after
{CLOCKS[0]:g}, {CLOCKS[1]:g} and {CLOCKS[2]:g} s, by `rho.plan` and `rho.plan_rho` in turn; scenes
with starts or goals inside an obstacle, and those without a plan, are left out. Hovering: a
vehicle whose goal is its start, or up to some 0.1 m away, with a ball that passes within its own
radius, up to {PLACES[-1]:g} m from the origin. Deepest: the largest depth at {_DENSE} instants in
each step, over the obstacle's size; a plan deeper than {_VIOLATED:g} is wrong."""
