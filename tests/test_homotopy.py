"""Ways round: a plan where the first linearisation has none though the problem has one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.homotopy import way_round
from tests.scenarios import box, random_scenario, single

STRAIGHT = rho.State([0.0, 1.0, 2.0]), rho.State([20.0, 1.0, 2.0])


def _through_the_middle(**changes: Any) -> rho.Scenario:
    """A flight whose free way leads straight through the centre of a sphere."""
    start, goal = STRAIGHT
    return dataclasses.replace(
        single(
            start=start,
            goal=goal,
            grid=rho.Grid(0.25, 41),
            limits=rho.Limits(velocity=box(4.0)),
            obstacles=(rho.Sphere([10.0, 1.0, 2.0], 2.0),),
        ),
        **changes,
    )


def test_the_convex_method_has_no_plan_through_the_middle_and_says_of_what() -> None:
    with pytest.raises(rho.InfeasibleError, match="another reference") as caught:
        rho.plan_convex(_through_the_middle())
    assert caught.value.about_linearisation


def test_scp_finds_the_way_round(paper: rho.Scenario) -> None:
    scenario = _through_the_middle()
    plan = rho.plan_scp(scenario)
    assert rho.verify(plan).ok
    assert plan.statistics.converged
    passing = np.linalg.norm(plan.positions[0] - scenario.obstacles[0].center, axis=1).min()
    assert passing == pytest.approx(2.0, abs=0.05)  # close by, not far out


def test_a_corridor_open_on_the_other_side_is_found() -> None:
    """The free way passes the centre on the side where a wall leaves no room."""
    limits = rho.Limits(position=rho.Box([-1.0, -20.0, 1.9], [21.0, 1.2, 2.1]))
    sphere = rho.Sphere([10.0, 0.6, 2.0], 2.0)
    scenario = _through_the_middle(limits=limits, obstacles=(sphere,))
    with pytest.raises(rho.InfeasibleError):
        rho.plan_convex(scenario)
    plan = rho.plan_scp(scenario)
    assert rho.verify(plan).ok
    assert plan.positions[0, :, 1].min() < -1.3


def test_a_receding_horizon_finds_it_with_scp_in_its_windows() -> None:
    flight = rho.plan_rho(_through_the_middle(), planner=rho.plan_scp)
    assert rho.verify(flight).ok


def test_only_the_vehicles_that_fail_are_sent_round(paper: rho.Scenario) -> None:
    alone = _through_the_middle()
    other = rho.Vehicle("other", rho.State([0.0, 6.0, 2.0]), rho.State([20.0, 6.0, 2.0]))
    both = rho.plan_scp(dataclasses.replace(alone, vehicles=(*alone.vehicles, other)))
    assert rho.verify(both).ok
    free = rho.plan_convex(dataclasses.replace(alone, vehicles=(other,), obstacles=()))
    np.testing.assert_allclose(both.accelerations[1], free.accelerations[0], atol=1e-9)
    np.testing.assert_allclose(both.positions[0], rho.plan_scp(alone).positions[0], atol=1e-4)


def test_a_wall_without_a_gap_is_no_way_and_the_tries_are_bounded() -> None:
    limits = rho.Limits(position=rho.Box([-1.0, 0.0, 1.0], [21.0, 2.0, 3.0]), velocity=box(4.0))
    scenario = _through_the_middle(limits=limits)
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_scp(scenario)
    assert 10 < caught.value.statistics.programs < 500
    assert any(name.startswith("obstacle 1") for name in caught.value.conflicts["solo"])


def test_without_the_obstacle_in_the_conflict_no_way_round_is_sought() -> None:
    weak = _through_the_middle(limits=rho.Limits(acceleration=box(0.1)))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan_scp(weak)
    assert not caught.value.about_linearisation
    assert caught.value.statistics.programs < 5


def test_a_detour_stays_outside_at_every_knot() -> None:
    spheres = (
        rho.Sphere([6.0, 1.0, 2.0], 2.0),
        rho.Sphere([9.0, 2.0, 2.5], 2.0),
        rho.Sphere([14.0, 0.5, 1.0], 2.5),
    )
    scenario = _through_the_middle(obstacles=spheres)
    free = rho.plan_convex(scenario.without_obstacles())
    plan = way_round(scenario, free)
    for sphere in spheres:
        distances = np.linalg.norm(plan.positions[0] - sphere.center, axis=1)
        assert distances.min() >= sphere.radius * (1 - 1e-6)
    assert rho.plan_scp(scenario).cost < plan.cost


@pytest.mark.parametrize("seed", [16, 39, 93, 217, 376])
def test_a_way_between_obstacles_is_found_by_bending_the_free_one(seed: int) -> None:
    """Random scenarios in which no choice of one side for each obstacle has a plan."""
    scenario = random_scenario(seed)
    with pytest.raises(rho.InfeasibleError):
        rho.plan_convex(scenario)
    assert rho.verify(rho.plan_scp(scenario)).ok
