"""The tube in plans: limits hold throughout the tube, at the right cost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.constraints.margins import margins_of
from drake_rho.planning.constraints.tightening import enlarged_by_margins, missing_slack
from tests.arrays import FloatArray
from tests.disturbed import tracked
from tests.scenarios import box, fleet, random_fleet, random_scenario, single, slow
from tests.shapes import KINDS, random_shape


def disturbed(scenario: rho.Scenario, seed: int, part: float = 0.1) -> rho.Scenario:
    """Return the scenario with wind of a fraction of the accelerations that its goals require."""
    rng, grid = np.random.default_rng(seed), scenario.grid
    size = part * float(scenario.fleet.scale("acceleration").min()) * rng.uniform(0.2, 1.0)
    samples, errors = int(rng.integers(1, 6)), float(rng.integers(0, 2)) * 0.2
    disturbance = rho.Disturbance(
        size,
        errors * size * (grid.step / samples) ** 2,
        errors * size * grid.step / samples,
        feedback_every=grid.step / samples,
        delay=int(rng.integers(0, 2)),
    )
    return dataclasses.replace(scenario, disturbance=disturbance)


def least_margin(plan: rho.Plan, per_step: int = 100) -> float:
    """Return the least margin of any vehicle anywhere in its tube, over the constraint's scale.

    It is sampled, with the exact radius of each instant.
    """
    scenario, tube, motion = plan.scenario, rho.error_tube(plan.scenario), plan.motion()
    fleet, grid = scenario.fleet, scenario.grid
    since = np.linspace(0.0, grid.duration, per_step * (grid.knots - 1) + 1)
    times = np.minimum(grid.start + since, grid.end)
    x, v = motion.at("position", since), motion.at("velocity", since)
    a, r = motion.at("acceleration", since), tube.position(times)
    radii = {"position": r, "velocity": tube.velocity(times), "acceleration": _around(tube, times)}
    values = {"position": x, "velocity": v, "acceleration": a}
    left = [np.inf]
    for quantity in ("position", "velocity", "acceleration"):
        value, radius = values[quantity], radii[quantity]
        scale = fleet.scale(quantity)[:, None]
        if (bounds := fleet.bounds(quantity)) is not None:
            sides = [value - bounds.lower[:, None], bounds.upper[:, None] - value]
            rooms = np.minimum(*sides).min(axis=2) - radius
            left.append(float((rooms / scale).min()))
        for limit in fleet.norms.values():
            if limit.kind.quantity == quantity:
                for i, each in enumerate(value):
                    outside = limit.sets.signed_distance(np.full(len(each), i), each) + radius
                    left.append(-float(outside.max()) / float(scale[i, 0]))
    for _, obstacle in scenario.known:
        kept = fleet.radii[:, None] + obstacle.deviation + r
        rooms = (obstacle.distances(x, times) - kept) / obstacle.shape.size
        left.append(float(rooms.min()))
    if scenario.separation is not None:
        one, other = np.triu_indices(len(x), 1)
        rooms = scenario.separation.shape.local_distance(x[one] - x[other]) - 2.0 * r
        left.append(float(rooms.min()) / scenario.separation.distance)
    return min(left)


def _around(tube: rho.ErrorTube, times: FloatArray) -> FloatArray:
    """Return the feedback's radius, at a sample the larger of both sides."""
    before = np.maximum(times - 1e-3 * tube.sample, times[0])
    after = np.minimum(times + 1e-3 * tube.sample, times[-1])
    return np.maximum(tube.acceleration(before), tube.acceleration(after))


def world(seed: int) -> rho.Scenario:
    """Return one vehicle with a radius among shapes of all kinds, some of them moving."""
    rng = np.random.default_rng(seed)
    obstacles: list[rho.Obstacle] = []
    for _ in range(int(rng.integers(1, 7))):
        shape = random_shape(rng, rng.choice(sorted(KINDS)), rng.uniform(2.0, 8.0, 3), 1.5)
        moving = rng.normal(size=3) * 0.3 if rng.random() < 0.4 else None
        obstacles.append(rho.Obstacle(shape, velocity=moving))
    limits = rho.Limits(
        velocity=box(4.0) if seed % 2 else None,
        acceleration=None if seed % 3 == 0 else box(4.0),
        max_speed=None if seed % 2 else 4.0,
        max_acceleration=4.0 if seed % 3 == 0 else None,
        max_thrust=14.0 if seed % 5 == 0 else None,
        max_tilt=0.6 if seed % 4 == 0 else None,
    )
    vehicle = rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([10, 10, 10]), radius=0.2)
    return rho.Scenario("world", rho.Grid.lasting(10.0, step=0.5), [vehicle], limits, obstacles)


@pytest.mark.parametrize("seed", [2, 5, *slow(0, 1, 3, 4, *range(6, 25))])
def test_every_limit_holds_anywhere_in_the_tube(seed: int) -> None:
    plans = 0
    for scenario in (
        world(seed),
        random_scenario(seed, between_knots=True),
        random_fleet(seed),
    ):
        try:
            plan = rho.plan(disturbed(scenario, seed))
        except (rho.InfeasibleError, rho.ScenarioError):
            continue
        assert margins_of(plan.scenario).steps.largest > 0.0
        assert least_margin(plan) > -1e-5
        plans += 1
    assert plans > 0


def in_constant_tube(scenario: rho.Scenario, disturbance: rho.Disturbance) -> rho.Scenario:
    """Return the scenario in a converged tube: its radii are constant."""
    grid = scenario.grid
    gains = rho.error_tube(dataclasses.replace(scenario, disturbance=disturbance)).gains
    tracking = tracked(grid.start - 400.0 * grid.step, gains)
    around = dataclasses.replace(disturbance, tracking=tracking)
    return dataclasses.replace(scenario, disturbance=around)


def test_a_constant_tube_equals_smaller_boxes_and_larger_vehicles() -> None:
    limits = rho.Limits(
        position=box(11.0), velocity=box(2.1), acceleration=box(1.2), max_speed=2.5, jerk=box(4.0)
    )
    obstacles = [rho.Sphere([5.0, 2.2, -1.4], 1.5)]
    scenario = single(limits=limits, obstacles=obstacles, between_knots=True)
    windy = in_constant_tube(scenario, rho.Disturbance(0.1, feedback_every=0.1, share=0.2))
    margins = margins_of(windy).steps
    assert all(np.ptp(each) < 1e-12 for each in margins.steps.values())
    r, v, a = (float(margins.steps[q][0]) for q in ("position", "velocity", "acceleration"))
    assert min(r, v, a) > 0.0
    smaller = rho.Limits(
        position=box(11.0 - r),
        velocity=box(2.1 - v),
        acceleration=box(1.2 - a),
        max_speed=2.5 - v,
        jerk=box(4.0),
    )
    vehicle = dataclasses.replace(scenario.vehicles[0], radius=r)
    twin = dataclasses.replace(scenario, limits=smaller, vehicles=(vehicle,))
    one, other = rho.plan(windy), rho.plan(twin)
    assert one.cost > 1.0001 * rho.plan(scenario).cost
    assert one.cost == pytest.approx(other.cost, rel=1e-6)


def test_the_separation_of_a_fleet_grows_by_the_tube() -> None:
    scenario = fleet([[0.0, 0, 0], [8, 0.1, 0]], [[8.0, 0, 0], [0, 0.1, 0]])
    windy = in_constant_tube(scenario, rho.Disturbance(0.05, feedback_every=0.25))
    r = margins_of(windy).steps.largest
    larger = dataclasses.replace(scenario, separation=rho.Separation(1.0 + 2.0 * r))
    assert rho.plan(windy).cost == pytest.approx(rho.plan(larger).cost, rel=1e-6)


def test_downwash_scales_no_margin() -> None:
    start, goal = [[0.0, 0, 0], [0, 0, 4.0]], [[0.0, 0, 4], [0.1, 0, 0]]
    scenario = fleet(start, goal, separation=rho.Separation(0.5, downwash=3.0))
    plan = rho.plan(in_constant_tube(scenario, rho.Disturbance(0.2, feedback_every=0.1)))
    assert -1e-6 < least_margin(plan) < 1e-3


def test_tolerances_of_waypoints_shrink_by_the_radius_at_their_time() -> None:
    waypoint = rho.Waypoint(2.0, [4.0, 3.0, 0.0], within=0.5)
    scenario = single(waypoints=[waypoint])
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.3, feedback_every=0.25))
    plan = rho.plan(windy)
    away = np.linalg.norm(plan.motion().at("position", 2.0)[0, 0] - waypoint.position)
    assert away == pytest.approx(0.5 - float(rho.error_tube(windy).position(2.0)), abs=1e-6)


def test_the_margin_of_a_step_is_its_largest_radius() -> None:
    scenario = single(limits=rho.Limits(acceleration=box(3.0)), between_knots=True)
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.3, 0.01, 0.02, 0.1, 1))
    margins, tube, grid = margins_of(windy).steps, rho.error_tube(windy), windy.grid
    since = np.linspace(0.0, grid.duration, 16 * 400 + 1)
    radius = tube.position(np.minimum(since, grid.end)).reshape(-1)
    for k, margin in enumerate(margins.steps["position"]):
        most = radius[400 * k : 400 * k + 401].max()
        assert most <= margin + 1e-12
        assert margin <= 1.01 * most + 1e-12
    knots = margins.at("position", grid.elapsed)
    inside = margins.at("position", grid.elapsed[:-1] + 0.3 * grid.step)
    np.testing.assert_array_equal(inside, margins.steps["position"])
    np.testing.assert_array_equal(knots[1:-1], np.maximum(inside[:-1], inside[1:]))


def test_the_rest_of_a_plan_has_the_rest_of_its_tube() -> None:
    scenario = single(limits=rho.Limits(acceleration=box(3.0)))
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.3, 0.01, 0.02, 0.1, 1))
    plan = rho.plan(windy)
    whole, rest = rho.error_tube(windy), rho.error_tube(plan.tail(3).tail(2).scenario)
    times = np.linspace(5 * windy.grid.step, windy.grid.end, 77)
    for quantity in ("position", "velocity", "acceleration"):
        ours, theirs = getattr(rest, quantity)(times), getattr(whole, quantity)(times)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    assert least_margin(plan.tail(5)) > 0.0


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"limits": rho.Limits(velocity=box(1.6))}, "velocity box"),
        ({"limits": rho.Limits(max_speed=1.6)}, "maximum speed"),
        ({"limits": rho.Limits(position=box(10.2))}, "position box (goal 0.2 m inside"),
        ({"obstacles": [rho.Sphere([10.0, 5.2, -2.0], 1.0)]}, "obstacle 1 (goal 0.2 m inside"),
        ({"waypoints": [rho.Waypoint(2.0, [4.0, 3.0, 0.0], 0.1)]}, "waypoint 1 (middle 0.1 m"),
    ],
)
def test_missing_slack_is_named_with_the_largest_tolerable_wind(
    changed: dict[str, object], expected: str
) -> None:
    scenario = single(between_knots=True, **changed)  # type: ignore[arg-type]
    disturbance = rho.Disturbance(2.0, feedback_every=0.5, share=1.0)
    for planner in (rho.plan, rho.plan_convex):
        with pytest.raises(rho.InfeasibleError) as caught:
            planner(dataclasses.replace(scenario, disturbance=disturbance))
        assert expected in str(caught.value)
        assert "no room for the errors" in str(caught.value)
    bearable = caught.value.bearable
    assert bearable is not None
    gains = rho.error_tube(dataclasses.replace(scenario, disturbance=disturbance)).gains
    tracking = tracked(0.0, gains)
    for part, borne in ((0.98, True), (1.02, False)):
        around = dataclasses.replace(disturbance, acceleration=part * bearable, tracking=tracking)
        weaker = dataclasses.replace(scenario, disturbance=around)
        assert (missing_slack(weaker, margins_of(weaker)) == {}) == borne


def test_starts_and_goals_of_pairs_need_distance_for_both_errors() -> None:
    scenario = fleet([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]], [[8.0, 0.0, 0.0], [8.0, 1.3, 0.0]])
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(2.0, feedback_every=0.5))
    with pytest.raises(rho.InfeasibleError, match=r"separation \(goal 0.15 m inside, of 0."):
        rho.plan(windy)


@pytest.mark.parametrize("seed", range(3))
def test_subdivided_steps_are_the_same_motion(seed: int) -> None:
    motion = rho.plan_convex(random_scenario(seed)).motion()
    finer = motion.subdivided(7)
    times = np.linspace(0.0, motion.step * motion.accelerations.shape[1], 301)
    for quantity in ("position", "velocity"):
        expected = motion.at(quantity, times)
        size = float(np.abs(expected).max())
        np.testing.assert_allclose(finer.at(quantity, times), expected, atol=1e-9 * size)
    assert motion.subdivided(1) is motion


SHORT_OF_ROOM: dict[str, rho.Scenario] = {
    "a start that is left at once": single(
        obstacles=[rho.Sphere([-1.2, 0.0, 0.0], 1.0)], between_knots=True
    ),
    "a speed that is needed at one knot": single(
        grid=rho.Grid(2.0, 3), goal=rho.State([4.0, 0, 0]), limits=rho.Limits(max_speed=3.0)
    ),
    "the same as a box": single(
        grid=rho.Grid(2.0, 3), goal=rho.State([4.0, 0, 0]), limits=rho.Limits(velocity=box(3.0))
    ),
    "starts beside each other": fleet([[0.0, 0, 0], [1.3, 0, 0]], [[-8, 0, 0], [8, 4, 0]]),
}


@pytest.mark.parametrize("seed", range(6))
def test_finer_margins_also_hold_for_part_of_a_fleet(seed: int) -> None:
    """Two start side by side and a third far away, which flies on as it does."""
    rng = np.random.default_rng(seed)
    side = float(rng.uniform(0.225, 0.26))
    scenario = fleet(
        [[-3.0, -3.0, 1.0], [0.0, 0.0, 0.0], [side, 0.0, 0.0]],
        [[-3.0, 0.0, 1.0], [0.5, 1.0, float(rng.normal())], [-0.5, 1.0, float(rng.normal())]],
        grid=rho.Grid(0.5, 8),
        limits=rho.Limits(acceleration=box(4.0)),
        separation=rho.Separation(0.214),
    )
    around = rho.Disturbance(0.0858, 0.0114, 0.0026, feedback_every=0.5 / 3)
    try:
        plan = rho.plan(dataclasses.replace(scenario, disturbance=around))
    except rho.InfeasibleError:
        return
    assert rho.verify(plan).ok


@pytest.mark.parametrize(
    "what",
    [
        "a start that is left at once",
        "starts beside each other",
        *slow("a speed that is needed at one knot", "the same as a box"),
    ],
)
def test_finer_margins_are_tried_before_a_scenario_is_refused(
    what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    wind = rho.Disturbance(0.4) if "speed" in what or "box" in what else None
    around = wind or rho.Disturbance(2.0, feedback_every=0.5)
    windy = dataclasses.replace(SHORT_OF_ROOM[what], disturbance=around)
    plan = rho.plan(windy)
    assert plan.scenario is windy
    assert rho.verify(plan).ok
    assert least_margin(plan) > -1e-6
    assert rho.certify(plan).gap >= -1e-6
    monkeypatch.setattr("drake_rho.planning.problem._REDUCTION", 1.0)  # no finer margins
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(windy)
    assert not caught.value.is_proved
    assert "tightened" in str(caught.value) or "room" in str(caught.value)


def test_a_gap_narrower_than_the_tube_is_closed() -> None:
    walls = [rho.Box([4, -9, -9], [5, -0.4, 9]), rho.Box([4, 0.4, -9], [5, 9, 9])]
    limits = rho.Limits(position=box(8.0))
    scenario = single(
        obstacles=walls, limits=limits, goal=rho.State([7.0, 0.0, 0.0]), between_knots=True
    )
    calm = rho.Disturbance(0.2, feedback_every=0.25)
    assert least_margin(rho.plan(dataclasses.replace(scenario, disturbance=calm))) > -1e-6
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(2.0, feedback_every=0.5))
    assert 0.4 < margins_of(windy).steps.largest < 1.0
    with pytest.raises(rho.InfeasibleError):
        rho.plan(windy)


def test_path_search_accounts_for_the_tube() -> None:
    scenario = fleet(
        [[0, 0, 0], [3, 0, 0]], [[8, 0, 0], [8, 3, 0]], obstacles=[rho.Sphere([5, 5, 5], 1)]
    )
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.5, feedback_every=0.5))
    larger, r = enlarged_by_margins(windy, margins_of(windy)), margins_of(windy).steps.largest
    np.testing.assert_allclose(larger.fleet.radii, r)
    assert larger.separation is not None
    assert larger.separation.distance == pytest.approx(1.0 + 2.0 * r)
    assert larger.disturbance is None
    assert enlarged_by_margins(scenario, margins_of(scenario)) is scenario


@pytest.mark.slow
def test_margins_cost_little(paper: rho.Scenario) -> None:
    windy = dataclasses.replace(paper, disturbance=rho.Disturbance(0.2))
    assert rho.plan_rho(windy).cost <= 1.001 * rho.plan_rho(paper).cost
    tube, ratios = 0.02, []
    for seed in range(3):
        drawn = rho.random_transitions(
            8,
            np.random.default_rng(seed),
            duration=10.0,
            separation=rho.Separation(0.35 + 2.5 * tube, downwash=2.0),
        )
        room = drawn.limits.position
        assert room is not None
        wider = rho.Box(room.lower - 2.0 * tube, room.upper + 2.0 * tube)
        scenario = dataclasses.replace(
            drawn,
            limits=dataclasses.replace(drawn.limits, position=wider),
            separation=rho.Separation(0.35, downwash=2.0),
            disturbance=rho.Disturbance(0.0, feedback_every=0.1, share=0.2),
        )
        W = rho.largest_disturbance(scenario, tube)
        around = rho.Disturbance(W, feedback_every=0.1, share=0.2)
        windy = dataclasses.replace(scenario, disturbance=around)
        assert margins_of(windy).steps.largest == pytest.approx(tube, rel=0.02)
        robust = rho.plan(windy)
        assert least_margin(robust) > -1e-6
        ratios.append(robust.cost / rho.plan(dataclasses.replace(scenario, disturbance=None)).cost)
    assert np.mean(ratios) <= 1.10
