"""The largest speed: tangent planes, and what there are of them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.keep_in_ball import balls_of
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.working_set import Keys, WorkingSet
from tests.scenarios import single
from tests.tolerances import INDEX


def fleet(count: int, *, knots: int, most: float) -> rho.Scenario:
    """Vehicles that fly 10 m in 10 s, side by side and each in a direction of its own."""
    starts = np.stack([np.zeros(count), np.arange(count), np.zeros(count)], axis=1)
    angles = np.linspace(0.0, 1.0, count)
    ways = 10.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
    ends = zip(starts, starts + ways, strict=True)
    vehicles = [
        rho.Vehicle(f"v{number}", rho.State(start), rho.State(goal))
        for number, (start, goal) in enumerate(ends)
    ]
    limits = rho.Limits(max_speed=most)
    return rho.Scenario("fast", rho.Grid(10.0 / (knots - 1), knots), vehicles, limits)


def test_speed_is_kept_in_any_direction_at_the_cost_of_any_other() -> None:
    """Turned, a motion costs the same: what is kept is a ball, whatever planes it is cut by."""
    plan = rho.plan_convex(fleet(5, knots=41, most=1.2))
    assert rho.verify(plan).ok
    speeds = np.linalg.norm(plan.velocities, axis=2)
    assert speeds.max() == pytest.approx(1.2, rel=1e-6)
    costs = np.sum(plan.accelerations**2, axis=(1, 2))
    assert costs == pytest.approx(costs[0], rel=INDEX)


def test_along_one_axis_it_is_a_box() -> None:
    """On a straight way the largest speed is that of a velocity box."""
    goal = rho.State([10.0, 0.0, 0.0])
    ball = rho.plan_convex(single(goal=goal, limits=rho.Limits(max_speed=1.6)))
    box = rho.Limits(velocity=rho.Box([-1.6] * 3, [1.6] * 3))
    boxed = rho.plan_convex(single(goal=goal, limits=box))
    assert ball.cost == pytest.approx(boxed.cost, rel=INDEX)


def test_known_tangent_planes_take_memory_in_proportion() -> None:
    """Looking rows up compares each with those of its own instant, not with all there are."""
    scenario = fleet(100, knots=101, most=1.01)
    (ball,) = balls_of(scenario)
    motion = MinimumEffort.of(scenario).motion
    rows = ball.violated(motion, np.arange(100))
    working = WorkingSet(Keys(20, 100, scenario.grid))
    working.add(rows)
    faster = motion.with_accelerations(1.1 * motion.accelerations)
    working.add(ball.violated(faster, np.arange(100)))
    tracemalloc.start()
    known = working.known(rows, motion)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert known.all()
    assert most < 1000 * len(rows)
