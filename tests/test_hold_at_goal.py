"""Holding at goals after the end: radii for ever, what comes later, and the three settings."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.motion.rest_tube import RestTube, rest_tube
from drake_rho.planning.constraints.tightening import missing_slack, missing_slack_at_rest
from drake_rho.planning.problem import Problem
from drake_rho.verification.holds import first_violation
from drake_rho.verification.notes import largest_error_ratios
from drake_rho.verification.rest import Rest, check_rest, notes_on_rest
from tests.disturbed import Array, disturbed, tracked
from tests.scenarios import box, fleet, single, slow
from tests.test_tube import DEADBEAT, SECONDS, random_tube

GOAL = np.array([10.0, 4.0, -2.0])
END = 8.0
WIND = rho.Disturbance(0.2, feedback_every=0.1)


def given(scenario: rho.Scenario, **changes: Any) -> rho.Scenario:
    return dataclasses.replace(scenario, **changes)


def shifted(*by: float) -> Array:
    return np.asarray(GOAL + np.array(by))


def moving(velocity: Any, reach: float, **more: Any) -> rho.Obstacle:
    """Return a ball that reaches the goal, with its centre, `reach` seconds after time 0."""
    at = GOAL - reach * np.asarray(velocity, dtype=float)
    return rho.Obstacle(rho.Sphere(at, 1.0), velocity=velocity, **more)


def until(scenario: rho.Scenario, vehicle: int = 0) -> float:
    rest = Rest.of(scenario)
    assert rest is not None
    return rest.until(vehicle)


def limit(scenario: rho.Scenario) -> RestTube:
    return rest_tube(rho.error_tube(scenario))


# radii for ever


@pytest.mark.parametrize("initial", [(0.0, 0.0), (0.3, 0.2)])
def test_the_limits_of_deadbeat_gains_are_known(initial: tuple[float, float]) -> None:
    tube = rho.ErrorTube(
        rho.Disturbance(1.0, feedback_every=SECONDS), rho.Grid(SECONDS, 50), DEADBEAT, initial
    )
    rest = rest_tube(tube)
    assert rest.is_bounded
    assert rest.largest("position") == pytest.approx(SECONDS**2, rel=1e-6)
    assert rest.largest("position") >= SECONDS**2 * (1.0 - 1e-12)
    assert rest.largest("velocity") == pytest.approx(2.0 * SECONDS, rel=1e-12)
    assert rest.largest("acceleration") == pytest.approx(3.0, rel=1e-12)


def test_without_feedback_errors_grow_for_ever() -> None:
    rest = rest_tube(rho.ErrorTube(rho.Disturbance(0.3, feedback_every=0.5), rho.Grid(0.5, 17)))
    assert not rest.is_bounded
    assert rest.largest("position") == rest.largest("velocity") == np.inf
    assert rest.largest("position", 20.0) == pytest.approx(0.3 * 20.0**2 / 2.0, rel=1e-6)
    assert rest.largest("velocity", 20.0) == pytest.approx(0.3 * 20.0, rel=1e-12)
    calm = rest_tube(rho.ErrorTube(rho.Disturbance(0.0, 0.1), rho.Grid(0.5, 17)))
    assert calm.largest("position") == 0.0
    wild = rest_tube(rho.ErrorTube(rho.Disturbance(0.3), rho.Grid(0.5, 17), (9.0, 9.0)))
    assert not wild.is_bounded
    assert np.isfinite(wild.largest("position", wild.end))


@pytest.mark.parametrize("seed", [3, 10, 17, 18, 29])
def test_no_radius_after_the_end_is_above_the_limit(seed: int) -> None:
    """The limit is the least upper bound, and its tube is the flight's, gone on."""
    tube, _ = random_tube(seed)
    rest = rest_tube(tube)
    assert rest.is_bounded
    times = np.linspace(rest.begin, rest.end, 3001)
    for quantity in ("position", "velocity", "acceleration"):
        dense = getattr(rest.tube, quantity)(times).max()
        assert dense <= rest.largest(quantity) * (1.0 + 1e-12)
        assert rest.largest(quantity) <= dense * (1.0 + 1e-2)
    flown = np.linspace(tube.grid.start, tube.grid.end - 1e-6 * tube.sample, 101)
    np.testing.assert_allclose(rest.tube.position(flown), tube.position(flown), rtol=1e-9)
    last = rest.end - tube.sample * np.linspace(0.0, 1.0, 11)[1:-1]
    longer = dataclasses.replace(
        rest.tube, grid=rho.Grid(tube.grid.step, rest.tube.grid.knots + 40, tube.grid.start)
    )
    later = last + tube.grid.step * 40
    np.testing.assert_allclose(longer.position(later), longer.position(last), rtol=1e-12)


def test_wind_reaches_the_limit_while_holding() -> None:
    """The ball of the limit is not larger than it has to be: some wind leads to its surface."""
    scenario = given(single(), disturbance=WIND)
    plan = rho.plan(scenario).holding(12.0)
    time = 19.0
    wind = rho.worst_case(plan.scenario, [0.0, 0.6, 0.8], time)
    flown = rho.simulate(plan, wind=wind)
    k = int(np.argmin(np.abs(flown.times - time)))
    assert flown.errors()[k, 0] == pytest.approx(limit(scenario).largest("position"), rel=1e-6)


# plans that hold


def test_a_plan_that_holds_is_the_plan_and_then_rest() -> None:
    scenario = given(single(), disturbance=WIND)
    plan = rho.plan(scenario)
    longer = plan.holding(3.3)
    assert longer.scenario.grid == rho.Grid(0.5, 24)
    np.testing.assert_array_equal(longer.accelerations[:, :16], plan.accelerations)
    np.testing.assert_array_equal(longer.positions[:, 16:] - plan.positions[:, -1:], 0.0)
    times = np.linspace(0.0, END, 33)
    tubes = rho.error_tube(scenario), rho.error_tube(longer.scenario)
    was, goes_on = (tube.position(times) for tube in tubes)
    np.testing.assert_allclose(goes_on, was, rtol=1e-12)
    assert rho.verify(longer).ok
    assert plan.holding(0.0).scenario.grid == scenario.grid


def test_bad_times_to_hold_and_goals_that_move_are_refused() -> None:
    plan = rho.plan(single())
    for seconds in (-1.0, np.nan, np.inf, 1e9):
        with pytest.raises(ValueError, match=r"seconds: got .*expected a time from 0 to"):
            plan.holding(seconds)
    passing = rho.plan(single(goal=rho.State(GOAL, [1.0, 0.0, 0.0])))
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\].goal.velocity: got \[1.0, 0.0"):
        passing.holding(1.0)


# what comes after the end


def test_an_obstacle_that_comes_is_told_with_its_time() -> None:
    scenario = single(obstacles=[moving([-1.0, 0.0, 0.0], 30.0)])
    assert until(scenario) == pytest.approx(29.0, abs=1e-9)
    report = rho.verify(rho.plan(scenario))
    assert report.ok
    assert report.notes == (
        "solo can hold at its goal until 29 s only: obstacle 1 is violated later, by up to 1 m",
    )
    windy = given(scenario, disturbance=WIND)
    radius = limit(windy).largest("position")
    assert until(windy) == pytest.approx(29.0 - radius, abs=1e-6)
    held = [rho.verify(rho.plan(scenario).holding(time)).ok for time in (20.9, 21.4)]
    assert held == [True, False]


def test_the_first_of_many_that_come_is_told() -> None:
    rng = np.random.default_rng(0)
    reach, speeds = rng.uniform(40.0, 90.0, 12), rng.uniform(0.3, 3.0, 12)
    directions = rng.standard_normal((12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scenario = single(obstacles=list(map(moving, speeds[:, None] * directions, reach)))
    assert until(scenario) == pytest.approx(np.min(reach - 1.0 / speeds), abs=1e-9)
    assert f"obstacle {1 + np.argmin(reach - 1.0 / speeds)} " in notes_on_rest(scenario)[0]


def test_obstacles_that_pass_by_or_have_passed_are_no_matter() -> None:
    beside = rho.Obstacle(
        rho.Sphere(GOAL + np.array([30.0, 1.1, 0.0]), 1.0), velocity=[-1.0, 0.0, 0.0]
    )
    gone = moving([-1.0, 0.0, 0.0], 4.0, active=(1.0, 2.0))
    leaves = rho.Obstacle(
        rho.Sphere(GOAL + np.array([0.0, 0.0, 4.0]), 1.0), velocity=[0.0, 0.0, 0.1]
    )
    until_end = moving([0.0, -1.0, 0.0], 9.0, active=(0.0, END))
    scenario = single(obstacles=[beside, gone, leaves, until_end])
    assert notes_on_rest(scenario) == ()
    assert not missing_slack_at_rest(given(scenario, hold_at_goal=True))


def test_tracks_and_intervals_after_the_end_are_told() -> None:
    away = shifted(0.0, 0.0, 20.0)
    track = rho.Track([0.0, 20.0, 40.0, 60.0], [away, away, GOAL, away])
    assert until(single(obstacles=[rho.Obstacle(rho.Sphere(away, 2.0), track=track)])) == (
        pytest.approx(38.0, abs=1e-9)
    )
    zone = rho.Obstacle(rho.Sphere(GOAL, 2.0), active=(12.5, 14.0))
    assert until(single(obstacles=[zone])) == pytest.approx(12.5, abs=1e-8)
    box_wall = rho.Obstacle(rho.Box([50, -9, -9], [51, 9, 9]), velocity=[-0.5, 0.0, 0.0])
    assert until(single(obstacles=[box_wall])) == pytest.approx(80.0, abs=1e-9)


def test_a_wall_closer_than_the_limit_is_told_with_the_amount() -> None:
    """The plan fits its own tube; the tube grows on after the end."""
    slow = rho.Disturbance(0.3, feedback_every=0.5, delay=1)
    free = given(single(limits=rho.Limits(acceleration=box(0.75))), disturbance=slow)
    tube, rest = rho.error_tube(free), limit(free)
    now, most = float(tube.position(END)), rest.largest("position")
    assert now < 0.99 * most
    gap = 0.5 * (now + most)
    wall = rho.Box([GOAL[0] + gap, -50.0, -50.0], [GOAL[0] + gap + 1.0, 50.0, 50.0])
    scenario = given(free, obstacles=[wall])
    np.testing.assert_allclose(rho.error_tube(scenario).gains, tube.gains)
    time = until(scenario)
    assert rest.tube.position(time) == pytest.approx(gap, rel=1e-5)
    (note,) = notes_on_rest(scenario)
    assert f"obstacle 1 is violated later, by up to {most - gap:.3g} m" in note
    required = given(scenario, hold_at_goal=True)
    (column,) = [each for each in check_rest(required) if each.unit == "m"]
    assert column.excess[0] == pytest.approx(most - gap, rel=1e-5)
    assert column.errors[0] == pytest.approx(most, rel=1e-6)
    lower, upper = wall.lower + np.array([most, 0, 0]), wall.upper + np.array([most, 0, 0])
    roomy = given(free, obstacles=[rho.Box(lower, upper)])
    assert notes_on_rest(roomy) == ()


@pytest.mark.parametrize("downwash", [1.0, 2.0])
def test_pairs_of_goals_need_twice_the_limit(downwash: float) -> None:
    radius = limit(given(single(), disturbance=WIND)).largest("position")
    for gap, holds in ((1.99 * radius, False), (2.01 * radius, True)):
        high = [[0.0, 0.0, downwash + gap], [8.0, 0.0, downwash + gap]]
        starts, goals = [[0.0, 0.0, 0.0], high[0]], [[8.0, 0.0, 0.0], high[1]]
        pair = fleet(
            starts, goals, separation=rho.Separation(1.0, downwash), grid=rho.Grid(0.5, 17)
        )
        scenario = given(pair, disturbance=WIND, hold_at_goal=True)
        slack = missing_slack(scenario, Problem.of(scenario).margins)
        assert any("separation (held goal" in each for why in slack.values() for each in why) == (
            not holds
        )
        assert all(each.holds for each in check_rest(scenario)) == holds


def test_requirements_after_the_end_are_told() -> None:
    away = rho.Track([0.0, 10.0], [GOAL, shifted(0.0, 1.0, 0.0)], after="goes_on")
    link = rho.KeepIn(rho.Sphere([0, 0, 0], 20.0), relative_to=away)
    assert until(given(single(), requirements=(link,))) == pytest.approx(200.0, abs=1e-7)
    brief = rho.KeepIn(rho.Sphere([0, 0, 0], 20.0), relative_to=away, active=(0.0, END))
    assert notes_on_rest(given(single(), requirements=(brief,))) == ()
    slow = rho.KeepIn(rho.Sphere([0, 0, 0], 3.0), of="velocity")
    assert notes_on_rest(given(single(), requirements=(slow,))) == ()
    lean = rho.KeepIn(rho.Cone([0, 0, 0], [0, 0, 1], 0.01), of="thrust")
    windy = given(single(), requirements=(lean,), disturbance=WIND)
    assert "requirement 1 of thrust" in notes_on_rest(windy)[0]
    assert missing_slack(given(windy, hold_at_goal=True), Problem.of(windy).margins)


def test_limits_are_compared_with_the_feedback_for_ever() -> None:
    weak = given(
        single(limits=rho.Limits(max_tilt=0.05, max_thrust=9.9, max_speed=4.0)), disturbance=WIND
    )
    rest = limit(weak)
    u = rest.largest("acceleration")
    (column,) = [each for each in check_rest(given(weak, hold_at_goal=True)) if each.unit == "m/s²"]
    left = min(9.9 - 9.81, 9.81 * np.sin(0.05))
    assert column.parts[0] == "maximum thrust"
    assert column.excess[0] == pytest.approx(u - left, rel=1e-9)


def test_without_feedback_the_time_is_told() -> None:
    free = given(single(limits=rho.Limits(max_speed=6.0)), disturbance=WIND)
    drifting = dataclasses.replace(WIND, tracking=tracked(0.0, (0.0, 0.0)))
    scenario = given(free, disturbance=drifting)
    assert until(scenario) == pytest.approx(30.0, abs=1e-4)  # W t = 6 m/s
    (note,) = notes_on_rest(scenario)
    assert note.endswith("for maximum speed: its errors go on growing")
    calm = Problem.of(given(scenario, hold_at_goal=True))
    with pytest.raises(rho.InfeasibleError, match="of inf"):
        calm.check_tightening_slack()


# the three settings


def test_true_refuses_false_is_silent_and_none_notes() -> None:
    scenario = single(obstacles=[moving([-1.0, 0.0, 0.0], 30.0)])
    plan = rho.plan(scenario)
    assert len(rho.verify(plan).notes) == 1
    silent = given(scenario, hold_at_goal=False)
    quiet = rho.plan(silent)
    np.testing.assert_array_equal(quiet.accelerations, plan.accelerations)
    assert rho.verify(quiet).notes == ()
    required = given(scenario, hold_at_goal=True)
    for planner in (rho.plan, rho.plan_convex):
        with pytest.raises(rho.InfeasibleError, match=r"cannot hold .*obstacle 1 \(held goal 1 m"):
            planner(required)
    report = rho.verify(rho.Plan.from_accelerations(required, plan.accelerations))
    (violated,) = report.violations
    assert (violated.kind, violated.constraint, violated.part) == (
        "holding",
        "hold at goal",
        "obstacle 1",
    )
    assert violated.excess == pytest.approx(1.0, abs=1e-6)
    assert violated.time == pytest.approx(30.0, abs=1e-3)


def test_the_least_time_is_refused_if_vehicles_cannot_hold_from_then_on() -> None:
    limits = rho.Limits(max_speed=4.0, max_acceleration=2.0)
    scenario = single(limits=limits, obstacles=[moving([-1.0, 0.0, 0.0], 30.0)])
    with pytest.raises(rho.InfeasibleError, match=r"cannot hold .*obstacle 1 \(held goal 1 m"):
        rho.plan_minimum_time(given(scenario, hold_at_goal=True))


def test_smooth_motions_hold_from_their_end_on() -> None:
    limits = rho.Limits(max_acceleration=2.0)
    scenario = single(limits=limits, obstacles=[moving([-1.0, 0.0, 0.0], 30.0)], between_knots=True)
    smooth = given(scenario, smoothing=rho.Smoothing(0.5, 2))
    assert until(smooth) == pytest.approx(29.0, abs=1e-9)
    longer = rho.plan(smooth).holding(5.0)
    assert rho.verify(longer).ok
    np.testing.assert_allclose(longer.at([13.0], vehicle="solo").positions[0], GOAL, atol=1e-9)


def test_a_goal_that_moves_is_refused_or_not_held() -> None:
    passing = single(
        goal=rho.State(GOAL, [1.0, 0.0, 0.0]), obstacles=[moving([-1.0, 0.0, 0.0], 30.0)]
    )
    assert rho.verify(rho.plan(passing)).notes == ()
    message = r"goal.velocity: got \[1.0, 0.0, 0.0\], expected none with hold_at_goal"
    with pytest.raises(rho.ScenarioError, match=message):
        given(passing, hold_at_goal=True)


def test_only_vehicles_with_goals_at_rest_are_held() -> None:
    ends = [rho.State([10.0, 0, 0]), rho.State([10.0, 9, 0], [1.0, 0, 0])]
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([0.0, 9.0 * i, 0]), end) for i, end in enumerate(ends)
    ]
    near = rho.KeepIn(rho.Sphere([0, 0, 0], 10.0), vehicles="v1", relative_to="v0")
    zones = [rho.Obstacle(rho.Sphere(end.position, 1.0), active=(12.0, 13.0)) for end in ends]
    scenario = rho.Scenario(
        "two", rho.Grid(0.5, 17), vehicles, obstacles=zones, requirements=[near]
    )
    (note,) = notes_on_rest(scenario)
    assert note.startswith("v0 can hold at its goal until 12 s only: obstacle 1")


def test_windows_hold_where_it_is_required() -> None:
    windy = given(disturbed(2, delay=0), hold_at_goal=True)
    flight = rho.plan_rho(windy, replan_every=4)
    report = rho.verify(flight)
    assert report.ok
    assert any(each.kind == "holding" for each in report.checks)
    assert not any(window.infeasible for window in flight.windows)
    late = moving([-1.0, 0.0, 0.0], 30.0)
    plan = rho.plan(given(single(), disturbance=WIND))
    blocked = given(plan.scenario, obstacles=[late], hold_at_goal=True)
    found = first_violation(rho.Plan.from_accelerations(blocked, plan.accelerations))
    assert found is not None
    assert found.what == "hold at goal obstacle 1"
    with pytest.raises(rho.InfeasibleError, match="held goal"):
        rho.RecedingHorizon(blocked).step(blocked.fleet.start_states, 0.0)


# independent computations agree


def random_world(seed: int) -> rho.Scenario:
    """Return two vehicles that rest among things that move, turn, and are active later."""
    rng = np.random.default_rng(seed)
    goals = np.array([[8.0, 0.0, 0.0], [8.0, rng.uniform(1.05, 1.4), 0.0]])
    turns = np.sort(rng.uniform(9.0, 60.0, 3))
    corners = goals[0] + rng.uniform(-9.0, 9.0, (3, 3))
    bodies = [
        rho.Obstacle(
            rho.Sphere(goals[0] + rng.uniform(-60, 60, 3), rng.uniform(0.5, 9.0)),
            velocity=rng.uniform(-2, 2, 3),
            active=(10.0, rng.uniform(11, 60)) if rng.random() < 0.5 else (9.0, 500.0),
        ),
        rho.Obstacle(
            rho.Box([-1, -1, -1], [1, 2, 3]),
            track=rho.Track(turns, corners, after=rng.choice(["rests", "goes_on"])),
            active=(9.0, 1e4),
        ),
    ]
    scenario = fleet(
        goals - [8.0, 0.0, 0.0],
        goals,
        separation=rho.Separation(1.0),
        grid=rho.Grid(0.5, 17),
        limits=rho.Limits(position=rho.Box([-2, -2, -2], [8.0 + rng.uniform(0.0, 0.3), 9, 2])),
        obstacles=bodies,
    )
    wind = rho.Disturbance(rng.uniform(0.05, 0.5), 0.01, 0.02, feedback_every=0.25, delay=1)
    return given(scenario, disturbance=wind if rng.random() < 0.8 else None, hold_at_goal=True)


@pytest.mark.parametrize("seed", [3, 7, *slow(*range(3), *range(8, 40))])
def test_planner_verifier_and_samples_agree(seed: int) -> None:
    scenario = random_world(seed)
    if scenario.disturbance is None:
        refused = missing_slack_at_rest(scenario)
    else:
        slack = missing_slack(scenario, Problem.of(scenario).margins)
        refused = {
            name: why for name, why in slack.items() if any("held goal" in each for each in why)
        }
    columns = list(check_rest(scenario))
    violated = {
        scenario.names[i]
        for each in columns
        for i in np.flatnonzero((each.excess > each.tolerances) & each.concerned)
    }
    assert violated == set(refused)
    # dense samples of distances, without pieces, bounds or searches
    times = np.arange(END, 800.0, 0.02)
    radius = 0.0 if scenario.disturbance is None else limit(scenario).largest("position")
    goals = scenario.fleet.goal_positions
    bounds = scenario.fleet.bounds("position")
    assert bounds is not None
    for i, goal in enumerate(goals):
        depths = [
            (
                scenario.fleet.radii[i]
                + radius
                - body.distances(np.tile(goal, (len(times), 1)), times)
            )
            for body in scenario.bodies
        ]
        walls = radius - min((goal - bounds.lower[i]).min(), (bounds.upper[i] - goal).min())
        pair = 1.0 + 2.0 * radius - np.linalg.norm(goals[0] - goals[1])
        worst = max(walls, pair, *(float(each.max()) for each in depths))
        if abs(worst) > 0.05:
            assert (worst > 0.0) == (scenario.names[i] in violated)


@pytest.mark.parametrize(("height", "holds"), [(-1.7, True), (-2.1, False)])
def test_a_map_that_moves_after_the_end_is_told(height: float, holds: bool) -> None:
    occupied = np.zeros((4, 4, 4), dtype=bool)
    occupied[1, 1, 1] = occupied[3, 3, 3] = True
    cells = rho.Voxels.from_grid(occupied, 0.1, [40.0, 3.95, height])
    solo = dataclasses.replace(single().vehicles[0], radius=0.3)
    scenario = given(
        single(), vehicles=[solo], obstacles=[rho.Obstacle(cells, velocity=[-1.0, 0.0, 0.0])]
    )
    assert (notes_on_rest(scenario) == ()) == holds
    assert (missing_slack_at_rest(given(scenario, hold_at_goal=True)) == {}) == holds


@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_holding_plans_are_verified_to_the_same_end(seed: int) -> None:
    """`verify` of a longer plan says what the note says of the shorter one."""
    rng = np.random.default_rng(seed)
    velocity = rng.uniform(-1.0, 1.0, 3)
    scenario = given(
        single(obstacles=[moving(velocity, 25.0)], between_knots=True), disturbance=WIND
    )
    time = until(scenario)
    plan = rho.plan(given(scenario, obstacles=()))
    for after, holds in ((time - 0.5, True), (time + 0.5, False)):
        longer = rho.Plan.from_accelerations(scenario, plan.accelerations).holding(after - END)
        late = [each for each in rho.verify(longer).violations if each.kind == "obstacles"]
        assert (late == []) == holds


def test_a_vehicle_that_hovers_closer_to_its_box_than_the_errors_is_seen() -> None:
    """Rounding may put its least value above its greatest; a check does not get lost by that."""
    for x in np.random.default_rng(0).uniform(-9.0, 9.0, 3):
        at = rho.State([x, 0.3, 0.7])
        limits = rho.Limits(position=rho.Box([-20, -20, -20], [x + 1e-3, 20, 20]))
        hover = single(start=at, goal=at, limits=limits, between_knots=True)
        still = rho.Plan.from_accelerations(given(hover, disturbance=WIND), np.zeros((1, 16, 3)))
        assert {each.kind for each in rho.verify(still).violations} == {"position"}
        note = "solo cannot hold at its goal: position box x upper is violated by up to 0.001 m"
        assert note == rho.verify(still).notes[-1]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_hovering_flights_stay_in_the_tube(seed: int) -> None:
    scenario, rng = disturbed(seed), np.random.default_rng(seed)
    plan = rho.plan(scenario).holding(60.0)
    wind = rho.winds.coloured_noise(plan.scenario, rng)
    if seed % 2:
        wind = rho.worst_case(plan.scenario, rng.standard_normal(3), plan.scenario.grid.end - 9.0)
    flown = rho.simulate(plan, wind=wind, rng=None if seed % 2 else rng)
    assert max(largest_error_ratios(flown).values()) <= 1.0 + 1e-6
    after = flown.times >= scenario.grid.end
    rest = limit(scenario)
    for quantity in ("position", "velocity", "acceleration"):
        errors = flown.errors(quantity)[after]
        assert errors.max() <= rest.largest(quantity) * (1.0 + 1e-9) + 1e-9
