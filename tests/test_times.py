"""One module compares times, and what is equal but for rounding is equal everywhere."""

from __future__ import annotations

import ast
import dataclasses
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho

PACKAGE = Path(rho.__file__).parent
CLOCKS = (0.0, 8.8, 1000.1, 100000.3, 1.7e9 + 8.8, 1.7e9 + 1.2)
SAME_COST = 1e-5
"""Relative difference of costs on clocks that round times."""


def straight(start: float, step: float, *requirements: rho.KeepIn, knots: int = 13) -> rho.Scenario:
    """Return a vehicle that flies 10 m from rest to rest, with requirements."""
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([10, 0, 0]))
    grid = rho.Grid(step, knots, start)
    return rho.Scenario("straight", grid, [vehicle], requirements=requirements)


def test_no_other_module_decides_which_times_are_equal() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path == PACKAGE / "scenario" / "times.py":
            continue
        text = path.read_text()
        if "SAME_TIME" not in text and "rounding" not in text:
            continue  # sooner than its syntax tree says so
        for node in ast.walk(ast.parse(text)):
            found = {getattr(node, field, None) for field in ("id", "attr", "arg", "name")}
            assert not found & {"SAME_TIME", "rounding"}, (path, getattr(node, "lineno", 0))


@pytest.mark.parametrize("start", [*CLOCKS, -1.7e9])
def test_a_clock_tells_knots_apart_and_sums_not(start: float) -> None:
    grid = rho.Grid(0.1, 101, start)
    clock, times = grid.clock, grid.times
    added = np.array([start + sum([0.1] * k) for k in range(101)])
    assert clock.same(times, added).all()
    assert not clock.before(times, added).any()
    assert not clock.after(times, added).any()
    assert clock.before(times[:-1], times[1:]).all()
    assert clock.after(times[1:], times[:-1]).all()
    assert clock.within(added, (times[0], times[-1])).all()
    np.testing.assert_array_equal(grid.since_start(added), grid.elapsed)
    between = grid.since_start(added[:-1] + 0.05)
    np.testing.assert_allclose(between, grid.elapsed[:-1] + 0.05, atol=3e-7)
    assert len(clock.apart(added, times)) == 0
    assert len(clock.distinct(np.concatenate([added, times]))) == 101
    np.testing.assert_array_equal(clock.last_begun(times, added), np.arange(101))
    np.testing.assert_array_equal(clock.last_before(times, added), np.arange(101) - 1)


def test_windows_compare_times_by_the_clock_of_their_flight() -> None:
    grid = rho.Grid(0.1, 11, -1.7e9)
    assert grid.from_knot(7).clock == grid.clock


@pytest.mark.parametrize(("of", "size"), [("acceleration", 0.05), ("thrust", 0.05), ("jerk", 0.01)])
def test_intervals_that_end_at_knots_mean_the_same_steps_on_every_clock(
    of: str, size: float
) -> None:
    costs = dict[tuple[float, int], list[float]]()
    for start in CLOCKS:
        for step in (0.1, 0.7):
            for first, last in ((2, 5), (6, 11), (12, 12)):
                interval = round(start + first * step, 1), round(start + last * step, 1)
                ball = rho.Ball(
                    [0, 0, 9.81 * (of == "thrust")],
                    10.0 * size / (12 * step) ** (3 if of == "jerk" else 2),
                )
                asked = rho.KeepIn(ball, of=of, active=interval)  # type: ignore[arg-type]
                plan = rho.plan(straight(start, step, asked))
                assert rho.verify(plan).ok, (start, step, interval)
                costs.setdefault((step, first), []).append(plan.cost)
    for each in costs.values():
        np.testing.assert_allclose(each, each[0], rtol=SAME_COST)


@pytest.mark.parametrize("start", [0.0, 1000.1, 1.7e9])
@pytest.mark.parametrize("of", ["acceleration", "thrust", "jerk", "velocity", "position"])
def test_a_rest_too_short_for_its_clock_is_verified(start: float, of: str) -> None:
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([1, 0, 0]))
    track = rho.Track([start, start + 1], [[1, 9, 0], [1, 8, 0]], after="goes_on")
    meets = rho.Obstacle(rho.Sphere([1, 9, 0], 1.0), track=track)
    asked = rho.KeepIn(rho.Ball([0, 0, 0], 1e4), of=of)  # type: ignore[arg-type]
    grid = rho.Grid(0.1, 21, start)
    report = rho.verify(
        rho.plan(rho.Scenario("s", grid, [vehicle], obstacles=[meets], requirements=[asked]))
    )
    assert report.ok
    assert any("can hold at its goal until" in note for note in report.notes)


@pytest.mark.parametrize("start", CLOCKS)
def test_what_is_passed_or_avoided_at_a_knot_is_so_exactly(start: float) -> None:
    step = 0.4
    near = start + 3 * step + (2e-7 if abs(start) > 1e8 else 0.0)  # equal but for rounding
    scenario = straight(start, step)
    (vehicle,) = scenario.vehicles
    gate = rho.Waypoint(near, [2, 1, 0])
    zone = rho.Obstacle(rho.Sphere([6, 0, 0], 1.0), active=(start, start + 6 * step))
    plan = rho.plan(
        dataclasses.replace(
            scenario,
            vehicles=(dataclasses.replace(vehicle, waypoints=(gate,)),),
            obstacles=(zone,),
        )
    )
    assert rho.verify(plan).ok
    np.testing.assert_allclose(plan.positions[0, 3], [2, 1, 0], atol=1e-5)
    assert np.linalg.norm(plan.positions[0, 6] - [6, 0, 0]) >= 1.0 - 1e-6


def test_two_waypoints_at_times_that_count_as_equal_are_refused() -> None:
    scenario = straight(1.7e9, 0.4)
    one = rho.Waypoint(1.7e9 + 1.0, [1, 0, 0])
    other = rho.Waypoint(1.7e9 + 1.0 + 3e-7, [2, 0, 0])
    vehicle = dataclasses.replace(scenario.vehicles[0], waypoints=(one, other))
    with pytest.raises(rho.ScenarioError, match=r"waypoints\[1\]\.time.*no other waypoint"):
        dataclasses.replace(scenario, vehicles=(vehicle,))
