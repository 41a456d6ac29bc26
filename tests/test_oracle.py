"""The benchmarks' own checks: an oracle of paths, the timing of paths, distances and samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.scenarios import box

pytest.importorskip("benchmarks")  # a source archive has the tests without them

from benchmarks import oracle
from benchmarks.clearance import clearance, distances, nearest
from benchmarks.sampling import sample
from benchmarks.timing import least_time


def field(*shapes: rho.Sphere | rho.Box, duration: float = 9.0) -> rho.Scenario:
    """Return ten metres along x in a room of 10 by 4 by 3 m, radius 0.15 m."""
    room = rho.Box([0.0, 0.0, 0.0], [10.0, 4.0, 3.0])
    ends = rho.State([0.0, 2.0, 1.5]), rho.State([10.0, 2.0, 1.5])
    return rho.Scenario(
        "field",
        rho.Grid(duration / 45, 46),
        (rho.Vehicle("solo", *ends, radius=0.15),),
        rho.Limits(position=room, velocity=box(3.0), acceleration=box(3.0)),
        shapes,
    )


def wall(gap: float) -> tuple[rho.Box, rho.Box]:
    """Return a wall across the room at x = 5 m, from floor to ceiling, with a gap at one side."""
    return (
        rho.Box([4.8, -1.0, -1.0], [5.2, 4.0 - gap, 4.0]),
        rho.Box([4.8, 3.0, 2.0], [5.2, 5.0, 4.0]),
    )


def test_a_free_flight_takes_the_time_of_full_acceleration_and_speed() -> None:
    answer = oracle.ask(field())
    assert answer.verdict == "way"
    assert answer.metres == pytest.approx(10.0, abs=0.01)
    assert answer.seconds == pytest.approx(10.0 / 3.0 + 1.0, rel=1e-3)


@pytest.mark.slow
def test_a_wall_has_a_path_through_its_gap_or_none() -> None:
    assert oracle.ask(field(*wall(0.0))).verdict == "none"
    assert oracle.ask(field(*wall(0.1))).verdict == "none"  # a gap less than the radius
    answer = oracle.ask(field(*wall(0.4)))
    assert answer.verdict == "way"
    # through (4.8, 3.75) and (5.2, 3.75) at the least, which the radius shifts by 0.15 m
    assert answer.metres > 2.0 * np.hypot(4.8, 1.6)
    assert oracle.ask(field(*wall(0.4), duration=4.5)).verdict == "too slow"


def test_scenarios_that_the_oracle_does_not_support_are_refused() -> None:
    moving = rho.Obstacle(rho.Sphere([5.0, 0.0, 0.0], 0.5), velocity=[0.0, 0.1, 0.0])
    with pytest.raises(TypeError, match="at rest"):
        oracle.ask(dataclasses.replace(field(), obstacles=(moving,)))


def test_a_curve_is_flown_no_faster_than_its_acceleration_allows() -> None:
    """On a circle at constant speed, boxes allow at least what the ball inside them allows."""
    angles = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(400)], axis=1)
    seconds = least_time(circle, np.full(3, 100.0), np.full(3, 1.0))
    assert 2.0 * np.pi / np.sqrt(np.sqrt(2.0)) < seconds < 2.0 * np.pi + 2.0
    assert least_time(circle, np.full(3, 100.0), np.full(3, 4.0)) == pytest.approx(seconds / 2.0)


@pytest.mark.parametrize(
    "shape", [rho.Sphere([1.0, -2.0, 0.5], 0.7), rho.Box([0.0, -3.0, 0.0], [1.0, -1.5, 2.0])]
)
def test_distances_are_those_of_the_shapes(shape: rho.Sphere | rho.Box) -> None:
    positions = shape.center + np.random.default_rng(0).normal(0.0, 1.5, (500, 3))
    known = shape.local_distance(positions - shape.center)
    outside = known > 0.0
    np.testing.assert_allclose(distances(shape, positions)[outside], known[outside], atol=1e-12)
    away = positions[outside] - nearest(shape, positions[outside])
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), known[outside], atol=1e-9)


def test_clearance_is_beyond_the_radius_from_the_obstacle_at_each_time() -> None:
    passing = rho.Obstacle(rho.Sphere([5.0, -1.0, 1.5], 0.5), velocity=[0.0, 1.0, 0.0])
    scenario = dataclasses.replace(field(), obstacles=(passing,))
    times = np.linspace(0.0, 9.0, 901)
    stay = np.broadcast_to([5.0, 2.0, 2.75], (901, 1, 3))
    assert clearance(scenario, times, stay) == pytest.approx(1.25 - 0.5 - 0.15)
    assert clearance(field(), times, stay) == np.inf


def test_samples_find_violations() -> None:
    scenario = field(rho.Sphere([5.0, 2.0, 1.5], 0.5))
    straight = rho.plan_convex(scenario.without_obstacles())
    through = rho.Plan.from_accelerations(scenario, straight.accelerations)
    found = sample(through)
    assert found.clearance == pytest.approx(-0.65, abs=0.02)
    assert found.metres == pytest.approx(10.0)
    assert found.beyond <= 1e-9
    slow = dataclasses.replace(scenario.limits, velocity=box(1.0))
    fast = rho.Plan.from_accelerations(
        dataclasses.replace(scenario, limits=slow), straight.accelerations
    )
    assert sample(fast).beyond == pytest.approx((straight.velocities.max() - 1.0) / 2.0)
