"""Windows of a receding horizon with a smoothing: one plan, of which the flight is the average."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import single, slow
from tests.test_smoothing import (
    LIMITS,
    SMOOTHINGS,
    SPHERE,
    _check_densely,
    _random,
    _windy,
    smooth,
    twin,
)


def _steepest(flown: rho.Flight) -> float:
    """Return the largest change of the acceleration over time [m/s³], at every 1 ms."""
    scenario = flown.scenario
    dt = 1e-3
    times = np.arange(scenario.grid.start - scenario.lead, scenario.grid.end + scenario.lead, dt)
    a = flown.at(times).accelerations
    return float(np.linalg.norm(np.diff(a, axis=1), axis=2).max() / dt)


@pytest.mark.parametrize(
    "smoothing", [SMOOTHINGS[0], *slow(*SMOOTHINGS[1:-1]), SMOOTHINGS[-1]], ids=str
)
def test_the_rest_of_a_plan_goes_on_from_what_was_flown(smoothing: rho.Smoothing) -> None:
    plan = rho.plan(smooth(smoothing))
    lead = plan.scenario.lead
    for knot in (1, 2, 3, 9):
        rest = plan.tail(knot)
        for same in (rest, plan.tail(1).tail(knot - 1) if knot > 1 else rest):
            start = same.scenario.grid.start - lead
            times = np.linspace(start, 8.0 + lead, 555)
            own, whole = same.at(times), plan.at(times)
            assert np.abs(own.states - whole.states).max() < 1e-12
            assert np.abs(own.accelerations - whole.accelerations).max() < 1e-12
            drake = same.trajectory("solo")
            assert drake.start_time() == pytest.approx(start)
            assert np.abs(drake.vector_values(times).T - whole.positions[0]).max() < 1e-12
        assert rho.verify(rest).ok


@pytest.mark.parametrize("smoothing", [*slow(*SMOOTHINGS[:-1]), SMOOTHINGS[-1]], ids=str)
def test_a_flight_in_windows_is_smooth(smoothing: rho.Smoothing) -> None:
    limits = rho.Limits(
        rho.Box([-0.1, -0.1, -2.005], [10.1, 4.1, 0.1]), max_speed=2.1, max_acceleration=1.5
    )
    flight = rho.plan_rho(smooth(smoothing, limits=limits), replan_every=3)
    report = rho.verify(flight)
    assert report.ok
    assert not any(window.infeasible for window in flight.windows)
    costs = [window.plan.cost for window in flight.windows]
    assert all(later < earlier for earlier, later in pairwise(costs))
    times, positions, accelerations = twin(flight.plan)
    away = np.linalg.norm(positions[0] - SPHERE.center, axis=1) - SPHERE.radius
    assert away.min() > -5e-6
    assert np.linalg.norm(accelerations, axis=2).max() <= 1.5 + 1e-5
    inside = (times >= -smoothing.lead) & (times <= 8.0 + smoothing.lead)
    own = flight.at(times[inside])
    assert np.abs(own.positions - positions[:, inside]).max() < 2e-6
    assert np.linalg.norm(own.velocities, axis=2).max() <= 2.1 + 1e-5
    # a jump would be as steep as the time between samples is short
    assert _steepest(flight) <= 2.0 * 1.5 / smoothing.width + 1e-6
    drake = flight.plan.trajectory("solo")
    corners = np.array(drake.get_segment_times())[1:-1]
    for order in range(2, smoothing.times + 2):
        rate = drake.derivative(order)
        sides = [rate.vector_values(corners + side) for side in (-1e-9, 1e-9)]
        assert np.abs(sides[1] - sides[0]).max() < 1e-5


@pytest.mark.parametrize("times", [*slow(1, 2), 3])
def test_a_flight_depends_only_on_what_is_known(times: int) -> None:
    """Averages reach ahead, but never to accelerations that were planned later."""
    known = 1.2
    seen = rho.Obstacle(SPHERE, known_from=known)
    scenario = smooth(rho.Smoothing(0.5, times))
    late = rho.plan_rho(dataclasses.replace(scenario, obstacles=(seen,)), replan_every=1)
    never = rho.plan_rho(dataclasses.replace(scenario, obstacles=()), replan_every=1)
    before = np.linspace(-scenario.lead, known, 400)
    apart = np.abs(late.at(before).positions - never.at(before).positions).max()
    assert apart < 1e-6
    after = np.linspace(known, 8.0, 400)
    assert np.abs(late.at(after).positions - never.at(after).positions).max() > 0.1
    assert rho.verify(late).ok
    assert [each.avoided for each in late.sightings] == [True]
    assert late.sightings[0].time >= known + scenario.lead - 1e-9

    horizon = rho.RecedingHorizon(scenario, replan_every=3)
    checked, flown = np.array([-scenario.lead]), np.zeros((1, 1, 6))
    for knot in horizon.knots:
        states = horizon.planned(knot)
        horizon.step(states, scenario.grid.times[knot])
        assert np.abs(horizon.flight.at(checked).states[..., :6] - flown).max() < 1e-12
        assert np.abs(states - flown[:, -1]).max() < 1e-12
        if knot + 3 in horizon.knots:
            begins = scenario.grid.times[knot + 3] - scenario.lead
            checked = np.linspace(-scenario.lead, begins, 99)
            flown = horizon.flight.at(checked).states[..., :6]


@pytest.mark.parametrize("time", [3.05, 3.3, 3.45, 3.5, 3.55, 4.1])
def test_waypoints_beside_the_beginning_of_a_window_are_passed_exactly(time: float) -> None:
    waypoint = rho.Waypoint(time, [3.5, 4.0, 0.0])
    own = (dataclasses.replace(single().vehicles[0], waypoints=(waypoint,)),)
    scenario = smooth(rho.Smoothing(0.5, 3), vehicles=own)
    flight = rho.plan_rho(scenario, replan_every=1)
    assert rho.verify(flight).ok
    assert not any(window.infeasible for window in flight.windows)
    there = flight.at(time, "solo").positions[0]
    assert np.linalg.norm(there - waypoint.position) < 1e-5
    passed = [bool(window.plan.scenario.vehicles[0].waypoints) for window in flight.windows]
    first_without = flight.windows[passed.index(False)].plan.scenario.grid.start
    assert first_without - scenario.lead >= time - 1e-9


@pytest.mark.parametrize(("smoothing", "most"), [(SMOOTHINGS[0], 1.5), (SMOOTHINGS[3], 5.0)])
def test_jerks_of_averages_are_limited_where_windows_begin(
    smoothing: rho.Smoothing, most: float
) -> None:
    limits = dataclasses.replace(LIMITS, max_jerk=most)
    flight = rho.plan_rho(smooth(smoothing, limits=limits), replan_every=2)
    assert rho.verify(flight).ok
    assert _steepest(flight) <= most + 1e-5
    free = rho.plan_rho(smooth(smoothing), replan_every=2)
    assert _steepest(free) > 1.1 * most


def test_options_of_windows() -> None:
    scenario = smooth(rho.Smoothing(0.5, 2))
    ready = rho.plan_rho(scenario, contingencies=True)
    assert rho.verify(ready).ok
    for window in ready.windows:
        assert window.contingency is not None
        assert rho.verify(window.contingency).ok
        begin = window.plan.scenario.grid.start - scenario.lead
        follows = np.linspace(begin, min(begin + 2.5, 8.0), 50)
        apart = window.contingency.at(follows).positions - window.plan.at(follows).positions
        assert np.abs(apart).max() < 1e-9 or begin > 5.0
    limits = dataclasses.replace(LIMITS, max_jerk=4.0)
    jerky = smooth(rho.Smoothing(0.5, 2), limits=limits)
    early = rho.plan_rho(jerky, free_final_time=True)
    assert rho.verify(early).ok
    rest = early.windows[-1].plan.accelerations
    assert not rest[:, -1].any()
    cheap = rho.plan_rho(scenario, bounded_cost=True)
    assert rho.verify(cheap).ok
    for window in cheap.windows:
        assert window.cost_bound == pytest.approx(window.plan.cost)


def test_a_flight_with_a_sphere_seen_too_late_stays_smooth(tmp_path: Path) -> None:
    wall = rho.Obstacle(rho.Sphere([5.0, 2.0, -1.0], 2.0), known_from=3.2)
    scenario = smooth(rho.Smoothing(0.4, 2), obstacles=[wall])
    flight = rho.plan_rho(scenario, replan_every=1)
    assert [each.avoided for each in flight.sightings] == [False]
    assert _steepest(flight) <= 2.0 * 2.0 / 0.4 + 1e-3
    rho.save(flight, tmp_path / "flight.npz")
    again = rho.load(tmp_path / "flight.npz")
    for own, loaded in zip(flight.windows, again.windows, strict=True):
        grid = own.plan.scenario.grid
        times = np.linspace(grid.start - scenario.lead, grid.end + scenario.lead, 99)
        assert np.array_equal(own.plan.at(times).states, loaded.plan.at(times).states)


@pytest.mark.slow
def test_what_is_written_of_a_flight_is_its_average(tmp_path: Path) -> None:
    flight = rho.plan_rho(smooth(rho.Smoothing(0.5, 2)))
    lead = flight.scenario.lead
    rho.export(flight, tmp_path / "flight.csv", format="csv", rate=10)
    table = np.loadtxt(tmp_path / "flight.csv", delimiter=",", skiprows=1, usecols=range(1, 5))
    assert table[0, 0] == pytest.approx(-lead)
    assert table[:, 1:] == pytest.approx(flight.at(table[:, 0], "solo").positions, abs=1e-9)
    rho.accelerations_figure(flight)
    rho.paths_figure(flight)
    assert "<html" in rho.viewer_page(flight)


@pytest.mark.slow
@pytest.mark.parametrize("smoothing", SMOOTHINGS[::2], ids=str)
def test_windows_in_wind_stay_in_one_tube_around_a_smooth_motion(
    smoothing: rho.Smoothing,
) -> None:
    scenario = _windy(smoothing)
    flight = rho.plan_rho(scenario, replan_every=4)
    assert rho.verify(flight).ok
    tubes = [rho.error_tube(window.plan.scenario) for window in flight.windows]
    whole = rho.error_tube(scenario)
    for tube in tubes:
        assert tube.grid.start == pytest.approx(-scenario.lead)
        assert tube.position(4.3) == pytest.approx(whole.position(4.3))
    wind = rho.winds.constant(scenario, [0, 1, 0])
    flown = rho.simulate(scenario, replan_every=4, wind=wind, rng=np.random.default_rng(3))
    assert rho.verify(flown).ok
    assert np.all(flown.errors().max(axis=1) <= flown.radii() + 1e-9)
    assert not any(window.off_tube or window.infeasible for window in flown.windows)
    assert len(flown.windows) == 4
    most = smoothing.width**2 * 2.6 / 12_000.0
    times = np.linspace(-scenario.lead, 8.0 + scenario.lead, 500)
    nominal = flown.plan.at(times).positions
    assert np.abs(nominal - flight.at(times).positions).max() < 2.0 * most + 1e-6
    a = flown.nominal("acceleration")
    steepest = 2.0 * 2.6 / smoothing.width * flown.scenario.grid.step
    assert np.linalg.norm(np.diff(a, axis=0), axis=2).max() <= 1.1 * steepest


@pytest.mark.slow
def test_vehicles_off_their_tube_are_named_and_fly_on_smoothly() -> None:
    scenario = _windy(SMOOTHINGS[0])

    def strong(t: float, p: Any, v: Any) -> Any:
        return np.broadcast_to([0.0, 0.0, 0.8 * (1.0 < t < 3.0)], p.shape)

    flown = rho.simulate(scenario, replan_every=2, wind=strong)
    assert [bool(window.off_tube) for window in flown.windows][:2] == [False, False]
    assert any(window.off_tube for window in flown.windows)
    steepest = 2.0 * 2.6 / 0.5 * flown.scenario.grid.step
    a = flown.nominal("acceleration")
    assert np.linalg.norm(np.diff(a, axis=0), axis=2).max() <= 1.1 * steepest


@pytest.mark.slow
def test_windows_are_planned_a_latency_before_their_averages_begin() -> None:
    scenario = _windy(SMOOTHINGS[2])
    horizon = rho.RecedingHorizon(scenario, replan_every=3, latency=0.25)
    flown = rho.simulate(horizon, rng=np.random.default_rng(1))
    assert rho.verify(flown).ok
    knots = np.array([window.first_knot for window in flown.windows])
    starts = flown.scenario.grid.times[knots]
    expected = scenario.grid.times[::3][: len(knots)] - scenario.lead
    assert starts == pytest.approx(expected)


@pytest.mark.slow
@pytest.mark.parametrize("late", [False, True])
def test_random_flights_in_windows_hold_at_every_instant(late: bool) -> None:
    flown = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        try:
            scenario = _random(seed)
            if late:
                first = 0.5 * scenario.grid.duration * rng.random(len(scenario.obstacles))
                seen = [
                    dataclasses.replace(each, known_from=float(time))
                    for each, time in zip(scenario.bodies, first, strict=True)
                ]
                scenario = dataclasses.replace(scenario, obstacles=tuple(seen))
            flight = rho.plan_rho(scenario, replan_every=int(rng.integers(1, 6)))
        except (rho.ScenarioError, rho.InfeasibleError):  # a start inside an obstacle, ...
            continue
        flown += 1
        report = rho.verify(flight)
        assert report.ok or not all(each.avoided for each in report.sightings), seed
        if not late:
            _check_densely(flight.plan)
        assert scenario.smoothing is not None
        most = np.linalg.norm(flight.plan.accelerations, axis=2).max()
        lead, width = scenario.lead, scenario.smoothing.width
        times = np.linspace(scenario.grid.start - lead, scenario.grid.end + lead, 9999)
        changes = np.diff(flight.at(times).accelerations, axis=1)
        steepest = np.linalg.norm(changes, axis=2).max() / (times[1] - times[0])
        assert steepest <= 2.0 * most / width * (1.0 + 1e-6)
    assert flown >= 30
