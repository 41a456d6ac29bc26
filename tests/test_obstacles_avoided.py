"""Obstacles of every shape, at rest and moving, are avoided at every instant."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.penetration import deepest, pieces_near
from drake_rho.planning.constraints.margins import without_errors
from drake_rho.planning.constraints.shapes_together import ShapesTogether
from drake_rho.planning.programs.backend import Solver
from tests.arrays import FloatArray
from tests.motions import from_start
from tests.scenarios import slow
from tests.shapes import KINDS, Shape, random_shape

seeds = st.integers(0, 2**32 - 1)

SAME = 1e-4
"""Relative difference of costs found by iterations that stop at 1e-6."""

SHAPES: dict[str, Shape] = {
    "sphere": rho.Sphere([5.0, 2.0, -1.0], 1.5),
    "box": rho.Box([4.0, 1.2, -2.0], [6.5, 3.0, 0.0]),
    "ellipsoid": rho.Ellipsoid([5.0, 2.0, -1.2], [1.0, 2.0, 0.7]),
    "cylinder": rho.Cylinder([5.0, 2.2, -1.0], 1.0, 3.0),
    "endless cylinder": rho.Cylinder([5.0, 2.2, -1.0], 1.0),
    "polytope": rho.Polytope(
        np.array([[4, 1, -2], [6, 1.5, -2], [4.5, 3.2, -2], [5, 2, 0.8], [6, 3, -0.5], [4, 1.5, 0]])
    ),
}


def flight(*obstacles: Shape | rho.Obstacle, radius: float = 0.2) -> rho.Scenario:
    """Return one vehicle whose straight path passes (5, 2, -1) after 4 s."""
    vehicle = rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([10, 4, -2]), radius=radius)
    limits = rho.Limits(acceleration=rho.Box([-3] * 3, [3] * 3))
    return rho.Scenario("flight", rho.Grid(0.4, 21), (vehicle,), limits, obstacles)


def clearance(plan: rho.Plan, per_step: int = 200) -> float:
    """Return the least sampled distance of any vehicle and obstacle, less radius and deviation."""
    grid, least = plan.scenario.grid, np.inf
    elapsed = np.linspace(0.0, grid.duration, per_step * (grid.knots - 1) + 1)
    positions = plan.motion().at("position", elapsed)
    for body in plan.scenario.bodies:
        d = body.shape.local_distance(positions - body.centers(grid.start + elapsed))
        kept = np.array([vehicle.radius for vehicle in plan.scenario.vehicles]) + body.deviation
        least = min(least, float((d - kept[:, None]).min()))
    return least


def moving(shape: Shape) -> list[rho.Obstacle]:
    """Return the shape with a velocity, and along a polyline that crosses the path."""
    at = shape.center
    offsets = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 0.0], [0.3, 0.4, 0.0], [4.0, 0.0, 0.0]])
    track = rho.Track([0.0, 3.0, 4.5, 8.0], at + offsets)
    return [
        rho.Obstacle(shape, velocity=[0.15, -0.1, 0.05]),
        rho.Obstacle(shape, track=track),
    ]


@pytest.mark.parametrize("kind", SHAPES)
def test_every_shape_is_avoided_and_has_an_effect(kind: str) -> None:
    shape = SHAPES[kind]
    obstacles: list[Shape | rho.Obstacle] = [shape, *moving(shape)]
    for obstacle in obstacles:
        scenario = flight(obstacle)
        plan = rho.plan(scenario)
        free = rho.plan(scenario.without_obstacles())
        assert rho.verify(plan).ok
        assert clearance(plan) >= -2.0 * shape.tolerance
        through = rho.Plan.from_accelerations(scenario, free.accelerations)
        if clearance(through) < -1e-3:
            assert plan.cost > free.cost * (1.0 + SAME)
        else:
            assert plan.cost == pytest.approx(free.cost, rel=SAME)


@pytest.mark.parametrize(
    "kind", ["sphere", "ellipsoid", *slow("box", "cylinder", "endless cylinder", "polytope")]
)
def test_a_moving_obstacle_with_zero_velocity_equals_one_at_rest(kind: str) -> None:
    shape = SHAPES[kind]
    still = rho.plan(flight(shape))
    for obstacle in (
        rho.Obstacle(shape, velocity=[0, 0, 0]),
        rho.Obstacle(shape, track=rho.Track([1.0], [shape.center])),
    ):
        np.testing.assert_allclose(rho.plan(flight(obstacle)).positions, still.positions, atol=1e-6)


def test_a_box_as_a_polytope_gives_the_same_plan() -> None:
    box = SHAPES["box"]
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T
    corners = rho.Polytope(box.center + signs * box.extent)
    one, other = rho.plan(flight(box)), rho.plan(flight(corners))
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-5)


def test_a_sphere_as_an_ellipsoid_gives_the_same_plan() -> None:
    ball = SHAPES["sphere"]
    assert isinstance(ball, rho.Sphere)
    ellipsoid = rho.Ellipsoid(ball.center, [ball.radius] * 3)
    one, other = rho.plan(flight(ball)), rho.plan(flight(ellipsoid))
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-6)
    assert rho.certify(other).lower_bound == pytest.approx(rho.certify(one).lower_bound, rel=SAME)


def test_a_larger_vehicle_equals_a_larger_sphere() -> None:
    one = rho.plan(flight(rho.Sphere([5, 2, -1.2], 1.5), radius=0.3))
    other = rho.plan(flight(rho.Sphere([5, 2, -1.2], 1.8), radius=0.0))
    assert one.cost == pytest.approx(other.cost, rel=1e-7)
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-3)


QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
SHIFT = np.array([30.0, -20.0, 5.0])


def turned(shape: Shape, scale: float) -> Shape:
    """Return the shape turned by 90 degrees about z, shifted and scaled."""

    def at(x: FloatArray) -> FloatArray:
        moved: FloatArray = scale * (x @ QUARTER.T + SHIFT)
        return moved

    center, extent = (
        at(shape.center),
        scale * np.abs(QUARTER) @ np.nan_to_num(shape.extent, posinf=1.0),
    )
    if isinstance(shape, rho.Sphere):
        return rho.Sphere(center, scale * shape.radius)
    if isinstance(shape, rho.Box):
        return rho.Box(center - extent, center + extent)
    if isinstance(shape, rho.Ellipsoid):
        return rho.Ellipsoid(center, extent)
    if isinstance(shape, rho.Cylinder):
        height = None if shape.height is None else scale * shape.height
        return rho.Cylinder(center, scale * shape.radius, height)
    assert isinstance(shape, rho.Polytope)
    return rho.Polytope(at(shape.vertices))


@pytest.mark.parametrize(
    "kind", [*slow("box", "polytope"), "sphere", "ellipsoid", "cylinder", "endless cylinder"]
)
@pytest.mark.parametrize("scale", [*slow(1.0), 25.0])
def test_a_turned_shifted_and_scaled_scenario_has_the_same_plan(kind: str, scale: float) -> None:
    shape = SHAPES[kind]
    one = rho.plan(flight(shape))
    old = one.scenario.vehicles[0]
    ends = [rho.State(scale * (QUARTER @ each.position + SHIFT)) for each in (old.start, old.goal)]
    vehicle = rho.Vehicle("solo", ends[0], ends[1], radius=scale * old.radius)
    limits = rho.Limits(acceleration=rho.Box([-3 * scale] * 3, [3 * scale] * 3))
    scenario = rho.Scenario(
        "turned", rho.Grid(0.4, 21), (vehicle,), limits, (turned(shape, scale),)
    )
    other = rho.plan(scenario)
    assert other.cost == pytest.approx(scale**2 * one.cost, rel=SAME)


def test_the_order_of_obstacles_does_not_matter() -> None:
    shapes: list[Shape] = [rho.Box([2, -1, -2], [3, 0.9, 1]), rho.Cylinder([7, 3.5, 0], 0.5)]
    one, other = rho.plan(flight(*shapes)), rho.plan(flight(*reversed(shapes)))
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-6)


@given(seed=seeds, kind=st.sampled_from(sorted(KINDS)), moves=st.booleans())
@settings(max_examples=20)
def test_the_deepest_instants_agree_with_dense_samples(seed: int, kind: str, moves: bool) -> None:
    rng = np.random.default_rng(seed)
    shape = random_shape(rng, kind, rng.normal(size=3), 1.0)
    track = rho.Track(np.sort(rng.uniform(0, 6, 4)), rng.normal(size=(4, 3)))
    obstacle = rho.Obstacle(shape, track=track if moves else None)
    start, step = float(rng.uniform(-1, 2)), 0.5
    motion = from_start(
        rho.State(2 * rng.normal(size=3), rng.normal(size=3)), rng.normal(size=(8, 3)), step
    )
    parts = (each for each in dataclasses.astuple(motion)[1:] if each is not None)
    motions = Motion(step, *(each[None] for each in parts))
    below = np.array([rng.uniform(-0.2, 0.5)])
    pieces = pieces_near(motions, obstacle.since(rho.Grid(step, 9, start)), np.maximum(below, 0.0))
    tolerances = np.full(len(pieces.owners), shape.tolerance)
    which, times = deepest(shape, pieces, below[pieces.owners], tolerances)
    found = dict(zip(pieces.times[which].tolist(), times.tolist(), strict=True))

    def distances(at: FloatArray) -> FloatArray:
        x = motions.at("position", at)[0] - obstacle.centers(start + at)
        return shape.local_distance(x)

    cuts = obstacle.corners - start
    edges = np.union1d(step * np.arange(9), cuts[(cuts > 0) & (cuts < 4.0)])
    for begin, end in pairwise(edges.tolist()):
        dense = float(distances(np.linspace(begin, end, 2001)).min())
        instants = [time for time in found.values() if begin - 1e-12 <= time <= end + 1e-12]
        if dense < below[0] - 1e-9:
            assert instants, "a piece that penetrates is found"
            assert min(distances(np.array(instants))) <= dense + 1e-8 * shape.size
        for time in instants:
            assert distances(np.array([time]))[0] < below[0] + 1e-12 or dense < below[0]


def _bodies(rng: np.random.Generator, count: int, step: float) -> list[rho.Obstacle]:
    """Return obstacles of every kind, at rest, moving, for a time, or more and more uncertain."""
    kinds = [*sorted(KINDS), "sphere", "sphere"]  # of balls, all are solved at once
    bodies = []
    for number in range(count):
        shape = random_shape(rng, kinds[number % len(kinds)], rng.normal(size=3), 1.0)
        changes: list[dict[str, object]] = [
            {},
            {"velocity": rng.normal(size=3)},
            {"velocity": rng.normal(size=3), "velocity_error": 0.1, "seen_at": 0.0},
            {"active": (2 * step, 5 * step)},  # with corners within the flight
        ]
        change = changes[int(rng.integers(4 if number > 0 else 3))]
        bodies.append(rho.Obstacle(shape, **change))  # type: ignore[arg-type]
    return bodies


@given(seed=seeds, count=st.integers(1, 14), vehicles=st.integers(1, 3))
@settings(max_examples=20)
def test_obstacles_are_as_deep_together_as_each_alone(seed: int, count: int, vehicles: int) -> None:
    rng, step, grid = np.random.default_rng(seed), 0.5, rho.Grid(0.5, 9)
    one = from_start(
        rho.State(2 * rng.normal(size=3), rng.normal(size=3)), rng.normal(size=(8, 3)), step
    )
    columns = (each for each in dataclasses.astuple(one)[1:] if each is not None)
    motion = Motion(step, *(np.stack([each] * vehicles) for each in columns))
    motion.positions[...] += rng.normal(size=(vehicles, 1, 3))
    bodies = [each.since(grid) for each in _bodies(rng, count, step)]
    required = [rng.uniform(0.0, 0.5, vehicles) for _ in bodies]
    tolerances = [np.full(vehicles, each.shape.tolerance) for each in bodies]
    group = [number for each in ShapesTogether.groups(bodies, motion) for number in each]
    assert group == [number for number, each in enumerate(bodies) if each.active is None]
    together = ShapesTogether(
        [bodies[number] for number in group],
        [required[number] for number in group],
        [tolerances[number] for number in group],
        without_errors(grid),
        motion,
    )
    everyone = np.arange(vehicles)
    for number, index in enumerate(group):
        whose, times = together.deepest_instants(number, motion, everyone, 0.0)
        body, below = bodies[index], required[index]
        pieces = pieces_near(motion, body, below)
        depth = np.full(len(pieces.owners), body.shape.tolerance)
        which, alone = deepest(body.shape, pieces, below[pieces.owners], depth)
        np.testing.assert_array_equal(whose, pieces.owners[which])
        np.testing.assert_allclose(times, alone, rtol=0.0, atol=1e-9)


def late(known_from: float, **changes: object) -> rho.Scenario:
    """Return a vehicle that flies along x through an obstacle that is seen late."""
    vehicle = rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([10, 0, 0]), radius=0.2)
    bird = rho.Obstacle(rho.Sphere([5, 0.1, 0], 0.8), known_from=known_from, name="bird")
    limits = rho.Limits(acceleration=rho.Box([-2] * 3, [2] * 3))
    return rho.Scenario("late", rho.Grid(0.2, 41), (vehicle,), limits, (bird,))


def test_an_obstacle_seen_in_time_is_avoided() -> None:
    flown = rho.plan_rho(late(2.0))
    report = rho.verify(flown)
    assert report.ok
    (sighting,) = flown.sightings
    assert (sighting.time, sighting.avoided) == (2.0, True)
    assert "became known at 2 s and was avoided" in str(report)
    assert not rho.verify(flown.windows[0].plan).ok  # the obstacle was still unknown


def test_an_obstacle_seen_too_late_is_reported_and_the_flight_continues(tmp_path: object) -> None:
    flown = rho.plan_rho(late(3.6))
    report = rho.verify(flown)
    assert not report.ok
    assert {check.constraint for check in report.violations} == {"obstacle 1 (bird)"}
    assert not flown.sightings[0].avoided
    assert "was not avoided" in str(report)
    window = next(window for window in flown.windows if window.learned)
    assert window.not_avoided == (1,)
    assert "bird" in window.infeasible
    path = f"{tmp_path}/late.npz"
    rho.save(flown, path)
    again = rho.load(path)
    assert isinstance(again, rho.Flight)
    assert again.sightings == flown.sightings


@pytest.mark.parametrize("planner", [rho.plan_rho, rho.simulate])
@pytest.mark.parametrize(("x", "avoided"), [(5.0, True), (9.68, False)])
def test_an_obstacle_seen_after_the_last_window_is_reported(
    x: float, avoided: bool, planner: Callable[[rho.Scenario], rho.Flight | rho.Simulation]
) -> None:
    scenario = late(7.1)
    bird = dataclasses.replace(scenario.bodies[0], shape=rho.Sphere([x, 0, 0], 0.1))
    flown = planner(dataclasses.replace(scenario, obstacles=(bird, late(2.0).bodies[0])))
    flight = flown.flight if isinstance(flown, rho.Simulation) else flown
    assert flight.windows[-1].plan.scenario.grid.start == 7.0
    first, last = flight.sightings
    assert (first.obstacle, first.time, first.planned_for) == ("obstacle 2 (bird)", 2.0, True)
    assert (last.obstacle, last.time, last.planned_for) == ("obstacle 1 (bird)", 7.1, False)
    assert not last.avoided  # it was unknown to every plan
    report = rho.verify(flown)
    assert report.sightings[1].avoided == report.ok == avoided
    assert "known at 7.1 s, after the last window began, so that no plan takes it" in str(report)


def test_a_flight_with_windows_that_begin_inside_an_obstacle_can_be_copied() -> None:
    flown = rho.plan_rho(late(3.6))
    inside = next(window.plan.scenario for window in flown.windows if window.not_avoided)
    with pytest.raises(rho.ScenarioError):  # a scenario must not begin with such a state
        dataclasses.replace(inside, name="anew")
    sent = pickle.loads(pickle.dumps(flown))  # noqa: S301  # made here
    for other in (copy.copy(flown), copy.deepcopy(flown), sent):
        assert other.sightings == flown.sightings
        for one, same in zip(other.windows, flown.windows, strict=True):
            assert one.plan.scenario == same.plan.scenario
            np.testing.assert_array_equal(one.plan.positions, same.plan.positions)
        with pytest.raises(ValueError, match="read-only"):
            other.scenario.vehicles[0].start.position[0] = 1.0
    assert str(rho.verify(sent)) == str(rho.verify(flown))


def test_windows_that_begin_inside_an_obstacle_search_no_path_around_it() -> None:
    """Such windows are the first that knows the obstacle, and later ones inside it."""
    asked = list[float]()

    def planner(
        scenario: rho.Scenario, *, reference: rho.Plan | None, solver: Solver | None
    ) -> rho.Plan:
        asked.append(scenario.grid.start)
        return rho.plan_convex(scenario, reference=reference, solver=solver)

    asks = late(3.8)
    flown = rho.plan_rho(asks, replan_every=1, planner=planner)
    windows = [each.plan for each in flown.windows if each.plan.scenario.known]
    inside = {
        plan.times[0]
        for plan in windows
        if asks.bodies[0].shape.local_distance(plan.positions[0, 0] - [5, 0.1, 0]) < 0.2 - 1e-3
    }
    assert len(inside) >= 2
    assert windows[0].times[0] in inside
    assert inside.isdisjoint(asked)
    assert {plan.times[0] for plan in windows} - inside <= set(asked)


def test_windows_use_the_position_of_an_obstacle_at_their_times() -> None:
    """On a clock that restarts in each window, a late crossing would not be seen."""
    gate = rho.Obstacle(rho.Box([4.5, -3, -3], [5.5, 3, 3]), velocity=[0, 1.2, 0])
    scenario = dataclasses.replace(late(0.0), obstacles=(gate,))
    flown = rho.plan_rho(scenario, replan_every=4)
    assert rho.verify(flown).ok
    assert [window.plan.scenario.grid.start for window in flown.windows] == pytest.approx(
        [0.8 * number for number in range(10)]
    )
    shifted = dataclasses.replace(
        scenario,
        grid=rho.Grid(0.2, 41, start=100.0),
        obstacles=(rho.Obstacle(rho.Box([4.5, -123, -3], [5.5, -117, 3]), velocity=[0, 1.2, 0]),),
    )
    assert rho.plan(shifted).cost == pytest.approx(rho.plan(scenario).cost, rel=1e-6)


@pytest.mark.slow
def test_the_bound_includes_obstacles_of_every_shape() -> None:
    for kind in ("sphere", "ellipsoid"):
        for obstacle in moving(SHAPES[kind]):
            certificate = rho.certify(rho.plan(flight(obstacle)))
            assert not certificate.left_out
            assert -1e-6 < certificate.gap < 0.05
    plan, free = rho.plan(flight(SHAPES["box"])), rho.plan(flight()).cost
    certificate = rho.certify(plan)
    assert certificate.left_out == ()
    assert free * (1 - 1e-9) <= certificate.lower_bound <= plan.cost
