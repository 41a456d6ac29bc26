"""`RecedingHorizon`: windows from measured states always have a plan."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import box, random_fleet, random_scenario, single, slow, through_the_middle
from tests.test_margins import disturbed, least_margin


def within(window: rho.Window, knot: int, rng: np.random.Generator) -> FloatArray:
    """Return estimated states anywhere in the tube of a window at one of its knots."""
    scenario = window.plan.scenario
    tube, time = rho.error_tube(scenario), scenario.grid.times[knot]
    around, count = tube.disturbance, len(scenario.vehicles)
    error, estimate = rng.normal(size=(2, count, 3)), rng.normal(size=(2, count, 3))
    error /= np.linalg.norm(error, axis=2, keepdims=True)
    estimate /= np.linalg.norm(estimate, axis=2, keepdims=True)
    part = rng.uniform(0.0, 1.0)
    p = part * tube.position(time) * error[0] + around.position_error * estimate[0]
    v = part * tube.velocity(time) * error[1] + around.velocity_error * estimate[1]
    states: FloatArray = window.plan.states(knot) + np.concatenate([p, v], axis=1)
    return states


@pytest.mark.parametrize("seed", [0, 1, 3, 7, *slow(2, 4, 5, 6, *range(8, 12))])
def test_every_window_has_a_plan_that_holds(seed: int) -> None:
    rng, windows, kept = np.random.default_rng(seed), 0, 0
    for scenario in (random_scenario(seed, between_knots=True), random_fleet(seed, most=4)):
        windy = disturbed(scenario, seed)
        horizon = rho.RecedingHorizon(windy, replan_every=int(rng.integers(1, 6)))
        states = windy.fleet.start_states
        try:
            horizon.step(states, windy.grid.start)
        except rho.InfeasibleError:
            continue
        for knot in horizon.knots[1:]:
            last = horizon.windows[-1]
            states = within(last, knot - last.first_knot, rng)
            window = horizon.step(states, windy.grid.times[knot])
            assert window.kept == bool(window.infeasible)
            assert not window.off_tube
            assert least_margin(window.plan, 20) > -1e-5
            windows, kept = windows + 1, kept + window.kept
    assert kept < windows or windows == 0


def test_a_new_plan_begins_at_the_measured_state_with_a_new_tube() -> None:
    scenario = single(limits=rho.Limits(acceleration=box(3.0)), between_knots=True)
    around = rho.Disturbance(0.2, 0.01, 0.02, feedback_every=0.1, delay=2)
    windy = dataclasses.replace(scenario, disturbance=around)
    horizon = rho.RecedingHorizon(windy)
    first = horizon.step(windy.fleet.start_states, 0.0)
    assert rho.error_tube(first.plan.scenario).initial == (0.0, 0.0)
    states = first.plan.states(5) + 0.02
    window = horizon.step(states, 2.5)
    np.testing.assert_allclose(window.plan.states(0), states, atol=1e-12)
    tube = rho.error_tube(window.plan.scenario)
    assert tube.gains == rho.error_tube(windy).gains
    assert tube.initial == pytest.approx((0.01 + 0.2 * 0.02 + 0.2 * 0.2**2 / 2, 0.02 + 0.2 * 0.2))
    assert tube.position(2.5) == pytest.approx(tube.initial[0])
    np.testing.assert_allclose(window.plan.positions[:, -1], windy.fleet.goal_positions, atol=1e-9)


def test_the_previous_plan_is_kept_where_the_start_has_no_slack() -> None:
    wall = rho.Box([2.0, -0.6, -5.0], [8.0, -0.05, 5.0])
    scenario = single(obstacles=[wall], goal=rho.State([10.0, 0.0, 0.0]), between_knots=True)
    around = rho.Disturbance(0.5, position_error=0.05, feedback_every=0.5)
    windy = dataclasses.replace(scenario, disturbance=around)
    horizon = rho.RecedingHorizon(windy)
    first = horizon.step(windy.fleet.start_states, 0.0)
    states = first.plan.states(8)
    tube = rho.error_tube(first.plan.scenario)
    states[0, 1] = -0.05 + 0.03  # nearer to the wall than the error of estimates
    kept = horizon.step(states, 4.0)
    assert kept.kept
    assert "obstacle 1" in kept.infeasible
    np.testing.assert_array_equal(kept.plan.positions, first.plan.positions[:, 8:])
    assert rho.error_tube(kept.plan.scenario).position(5.0) == pytest.approx(
        float(tube.position(5.0))
    )
    assert horizon.step(kept.plan.states(5), 6.5).infeasible == ""


def test_a_state_off_the_tube_is_reported_and_planned_from() -> None:
    scenario = single(limits=rho.Limits(acceleration=box(3.0)), between_knots=True)
    windy = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.2, feedback_every=0.1))
    horizon = rho.RecedingHorizon(windy)
    first = horizon.step(windy.fleet.start_states, 0.0)
    window = horizon.step(first.plan.states(5) + 0.5, 2.5)
    assert window.off_tube == ("solo",)
    assert window.infeasible == ""
    window = horizon.step(window.plan.states(5), 5.0)
    assert window.off_tube == ()


@pytest.mark.parametrize("seed", [0, 1, *slow(*range(2, 8))])
def test_every_measured_state_gives_a_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for scenario in (random_scenario(seed), random_fleet(seed, most=4)):
        for windy in (scenario, disturbed(scenario, seed)):
            horizon = rho.RecedingHorizon(windy, fallback=None)
            try:
                window = horizon.step(windy.fleet.start_states, windy.grid.start)
            except rho.InfeasibleError:
                continue
            size = float(windy.fleet.lengths.max())
            for knot in horizon.knots[1:]:
                states = window.plan.states(knot - window.first_knot)
                states = states + 10 ** rng.uniform(-3, 0.5) * size * rng.normal(size=states.shape)
                window = horizon.step(states, windy.grid.times[knot])
                np.testing.assert_allclose(
                    window.plan.states(0), states, rtol=1e-6, atol=1e-6 * size
                )
            assert np.isfinite(horizon.flight.cost)


def test_a_window_that_begins_inside_an_obstacle_leaves_it() -> None:
    scenario = single(obstacles=[rho.Sphere([5.0, 2.0, 0.5], 1.0)], between_knots=True)
    horizon = rho.RecedingHorizon(scenario)
    horizon.step(scenario.fleet.start_states, 0.0)
    inside = np.array([[5.3, 2.2, 0.4, 1.0, 0.5, 0.0]])
    window = horizon.step(inside, 4.0)
    assert not window.kept
    assert "obstacle 1 (start" in window.infeasible
    clearances = scenario.bodies[0].distances(window.plan.positions[0], window.plan.times)
    assert clearances[0] < 0.0
    assert clearances[3:].min() > 0.0
    np.testing.assert_allclose(
        window.plan.positions[:, -1], scenario.fleet.goal_positions, atol=1e-6
    )
    assert horizon.step(window.plan.states(5), 6.5).infeasible == ""


def test_a_window_that_begins_outside_its_box_returns() -> None:
    scenario = single(limits=rho.Limits(position=box(10.5)), between_knots=True)
    horizon = rho.RecedingHorizon(scenario)
    horizon.step(scenario.fleet.start_states, 0.0)
    window = horizon.step(np.array([[5.0, 10.9, 0.0, 1.0, -0.2, 0.0]]), 2.5)
    assert "position box (start 0.4 m beyond)" in window.infeasible
    assert np.abs(window.plan.positions[0, 3:]).max() < 10.5 + 1e-6
    np.testing.assert_allclose(
        window.plan.positions[:, -1], scenario.fleet.goal_positions, atol=1e-6
    )


def test_an_unreachable_goal_is_missed_and_limits_hold() -> None:
    limits = rho.Limits(acceleration=box(1.2), jerk=box(4.0))
    scenario = single(
        limits=limits, obstacles=[rho.Sphere([5.0, 2.0, 0.5], 1.0)], between_knots=True
    )
    horizon = rho.RecedingHorizon(scenario)
    first = horizon.step(scenario.fleet.start_states, 0.0)
    window = horizon.step(first.plan.states(13) + 0.5, 6.5)
    assert not window.kept
    assert "goal" in window.infeasible
    report = rho.verify(window.plan)
    assert {check.constraint for check in report.violations} == {"goal"}
    assert np.abs(window.plan.accelerations).max() <= 1.2 + 1e-6


def test_the_first_window_is_exact_at_the_starts_and_nowhere_else() -> None:
    windy = dataclasses.replace(single(), disturbance=rho.Disturbance(0.1, 0.05, 0.05))
    starts = windy.fleet.start_states
    window = rho.RecedingHorizon(windy).step(starts, 0.0)
    assert window.plan.scenario is windy
    assert rho.error_tube(windy).initial == (0.0, 0.0)
    for off in (1e-6, 0.02, 0.5):
        window = rho.RecedingHorizon(windy).step(starts + off, 0.0)
        np.testing.assert_allclose(window.plan.states(0), starts + off, atol=1e-12)
        assert rho.error_tube(window.plan.scenario).initial == (0.05, 0.05)


@pytest.mark.parametrize("windy", [False, True])
@pytest.mark.parametrize("inside", [0.1, 0.3])
def test_a_first_window_without_slack_says_so_and_flies_out(windy: bool, inside: float) -> None:
    around = rho.Disturbance(0.1, 0.05, 0.05, 0.25) if windy else None
    scenario = single(obstacles=[rho.Sphere([-1.6, 0, 0], 1.4)], between_knots=True)
    scenario = dataclasses.replace(scenario, disturbance=around)
    states = np.array([[-0.2 - inside, 0.0, 0.0, 0.0, 0.0, 0.0]])
    window = rho.RecedingHorizon(scenario).step(states, 0.0)
    assert "obstacle 1" in window.infeasible
    assert not window.kept
    np.testing.assert_allclose(window.plan.states(0), states, atol=1e-12)
    distances = window.plan.scenario.bodies[0].distances(window.plan.positions, np.zeros(1))
    assert np.all(np.diff(distances[0, :3]) > 0.0)
    np.testing.assert_allclose(
        window.plan.positions[:, -1], scenario.fleet.goal_positions, atol=1e-6
    )


def test_the_first_window_raises_only_where_the_scenario_has_no_plan_itself() -> None:
    wall = rho.Obstacle(rho.Box([2.0, -99.0, -99.0], [3.0, 99.0, 99.0]))
    scenario = single(
        obstacles=[wall],
        between_knots=True,
        limits=rho.Limits(position=rho.Box([-1.0, -5.0, -5.0], [11.0, 5.0, 5.0])),
    )
    for states in (scenario.fleet.start_states, scenario.fleet.start_states + 0.1):
        with pytest.raises(rho.InfeasibleError):
            rho.RecedingHorizon(scenario).step(states, 0.0)


@pytest.mark.parametrize("error", [TypeError, ValueError, ZeroDivisionError, RuntimeError])
def test_no_error_of_a_planner_ends_a_flight_after_the_first_window(error: type[Exception]) -> None:
    planned = list[rho.Plan]()

    def planner(scenario: rho.Scenario, **around: Any) -> rho.Plan:
        if planned:
            raise error("out of order")
        planned.append(rho.plan_convex(scenario, **around))
        return planned[-1]

    scenario = single(obstacles=[rho.Sphere([5.0, 0.1, 0.0], 1.0)], between_knots=True)
    horizon = rho.RecedingHorizon(scenario, planner=planner, fallback=planner)
    for knot in horizon.knots:
        window = horizon.step(horizon.planned(knot), float(scenario.grid.times[knot]))
        assert (f"{error.__name__}: out of order" in window.infeasible) == (knot > 0)
        assert window.kept == (knot > 0)

    planned[:] = [window.plan]
    with pytest.raises(error, match="out of order"):
        rho.RecedingHorizon(scenario, planner=planner).step(scenario.fleet.start_states, 0.0)


def test_a_window_whose_limits_leave_no_room_for_the_feedback_violates_least() -> None:
    """An unseen vehicle may need more feedback than there is in its acceleration box at all."""
    late = rho.Obstacle(rho.Sphere([0.5, 0.0, 0.0], 0.2), known_from=2.0)
    scenario = single(
        goal=rho.State([1.0, 0.0, 0.0]),
        limits=rho.Limits(acceleration=box(0.6)),
        obstacles=[late],
        between_knots=True,
    )
    around = rho.Disturbance(0.3, feedback_every=0.5, delay=1, share=0.6, prediction=True)
    scenario = dataclasses.replace(scenario, disturbance=around)
    horizon = rho.RecedingHorizon(scenario, replan_every=2, latency=1.0)
    horizon.step(scenario.fleet.start_states, 0.0)
    windows = [
        horizon.step(np.full((1, 6), np.nan), float(scenario.grid.times[knot]))
        for knot in horizon.knots[1:]
    ]
    least = [window for window in windows if window.infeasible and not window.kept]
    assert any("acceleration box (middle" in window.infeasible for window in least)
    assert all(np.isfinite(window.plan.accelerations).all() for window in windows)


def test_a_vehicle_without_a_measurement_is_predicted_and_its_tube_continues() -> None:
    around = rho.Disturbance(0.2, 0.01, 0.02, feedback_every=0.25)
    scenario = dataclasses.replace(through_the_middle(2), disturbance=around)
    horizon = rho.RecedingHorizon(scenario)
    first = horizon.step(scenario.fleet.start_states, scenario.grid.start)
    states, now = first.plan.states(5), float(scenario.grid.times[5])
    states[0] += 0.003
    states[1] = np.nan
    window, tube = horizon.step(states, now), rho.error_tube(first.plan.scenario)
    assert window.infeasible == ""
    assert window.off_tube == ()
    np.testing.assert_allclose(window.plan.states(0)[0], states[0], atol=1e-12)
    np.testing.assert_allclose(window.plan.states(0)[1], first.plan.states(5)[1], atol=1e-12)
    expected = float(tube.position(now)), float(tube.velocity(now))
    assert rho.error_tube(window.plan.scenario).initial == pytest.approx(expected)
    assert expected[0] > around.position_error
    seen = horizon.step(window.plan.states(2), float(scenario.grid.times[7]))
    assert rho.error_tube(seen.plan.scenario).initial == pytest.approx((0.01, 0.02))


@pytest.mark.parametrize("far", [1e3, 1e6, 1e11, 1e30, 1e300])
@pytest.mark.parametrize("windy", [False, True])
def test_no_finite_state_ends_a_flight(far: float, windy: bool) -> None:
    around = rho.Disturbance(0.1, 0.01, 0.01, 0.25) if windy else None
    scenario = single(obstacles=[rho.Sphere([5.0, 0.1, 0.0], 1.0)], between_knots=True)
    horizon = rho.RecedingHorizon(dataclasses.replace(scenario, disturbance=around))
    states = scenario.fleet.start_states
    for knot in (0, 5, 10):
        window = horizon.step(states + far * (knot > 0), float(scenario.grid.times[knot]))
        assert np.isfinite(window.plan.accelerations).all()
    assert horizon.step(states - far, float(scenario.grid.times[15])).plan.states(0).shape == (1, 6)


def test_plan_rho_is_the_loop_with_perfect_measurements() -> None:
    windy = dataclasses.replace(
        single(obstacles=[rho.Sphere([5.0, 2.0, -0.5], 1.0)], between_knots=True),
        disturbance=rho.Disturbance(0.2, 0.001, 0.002, feedback_every=0.1),
    )
    flight, horizon = rho.plan_rho(windy, replan_every=4), rho.RecedingHorizon(windy)
    for window in flight.windows:
        again = horizon.step(window.plan.states(0), window.plan.scenario.grid.start)
        np.testing.assert_array_equal(again.plan.accelerations, window.plan.accelerations)
        assert least_margin(window.plan) > -1e-6
    np.testing.assert_array_equal(horizon.flight.plan.accelerations, flight.plan.accelerations)


def test_invalid_arguments_are_refused_by_name() -> None:
    scenario = single()
    states = scenario.fleet.start_states
    for every in (0, 1.5):
        with pytest.raises(ValueError, match="replan_every: got"):
            rho.RecedingHorizon(scenario, replan_every=every)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="replan_every: got True, expected a number"):
        rho.RecedingHorizon(scenario, replan_every=True)
    horizon = rho.RecedingHorizon(scenario)
    with pytest.raises(ValueError, match="windows: got none"):
        _ = horizon.flight
    with pytest.raises(ValueError, match=r"states: got shape \(1, 3\), expected \(1, 6\)"):
        horizon.step(states[:, :3], 0.0)
    for wrong in (np.nan, np.inf):
        part = np.array(states)
        part[0, 2] = wrong
        with pytest.raises(ValueError, match="finite numbers for solo"):
            horizon.step(part, 0.0)
    for time in (0.5, -0.5, np.nan):
        with pytest.raises(ValueError, match="time: got"):
            horizon.step(states, time)
    horizon.step(states, 0.0)
    for time in (0.0, 0.7, 8.0, np.inf):
        with pytest.raises(ValueError, match=r"expected the time of a knot from 0\.5 to 7\.5 s"):
            horizon.step(states, time)
    assert len(horizon.windows) == 1
