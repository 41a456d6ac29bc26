"""Flights do not depend on when they begin, even on clocks that floating point cannot represent."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drake_rho as rho
from tests.scenarios import examples
from tests.test_cli import run
from tests.test_cli_json import read

starts = st.one_of(
    st.integers(-100, 100).map(lambda k: 0.1 * k),
    st.integers(0, 100).map(lambda k: 1e3 + 0.1 * k),
    st.integers(0, 100).map(lambda k: 1.7e9 + 0.1 * k),
)
"""Times of first knots [s]: sums of tenths, which are not binary fractions."""


def dashing(start: float, corner: float, step: float = 1.0) -> rho.Scenario:
    """Return one vehicle, and a ball that waits beside its path and then dashes across it."""
    times = start + np.array([-1.0, corner, corner + 0.25, 5.0]) * step
    places = [[0.3, -3.0, 0.0], [0.3, -3.0, 0.0], [0.3, 3.0, 0.0], [0.3, 30.0, 0.0]]
    return rho.Scenario(
        "dash",
        rho.Grid(step, 6, start),
        [rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([4, 0, 0]))],
        obstacles=[rho.Obstacle(rho.Sphere([0, 0, 0], 0.3), track=rho.Track(times, places))],
    )


def least_clearance(plan: rho.Plan) -> float:
    """Return the least distance from the ball's surface [m], integrated and sampled by hand."""
    scenario, h = plan.scenario, plan.scenario.grid.step
    track = scenario.bodies[0].track
    assert track is not None
    since = track.times - scenario.grid.start
    p, v, least = np.zeros(3), np.zeros(3), np.inf
    s = np.linspace(0.0, h, 2001)[:, None]
    for k, a in enumerate(plan.accelerations[0]):
        path = p + s * v + s**2 / 2.0 * a
        times = k * h + s[:, 0]
        ball = np.stack([np.interp(times, since, axis) for axis in track.positions.T], axis=-1)
        least = min(least, float(np.linalg.norm(path - ball, axis=1).min()) - 0.3)
        p, v = p + h * v + h**2 / 2.0 * a, v + h * a
    return least


@given(start=starts, corner=st.integers(1, 45).map(lambda k: 0.1 * k), step=st.floats(0.1, 1.0))
@examples(few=8, many=20)
def test_no_corner_of_a_track_is_missed(start: float, corner: float, step: float) -> None:
    scenario = dashing(start, corner, step)
    for flown in (rho.plan(scenario), rho.plan_rho(scenario, replan_every=2).plan):
        assert least_clearance(flown) > -1e-6
        assert rho.verify(flown).ok


@pytest.mark.parametrize(("start", "corner"), [(0.2, 0.7), (0.0, 0.7)])
def test_a_corner_that_rounds_into_the_piece_before_it_is_not_missed(
    start: float, corner: float
) -> None:
    scenario = dashing(start, corner)
    assert least_clearance(rho.plan(scenario)) > -1e-6


@given(start=starts.filter(lambda t: t >= 0.0), step=st.sampled_from([0.1, 1.0 / 3.0, 0.5]))
@examples(few=1, many=3)
def test_a_flight_in_wind_does_not_depend_on_when_it_begins(start: float, step: float) -> None:
    def at(begin: float) -> rho.Simulation:
        scenario = rho.Scenario(
            "clock",
            rho.Grid(step, 11, begin),
            [
                rho.Vehicle(
                    "v",
                    rho.State([0, 0, 0]),
                    rho.State([1, 0, 0]),
                    waypoints=[rho.Waypoint(begin + 4.5 * step, [0.4, 0.1, 0], 0.1)],
                )
            ],
            rho.Limits(max_acceleration=30.0),
            obstacles=[
                rho.Sphere([0.5, 0.05, 0], 0.1),
                rho.Obstacle(
                    rho.Sphere([0, 0, 0], 0.1),
                    track=rho.Track(
                        begin + step * np.array([0.0, 5.5, 10.0]),
                        [[0.7, -1, 0], [0.7, 0.0, 0], [0.7, 1, 0]],
                    ),
                    known_from=begin + 3.0 * step,
                ),
            ],
            disturbance=rho.Disturbance(0.1, 0.001, 0.001, step / 5),
        )
        wind = rho.winds.constant(scenario, [0, 1, 0])
        return rho.simulate(scenario, replan_every=3, wind=wind, rng=np.random.default_rng(0))

    here, there = at(0.0), at(start)
    assert rho.verify(there).ok
    assert (there.errors() <= there.radii()[:, None] * (1.0 + 1e-6) + 1e-9).all()
    learned = [[window.learned for window in each.flight.windows] for each in (here, there)]
    assert learned[0] == learned[1]
    apart = np.linalg.norm(here.flight.plan.positions - there.flight.plan.positions, axis=2).max()
    assert apart < 1e-4


@given(start=starts, sample=st.sampled_from([0.01, 0.05, 0.1]))
@settings(max_examples=10)
def test_times_of_a_simulation_increase_and_begin_at_the_samples(
    start: float, sample: float
) -> None:
    scenario = rho.Scenario(
        "times",
        rho.Grid(0.1, 11, start),
        [rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([1, 0, 0]))],
        obstacles=[
            rho.Obstacle(
                rho.Sphere([9, 9, 9], 0.1),
                track=rho.Track(start + 0.1 * np.arange(11), np.full((11, 3), 9.0)),
            )
        ],
        disturbance=rho.Disturbance(0.1, feedback_every=sample),
    )
    flown = rho.simulate(scenario)
    assert np.all(np.diff(flown.times) > 0.0)
    # a sample has ten times; corners are at knots, which count once
    samples = round(1.0 / sample)
    assert flown.elapsed is not None
    assert len(flown.elapsed) == 10 * samples + 1
    np.testing.assert_allclose(flown.elapsed[::10], sample * np.arange(samples + 1), atol=1e-12)


def test_windows_begin_at_the_knots_of_the_flight() -> None:
    grid = rho.Grid(0.1, 101, 1.7e9 + 0.1)
    left = grid
    for _ in range(99):
        left = left.from_knot(1)
    assert left.start == grid.times[99]
    assert left.knots == 2


def test_a_simulation_is_reproduced_with_exact_times_even_from_a_file(tmp_path: Path) -> None:
    scenario = dataclasses.replace(
        dashing(1.7e9 + 0.1, 2.0), disturbance=rho.Disturbance(0.05, feedback_every=0.1)
    )
    flown = rho.simulate(scenario, replan_every=2)
    assert flown.elapsed is not None
    assert np.abs(flown.times - scenario.grid.start - flown.elapsed).max() > 1e-9
    assert rho.verify(flown).ok
    path = tmp_path / "flown.npz"
    rho.save(flown, path)
    again = rho.load(path)
    assert isinstance(again, rho.Simulation)
    assert again.elapsed is not None
    np.testing.assert_array_equal(again.elapsed, flown.elapsed)
    assert rho.verify(again).ok


@pytest.mark.parametrize("start", [0.1, 1e3 + 0.1, 1.7e9 + 0.1])
def test_a_table_on_any_clock_is_read_back(start: float, tmp_path: Path) -> None:
    plan = rho.plan(dashing(start, 2.0, step=0.3))
    rho.export(plan, tmp_path / "plan.csv", format="csv")
    again = rho.load(tmp_path / "plan.csv", scenario=plan.scenario)
    assert isinstance(again, rho.Plan)
    np.testing.assert_allclose(again.positions, plan.positions, atol=1e-12)
    head, *rows = (tmp_path / "plan.csv").read_text().splitlines()
    third = plan.scenario.grid.times[2]
    rows = [row for row in rows if abs(float(row.split(",")[1]) - third) > 0.01]
    (tmp_path / "short.csv").write_text("\n".join([head, *rows]) + "\n")
    with pytest.raises(ValueError, match="no sample at knot 3"):
        rho.load(tmp_path / "short.csv", scenario=plan.scenario)


BALL = rho.Sphere([4, 0, 1], 1)


@pytest.mark.parametrize("between", [BALL, rho.Obstacle(BALL)])
def test_a_flight_that_ends_before_time_0_avoids_obstacles(
    between: rho.Sphere | rho.Obstacle,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An obstacle is known from the first knot by default, also where that is before time 0."""
    vehicle = rho.Vehicle("v", rho.State([0, 0, 1]), rho.State([8, 0, 1]))
    scenario = rho.Scenario("before zero", rho.Grid(0.5, 11, -10.0), [vehicle], obstacles=[between])
    later = dataclasses.replace(scenario, grid=rho.Grid(0.5, 11))
    rho.save_scenario(scenario, tmp_path / "asked.yaml")
    assert rho.load_scenario(tmp_path / "asked.yaml") == scenario
    for planner in (rho.plan, rho.plan_rho):
        plan, same = planner(scenario), planner(later)
        assert plan.cost == pytest.approx(same.cost, rel=1e-9)
        report = rho.verify(plan)
        assert report.ok
        assert any(check.constraint == "obstacle 1" and check.asked for check in report.checks)
        assert not any("before it is known" in check.constraint for check in report.checks)
    assert rho.verify(rho.simulate(scenario)).ok
    _, out, _ = run(capsys, monkeypatch, "simulate", str(tmp_path / "asked.yaml"), "--json")
    (row,) = read(out, "simulate")["errors"]
    assert row["to_obstacles_m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("early", [2e-6, 3.2e-6, 6e-6])
def test_points_at_rounded_times_are_not_proved_to_contradict_each_other(early: float) -> None:
    """Two accelerations pass three points to within the clock's rounding, and never exactly."""
    flown = [[5.4, 1.7, 4.5], [3.3, 7.1, 6.4], [-4.5, -4.4, -4.5], [-2, -4, -3], [1, -2, 0.4]]
    grid, h, a = rho.Grid(5.0, 6, 1.7e9), 5.0, np.array(flown)
    p, v = np.zeros((6, 3)), np.zeros((6, 3))
    for k in range(5):
        p[k + 1], v[k + 1] = p[k] + h * v[k] + h**2 / 2.0 * a[k], v[k] + h * a[k]
    points = [
        rho.Waypoint(grid.start + h - early, p[1]),
        rho.Waypoint(grid.start + 1.05 * h, p[1] + 0.25 * v[1] + 0.25**2 / 2.0 * a[1]),
        rho.Waypoint(grid.start + 2.0 * h - early, p[2]),
    ]
    vehicle = rho.Vehicle("v", rho.State(p[0]), rho.State(p[5], v[5]), waypoints=points)
    scenario = rho.Scenario("rounded", grid, [vehicle])
    assert rho.verify(rho.Plan.from_accelerations(scenario, a[None])).ok
    assert rho.verify(rho.plan_convex(scenario)).ok
