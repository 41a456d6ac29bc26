"""Plans along paths, for problems whose first linearisation has no plan."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.planners.from_paths import plan_along_paths
from drake_rho.planning.problem import Problem
from tests.scenarios import box, random_scenario, single, slow

STRAIGHT = rho.State([0.0, 1.0, 2.0]), rho.State([20.0, 1.0, 2.0])


def _through_the_middle(**changes: Any) -> rho.Scenario:
    """Return a scenario whose obstacle-free motion passes through the centre of a sphere."""
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


def test_the_convex_method_has_no_plan_through_the_centre_and_names_the_obstacle() -> None:
    with pytest.raises(rho.InfeasibleError, match="another reference") as caught:
        rho.plan_convex(_through_the_middle())
    assert caught.value.about_linearisation


def test_scp_finds_the_path_around_the_obstacle(paper: rho.Scenario) -> None:
    scenario = _through_the_middle()
    plan = rho.plan_scp(scenario)
    assert rho.verify(plan).ok
    assert plan.statistics.converged
    center = scenario.bodies[0].shape.center
    passing = np.linalg.norm(plan.positions[0] - center, axis=1).min()
    assert passing == pytest.approx(2.0, abs=0.05)  # close to the sphere, not far out


def test_a_corridor_open_on_the_other_side_is_found() -> None:
    """The obstacle-free motion passes the centre on the side where a wall blocks the corridor."""
    limits = rho.Limits(position=rho.Box([-1.0, -20.0, 1.9], [21.0, 1.2, 2.1]))
    sphere = rho.Sphere([10.0, 0.6, 2.0], 2.0)
    scenario = _through_the_middle(limits=limits, obstacles=(sphere,))
    with pytest.raises(rho.InfeasibleError):
        rho.plan_convex(scenario)
    plan = rho.plan_scp(scenario)
    assert rho.verify(plan).ok
    assert plan.positions[0, :, 1].min() < -1.3


def test_a_receding_horizon_finds_the_path_with_scp_in_its_windows() -> None:
    flight = rho.plan_rho(_through_the_middle(), planner=rho.plan_scp)
    assert rho.verify(flight).ok


def test_only_the_vehicles_that_fail_are_given_paths(paper: rho.Scenario) -> None:
    alone = _through_the_middle()
    other = rho.Vehicle("other", rho.State([0.0, 6.0, 2.0]), rho.State([20.0, 6.0, 2.0]))
    both = rho.plan_scp(dataclasses.replace(alone, vehicles=(*alone.vehicles, other)))
    assert rho.verify(both).ok
    free = rho.plan_convex(dataclasses.replace(alone, vehicles=(other,), obstacles=()))
    np.testing.assert_allclose(both.accelerations[1], free.accelerations[0], atol=1e-9)
    np.testing.assert_allclose(both.positions[0], rho.plan_scp(alone).positions[0], atol=1e-4)


def test_a_wall_without_a_gap_has_no_path_and_the_error_says_where_one_was_searched() -> None:
    limits = rho.Limits(position=rho.Box([-1.0, 0.0, 1.0], [21.0, 2.0, 3.0]), velocity=box(4.0))
    scenario = _through_the_middle(limits=limits)
    with pytest.raises(
        rho.InfeasibleError, match=r"no path was found on a grid of 0\.\d+ m"
    ) as caught:
        rho.plan_scp(scenario)
    assert caught.value.about_linearisation
    assert caught.value.statistics.searched is not None
    assert caught.value.statistics.searched.ways == 0
    assert any(name.startswith("obstacle 1") for name in caught.value.conflicts["solo"])
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)  # noqa: S301  # ours


def test_no_path_is_searched_if_the_conflict_names_no_obstacle() -> None:
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
    plan = plan_along_paths(Problem.of(scenario)).plan
    assert plan is not None
    for sphere in spheres:
        distances = np.linalg.norm(plan.positions[0] - sphere.center, axis=1)
        assert distances.min() >= sphere.radius * (1 - 1e-6)
    assert rho.plan_scp(scenario).cost <= plan.cost


@pytest.mark.parametrize("seed", [16, *slow(39, 93, 217, 376)])
def test_a_path_between_obstacles_is_found_from_a_perturbed_initial_guess(seed: int) -> None:
    """Random scenarios in which no choice of one side for each obstacle has a plan."""
    scenario = random_scenario(seed)
    with pytest.raises(rho.InfeasibleError):
        rho.plan_convex(scenario)
    assert rho.verify(rho.plan_scp(scenario)).ok


ASIDE = [[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]


@pytest.mark.parametrize("aside", ASIDE)
@pytest.mark.parametrize("opening", ASIDE)
def test_the_only_open_side_is_found_whatever_the_obstacle_free_motion(
    aside: list[float], opening: list[float]
) -> None:
    """A corridor around a sphere leaves room for the vehicle on one side only."""
    center = [10.0, 1.0, 2.0] - 0.3 * np.array(aside)
    room, half = np.array(opening), np.array([20.0, 1.4, 1.4])  # the sphere covers its edges
    walls = rho.Box(
        center - half + 3 * np.minimum(room, 0), center + half + 3 * np.maximum(room, 0)
    )
    limits = rho.Limits(position=walls, velocity=box(4.0))
    scenario = _through_the_middle(obstacles=(rho.Sphere(center, 2.0),), limits=limits)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert (plan.positions[0, 20] - center) @ room > 1.3


def test_a_perturbed_guess_is_linearised_on_its_side_of_the_obstacle() -> None:
    """The perturbed guess is above the sphere: its plan passes above, the mirrored one below."""
    scenario = _through_the_middle()
    free = rho.plan_convex(scenario.without_obstacles())
    thrust = np.repeat([1.0, -1.0, -1.0, 1.0], 10)
    for up in (1.0, -1.0):
        bend = up * 3.0 / 2.5**2 * thrust[:, None] * np.array([0.0, 0.0, 1.0])
        around = rho.Plan.from_accelerations(scenario, free.accelerations + bend)
        plan = rho.plan(scenario, reference=around)
        assert up * (plan.positions[0, 20, 2] - 2.0) == pytest.approx(2.0, abs=1e-4)


def test_the_number_of_paths_tried_is_bounded() -> None:
    tried = []
    for most in (1, 3):
        plan = rho.plan(_through_the_middle(), options=rho.Options(max_ways=most))
        assert rho.verify(plan).ok
        assert plan.statistics.searched is not None
        tried.append(plan.statistics.searched.ways)
    assert tried == [1, 3]


def test_the_cheapest_of_paths_on_different_sides_is_kept() -> None:
    """The shortest path does not have the least cost: it requires sharp turns in succession."""
    scenario = random_scenario(401)
    one, best = (rho.plan(scenario, options=rho.Options(max_ways=most)).cost for most in (1, 6))
    assert best <= one * (1 + 1e-9)


def _maze(radius: float) -> rho.Scenario:
    """Return three walls with gaps at alternating ends, and a pillar behind them."""
    walls = tuple(
        rho.Box([x, -3.0 + shift, -1.0], [x + 0.4, 2.4 + shift, 1.0])
        for x, shift in ((1.0, 0.0), (3.0, 0.6), (5.0, 0.0))
    )
    pillar = rho.Cylinder([7.0, 0.0, 0.0], 0.3)
    vehicle = rho.Vehicle("solo", rho.State([0, 0, 0]), rho.State([8, 0, 0]), radius=radius)
    limits = rho.Limits(
        position=rho.Box([-1, -3, -1], [9, 3, 1]), velocity=box(2.0), acceleration=box(3.0)
    )
    grid = rho.Grid.lasting(16.0, step=0.2)
    return rho.Scenario("maze", grid, (vehicle,), limits, (*walls, pillar))


def test_a_maze_is_passed() -> None:
    plan = rho.plan(_maze(0.3))
    assert rho.verify(plan).ok
    assert plan.statistics.searched is not None
    assert plan.statistics.searched.ways >= 1


def test_a_vehicle_too_large_for_the_maze_has_no_path() -> None:
    with pytest.raises(rho.InfeasibleError, match="no path was found"):
        rho.plan(_maze(0.65))


def test_a_gate_that_opens_is_waited_for() -> None:
    gate = rho.Obstacle(
        rho.Box([4, -1, -2], [4.5, 1, 2]),
        track=rho.Track([0, 5, 8], [[4.25, 0, 0], [4.25, 0, 0], [4.25, 3, 0]]),
    )
    walls = rho.Box([4, -9, -2], [4.5, -0.9, 2]), rho.Box([4, 0.9, -2], [4.5, 9, 2])
    scenario = single(
        start=rho.State([0, 0, 0]),
        goal=rho.State([8, 0, 0]),
        grid=rho.Grid.lasting(12.0, step=0.25),
        limits=rho.Limits(position=rho.Box([-1, -4, -1], [9, 4, 1]), velocity=box(3.0)),
        between_knots=True,
    )
    plan = rho.plan(dataclasses.replace(scenario, obstacles=(*walls, gate)))
    assert rho.verify(plan).ok
    assert np.interp(4.25, plan.positions[0, :, 0], plan.times) > 5.0


@pytest.mark.slow
def test_a_crowd_between_pillars_is_planned() -> None:
    """Six vehicles swap sides through three gaps, of which only one is wide enough."""
    pillars = tuple(rho.Box([-0.4, y, -2], [0.4, y + 1.0, 2]) for y in (-3.5, -1.75, 0.0, 1.75))
    sides = [(side, y) for side in (-1, 1) for y in (-2.0, 0.0, 2.0)]
    vehicles = tuple(
        rho.Vehicle(f"v{n}", rho.State([3 * side, y, 0]), rho.State([-3 * side, -y, 0]), radius=0.2)
        for n, (side, y) in enumerate(sides)
    )
    limits = rho.Limits(
        position=rho.Box([-4, -3, -0.1], [4, 3, 0.1]), velocity=box(2.0), acceleration=box(3.0)
    )
    scenario = rho.Scenario(
        "crowd",
        rho.Grid.lasting(10.0, step=0.2),
        vehicles,
        limits,
        pillars,
        rho.Separation(0.4),
    )
    assert rho.verify(rho.plan(scenario, options=rho.Options(max_iterations=2))).ok
    along = plan_along_paths(Problem.of(scenario))
    assert along.plan is not None
    assert rho.verify(along.plan).ok
