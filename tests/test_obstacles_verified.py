"""`verify` of obstacles of every shape, moving or not, compared with samples taken by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.fleet import Fleet
from tests.arrays import FloatArray
from tests.scenarios import box, examples, fleet, single
from tests.shapes import KINDS, random_shape

PER_STEP = 400


def by_hand(plan: rho.Plan, vehicle: int, times: FloatArray) -> FloatArray:
    """Return positions of a vehicle at times on the scenario's clock, by (1) and (2) alone."""
    h, record = plan.scenario.grid.step, plan.scenario.vehicles[vehicle]
    p, v, found = record.start.position, record.start.velocity, np.zeros((len(times), 3))
    elapsed = times - plan.scenario.grid.start
    for k, a in enumerate(plan.accelerations[vehicle]):
        s = (elapsed - k * h)[:, None]
        found = np.where((s >= 0.0) | (k == 0), p + s * v + s**2 / 2 * a, found)
        p, v = p + h * v + h**2 / 2 * a, v + h * a
    return found


def places(obstacle: rho.Obstacle, times: FloatArray) -> FloatArray:
    """Return the centres of an obstacle at times, piece by piece."""
    found: FloatArray
    if obstacle.track is None:
        velocity = np.zeros(3) if obstacle.velocity is None else obstacle.velocity
        found = obstacle.shape.center + times[:, None] * velocity
        return found
    knots, at = obstacle.track.times, obstacle.track.positions
    found = np.where((times < knots[0])[:, None], at[0], at[-1])
    for one in range(len(knots) - 1):
        during = (times >= knots[one]) & (times < knots[one + 1])
        part = (times[during] - knots[one]) / (knots[one + 1] - knots[one])
        found[during] = at[one] + part[:, None] * (at[one + 1] - at[one])
    return found


def random_case(seed: int, kind: str) -> rho.Plan:
    """Return random motions near a randomly moving obstacle that is known at a random time."""
    rng = np.random.default_rng(seed)
    size, h = 10 ** rng.uniform(-2, 3), 10 ** rng.uniform(-2, 2)
    count, knots = int(rng.integers(1, 4)), int(rng.integers(2, 10))
    grid = rho.Grid(h, knots, float(rng.choice([0.0, 7.3 * h, -2.5 * h])))
    velocities = size / h * rng.normal(size=(count, 3)) * rng.integers(0, 2)
    a = size / h**2 * rng.normal(size=(count, knots - 1, 3)) * 10 ** rng.uniform(-2, 0.5)
    starts = size * rng.normal(size=(count, 3)) * 2.0
    scenario = rho.Scenario(
        "random",
        grid,
        [
            rho.Vehicle(f"v{n}", rho.State(p, v), rho.State(p), radius=float(radius))
            for n, (p, v, radius) in enumerate(
                zip(starts, velocities, size * rng.choice([0.0, 0.3], count), strict=True)
            )
        ],
        between_knots=bool(rng.integers(0, 2)),
    )
    plan = rho.Plan.from_accelerations(scenario, a)
    times = rng.uniform(grid.start, grid.end, 5)
    near = plan.motion().at("position", times - grid.start)[int(rng.integers(count))]
    shape = random_shape(rng, kind, near[0], size)
    known_from = float(rng.choice([0.0, rng.uniform(grid.start, grid.end), times[0], grid.end]))
    motion = int(rng.integers(3))
    obstacle = rho.Obstacle(
        shape,
        velocity=size / h * rng.normal(size=3) if motion == 1 else None,
        track=random_track(rng, times, near, grid) if motion == 2 else None,
        known_from=known_from,
        name="it" if rng.integers(2) else None,
    )
    asked = unchecked(scenario, obstacles=(obstacle,), bodies=(obstacle,))  # ends may be inside
    return rho.Plan(asked, plan.positions, plan.velocities, plan.accelerations)


def random_track(
    rng: np.random.Generator, times: FloatArray, places: FloatArray, grid: rho.Grid
) -> rho.Track:
    """Return a track through some places, with corners at knots too, or at a single time."""
    order = np.argsort(times)
    many = int(rng.integers(1, len(times) + 1))
    at, positions = times[order][:many], places[order][:many]
    if rng.integers(2):
        k = int(rng.integers(grid.knots))
        at[0] = grid.times[k]
        at, kept = np.unique(at, return_index=True)
        positions = positions[kept]
    return rho.Track(at, positions, deviation=float(rng.choice([0.0, 0.1])))


def check_against_samples(plan: rho.Plan) -> int:
    """Check that every row of an obstacle is the worst sampled, and attained; count the rows."""
    scenario, (obstacle,) = plan.scenario, plan.scenario.bodies
    grid, shape, name = scenario.grid, obstacle.shape, scenario.obstacle_name(1)
    late = obstacle.known_from > max(grid.start, 0.0)
    since = obstacle.known_from if late else grid.start
    dense = np.linspace(grid.start, grid.end, PER_STEP * (grid.knots - 1) + 1)
    report = rho.verify(plan)
    rows = [check for check in report.checks if check.constraint.startswith(name)]
    assert len(rows) == len(scenario.vehicles) * (4 if late else 2)
    for check in rows:
        index = scenario.index_of(check.vehicle)
        known = check.constraint == name
        assert known or check.constraint == f"{name} before it is known"
        assert check.asked == (known and (check.part == "at knots" or scenario.between_knots))
        assert check.limit == scenario.vehicles[index].radius + obstacle.deviation
        assert check.excess == check.limit - check.value
        times = grid.times if check.part == "at knots" else dense
        times = times[(times >= since) if known else (times < since)]

        def clearance(times: FloatArray, index: int = index) -> FloatArray:
            x = by_hand(plan, index, times) - places(obstacle, times)
            return shape.local_distance(x)

        scale = np.abs(plan.positions).max() + np.abs(places(obstacle, dense)).max()
        rounding = 1e-10 * (scale + shape.size)
        slack = 0.01 * check.tolerance + rounding
        assert check.value <= clearance(times).min() + slack
        assert clearance(np.array([check.time]))[0] == pytest.approx(check.value, abs=rounding)
        early = 1e-9 * grid.step
        assert check.time >= since - early if known else check.time <= since + early
        if check.part == "at knots":
            assert np.abs(grid.times - check.time).min() <= 1e-12 * (grid.end - grid.start)
            assert check.value == pytest.approx(clearance(times).min(), abs=rounding)
    return len(rows)


@pytest.mark.parametrize("kind", KINDS)
@example(seed=100149)  # as near to the polytope as to its bounding box, except for rounding
@given(seed=st.integers(0, 2**32 - 1))
@examples(few=10, many=33)
def test_the_reported_value_is_the_worst_of_all_instants(kind: str, seed: int) -> None:
    assert check_against_samples(random_case(seed, kind))


@pytest.mark.parametrize(
    ("known_from", "after", "before"),
    [(0.0, 0.5, None), (4.0, 0.5, 0.5), (6.5, -1.5, 0.5)],
    ids=["from the start", "between two meetings", "after both"],
)
def test_an_intruder_counts_from_the_time_it_is_known(
    known_from: float, after: float, before: float | None
) -> None:
    """It crosses the path at 2 s and again at 6 s, and is 1.7 m beside it from 6.5 s on."""
    where: list[list[float]] = [
        [2, 9, 0],
        [2, 0, 0],
        [2, 9, 0],
        [6, 9, 0],
        [6, 0, 0],
        [6.5, 2, 0],
        [8, 2, 0],
    ]
    track = rho.Track([1.0, 2.0, 3.0, 5.0, 6.0, 6.5, 8.0], where)
    shape = rho.Box([-0.3, -0.3, -0.3], [0.3, 0.3, 0.3])
    intruder = rho.Obstacle(shape, track=track, known_from=known_from, name="intruder")
    start, goal = rho.State([0, 0, 0], [1, 0, 0]), rho.State([8, 0, 0], [1, 0, 0])
    flown = rho.plan_convex(single(start=start, goal=goal, between_knots=True))
    vehicle = dataclasses.replace(flown.scenario.vehicles[0], radius=0.2)
    scenario = dataclasses.replace(flown.scenario, vehicles=(vehicle,), obstacles=(intruder,))
    report = rho.verify(dataclasses.replace(flown, scenario=scenario))
    found = {check.what: check for check in report.checks}
    row = found["obstacle 1 (intruder) at all times"]
    assert row.limit == 0.2
    assert row.excess == pytest.approx(after, abs=1e-6)
    assert report.ok == row.holds == (after < 0.0)
    reported = found.get("obstacle 1 (intruder) before it is known at all times")
    assert (reported is None) == (before is None)
    if reported is not None:
        assert reported.excess == pytest.approx(before, abs=1e-6)
        assert (reported.time < known_from, reported.asked) == (True, False)
        assert reported not in report.violations
        assert not report.ok or "before it is known at all times" in str(report)


def test_an_estimated_track_is_reported() -> None:
    def where(time: float) -> list[float]:
        return [5.0, 9.0 + np.sin(time), 0.0]

    shape, times = rho.Sphere([0, 0, 0], 1.0), np.linspace(0.0, 8.0, 9)
    free = rho.plan_convex(single())
    for most in (1.0, None):
        track = rho.Track.sampled(where, times, max_acceleration=most)
        scenario = single(obstacles=(rho.Obstacle(shape, track=track, name="drone"),))
        text = str(rho.verify(dataclasses.replace(free, scenario=scenario)))
        reported = (
            "estimated from samples: the deviation from the track of obstacle 1 (drone)" in text
        )
        assert reported == (most is None)


def test_all_times_are_on_the_scenarios_clock() -> None:
    """The flight is 100 s later, with obstacles that are there later too."""
    track = rho.Track([1.0, 4.0, 6.0], [[5, 5, 0], [5, 0, 0], [5, 5, 5]])
    ball, late = rho.Sphere([5.0, 2.3, -1.0], 1.0), 100.0
    starts, goals = np.array([[0, 0, 0], [0, 3, 0]]), np.array([[10, 4, -2], [10, 1, -2]])
    limits = rho.Limits(box(9), box(2), box(2), box(2), max_speed=2.0)

    def scenario(start: float) -> rho.Scenario:
        moved = rho.Track(track.times + start, track.positions)
        drifting = rho.Sphere(ball.center - start * np.array([0.1, 0.0, 0.0]), ball.radius)
        obstacles = (
            ball,
            rho.Obstacle(ball, track=moved, known_from=start + 3.3),
            rho.Obstacle(drifting, velocity=[0.1, 0.0, 0.0]),
        )
        one = fleet(starts, goals, grid=rho.Grid(0.5, 17, start))
        return unchecked(
            one,
            limits=limits,
            obstacles=obstacles,
            bodies=tuple(
                each if isinstance(each, rho.Obstacle) else rho.Obstacle(each) for each in obstacles
            ),
            fleet=Fleet(one.grid, one.vehicles, limits, 1.0),
        )

    free = rho.plan_convex(fleet(starts, goals, grid=rho.Grid(0.5, 17)).without_separation())
    early, later = (
        rho.verify(rho.Plan.from_accelerations(scenario(start), free.accelerations)).checks
        for start in (0.0, late)
    )
    assert {check.constraint for check in early} > {"separation", "position box", "goal"}
    for one, other in zip(early, later, strict=True):
        assert (one.what, one.vehicle, one.asked) == (other.what, other.vehicle, other.asked)
        assert other.value == pytest.approx(one.value, abs=1e-9)
        assert other.time == pytest.approx(one.time + late, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("huge", [1e12, 1e100, 1e300])
def test_huge_numbers_are_verified_without_warnings(kind: str, huge: float) -> None:
    """Warnings are errors in tests."""
    rng = np.random.default_rng(3)
    shape = random_shape(rng, kind, np.array([5.0, 9.0, -1.0]), 1.0)
    track = rho.Track([0.0, 3.3, 8.0], [[5, 9, -1], [5, 8, -1], [5, 9, -1]])
    scenario = single(obstacles=(shape, rho.Obstacle(shape, track=track, known_from=3.0)))
    a = np.zeros((1, 16, 3))
    a[0, 3, 2], a[0, 5] = huge, [-huge, huge, 0.0]
    report = rho.verify(rho.Plan.from_accelerations(scenario, a))
    assert not report.ok
    assert str(report)
