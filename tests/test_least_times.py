"""The benchmarks of least times: closed forms, what answers a scenario, and the referee."""

from __future__ import annotations

import dataclasses
import importlib

import numpy as np
import pytest

import drake_rho as rho

pytest.importorskip("benchmarks")  # a source archive has the tests without them

from benchmarks.bisection import PRECISION, bisected
from benchmarks.least_times import answers
from benchmarks.time_closed_forms import Straight


@pytest.mark.parametrize("knots", [3, 6, 11, 12, 161])
def test_without_a_speed_limit_only_an_odd_number_of_steps_costs_time(knots: int) -> None:
    motion, steps = Straight(7.0, 3.0), knots - 1
    odd = steps / np.sqrt(steps**2 - 1.0) if steps % 2 else 1.0
    assert motion.on(knots) == pytest.approx(odd * 2.0 * np.sqrt(7.0 / 3.0), rel=1e-12)


@pytest.mark.parametrize("speed", [0.7, 1.1, 3.0])
def test_a_speed_limit_costs_at_most_two_corners(speed: float) -> None:
    motion = Straight(10.0, 2.0, speed)
    assert motion.duration == pytest.approx(10.0 / speed + speed / 2.0)
    for knots in (41, 81, 161, 1281):
        least = motion.on(knots)
        corners = 2.0 * 2.0 * (least / (knots - 1)) ** 2 / (8.0 * speed)
        assert -1e-12 <= least - motion.duration <= corners


@pytest.mark.parametrize("knots", [11, 12])
def test_a_closed_form_is_what_bisection_finds(knots: int) -> None:
    motion = Straight(10.0, 2.0, 3.0)
    found = bisected(motion.scenario(knots)).scenario.grid.duration / motion.on(knots)
    assert 1.0 - 1e-6 <= found <= 1.0 + 2.0 * PRECISION


def test_only_a_plan_of_the_same_places_in_their_order_answers_a_scenario() -> None:
    first, second = [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]
    waypoints = [rho.Waypoint(1.0, first), rho.Waypoint(2.0, second)]
    swapped = [rho.Waypoint(2.0, first), rho.Waypoint(1.0, second)]
    vehicle = rho.Vehicle("one", rho.State([0.0] * 3), rho.State([3.0, 0.0, 0.0]))

    def flown(*passed: rho.Waypoint, knots: int = 25, most: float = 30.0) -> rho.Scenario:
        one = dataclasses.replace(vehicle, waypoints=passed)
        grid = rho.Grid.lasting(3.0, step=3.0 / (knots - 1))
        return rho.Scenario("flown", grid, [one], rho.Limits(max_thrust=most))

    given = flown(*waypoints)
    assert answers(rho.plan(given), given)
    others = (flown(waypoints[0]), flown(*swapped), flown(*waypoints, knots=31))
    for other in (*others, flown(*waypoints, most=31.0)):
        assert not answers(rho.plan(other), given)


def test_the_referee_finds_the_closed_form_along_an_axis() -> None:
    pytest.importorskip("casadi")  # of the bench extra, which tests do without
    peer = importlib.import_module("benchmarks.peers.casadi_least_time")
    track = {"waypoints": [[0, 0, 0], [3, 0, 0], [10, 0, 0]], "steps": 24}
    for uniform in (False, True):
        found = peer.answer({**track, "thrust": 2.0, "gravity": 0.0, "uniform": uniform})
        assert found["time"] == pytest.approx(2.0 * np.sqrt(5.0), rel=1e-3)
        assert found["error"] < 1e-6
