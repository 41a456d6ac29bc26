"""A horizon that rolls with the flight: windows that end at rest where vehicles may stay."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho

STEP, EVERY, HORIZON = 0.1, 2, 3.0
GRID = rho.Grid.lasting(12.0, step=STEP)
VOLUME = rho.Box([-6, -6, 0], [16, 6, 3])
LIMITS = rho.Limits(position=VOLUME, max_speed=2.0, max_acceleration=3.0)
RADIUS, WIND = 0.2, rho.Disturbance(0.2, position_error=0.01, velocity_error=0.02)
SAMPLES = 101
GOAL = rho.State([8, 0, 1.5])


def vehicle(name: str, start: Sequence[float], goal: Any, **fields: Any) -> rho.Vehicle:
    """Return a vehicle at rest at a start."""
    return rho.Vehicle(name, rho.State(start), goal, radius=RADIUS, **fields)


def scene(*obstacles: Any, goal: Any = GOAL, **fields: Any) -> rho.Scenario:
    """Return a flight of 8 m among obstacles."""
    scout = vehicle("scout", [0, 0, 1.5], goal)
    return rho.Scenario("rolling", GRID, [scout], LIMITS, obstacles=obstacles, **fields)


def with_goal(scenario: rho.Scenario, goal: Any) -> rho.Scenario:
    """Return a scenario with another goal of its vehicle."""
    scout = dataclasses.replace(scenario.vehicles[0], goal=goal)
    return dataclasses.replace(scenario, vehicles=(scout,))


def fly(
    scenario: rho.Scenario,
    news: Mapping[int, rho.Scenario] | None = None,
    *,
    knots: int = 120,
    **settings: Any,
) -> rho.RecedingHorizon:
    """Return a horizon after windows from knots up to a last one, with news told at knots."""
    settings = {"horizon": HORIZON, "fallback": None, "replan_every": EVERY} | settings
    horizon, start = rho.RecedingHorizon(scenario, **settings), scenario.grid.start
    for knot in range(0, knots, EVERY):
        now = (news or {}).get(knot)
        horizon.step(horizon.planned(knot), start + knot * STEP, scenario=now)
    return horizon


def samples(flight: rho.Flight) -> tuple[np.ndarray, np.ndarray]:
    """Return times (M,) and positions (M, N, 3), integrated from the accelerations alone."""
    plan, parts = flight.plan, np.linspace(0.0, STEP, SAMPLES)[:, None, None]
    states = flight.scenario.fleet.start_states
    p, v, times, positions = states[:, :3], states[:, 3:], [], []
    for k in range(plan.accelerations.shape[1]):
        a = plan.accelerations[:, k]
        times.append(plan.times[k] + parts[:, 0, 0])
        positions.append(p + parts * v + parts**2 / 2.0 * a)
        p, v = p + STEP * v + STEP**2 / 2.0 * a, v + STEP * a
    return np.concatenate(times), np.concatenate(positions)


def place(flight: rho.Flight, time: float) -> np.ndarray:
    """Return the position of the first vehicle at a time [m], shape (3,)."""
    found: np.ndarray = flight.at(time).positions[0, 0]
    return found


def least_distance(flight: rho.Flight, center: Any, size: float, since: float = 0.0) -> float:
    """Return the least distance from a ball [m], whose centre may be a function of times."""
    times, x = samples(flight)
    centers = center(times) if callable(center) else np.broadcast_to(center, (len(times), 3))
    away = np.linalg.norm(x - centers[:, None], axis=2)[times >= since]
    return float(away.min()) - size - RADIUS


PILLARS = [
    rho.Cylinder([x, y, 1.5], 0.4, 3.0)
    for x, y in ([2.0, 0.1], [4.0, -0.9], [4.0, 1.1], [6.0, 0.2], [3.0, 2.0], [3.0, -2.4])
]


@pytest.fixture(scope="module")
def among_pillars() -> rho.RecedingHorizon:
    """Return a horizon after a flight among pillars."""
    return fly(scene(*PILLARS))


def test_a_vehicle_arrives_and_stays(among_pillars: rho.RecedingHorizon) -> None:
    flight = among_pillars.flight
    assert rho.verify(flight).ok
    times, x = samples(flight)
    assert np.abs(x[-1, 0] - [8, 0, 1.5]).max() < 1e-6
    arrived = times[np.argmax(np.linalg.norm(x[:, 0] - [8, 0, 1.5], axis=1) < 1e-3)]
    assert arrived < 8.0  # the straight line takes 4.7 s at least
    for pillar in PILLARS:
        away = np.linalg.norm(x[:, 0, :2] - pillar.center[:2], axis=1).min()
        assert away >= pillar.radius + RADIUS - 1e-6


def test_windows_plan_the_same_time_ahead_and_end_at_rest(
    among_pillars: rho.RecedingHorizon,
) -> None:
    for window in among_pillars.windows:
        assert window.plan.scenario.grid.duration == pytest.approx(HORIZON)
        assert np.abs(window.plan.velocities[:, -1]).max() < 1e-6
        assert not window.infeasible
        assert window.rest_until is None


def test_every_window_may_be_the_last(among_pillars: rho.RecedingHorizon) -> None:
    for window in among_pillars.windows[::7]:
        assert rho.verify(window.plan.holding(60.0)).ok


def test_the_time_of_an_arrival_stays(among_pillars: rho.RecedingHorizon) -> None:
    arrivals = [
        waypoint.time or 0.0
        for window in among_pillars.windows
        for waypoint in window.plan.scenario.vehicles[0].waypoints
    ]
    assert len(arrivals) > 5
    assert len(set(arrivals)) == 1
    at = among_pillars.flight.at(arrivals[0])
    assert np.abs(at.positions[0, 0] - [8, 0, 1.5]).max() < 1e-6
    assert np.abs(at.velocities).max() < 1e-6


def test_goals_change_and_a_vehicle_without_one_stops() -> None:
    scenario = scene(*PILLARS)
    news = {
        20: with_goal(scenario, rho.State([0, 3, 1.5])),
        90: with_goal(scenario, rho.Goal(None)),
        130: with_goal(scenario, rho.Goal(rho.Box([8, -1, 1], [10, 1, 2]))),
    }
    flight = fly(scenario, news, knots=240).flight
    assert rho.verify(flight).ok
    times, x = samples(flight)
    assert np.abs(place(flight, 8.9) - [0, 3, 1.5]).max() < 1e-3
    still = x[(times > 11.5) & (times < 13.0), 0]
    assert np.ptp(still, axis=0).max() < 1e-6
    assert news[130].vehicles[0].goal.position.signed_distance(x[-1, 0]) <= 1e-6


def test_a_vehicle_in_motion_without_a_goal_stops_with_least_effort() -> None:
    start = rho.State([0, 0, 1.5], [2, 0, 0])
    scout = rho.Vehicle("scout", start, rho.Goal(None), radius=RADIUS)
    horizon = fly(rho.Scenario("stop", GRID, [scout], LIMITS), knots=40)
    flight = horizon.flight
    assert rho.verify(flight).ok
    # a constant acceleration of -v/T ends at v T / 2
    assert samples(flight)[1][-1, 0, 0] == pytest.approx(2.0 * HORIZON / 2.0, rel=0.02)


def test_a_moving_obstacle_across_the_goal_is_waited_for() -> None:
    velocity = np.array([0.0, 0.6, 0.0])
    crossing = rho.Obstacle(rho.Sphere([8, -4, 1.5], 0.5), velocity=velocity)
    horizon = fly(scene(crossing), knots=160)
    flight = horizon.flight
    assert rho.verify(flight).ok
    assert (
        least_distance(flight, lambda t: np.array([8, -4, 1.5]) + t[:, None] * velocity, 0.5)
        >= -1e-6
    )
    assert np.abs(place(flight, 5.0) - [8, 0, 1.5]).max() > 0.5
    assert np.abs(samples(flight)[1][-1, 0] - [8, 0, 1.5]).max() < 1e-6
    for window in horizon.windows[::9]:  # what moves on is far away then
        assert rho.verify(window.plan.holding(60.0)).ok


def test_where_errors_grow_vehicles_can_stay_for_the_declared_time() -> None:
    drifting = rho.Obstacle(
        rho.Sphere([4, -1.5, 1.5], 0.5), position_error=0.1, velocity_error=0.1, seen_at=0.0
    )
    horizon = fly(scene(drifting), knots=90, rest_for=8.0)
    assert rho.verify(horizon.flight).ok
    for window in horizon.windows:
        assert window.rest_until is not None
        left = window.rest_until - window.plan.scenario.grid.end
        assert left == pytest.approx(8.0) or (window.kept and 6.0 < left < 8.0)
        place = window.plan.positions[0, -1]
        grown = 0.1 + 0.1 * window.rest_until
        assert np.linalg.norm(place - [4, -1.5, 1.5]) >= 0.5 + grown + RADIUS - 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_flights_in_wind_stay_safe_and_arrive(seed: int) -> None:
    scenario = scene(rho.Sphere([4, 0.1, 1.5], 0.5), disturbance=WIND)
    blow = np.random.default_rng(seed)
    wind = rho.winds.coloured_noise(scenario, blow, intensity=1.0, correlation=0.3)
    rng = np.random.default_rng(seed)
    simulation = rho.simulate(scenario, wind=wind, rng=rng, horizon=HORIZON)
    assert rho.verify(simulation).ok
    away = np.linalg.norm(simulation.positions[:, 0] - [4, 0.1, 1.5], axis=1)
    assert away.min() >= 0.5 + RADIUS
    assert np.linalg.norm(simulation.positions[-1, 0] - [8, 0, 1.5]) < 0.3
    for window in simulation.windows[::6]:
        assert rho.verify(window.plan.holding(30.0)).ok  # with the radii of its tube after the end


def test_vehicles_that_swap_places_keep_their_separation() -> None:
    both = [
        vehicle("a", [0, 0, 1.5], rho.State([8, 0, 1.5])),
        vehicle("b", [8, 0.1, 1.5], rho.State([0, 0.1, 1.5])),
    ]
    scenario = rho.Scenario("swap", GRID, both, LIMITS, separation=rho.Separation(1.0))
    flight = rho.plan_rho(scenario, horizon=HORIZON)
    assert rho.verify(flight).ok
    _, x = samples(flight)
    assert np.linalg.norm(x[:, 0] - x[:, 1], axis=1).min() >= 1.0 - 1e-6
    assert np.abs(x[-1] - [[8, 0, 1.5], [0, 0.1, 1.5]]).max() < 1e-6


WALLS = [
    rho.Obstacle(rho.Box(lower, upper), name=name)
    for name, lower, upper in (
        ("left", [6.0, -2.0, 0.0], [6.4, 2.0, 3.0]),
        ("right", [9.6, -2.0, 0.0], [10.0, 2.0, 3.0]),
        ("below", [6.0, -2.0, 0.0], [10.0, -1.6, 3.0]),
        ("above", [6.0, 1.6, 0.0], [10.0, 2.0, 3.0]),
    )
]


def test_a_goal_behind_walls_is_named_and_reached_once_they_open() -> None:
    closed, opened = scene(*WALLS), scene(*WALLS[1:])
    horizon = fly(closed, {100: opened}, knots=200)
    assert all(window.unreachable == ("scout",) for window in horizon.windows[:50])
    assert not any(window.unreachable for window in horizon.windows[50:])
    flight = horizon.flight
    assert rho.verify(flight).ok
    assert place(flight, 9.9)[0] < 6.0 - RADIUS + 1e-6
    assert np.abs(samples(flight)[1][-1, 0] - [8, 0, 1.5]).max() < 1e-6


def test_a_way_around_a_wide_wall_is_found() -> None:
    wall = rho.Box([3.0, -6.0, 0.0], [3.4, 4.5, 3.0])
    flight = fly(scene(wall), knots=160).flight
    assert rho.verify(flight).ok
    assert np.abs(samples(flight)[1][-1, 0] - [8, 0, 1.5]).max() < 1e-6


def test_what_appears_across_the_plan_is_not_touched() -> None:
    # at 2 m/s a vehicle stops within 0.67 m, and flies 0.4 m until the next window
    center = np.array([4.2, 0.05, 1.5])
    seen = scene(rho.Obstacle(rho.Sphere(center, 0.6), name="seen"))
    horizon = fly(scene(), {16: seen}, knots=120)
    assert place(horizon.flight, 1.6)[0] < center[0] - 0.6 - RADIUS - 1.1
    assert rho.verify(horizon.flight).ok
    assert least_distance(horizon.flight, center, 0.6, since=1.6) >= -1e-6
    assert np.abs(samples(horizon.flight)[1][-1, 0] - [8, 0, 1.5]).max() < 1e-6


def test_requirements_with_an_interval_hold_in_it() -> None:
    slowly = rho.KeepIn(rho.Ball([0, 0, 0], 0.8), of="velocity", active=(3.0, 6.0), name="slowly")
    flight = fly(scene(requirements=[slowly])).flight
    assert rho.verify(flight).ok
    speeds = np.linalg.norm(flight.at(np.linspace(0.0, 9.0, 901)).velocities[0], axis=1)
    assert speeds[301:600].max() <= 0.8 + 1e-6
    assert speeds.max() > 1.5


def test_steps_that_skip_knots_go_on_and_say_so() -> None:
    horizon = fly(scene(*PILLARS), knots=20)
    window = horizon.step(horizon.planned(30), 3.0)
    assert window.skipped == 10
    late = horizon.step(horizon.planned(130), 13.0)  # after the end of the plan, and of the grid
    assert late.skipped == 98
    assert late.plan.positions[0, 0] == pytest.approx(window.plan.positions[0, -1])
    assert rho.verify(horizon.flight).ok
    with pytest.raises(ValueError, match=r"time: got 2.0, expected the time of a knot from 13.1"):
        horizon.step(horizon.planned(140), 2.0)


@pytest.mark.parametrize("start", [-30.0, 1.7e9])
def test_clocks_make_no_difference(start: float) -> None:
    usual = fly(scene(*PILLARS), knots=60).flight.plan
    other = dataclasses.replace(scene(*PILLARS), grid=dataclasses.replace(GRID, start=start))
    assert fly(other, knots=60).flight.plan.positions == pytest.approx(usual.positions, abs=1e-4)


def test_files_keep_flights_and_their_verdicts(
    among_pillars: rho.RecedingHorizon, tmp_path: Path
) -> None:
    rho.save(among_pillars.flight, tmp_path / "flight.npz")
    again = rho.load(tmp_path / "flight.npz")
    assert str(rho.verify(again)) == str(rho.verify(among_pillars.flight))
    assert np.array_equal(again.plan.accelerations, among_pillars.flight.plan.accelerations)


def test_flights_of_a_mission_are_kept_whatever_they_did_not_last_for(tmp_path: Path) -> None:
    slow = rho.KeepIn(rho.Sphere([0, 0, 0], 1.0), of="velocity", active=(0.5, 1.5), name="slow")
    late = dataclasses.replace(slow, active=(8.0, 9.0), name="late")
    ceiling = rho.KeepIn(rho.HalfSpace([0, 0, 1], 2.0), of="position", active=(3.0, 7.0))
    unseen = rho.Obstacle(rho.Sphere([5, 4, 1.5], 0.5), known_from=9.0)
    first = scene(unseen, *PILLARS, requirements=[slow, ceiling, late])
    horizon = fly(first, {20: dataclasses.replace(first, requirements=(slow, late))}, knots=30)
    horizon.end_flight()
    for knot in range(30, 50, EVERY):
        states = horizon.planned(knot) + (0.05 if knot == 30 else 0.0)
        horizon.step(states, knot * STEP)
    horizon.record(4.9, horizon.planned(48))
    flights = [fly(first, knots=10).flight, *horizon.flights]
    assert [each.scenario.under_way for each in flights] == [False, False, True]
    for each in flights:
        begin, end = each.scenario.grid.start, each.scenario.grid.end
        active = [one.active for one in each.scenario.requirements if one.active is not None]
        assert all(begin <= one <= last <= end for one, last in active)
        rho.save(each, tmp_path / "flight.npz")
        rho.export(each, tmp_path / "flight.json", format="json")
        for again in map(rho.load, (tmp_path / "flight.npz", tmp_path / "flight.json")):
            assert again.scenario == each.scenario
            assert again.scenario.under_way == each.scenario.under_way
            assert again.cost == pytest.approx(each.cost, rel=1e-12)
            assert str(rho.verify(again.plan)) == str(rho.verify(each.plan))


def test_long_flights_at_their_limits_are_verified_like_their_windows() -> None:
    tight = dataclasses.replace(LIMITS, max_acceleration=0.8)
    scenario = dataclasses.replace(scene(), limits=tight)
    ends = [rho.State([8, 0, 1.5]), rho.State([0, 3, 1.5])]
    news = {40 * (n + 1): with_goal(scenario, ends[(n + 1) % 2]) for n in range(14)}
    flight = fly(scenario, news, knots=600).flight
    assert flight.scenario.grid.duration > 60.0
    assert rho.verify(flight).ok
    norms = np.linalg.norm(flight.plan.accelerations, axis=2)
    assert 0.8 - 1e-6 <= norms.max() <= 0.8 + 1e-6


def test_a_price_of_the_distance_makes_flights_faster_or_gentler() -> None:
    gentle = dataclasses.replace(scene(), objective=rho.Objective(terminal_position=20.0))
    usual, slower = (fly(each, knots=40).flight for each in (scene(), gentle))
    assert slower.cost < usual.cost
    assert place(slower, 2.0)[0] < place(usual, 2.0)[0]


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "too short": (
        {"horizon": 0.2, "replan_every": 2},
        "horizon: got 0.2, expected a time from 0.4 to",
    ),
    "too short for the period": ({"replan_every": 40}, "horizon: got 3.0, expected a time from 4"),
    "not a number": ({"horizon": np.nan}, "horizon: got nan"),
    "no rest": ({"rest_for": 0.0}, "rest_for: got 0.0, expected a time above 0"),
    "a free final time": ({"free_final_time": True}, "horizon: got 3 s, expected none beside"),
    "a reference": ({"reference": rho.tail_reference}, "horizon: got 3 s, expected none beside"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_settings_that_do_not_fit_are_refused(case: str) -> None:
    settings, expected = REFUSED[case]
    with pytest.raises(ValueError, match=re.escape(expected)):
        rho.RecedingHorizon(scene(), **({"horizon": HORIZON} | settings))


UNPLANNED: dict[str, tuple[rho.Scenario, str]] = {
    "waypoints": (
        dataclasses.replace(
            scene(),
            vehicles=(
                vehicle(
                    "scout",
                    [0, 0, 1.5],
                    rho.State([8, 0, 1.5]),
                    waypoints=[rho.Waypoint(3.0, [4, 1, 1.5])],
                ),
            ),
        ),
        "vehicles[0].waypoints",
    ),
    "a goal in motion": (
        scene(goal=rho.State([8, 0, 1.5], [1, 0, 0])),
        "vehicles[0].goal.velocity",
    ),
    "a smoothing": (scene(smoothing=rho.Smoothing(0.1)), "smoothing"),
}


@pytest.mark.parametrize("case", UNPLANNED)
def test_scenarios_that_do_not_fit_are_refused(case: str) -> None:
    scenario, field = UNPLANNED[case]
    with pytest.raises(rho.ScenarioError) as refused:
        rho.RecedingHorizon(scenario, horizon=HORIZON)
    assert refused.value.field == field


def _mission(rng: np.random.Generator) -> tuple[rho.RecedingHorizon, list[np.ndarray]]:
    """Return a horizon after a random mission, and the obstacles (x, y, radius) of its world.

    Obstacles are seen within 5 m, more than a vehicle needs to brake, and the goal changes once.
    """
    start = np.array([-5.0, -5.0, 1.5])
    world = [np.array([*rng.uniform(-4.5, 5.0, 2), rng.uniform(0.3, 0.7)]) for _ in range(14)]
    goals = list[np.ndarray]()
    while len(goals) < 2:
        place = np.array([*rng.uniform(-4.5, 5.0, 2), rng.uniform(1.0, 2.0)])
        if all(np.hypot(*(place[:2] - o[:2])) > o[2] + RADIUS + 0.4 for o in world):
            goals.append(place)
    known: dict[int, rho.Obstacle] = {}

    def now(number: int, place: np.ndarray) -> rho.Scenario:
        for i, o in enumerate(world):
            if i not in known and np.hypot(*(place[:2] - o[:2])) < 5.0 + o[2]:
                pillar = rho.Cylinder([o[0], o[1], 1.5], o[2], 3.0)
                known[i] = rho.Obstacle(pillar, name=f"pillar {i}")
        scout = vehicle("scout", start.tolist(), rho.State(goals[number]))
        return rho.Scenario("mission", GRID, [scout], LIMITS, obstacles=list(known.values()))

    horizon = rho.RecedingHorizon(now(0, start), horizon=HORIZON, replan_every=EVERY, fallback=None)
    horizon.step(horizon.planned(0), 0.0)
    for knot in range(EVERY, 240, EVERY):
        states = horizon.planned(knot)
        told = now(int(knot >= 60), states[0, :3])
        horizon.step(states, knot * STEP, scenario=told)
    assert np.linalg.norm(horizon.planned(240)[0, :3] - goals[1]) < 1e-3
    return horizon, world


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(n, marks=pytest.mark.slow) for n in range(2, 12))]
)
def test_random_missions_stay_safe(seed: int) -> None:
    horizon, world = _mission(np.random.default_rng(seed))
    assert rho.verify(horizon.flight).ok
    _, x = samples(horizon.flight)
    for pillar in world:
        away = np.linalg.norm(x[:, 0, :2] - pillar[:2], axis=1).min()
        assert away >= pillar[2] + RADIUS - 1e-6


def test_limits_change_where_another_flight_begins(tmp_path: Path) -> None:
    scenario = scene(*PILLARS)
    fast = dataclasses.replace(LIMITS, max_speed=3.0, max_acceleration=5.0)
    horizon = fly(scenario, {16: dataclasses.replace(scenario, limits=fast)}, knots=100)
    before, after = horizon.flights
    assert before.scenario.grid.end == after.scenario.grid.start == pytest.approx(1.6)
    assert after.scenario.limits == fast
    for number, flight in enumerate(horizon.flights):
        assert rho.verify(flight).ok
        rho.save(flight, tmp_path / f"{number}.npz")
        assert str(rho.verify(rho.load(tmp_path / f"{number}.npz"))) == str(rho.verify(flight))
    assert np.linalg.norm(before.plan.velocities, axis=2).max() <= 2.0 + 1e-6
    assert np.linalg.norm(after.plan.velocities, axis=2).max() > 2.2
    ends = [np.array(each) for each in (samples(before)[1][-1], samples(after)[1][0])]
    assert np.abs(ends[0] - ends[1]).max() < 1e-9
    with pytest.raises(ValueError, match="flight: got 2 flights, expected one"):
        _ = horizon.flight


def test_a_limit_below_the_speed_flown_is_met_as_soon_as_it_can_be() -> None:
    scenario = scene()
    slow = dataclasses.replace(scenario, limits=dataclasses.replace(LIMITS, max_speed=1.0))
    _, after = fly(scenario, {20: slow}, knots=100).flights
    speeds = np.linalg.norm(after.plan.velocities[0], axis=1)
    assert speeds[0] > 1.5  # as flown before
    braking = int(np.ceil((speeds[0] - 1.0) / (3.0 * STEP)))
    assert speeds[braking + 1 :].max() <= 1.0 + 1e-6


def _fleet(separation: float, *members: rho.Vehicle) -> rho.Scenario:
    return rho.Scenario("fleet", GRID, members, LIMITS, separation=rho.Separation(separation))


A = vehicle("a", [0, 0, 1.5], rho.State([8, 0, 1.5]))
B = vehicle("b", [8, 0.1, 1.5], rho.State([0, 0.1, 1.5]))
C = vehicle("c", [4, 4, 1.5], rho.State([4, -4, 1.5]))


def test_vehicles_join_and_leave_and_their_separation_changes() -> None:
    horizon = rho.RecedingHorizon(_fleet(1.0, A, B), horizon=HORIZON, replan_every=EVERY)
    for knot in range(0, 140, EVERY):
        states, now = horizon.planned(knot), None
        if knot == 20:
            states, now = np.vstack([states, [4, 4, 1.5, 0, 0, 0]]), _fleet(1.0, A, B, C)
        if knot == 60:
            states, now = states[1:], _fleet(1.4, B, C)
        horizon.step(states, knot * STEP, scenario=now)
    flights = horizon.flights
    assert [each.scenario.names for each in flights] == [("a", "b"), ("a", "b", "c"), ("b", "c")]
    for flight, least in zip(flights, (1.0, 1.0, 1.4), strict=True):
        assert rho.verify(flight).ok
        x = samples(flight)[1]
        for i in range(x.shape[1]):
            for j in range(i):
                assert np.linalg.norm(x[:, i] - x[:, j], axis=1).min() >= least - 1e-6
    assert np.abs(samples(flights[-1])[1][-1] - [[0, 0.1, 1.5], [4, -4, 1.5]]).max() < 1e-6


@pytest.mark.parametrize(
    ("start", "field"),
    [
        (rho.State([0.3, 0.2, 1.5]), "scenario.vehicles[2].start"),
        (rho.State([4, 4, 1.5], [1, 0, 0]), "scenario.vehicles[2].start.velocity"),
    ],
)
def test_a_vehicle_that_cannot_join_is_one_error(start: rho.State, field: str) -> None:
    horizon = rho.RecedingHorizon(_fleet(0.8, A, B), horizon=HORIZON, replan_every=EVERY)
    horizon.step(horizon.planned(0), 0.0)
    # the start is clear of the others' own starts, which are ignored in flight
    moved = [
        dataclasses.replace(each, start=rho.State([x, -4, 1.5])) for each, x in ((A, 0), (B, 8))
    ]
    now = _fleet(0.8, *moved, dataclasses.replace(C, start=start))
    states = np.vstack([horizon.planned(EVERY), np.concatenate([start.position, np.zeros(3)])])
    with pytest.raises(rho.ScenarioError) as refused:
        horizon.step(states, EVERY * STEP, scenario=now)
    assert refused.value.field == field
    assert len(horizon.windows) == 1
    horizon.step(horizon.planned(EVERY), EVERY * STEP)  # the mission goes on


def test_flights_that_ended_can_be_stored_and_forgotten() -> None:
    horizon, ended = fly(scene(*PILLARS), knots=20), list[rho.Flight]()
    for knot in range(20, 100, EVERY):
        if knot % 20 == 0:
            ended += horizon.end_flight()
        horizon.step(horizon.planned(knot), knot * STEP)
        assert len(horizon.windows) <= 10
    ended += horizon.end_flight()
    assert [each.scenario.grid.start for each in ended] == pytest.approx([0.0, 2.0, 4.0, 6.0])
    assert all(rho.verify(each).ok for each in ended)
    whole = fly(scene(*PILLARS), knots=100).flight
    for each in ended:
        times = np.linspace(each.scenario.grid.start, each.scenario.grid.end, 7)
        assert each.at(times).positions == pytest.approx(whole.at(times).positions, abs=1e-6)


def test_a_map_seen_piece_by_piece_is_told_anew() -> None:
    rng = np.random.default_rng(3)
    places = np.unique(rng.integers([2, -12, 0], [30, 13, 1], (90, 3)), axis=0)
    centers = 0.25 * (places[:, :2] + 0.5)
    far = [np.linalg.norm(centers - end, axis=1) > 0.6 for end in ([0.0, 0.0], [8.0, 0.0])]
    places, centers = places[far[0] & far[1]], centers[far[0] & far[1]]
    known = np.zeros(len(places), dtype=bool)

    def seen(position: np.ndarray) -> rho.Scenario:
        known[np.linalg.norm(centers - position[:2], axis=1) < 2.5] = True
        columns = np.repeat(places[known], 12, axis=0)
        columns[:, 2] = np.tile(np.arange(12), known.sum())
        return scene(rho.Obstacle(rho.Voxels(columns, 0.25), name="map"))

    horizon = rho.RecedingHorizon(seen(np.zeros(3)), horizon=HORIZON, replan_every=1, fallback=None)
    horizon.step(horizon.planned(0), 0.0)
    for knot in range(1, 120):
        states = horizon.planned(knot)
        horizon.step(states, knot * STEP, scenario=seen(states[0, :3]))
    assert len(horizon.flights) > 1
    for flight in horizon.flights:
        assert rho.verify(flight).ok
        assert len(flight.scenario.bodies) < 20
        x = samples(flight)[1][:, 0, None, :2]
        beyond = np.maximum(np.abs(x - centers[known]) - 0.125, 0.0)
        assert np.linalg.norm(beyond, axis=2).min() >= RADIUS - 1e-6
    assert np.abs(samples(horizon.flights[-1])[1][-1, 0] - [8, 0, 1.5]).max() < 1e-6
