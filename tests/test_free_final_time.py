"""Windows with a free final time: arrivals fall, and do not rise while what was proved holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import drake_rho as rho
from drake_rho import cli
from drake_rho.planning.horizon.waypoints_ahead import until
from tests.scenarios import slow

LIMITS = rho.Limits(max_speed=3.0, max_acceleration=3.0)
WIND = rho.Disturbance(0.2, 0.005, 0.01, feedback_every=0.1)


def crossing(
    *obstacles: rho.Sphere | rho.Obstacle, knots: int = 41, step: float = 0.2, length: float = 6.0
) -> rho.Scenario:
    """Return one vehicle that flies along x among obstacles, with time to spare."""
    vehicle = rho.Vehicle("a", rho.State([0, 0, 1]), rho.State([length, 0, 1]), radius=0.2)
    return rho.Scenario("crossing", rho.Grid(step, knots), [vehicle], LIMITS, obstacles)


def arrival_steps(plan: rho.Plan) -> int:
    """Return the number of steps after which no vehicle accelerates any more."""
    moving = np.flatnonzero(plan.accelerations.any(axis=(0, 2)))
    return int(moving[-1]) + 1 if len(moving) > 0 else 0


def arrivals(flown: rho.Plan | rho.Flight | rho.Simulation) -> list[int]:
    """Return the knots at which windows arrive, of those that begin before their arrival."""
    steps = [(window.first_knot, arrival_steps(window.plan)) for window in flown.windows]
    return [first + count for first, count in steps if count > 0]


def flown_as_planned(scenario: rho.Scenario, moved: dict[int, list[float]]) -> rho.RecedingHorizon:
    """Return a horizon whose windows begin as planned, but for given deviations at knots."""
    horizon = rho.RecedingHorizon(scenario, free_final_time=True)
    for knot in horizon.knots:
        states = horizon.planned(knot) + moved.get(knot, 0.0)
        horizon.step(states, scenario.grid.times[knot])
    return horizon


def test_the_first_window_arrives_at_the_knot_after_the_least_time() -> None:
    for scenario in (crossing(), crossing(rho.Sphere([3, 0.1, 1], 0.6))):
        horizon = rho.RecedingHorizon(scenario, free_final_time=True, fallback=None)
        window = horizon.step(horizon.planned(0), 0.0)
        steps = arrival_steps(window.plan)
        least = rho.plan_minimum_time(scenario, knots=steps + 1).scenario.grid.duration
        assert least - 1e-6 <= 0.2 * steps < least + 0.2
        assert window.plan.arrivals == pytest.approx([0.2 * steps])
        assert not window.plan.accelerations[:, steps:].any()
        assert rho.verify(window.plan).ok


def test_nothing_changes_where_the_last_knot_is_the_least_time() -> None:
    scenario = crossing(knots=16)
    fixed, free = (rho.plan_rho(scenario, free_final_time=each) for each in (False, True))
    assert np.array_equal(free.plan.accelerations, fixed.plan.accelerations)


def test_in_still_air_no_window_arrives_later_than_the_first() -> None:
    flight = rho.plan_rho(crossing(rho.Sphere([3, 0.1, 1], 0.6)), free_final_time=True)
    assert len({*arrivals(flight)}) == 1
    assert not any(window.infeasible for window in flight.windows)
    assert flight.windows[-1].kept
    assert flight.plan.arrivals == pytest.approx(flight.windows[0].plan.arrivals)
    assert rho.verify(flight).ok


def test_the_least_time_is_the_grid_of_a_plan_of_least_time() -> None:
    fastest = rho.plan_minimum_time(crossing(knots=13))
    flight = rho.plan_rho(fastest.scenario, free_final_time=True, fallback=None)
    assert {*arrivals(flight)} == {12}
    assert rho.verify(flight).ok


def test_an_earlier_end_has_the_tube_of_feedback_without_prediction() -> None:
    around = dataclasses.replace(WIND, delay=2, prediction=False)
    scenario = dataclasses.replace(crossing(), disturbance=around)
    short = until(scenario, rho.Grid(0.2, 21), scenario.vehicles)
    tubes = rho.error_tube(scenario), rho.error_tube(short)
    assert tubes[0].position(4.0) == tubes[1].position(4.0)


def windy(seed: int) -> rho.Scenario:
    """Return one to three vehicles in wind that meet in the middle, some of them at waypoints."""
    rng = np.random.default_rng(seed)
    count, radius = int(rng.integers(1, 4)), rng.uniform(2.5, 4.0)
    vehicles = []
    for i, turn in enumerate(2 * np.pi * np.arange(count) / count + rng.uniform(0, 6)):
        x, y = radius * np.cos(turn), radius * np.sin(turn)
        gate = rho.Waypoint(None, [-0.4 * y, 0.4 * x, 1.5], within=0.5)
        ends = rho.State([x, y, 1]), rho.State([-x, -y, 1])
        passed = [gate] if rng.random() < 0.3 else []
        vehicles.append(rho.Vehicle(f"v{i}", *ends, radius=0.1, waypoints=passed))
    apart = rho.Separation(0.4) if count > 1 else None
    obstacles = [rho.Sphere([*rng.uniform(-1, 1, 2), 1], 0.4)] if rng.random() < 0.5 else []
    grid = rho.Grid(0.2, int(rng.integers(25, 40)), float(rng.choice([0.0, 7.0])))
    limits = dataclasses.replace(LIMITS, max_jerk=15.0 if rng.random() < 0.3 else None)
    delay = int(rng.integers(0, 2))
    around = dataclasses.replace(WIND, acceleration=rng.uniform(0.1, 0.3), delay=delay)
    return rho.Scenario("windy", grid, vehicles, limits, obstacles, apart, disturbance=around)


def check_no_rise(
    scenario: rho.Scenario, seed: int, fallback: Callable[..., rho.Plan] | None
) -> None:
    """Check that no window arrives later than the one before it, in noise."""
    rng = np.random.default_rng(seed)
    every = int(rng.integers(3, 6))
    wind = rho.winds.coloured_noise(scenario, rng)
    simulation = rho.simulate(
        scenario, replan_every=every, free_final_time=True, fallback=fallback, wind=wind, rng=rng
    )
    found = arrivals(simulation)
    assert found == sorted(found, reverse=True)
    assert found[0] < scenario.grid.knots - 1
    assert all(window.kept or not window.infeasible for window in simulation.windows)
    assert rho.verify(simulation).ok
    for window in simulation.windows:
        assert rho.verify(window.plan).ok


def test_no_wind_makes_a_window_arrive_later() -> None:
    check_no_rise(dataclasses.replace(crossing(knots=21, length=4.0), disturbance=WIND), 1, None)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(16))
def test_no_wind_makes_a_window_of_random_fleets_arrive_later(seed: int) -> None:
    try:
        check_no_rise(windy(seed), seed, rho.plan)
    except rho.InfeasibleError:
        pytest.skip("the first window has no plan")


def test_a_block_that_goes_away_makes_the_arrival_earlier() -> None:
    both = rho.Voxels([[0, 0, 0], [0, 3, 0]], 2.0, origin=[2.0, -0.9, 0.0])
    scenario = crossing(rho.Obstacle(both, name="blocks"))
    horizon = rho.RecedingHorizon(scenario, replan_every=3, free_final_time=True)
    left = dataclasses.replace(both, occupied=both.occupied[1:])
    for knot in horizon.knots[:3]:
        now = crossing(rho.Obstacle(left, name="blocks")) if knot == 3 else None
        horizon.step(horizon.planned(knot), scenario.grid.times[knot], scenario=now)
    first, *others = arrivals(horizon.flight)
    assert max(others) < first
    assert len({*others}) == 1
    assert rho.verify(horizon.flight).ok


def test_vehicles_ahead_of_their_plan_arrive_earlier_and_those_behind_later() -> None:
    ahead = flown_as_planned(crossing(), {5: [0.9, 0, 0, 0, 0, 0]})
    first, *others = arrivals(ahead.flight)
    assert {*others} == {first - 1}
    behind = flown_as_planned(crossing(), {5: [-0.5, 0, 0, 0, 0, 0]})
    first, *others = arrivals(behind.flight)
    assert {*others} == {first + 1}
    assert not any(window.infeasible for window in behind.windows)


def test_an_obstacle_that_is_news_may_make_the_arrival_later() -> None:
    late = rho.Obstacle(rho.Sphere([3.5, 0.1, 1], 0.8), known_from=0.6)
    flight = rho.plan_rho(crossing(late), replan_every=3, free_final_time=True, fallback=None)
    first, *others = arrivals(flight)
    assert min(others) > first
    assert rho.verify(flight).ok
    assert flight.sightings[0].avoided


def test_vehicles_leave_no_room_for_what_crosses_their_goals_later() -> None:
    track = rho.Track([0.0, 4.8, 9.6], [[6, -12, 1], [6, 0, 1], [6, 12, 1]])
    crosses = rho.Obstacle(rho.Sphere([0, 0, 0], 0.5), track=track)
    flight = rho.plan_rho(crossing(crosses), free_final_time=True, fallback=None)
    assert 4.8 < flight.plan.arrivals[0] < 8.0
    assert rho.verify(flight).ok


def test_jerk_limits_hold_where_vehicles_come_to_rest() -> None:
    scenario = crossing()
    scenario = dataclasses.replace(scenario, limits=dataclasses.replace(LIMITS, max_jerk=6.0))
    flight = rho.plan_rho(scenario, free_final_time=True)
    assert {*arrivals(flight)} == {arrivals(flight)[0]}
    assert flight.plan.arrivals[0] < 5.0
    assert rho.verify(flight).ok


def through_a_gate(
    time: float | None = None, *, knots: int = 41, step: float = 0.2
) -> rho.Scenario:
    """Return one vehicle that passes a gate."""
    scenario = crossing(knots=knots, step=step)
    gate = rho.Waypoint(time, [3, 0.5, 1], within=0.2)
    vehicle = dataclasses.replace(scenario.vehicles[0], waypoints=(gate,))
    return dataclasses.replace(scenario, vehicles=(vehicle,))


def gate_of(flown: rho.Flight | rho.Simulation | rho.Window) -> float:
    """Return the time at which the gate is passed [s]."""
    (gate,) = flown.plan.scenario.vehicles[0].waypoints
    assert gate.time is not None
    return gate.time


def test_times_of_waypoints_are_found_in_the_first_window_and_stay() -> None:
    flight = rho.plan_rho(through_a_gate(knots=21, step=0.4), replan_every=10)
    assert gate_of(flight) == gate_of(flight.windows[0])
    assert 2.0 < gate_of(flight) < 6.0
    assert flight.plan.arrivals == pytest.approx([8.0])
    assert rho.verify(flight).ok


def test_times_of_free_waypoints_are_those_of_the_least_time() -> None:
    scenario = through_a_gate(knots=21, step=0.4)
    horizon = rho.RecedingHorizon(scenario, free_final_time=True, fallback=None)
    steps = arrival_steps(horizon.step(horizon.planned(0), 0.0).plan)
    least = rho.plan_minimum_time(scenario, knots=steps + 1).scenario.grid.duration
    assert least - 1e-6 <= 0.4 * steps < least + 0.4
    assert rho.verify(horizon.flight).ok


@pytest.mark.slow
def test_free_waypoints_ahead_are_passed_earlier_with_the_arrival() -> None:
    horizon = rho.RecedingHorizon(
        through_a_gate(), replan_every=3, free_final_time=True, fallback=None
    )
    first = horizon.step(horizon.planned(0), 0.0)
    ahead = horizon.planned(3) + np.array([0.9, 0, 0, 0, 0, 0])
    second = horizon.step(ahead, 0.6)
    before, after = arrivals(horizon.flight)
    assert after < before
    sooner = (after - 3) / (before - 3)
    assert gate_of(second) - 0.6 == pytest.approx(sooner * (gate_of(first) - 0.6))
    assert gate_of(horizon.flight) == gate_of(second)


def test_given_times_of_waypoints_stay() -> None:
    scenario = through_a_gate(4.05, knots=21, step=0.4)
    flight = rho.plan_rho(scenario, replan_every=10, free_final_time=True, fallback=None)
    assert gate_of(flight) == 4.05
    assert 4.05 < flight.plan.arrivals[0] < 7.0
    assert rho.verify(flight).ok


@pytest.mark.slow
def test_while_a_given_time_lies_ahead_waypoints_keep_their_order() -> None:
    scenario = through_a_gate(4.05, knots=21, step=0.4)
    (vehicle,) = scenario.vehicles
    gates = [rho.Waypoint(None, [1, 0, 1]), *vehicle.waypoints, rho.Waypoint(None, [5, 0, 1])]
    vehicle = dataclasses.replace(vehicle, waypoints=tuple(gates))
    scenario = dataclasses.replace(scenario, vehicles=(vehicle,))
    flight = rho.plan_rho(scenario, replan_every=10, free_final_time=True)
    times = [each.time or 0.0 for each in flight.scenario.vehicles[0].waypoints]
    assert times == sorted(times)
    assert times[1] == 4.05
    assert rho.verify(flight).ok


@pytest.mark.parametrize("replan_every", [*slow(5), 10])
def test_flights_and_simulations_are_read_as_they_were_written(
    replan_every: int, tmp_path: Path
) -> None:
    gate = through_a_gate(knots=21, step=0.4)
    scenario = dataclasses.replace(gate, disturbance=WIND)
    simulation = rho.simulate(
        scenario, replan_every=replan_every, free_final_time=True, fallback=None
    )
    for flown in (simulation, simulation.flight):
        rho.save(flown, tmp_path / "flown.npz")
        read = rho.load(tmp_path / "flown.npz")
        assert read.scenario == flown.scenario
        assert arrivals(read) == arrivals(flown)
        assert [each.kept for each in read.windows] == [each.kept for each in flown.windows]
        assert rho.verify(read).ok == rho.verify(flown).ok


def test_a_vehicle_that_stays_has_arrived() -> None:
    scenario = crossing(length=0.0)
    flight = rho.plan_rho(scenario, free_final_time=True)
    assert flight.plan.arrivals == pytest.approx([0.0])
    assert arrivals(flight) == []


def test_an_invalid_request_is_one_clear_error() -> None:
    scenario = crossing()
    moving = dataclasses.replace(scenario.vehicles[0], goal=rho.State([6, 0, 1], [1, 0, 0]))
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\]\.goal\.velocity.*rest"):
        rho.plan_rho(dataclasses.replace(scenario, vehicles=(moving,)), free_final_time=True)
    with pytest.raises(TypeError, match="free_final_time"):
        rho.RecedingHorizon(scenario, free_final_time=1)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="free_final_time: got True, expected none for a plan"):
        rho.simulate(rho.plan(scenario), free_final_time=True)
    with pytest.raises(rho.InfeasibleError):
        rho.plan_rho(crossing(knots=9), free_final_time=True)


def test_the_command_flies_with_a_free_final_time(tmp_path: Path) -> None:
    rho.save_scenario(crossing(knots=21, length=4.0), tmp_path / "crossing.yaml")
    file = tmp_path / "flown.npz"
    words = "fly", str(tmp_path / "crossing.yaml"), "--free-final-time", "-o", str(file)
    with patch("sys.argv", ["drake-rho", *words]), pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert {*arrivals(rho.load(file))} == {12}
