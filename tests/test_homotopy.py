"""Ways round: a plan where the first linearisation has none though the problem has one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning import homotopy
from drake_rho.planning.homotopy import SIZES, TURNS, Trials, way_round
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
    passing = np.linalg.norm(plan.positions[0] - scenario.spheres[0].center, axis=1).min()
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


ASIDE = [[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0, 0.6, -0.8]]


@pytest.mark.parametrize("aside", ASIDE)
def test_the_side_on_which_the_free_way_passes_is_tried_first(aside: list[float]) -> None:
    off = np.array(aside)
    scenario = _through_the_middle(obstacles=(rho.Sphere([10.0, 1.0, 2.0] - 0.4 * off, 2.0),))
    free = rho.plan_convex(scenario.without_obstacles())
    plan = way_round(scenario, free, most=1)
    x = plan.positions[0] - scenario.spheres[0].center
    assert 2.0 - 1e-5 < x[20] @ off < 2.1  # beyond the plane on that side, and no further
    across = np.cross([1.0, 0.0, 0.0], off)
    np.testing.assert_allclose(x @ across, 0.0, atol=1e-6)  # and has no cause to go elsewhere


@pytest.mark.parametrize("aside", ASIDE[:4])
@pytest.mark.parametrize("opening", ASIDE[:4])
def test_the_only_open_side_is_found_whatever_the_free_way(
    aside: list[float], opening: list[float]
) -> None:
    """A corridor around a sphere with room for the vehicle on one side alone."""
    center = [10.0, 1.0, 2.0] - 0.3 * np.array(aside)
    room, half = np.array(opening), np.array([20.0, 1.5, 1.5])
    walls = rho.Box(
        center - half + 3 * np.minimum(room, 0), center + half + 3 * np.maximum(room, 0)
    )
    limits = rho.Limits(position=walls, velocity=box(4.0))
    scenario = _through_the_middle(obstacles=(rho.Sphere(center, 2.0),), limits=limits)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert (plan.positions[0, 20] - center) @ room >= 1.3  # above the edge of the corridor


def test_turns_are_every_eighth_of_a_circle_once_and_the_smallest_first() -> None:
    eighths = np.degrees(TURNS) / 45.0
    assert sorted(eighths % 8) == pytest.approx(range(8))
    assert eighths[0] == 0.0
    assert set(np.abs(eighths[1:4])) == {2.0, 4.0}


def test_the_free_way_is_bent_towards_every_side_by_radii_of_the_obstacle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each reference reaches the goal, and in the middle of its time is aside by so much."""
    walls = rho.Box([-1.0, 0.0, 1.0], [21.0, 2.0, 3.0])
    limits = rho.Limits(position=walls, velocity=box(4.0))
    scenario = _through_the_middle(limits=limits)
    free = rho.plan_convex(scenario.without_obstacles())
    references: list[rho.Plan] = []

    def noted(asked: rho.Scenario, reference: rho.Plan, solver: object) -> rho.Plan:
        references.append(reference)
        raise rho.InfeasibleError({"solo": ("obstacle 1",)})

    monkeypatch.setattr(homotopy, "plan_around", noted)
    with pytest.raises(rho.InfeasibleError):
        way_round(scenario, free)
    assert len(references) == len(SIZES) * len(TURNS)
    found = []
    for reference in references:
        np.testing.assert_allclose(reference.positions[0, -1], free.positions[0, -1], atol=1e-9)
        np.testing.assert_allclose(reference.velocities[0, -1], 0.0, atol=1e-9)
        aside = reference.positions[0, 20] - free.positions[0, 20]
        assert aside[0] == pytest.approx(0.0, abs=1e-9)
        found.append((np.linalg.norm(aside) / 2.0, np.degrees(np.arctan2(aside[2], aside[1]))))
    sizes, angles = np.array(found).reshape(len(SIZES), len(TURNS), 2).transpose(2, 0, 1)
    np.testing.assert_allclose(sizes, np.tile(np.array(SIZES)[:, None], len(TURNS)), rtol=1e-9)
    for row in angles:
        np.testing.assert_allclose(
            np.sort(np.round(row % 360.0, 6)), 45.0 * np.arange(8), atol=1e-5
        )


def test_a_free_way_that_is_bent_is_linearised_around_on_that_side() -> None:
    """Bent upwards, past a sphere: the plan around it passes above, and mirrored below."""
    scenario = _through_the_middle()
    free = rho.plan_convex(scenario.without_obstacles())
    thrust = np.repeat([1.0, -1.0, -1.0, 1.0], 10)
    for up in (1.0, -1.0):
        bend = up * 3.0 / 2.5**2 * thrust[:, None] * np.array([0.0, 0.0, 1.0])
        around = rho.Plan.from_accelerations(scenario, free.accelerations + bend)
        plan = rho.plan(scenario, reference=around)
        assert up * (plan.positions[0, 20, 2] - 2.0) == pytest.approx(2.0, abs=1e-4)


def test_each_failure_suggests_one_more_turn_of_the_obstacles_it_touched() -> None:
    trials, seen = Trials(3, most=9), []
    for turns in trials:
        seen.append(turns)
        trials.turn(turns, frozenset([1, 3]))
    assert seen[0] == (0, 0, 0)
    assert seen[1:3] == [(1, 0, 0), (0, 0, 1)]
    assert len(seen) == len(set(seen)) == 9
    assert [sum(turns) for turns in seen] == sorted(map(sum, seen))
    assert all(turns[1] == 0 for turns in seen)
    assert len(list(Trials(2, most=9))) == 1  # nothing more without a failure


def test_turns_come_to_an_end() -> None:
    trials = Trials(1, most=1000)
    for turns in trials:
        trials.turn(turns, frozenset([1]))
    assert turns == (len(TURNS) - 1,)
