"""Obstacles that a receding horizon sees again, with errors that count anew."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.horizon.known_now import Known
from tests.scenarios import single, slow

OFF, DRIFT, EVERY = 0.12, 0.08, 4
"""Errors of a sighting, of position [m] and velocity [m/s], and the steps of a window."""
RADIUS, SPEED = 0.5, np.array([-0.8, 0.0, 0.0])


def _scenario(start: float = 0.0, **more: Any) -> rho.Scenario:
    """Return one vehicle, 10 s from rest to rest, and an intruder that comes towards it."""
    intruder = rho.Obstacle(
        rho.Sphere(np.array([9.0, 0.2, 1.0]) - start * SPEED, RADIUS),
        velocity=SPEED,
        name="intruder",
        position_error=OFF,
        velocity_error=DRIFT,
        seen_at=start,
    )
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([10, 0, 1]), radius=0.15)
    grid = rho.Grid.lasting(10.0, step=0.25, start=start)
    return rho.Scenario("seen", grid, [vehicle], obstacles=[intruder], **more)


class Truth:
    """A true motion that is within the errors of every sighting of it, and these sightings.

    Args:
        rng: of the velocities, which change at every window by no more than the errors allow, and
            of the errors of what is seen.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        place = np.array([9.0, 0.2, 1.0]) + 0.9 * OFF * _in_ball(rng)
        self._places, self._speeds = [place], []
        for _ in range(10):
            self._speeds.append(SPEED + 0.4 * DRIFT * _in_ball(rng))
            self._places.append(self._places[-1] + self._speeds[-1])
        self._rng = rng

    def at(self, elapsed: np.ndarray) -> np.ndarray:
        """Return true positions at times since the start, (M, 3)."""
        k = np.minimum(elapsed.astype(int), 9)
        moved = (elapsed - k)[:, None] * np.array(self._speeds)[k]
        return np.asarray(np.array(self._places)[k] + moved)

    def seen(self, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the position and the velocity that are seen after a number of seconds."""
        place = self._places[second] + OFF * _in_ball(self._rng)
        return place, SPEED + 0.5 * DRIFT * _in_ball(self._rng)


def _in_ball(rng: np.random.Generator) -> np.ndarray:
    way = rng.standard_normal(3)
    return np.asarray(way / np.linalg.norm(way) * rng.uniform(0.0, 1.0))


def again(scenario: rho.Scenario, place: Any, speed: Any, time: float) -> rho.Scenario:
    """Return a scenario whose one obstacle was seen again."""
    (body,) = scenario.bodies
    return dataclasses.replace(scenario, obstacles=(body.seen(place, speed, time),))


def news(scenario: rho.Scenario, now: rho.Scenario, time: float) -> Known:
    """Return what is known of a flight after a scenario was told."""
    return Known.of(scenario, scenario).with_news(now, time, 0.0)


def _no_plan(scenario: rho.Scenario) -> rho.Plan:
    raise rho.InfeasibleError({"v": ("nothing",)}, scenario=scenario)


def _fly(
    horizon: rho.RecedingHorizon, truth: Truth, start: float = 0.0, *, blind: bool = False
) -> list[rho.Scenario]:
    """Fly with a sighting before every window but the first; return what is known after each."""
    known, given = [], horizon.scenario
    for k in horizon.knots:
        time = start + 0.25 * k
        now = None if k == 0 or blind else again(given, *truth.seen(k // EVERY), time)
        horizon.step(horizon.planned(k), time, scenario=now)
        known.append(horizon.scenario)
    return known


def _clearance(plan: rho.Plan, truth: Truth, start: float) -> float:
    elapsed = np.linspace(0.0, 10.0, 4001)
    away = plan.at(start + elapsed).positions[0] - truth.at(elapsed)
    return float(np.linalg.norm(away, axis=1).min()) - RADIUS - 0.15


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 20))])
def test_no_truth_within_the_errors_is_met(seed: int, start: float) -> None:
    truth = Truth(np.random.default_rng(seed))
    horizon = rho.RecedingHorizon(_scenario(start), replan_every=EVERY)
    _fly(horizon, truth, start)
    flight = horizon.flight
    assert rho.verify(flight).ok
    assert _clearance(flight.plan, truth, start) >= -1e-6
    assert all(not window.not_avoided for window in flight.windows)


def test_sightings_make_flights_cheaper_than_growing_errors() -> None:
    truth = Truth(np.random.default_rng(0))
    costs = []
    for blind in (False, True):
        horizon = rho.RecedingHorizon(_scenario(), replan_every=EVERY)
        _fly(horizon, truth, blind=blind)
        costs.append(horizon.flight.cost)
    assert costs[0] < costs[1]


@pytest.mark.parametrize("disturbed", [False, True])
def test_the_rest_of_a_plan_stays_valid_without_a_new_one(disturbed: bool) -> None:
    """Its own sighting holds as well: the new one need not be inside of what that allows."""
    around = rho.Disturbance(acceleration=0.05, feedback_every=0.05) if disturbed else None
    scenario = _scenario(disturbance=around)
    first = rho.plan(scenario)
    calls = [first]

    def once(scenario: rho.Scenario, *, reference: rho.Plan | None, solver: Any) -> rho.Plan:
        return calls.pop() if calls else _no_plan(scenario)

    for seed in range(3):
        calls[:] = [first]
        horizon = rho.RecedingHorizon(scenario, replan_every=EVERY, planner=once, fallback=None)
        truth = Truth(np.random.default_rng(seed))
        known = _fly(horizon, truth)
        assert all(window.kept for window in horizon.windows[1:])
        assert all(each.obstacles is scenario.obstacles for each in known)
        assert rho.verify(horizon.flight).ok
        np.testing.assert_array_equal(horizon.flight.plan.accelerations, first.accelerations)
        assert _clearance(horizon.flight.plan, truth, 0.0) >= -1e-6


def test_what_contradicts_the_errors_holds_in_any_case() -> None:
    scenario = _scenario()
    plan = rho.plan(scenario)
    at = 0.25 * EVERY
    center = scenario.bodies[0].centers(np.array([at]))[0]
    most = 2.0 * OFF + DRIFT * at
    for away, excluded in ((most - 1e-6, False), (most + 1e-6, True)):
        place = center + away * np.eye(3)[1]
        known = news(scenario, again(scenario, place, SPEED, at), at)
        assert (known.necessary[0] is scenario.obstacles) == (not excluded)
        assert len(known.flight.bodies) == 2
        assert (known.flight.bodies == known.necessary[0]) == excluded
    calls = [plan]

    def once(scenario: rho.Scenario, *, reference: rho.Plan | None, solver: Any) -> rho.Plan:
        return calls.pop() if calls else _no_plan(scenario)

    horizon = rho.RecedingHorizon(scenario, replan_every=EVERY, planner=once, fallback=None)
    horizon.step(horizon.planned(0), 0.0)
    ahead = plan.at(3.0).positions.reshape(3)
    now = again(scenario, ahead, [0, 0, 0], at)
    window = horizon.step(horizon.planned(EVERY), at, scenario=now)
    assert not window.kept
    assert len(horizon.scenario.bodies) == 2  # the motion of least violation keeps clear of it
    assert _clearance_from(window.plan, ahead) > -0.2


def _clearance_from(plan: rho.Plan, place: np.ndarray) -> float:
    times = np.linspace(plan.times[0], plan.times[-1], 1001)
    return float(np.linalg.norm(plan.at(times).positions[0] - place, axis=1).min()) - RADIUS - 0.15


def test_reports_and_files_tell_what_was_known_when(tmp_path: object) -> None:
    horizon = rho.RecedingHorizon(_scenario(), replan_every=EVERY)
    _fly(horizon, Truth(np.random.default_rng(0)))
    flight = horizon.flight
    names = [body.name for body in flight.scenario.bodies]
    assert names[0] == "intruder until 1 s"
    assert names[-1] == "intruder"
    assert [each.time for each in flight.sightings] == [float(t) for t in range(1, 10)]
    assert all(each.avoided for each in flight.sightings)
    rows = [each for each in rho.verify(flight).checks if each.kind == "obstacles"]
    for each in rows:
        number = int(each.constraint.split()[1])
        assert number - 1 - 1e-6 <= each.time <= number + 1e-6 or each.time == 0.0
    rho.save(flight, f"{tmp_path}/flight.npz")
    assert rho.verify(rho.load(f"{tmp_path}/flight.npz")).ok


def test_an_obstacle_is_known_once_it_is_seen() -> None:
    hidden = dataclasses.replace(_scenario().bodies[0], known_from=9.0)
    scenario = dataclasses.replace(_scenario(), obstacles=(hidden,))
    horizon = rho.RecedingHorizon(scenario, replan_every=EVERY)
    truth = Truth(np.random.default_rng(1))
    _fly(horizon, truth)
    assert rho.verify(horizon.flight).ok
    assert _clearance(horizon.flight.plan, truth, 0.0) >= -1e-6


def test_intervals_of_time_stay() -> None:
    body = _scenario().bodies[0]
    place = [5.0, 0.0, 1.0]
    for active, old, new in (
        ((2.0, 8.0), (2.0, 5.0), (5.0, 8.0)),
        ((6.0, 8.0), (-0.5, -0.25), (6.0, 8.0)),
    ):
        timed = dataclasses.replace(body, active=active)
        scenario = dataclasses.replace(_scenario(), obstacles=(timed,))
        now = news(scenario, again(scenario, place, SPEED, 5.0), 5.0).flight
        assert now.bodies[0].active == pytest.approx(old, abs=1e-5)
        assert now.bodies[1].active == pytest.approx(new)
    over = dataclasses.replace(_scenario(), obstacles=(dataclasses.replace(body, active=(1, 4)),))
    assert news(over, again(over, place, SPEED, 5.0), 5.0).flight.bodies == over.bodies


@pytest.mark.parametrize("place", [[0, 0, np.nan], [0, 0], "there"])
def test_what_is_no_sighting_is_told(place: Any) -> None:
    with pytest.raises(rho.ScenarioError, match="position: got"):
        _scenario().bodies[0].seen(place, [0, 0, 0], 1.0)


def test_a_name_of_two_obstacles_is_told() -> None:
    body = dataclasses.replace(_scenario().bodies[0], shape=rho.Sphere([5, 4, 1], 0.5))
    twice = dataclasses.replace(single(), obstacles=(body, body))
    with pytest.raises(rho.ScenarioError, match=r"obstacles\[1\].name: got 'intruder'"):
        news(single(), twice, 1.0)
