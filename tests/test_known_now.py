"""The scenario as it is known now, told to a receding horizon in flight."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho

GRID = rho.Grid(step=0.25, knots=41)
SPHERE = rho.Sphere([5.0, 0.2, 1.0], 1.0)
BALL = rho.Obstacle(SPHERE, name="ball")
SLOW = rho.KeepIn(rho.Ball([0, 0, 0], 1.5), of="velocity", name="slow")
Change = Callable[[rho.Scenario], rho.Scenario]


def scene(**changes: Any) -> rho.Scenario:
    """Return a flight of 10 m along x in 10 s."""
    vehicle = rho.Vehicle("scout", rho.State([0, 0, 1]), rho.State([10, 0, 1]), radius=0.2)
    limits = rho.Limits(max_speed=4.0, max_acceleration=5.0)
    return rho.Scenario("news", GRID, [vehicle], limits, **changes)


def changed(scenario: rho.Scenario, **changes: Any) -> rho.Scenario:
    """Return a scenario with other values of its one vehicle."""
    vehicles = (dataclasses.replace(scenario.vehicles[0], **changes),)
    return dataclasses.replace(scenario, vehicles=vehicles)


def fly(
    scenario: rho.Scenario, news: Mapping[float, rho.Scenario], **settings: Any
) -> rho.RecedingHorizon:
    """Return a horizon after a flight in which scenarios are told at times [s]."""
    horizon = rho.RecedingHorizon(scenario, replan_every=4, **settings)
    for knot in horizon.knots:
        time = float(GRID.times[knot])
        horizon.step(horizon.planned(knot), time, scenario=news.get(time))
    return horizon


def away(flight: rho.Flight, ball: rho.Sphere, begin: float = 0.0) -> float:
    """Return the least distance from a ball after a time, by dense samples [m]."""
    x = flight.at(np.linspace(begin, 10.0, 4001)).positions[0]
    return float(np.linalg.norm(x - ball.center, axis=1).min()) - ball.radius - 0.2


def test_the_same_scenario_told_again_changes_nothing() -> None:
    scenario = scene(obstacles=[BALL], requirements=[SLOW])
    once = fly(scenario, {})
    again = fly(scenario, {float(k): dataclasses.replace(scenario) for k in range(1, 10)})
    assert np.array_equal(once.flight.plan.accelerations, again.flight.plan.accelerations)
    assert again.flight.scenario == scenario


def test_an_obstacle_that_vanishes_is_avoided_until_then() -> None:
    horizon = fly(scene(obstacles=[BALL]), {1.0: scene()})
    flight = horizon.flight
    assert rho.verify(flight).ok
    assert away(flight, SPHERE) < -0.1
    (body,) = flight.scenario.bodies
    assert body.name == "ball until 1 s"
    assert body.active is not None
    assert body.active[1] == pytest.approx(1.0)
    never = fly(scene(), {}).flight
    assert flight.cost > never.cost
    assert flight.cost < fly(scene(obstacles=[BALL]), {}).flight.cost


def test_an_obstacle_that_appears_is_avoided_from_then_on() -> None:
    horizon = fly(scene(), {1.0: scene(obstacles=[BALL])})
    assert rho.verify(horizon.flight).ok
    assert away(horizon.flight, SPHERE) >= -1e-6
    (sighting,) = horizon.flight.sightings
    assert sighting.time == 1.0
    assert sighting.avoided


def test_an_obstacle_that_appears_on_a_clock_before_0_is_avoided_at_once() -> None:
    early = dataclasses.replace(scene(), grid=dataclasses.replace(GRID, start=-50.0))
    told = dataclasses.replace(early, obstacles=(BALL,))
    horizon = rho.RecedingHorizon(early, replan_every=4)
    for knot in horizon.knots:
        time = float(early.grid.times[knot])
        horizon.step(horizon.planned(knot), time, scenario=told if knot == 4 else None)
    x = horizon.flight.at(np.linspace(-50.0, -40.0, 4001)).positions[0]
    assert np.linalg.norm(x - SPHERE.center, axis=1).min() >= SPHERE.radius + 0.2 - 1e-6
    (body,) = horizon.flight.scenario.bodies
    assert body.active is not None
    assert body.active[0] == early.grid.times[4]


def test_obstacles_without_a_name_are_the_same_if_they_are_equal() -> None:
    one, other = rho.Sphere([5, 3, 1], 0.5), rho.Sphere([5, -3, 1], 0.5)
    horizon = fly(scene(obstacles=[one, other]), {1.0: scene(obstacles=[other])})
    assert [each.active is None for each in horizon.flight.scenario.bodies] == [False, True]


def test_an_obstacle_that_was_over_may_be_active_again() -> None:
    """It was told only when its interval was over, and then with a later one."""
    over, again = (dataclasses.replace(BALL, active=each) for each in ((0.0, 0.5), (2.0, 9.0)))
    news = {1.0: scene(obstacles=[over]), 2.0: scene(obstacles=[again])}
    flight = fly(scene(), news).flight
    assert rho.verify(flight).ok
    assert away(flight, SPHERE, 2.0) >= -1e-6


def test_cells_that_a_map_gains_are_as_uncertain_as_it_is() -> None:
    few, more = (rho.Voxels([[20, y, 2] for y in range(n)], 0.25, [0, -1, 0]) for n in (2, 5))
    first, now = (rho.Obstacle(each, name="map", position_error=0.1) for each in (few, more))
    flight = fly(scene(obstacles=[first]), {1.0: scene(obstacles=[now])}).flight
    assert rho.verify(flight).ok
    assert [each.position_error for each in flight.scenario.bodies] == [0.1, 0.1]


def test_an_obstacle_of_another_shape_replaces_the_one_before() -> None:
    sphere = rho.Sphere([5.0, 0.2, 1.0], 1.4)
    larger = dataclasses.replace(BALL, shape=sphere)
    flight = fly(scene(obstacles=[BALL]), {1.0: scene(obstacles=[larger])}).flight
    assert rho.verify(flight).ok
    assert away(flight, sphere) >= -1e-6
    assert [each.name for each in flight.scenario.bodies] == ["ball until 1 s", "ball"]


@pytest.mark.parametrize("settings", [{}, {"free_final_time": True}, {"contingencies": True}])
def test_a_goal_may_become_another(settings: Any) -> None:
    scenario = scene(obstacles=[BALL])
    horizon = fly(scenario, {2.0: changed(scenario, goal=rho.State([8, 3, 1]))}, **settings)
    assert rho.verify(horizon.flight).ok
    np.testing.assert_allclose(horizon.flight.plan.positions[0, -1], [8, 3, 1], atol=1e-6)


def test_a_goal_without_a_plan_leaves_the_one_before() -> None:
    """It cannot be reached in the time that is left; once another can be, it is."""
    scenario = scene()
    far, near = (changed(scenario, goal=rho.State([x, 0, 1])) for x in (60.0, 11.0))
    horizon = fly(scenario, {6.0: far, 8.0: near})
    kept = [window.kept for window in horizon.windows]
    assert kept == [False] * 6 + [True] * 2 + [False] * 2
    assert "goal" in horizon.windows[6].infeasible
    assert rho.verify(horizon.flight).ok
    never = fly(scenario, {6.0: far}).flight
    np.testing.assert_allclose(never.plan.positions[0, -1], [10, 0, 1], atol=1e-6)
    assert [each.constraint for each in rho.verify(never).violations] == ["goal"]


def test_requirements_begin_and_end() -> None:
    slow = dataclasses.replace(SLOW, set=rho.Ball([0, 0, 0], 1.3))
    flight = fly(scene(), {2.0: scene(requirements=[slow]), 5.0: scene()}).flight
    assert rho.verify(flight).ok
    assert flight.scenario.requirements[0].name == "slow until 5 s"
    assert flight.scenario.requirements[0].active == pytest.approx((2.0, 5.0))
    times = np.linspace(0.0, 10.0, 4001)
    speeds = np.linalg.norm(flight.at(times).velocities[0], axis=1)
    due = (times >= 2.0) & (times <= 4.999)
    assert speeds[due].max() <= 1.3 + 1e-6
    assert speeds[times > 5.5].max() > 1.3


def test_a_requirement_that_the_plan_in_force_breaks_ends_it() -> None:
    scenario = scene()
    plan, calls = rho.plan(scenario), list[rho.Plan]()

    def once(scenario: rho.Scenario, *, reference: Any, solver: Any) -> rho.Plan:
        if calls:
            raise rho.InfeasibleError({"scout": ("nothing",)}, scenario=scenario)
        calls.append(plan)
        return plan

    for disturbance in (None, rho.Disturbance(acceleration=0.01)):
        calls.clear()
        own = dataclasses.replace(scenario, disturbance=disturbance)
        plan = rho.plan(own)
        horizon = rho.RecedingHorizon(own, replan_every=4, planner=once, fallback=None)
        horizon.step(horizon.planned(0), 0.0)
        now = dataclasses.replace(own, requirements=(SLOW,))
        window = horizon.step(horizon.planned(4), 1.0, scenario=now)
        assert not window.kept


def test_waypoints_ahead_may_be_others() -> None:
    passed, ahead = rho.Waypoint(3.0, [2, 1, 1]), rho.Waypoint(7.0, [7, 1, 1])
    scenario = changed(scene(), waypoints=(passed, ahead))
    free = rho.Waypoint(None, [6, -2, 1], name="new")
    flight = fly(scenario, {4.0: changed(scenario, waypoints=(passed, free))}).flight
    assert rho.verify(flight).ok
    first, second = flight.scenario.vehicles[0].waypoints
    assert first == passed
    assert second.name == "new"
    assert second.time is not None
    assert 4.0 < second.time < 10.0
    for time, each in ((3.0, first), (second.time, second)):
        away = flight.at([time]).positions[0, 0] - each.position
        assert np.abs(away).max() <= 1e-6


def test_free_waypoints_that_have_been_passed_are_not_passed_again() -> None:
    gate, other = rho.Waypoint(None, [2, 1, 1]), rho.Waypoint(None, [7, 1, 1])
    scenario = changed(scene(), waypoints=(gate,))
    flight = fly(scenario, {8.0: changed(scenario, waypoints=(gate, other))}).flight
    places = [each.position.tolist() for each in flight.scenario.vehicles[0].waypoints]
    assert places == [[2, 1, 1], [7, 1, 1]]


def test_starts_are_ignored() -> None:
    scenario = scene()
    moved = changed(scenario, start=rho.State([3, 3, 1], [1, 0, 0]))
    assert fly(scenario, {2.0: moved}).flight.scenario == scenario


FIXED: dict[str, tuple[Any, str]] = {
    "another vehicle": (lambda s: changed(s, name="other"), "scenario.vehicles"),
    "another step": (
        lambda s: dataclasses.replace(s, grid=rho.Grid(0.5, 41)),
        "scenario.grid.step",
    ),
    "other limits": (
        lambda s: dataclasses.replace(s, limits=rho.Limits(max_speed=2.0)),
        "scenario.limits",
    ),
    "another radius": (lambda s: changed(s, radius=0.5), "scenario.vehicles[0].radius"),
    "one name twice": (
        lambda s: dataclasses.replace(s, obstacles=[BALL, BALL]),
        "scenario.obstacles[1].name",
    ),
}


@pytest.mark.parametrize("case", FIXED)
def test_what_stays_the_same_in_a_flight_is_told(case: str) -> None:
    change, field = FIXED[case]
    horizon = rho.RecedingHorizon(scene(), replan_every=4)
    horizon.step(horizon.planned(0), 0.0)
    with pytest.raises(rho.ScenarioError) as refused:
        horizon.step(horizon.planned(4), 1.0, scenario=change(scene()))
    assert refused.value.field == field
    assert len(horizon.windows) == 1


def test_files_tell_what_was_known_when(tmp_path: Path) -> None:
    news = {1.0: scene(obstacles=[BALL], requirements=[SLOW]), 4.0: scene(obstacles=[BALL])}
    flight = fly(scene(), news).flight
    rho.save(flight, tmp_path / "flight.npz")
    again = rho.load(tmp_path / "flight.npz")
    assert again.scenario == flight.scenario
    assert rho.verify(again).ok


def _drawn(rng: np.random.Generator, now: rho.Scenario, time: float) -> rho.Scenario:
    """Return a scenario with one thing changed at random."""
    bodies, kind = list(now.bodies), rng.integers(5)
    if kind == 0 and bodies:
        bodies.pop(rng.integers(len(bodies)))
    elif kind == 1:
        shape = rho.Sphere(rng.uniform([2, -2, 0.5], [9, 3, 1.5]), rng.uniform(0.3, 0.9))
        bodies.append(rho.Obstacle(shape, name=f"new at {time:g}"))
    elif kind == 2:
        goal = rho.State([rng.uniform(8, 12), rng.uniform(-1, 4), 1])
        return changed(now, goal=goal)
    elif kind == 3:
        most = rho.Ball([0, 0, 0], rng.uniform(2.5, 4.0))
        slow = rho.KeepIn(most, of="velocity", name=f"slow from {time:g}")
        return dataclasses.replace(now, requirements=(slow,) if rng.random() < 0.7 else ())
    elif bodies:
        index = int(rng.integers(len(bodies)))
        place = bodies[index].centers(np.array([time]))[0] + 0.1 * rng.normal(size=3)
        again = dataclasses.replace(bodies[index], position_error=0.1)
        bodies[index] = again.seen(place, 0.2 * rng.normal(size=3), time)
    return dataclasses.replace(now, obstacles=tuple(bodies))


@pytest.mark.parametrize(
    "seed", [*range(6), *(pytest.param(each, marks=pytest.mark.slow) for each in range(6, 60))]
)
def test_random_news_break_nothing_that_was_avoidable(seed: int) -> None:
    rng = np.random.default_rng(seed)
    disturbance = rho.Disturbance(acceleration=0.05) if seed % 3 == 1 else None
    now, news = scene(obstacles=[BALL], disturbance=disturbance), dict[float, rho.Scenario]()
    first = now
    for time in range(1, 9):
        if rng.random() < 0.5:
            try:
                now = news[float(time)] = _drawn(rng, now, float(time))
            except rho.ScenarioError:  # such as a goal inside of an obstacle
                continue
    horizon = fly(first, news, free_final_time=seed % 5 == 2, contingencies=seed % 4 == 3)
    flight, report = horizon.flight, rho.verify(horizon.flight)
    without = [window for window in horizon.windows if window.infeasible]
    unavoidable = {each.obstacle for each in flight.sightings if not each.avoided}
    if any(not window.kept for window in without):  # a speed that was higher when it was told
        unavoidable.add("requirement")
    if without:
        unavoidable.add("goal")
    for each in report.violations:
        assert each.constraint.startswith(tuple(unavoidable)), each
