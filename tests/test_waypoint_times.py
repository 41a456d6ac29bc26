"""Times of waypoints that `rho.plan` finds: with everything in view, where places are allowed.

Each is judged by plans in which the same times are given.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pytest

import drake_rho as rho
from drake_rho.planning.planners.allowed_times import AllowedTimes
from drake_rho.scenario.waypoints import AllWaypoints
from tests.scenarios import slow

BEST = 2e-3
"""Relative difference of costs at times that are found and at the best ones given."""

SAME = 1e-4
"""Relative difference of costs with a limit and with the same bound as a requirement."""

HELD = 4.0
"""Time at which a place is no longer forbidden, or begins to be [s]."""


def flight(
    time: float | None,
    place: Sequence[float] = (3.0, 1.0, 0.0),
    grid: rho.Grid | None = None,
    limits: rho.Limits | None = None,
    obstacles: Sequence[rho.Obstacle] = (),
    requirements: Sequence[rho.KeepIn] = (),
) -> rho.Scenario:
    """Return 6 m from rest to rest, through one place on the way."""
    ends = rho.State([0.0, 0.0, 0.0]), rho.State([6.0, 0.0, 0.0])
    vehicle = rho.Vehicle("v", *ends, radius=0.1, waypoints=[rho.Waypoint(time, place)])
    return rho.Scenario(
        "waypoint",
        grid or rho.Grid(0.25, 25),
        [vehicle],
        limits or rho.Limits(max_speed=3.0, max_acceleration=4.0),
        obstacles,
        requirements=requirements,
    )


def timed(scenario: rho.Scenario, time: float) -> rho.Scenario:
    """Return the scenario of one vehicle with its first waypoint at a time."""
    vehicle = scenario.vehicles[0]
    first = dataclasses.replace(vehicle.waypoints[0], time=time)
    waypoints = first, *vehicle.waypoints[1:]
    return dataclasses.replace(
        scenario, vehicles=(dataclasses.replace(vehicle, waypoints=waypoints),)
    )


def best_given(scenario: rho.Scenario, times: npt.ArrayLike) -> float:
    """Return the least cost of plans with times of the first waypoint that are given."""
    costs = []
    for time in np.asarray(times):
        try:
            costs.append(rho.plan(timed(scenario, float(time))).cost)
        except (rho.InfeasibleError, rho.ScenarioError):
            continue
    return min(costs)


def best_found(scenario: rho.Scenario) -> rho.Plan:
    """Return the plan with times that are found, which has to hold."""
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    return plan


@pytest.mark.parametrize("speed", [1.69, *slow(1.7, 1.75, 1.9)])
def test_a_required_speed_leads_to_the_times_that_the_same_limit_does(speed: float) -> None:
    place, limited = (5.5, 2.5, 0.0), rho.Limits(max_speed=speed)
    kept = rho.KeepIn(rho.Ball([0.0, 0.0, 0.0], speed), of="velocity")
    required = best_found(flight(None, place, limits=rho.Limits(), requirements=[kept]))
    limit = best_found(flight(None, place, limits=limited))
    assert required.cost == pytest.approx(limit.cost, rel=SAME)


def test_a_gate_that_opens_late_is_passed_when_that_costs_least() -> None:
    closed = rho.KeepIn(rho.HalfSpace([1.0, 0.0, 0.0], 1.0), active=(0.0, 3.9))
    scenario = flight(None, (3.0, 0.5, 0.0), rho.Grid(0.25, 33), rho.Limits(), (), [closed])
    plan = best_found(scenario)
    assert plan.cost <= (1.0 + BEST) * best_given(scenario, [3.95, 4.5, 5.0, 5.2, 5.3, 5.4, 6.0])


@pytest.mark.parametrize(
    ("obstacle", "allowed"),
    [
        pytest.param(
            rho.Obstacle(rho.Sphere([3, 1, 0], 0.5), active=(0.0, HELD)),
            (HELD, 6.0),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            rho.Obstacle(rho.Sphere([3, 1, 0], 0.5), active=(6.0 - HELD, 6.0)),
            (0.0, 6.0 - HELD),
            marks=pytest.mark.slow,
        ),
        (
            rho.Obstacle(
                rho.Box([-0.5] * 3, [0.5] * 3),
                track=rho.Track([0, 2, 4], [[3, 1, 0], [3, 1, 0], [3, 9, 0]], after="rests"),
            ),
            (2.0, 6.0),
        ),
    ],
    ids=["until", "from", "moving away"],
)
def test_a_place_that_is_forbidden_for_a_while_is_passed_at_another_time(
    obstacle: rho.Obstacle, allowed: tuple[float, float]
) -> None:
    scenario = flight(None, obstacles=[obstacle])
    plan = best_found(scenario)
    (waypoint,) = plan.scenario.vehicles[0].waypoints
    assert waypoint.time is not None
    assert allowed[0] < waypoint.time < allowed[1]
    assert plan.cost <= (1.0 + BEST) * best_given(scenario, np.linspace(*allowed, 9)[1:-1])


def moving(times: Sequence[float | None]) -> rho.Scenario:
    """Return a flight under a limit of jerk from and to motion, past two waypoints."""
    start = rho.State([0.13879781, 0.39568076, 0.23334248], [-0.72118087, -0.34483635, -0.19495276])
    goal = rho.State([1.82805215, 1.50649492, 0.52707189])
    places = [[0.24632771, 0.5295395, 0.20423661], [1.63477802, 1.33345269, 0.44033054]]
    waypoints = [rho.Waypoint(t, at, 0.02154172) for t, at in zip(times, places, strict=True)]
    vehicle = rho.Vehicle("v", start, goal, waypoints=waypoints)
    return rho.Scenario("jerk", rho.Grid(0.4, 6), [vehicle], rho.Limits(max_jerk=11.61258879))


def test_times_are_found_though_the_first_guess_has_no_motion() -> None:
    scenario = moving([None, 1.6])
    plan = best_found(scenario)
    assert plan.cost <= (1.0 + BEST) * best_given(scenario, np.arange(0.3, 1.0, 0.05))


@pytest.mark.parametrize("planner", [rho.plan, *slow(rho.plan_minimum_time)])
def test_waypoints_are_passed_a_hundredth_of_a_step_apart(
    planner: Callable[[rho.Scenario], rho.Plan],
) -> None:
    """At the largest speed of 2 m/s all the way, steps of 0.25 s are 0.5 m long."""
    moving = [rho.State([x, 0.0, 0.0], [2.0, 0.0, 0.0]) for x in (0.0, 6.0)]
    places = [[x, 0.0, 0.0] for x in (3.0, 3.005, 3.01)]
    waypoints = [rho.Waypoint(None, each) for each in places]
    vehicle = rho.Vehicle("v", moving[0], moving[1], waypoints=waypoints)
    limits = rho.Limits(max_speed=2.0)
    plan = planner(rho.Scenario("close", rho.Grid(0.25, 13), [vehicle], limits))
    assert rho.verify(plan).ok
    assert plan.scenario.grid.duration == pytest.approx(3.0, rel=SAME)


@pytest.mark.slow
def test_nothing_is_proved_of_times_that_were_chosen() -> None:
    """A waypoint 30 m aside is too far, but it is not proved that it is at every time."""
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(flight(None, (3.0, 30.0, 0.0), rho.Grid(0.5, 8)))
    assert not caught.value.is_proved
    assert "times" in str(caught.value)


def test_what_is_infeasible_without_the_waypoints_is_proved() -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(flight(None, grid=rho.Grid(0.1, 15)))
    assert caught.value.is_proved
    assert not any("waypoint" in each for each in caught.value.conflicts["v"])


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 20))])
@pytest.mark.parametrize("clock", [0.0, 1.7e9])
def test_times_are_allowed_where_a_scenario_with_them_is_valid(seed: int, clock: float) -> None:
    rng = np.random.default_rng([45, seed])
    first, last = np.sort(rng.uniform(0.3, 5.7, 2))
    until = clock + float(rng.choice([first, 1.0]))
    track = rho.Track(clock + np.sort(rng.uniform(0.0, 6.0, 3)), rng.uniform(0.5, 4.0, (3, 3)))
    scenario = dataclasses.replace(
        flight(None, grid=rho.Grid(0.25, 25, clock)),
        obstacles=(
            rho.Obstacle(rho.Sphere([3.0, 1.2, 0.0], 0.4), active=(until, clock + float(last))),
            rho.Obstacle(rho.Box([-1.0] * 3, [1.0] * 3), track=track),
        ),
        requirements=(
            rho.KeepIn(rho.HalfSpace([1.0, 0.0, 0.0], 2.0), active=(clock + 0.2, clock + 0.9)),
        ),
    )
    waypoints = AllWaypoints.of(scenario.vehicles)
    without = dataclasses.replace(scenario, vehicles=waypoints.placed(scenario.vehicles, None))
    (intervals,) = AllowedTimes.of(without, waypoints).intervals
    inner = [a + (b - a) * part for a, b in intervals for part in (0.0, 0.5, 1.0)]
    for time in inner:
        if 0.01 < time < 5.99:  # in the flight
            timed(scenario, clock + time)
    gaps = zip([0.0, *intervals[:, 1]], [*intervals[:, 0], 6.0], strict=True)
    for a, b in gaps:
        if b - a > 1e-5:
            with pytest.raises(rho.ScenarioError):
                timed(scenario, clock + a + 0.5 * (b - a))


@pytest.mark.parametrize("planner", [rho.plan, rho.plan_rho])
def test_a_place_that_is_forbidden_at_all_times_is_named(planner: Callable[..., object]) -> None:
    """It is no error about a time, which nobody gave."""
    creeping = rho.Obstacle(rho.Sphere([3, 1, 0], 0.5), velocity=[1e-3, 0, 0])
    ways = [rho.Waypoint(None, [1, 0, 0]), rho.Waypoint(None, [3, 1, 0])]
    vehicle = rho.Vehicle(
        "v", rho.State([0, 0, 0]), rho.State([6, 0, 0]), radius=0.1, waypoints=ways
    )
    scenario = rho.Scenario("zone", rho.Grid(0.25, 33), [vehicle], obstacles=[creeping])
    with pytest.raises(rho.InfeasibleError, match="at all times: v: waypoint 2") as caught:
        planner(scenario)
    assert not caught.value.is_proved
