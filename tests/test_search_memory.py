"""Memory of path searches: grids that fit the speeds, and a bound in bytes."""

from __future__ import annotations

import dataclasses
import tracemalloc
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.path_search.fleet_in_space import FleetSpaceSearch, space_size
from drake_rho.planning.path_search.initial_guesses import find_paths
from drake_rho.planning.path_search.lattice import Lattice, Raster, TooLargeError
from drake_rho.planning.path_search.moving_obstacles import MovingObstacle
from drake_rho.planning.path_search.prioritized import FleetSpaceTimeSearch, space_time_size
from drake_rho.planning.path_search.reachable import reachable_bounds
from drake_rho.planning.path_search.resolution import resolutions
from drake_rho.planning.path_search.space_time import TimeExpandedGraph
from drake_rho.planning.planners.from_paths import plan_along_paths
from drake_rho.planning.problem import Problem

CASES = Path(__file__).parent / "cases"


def door(
    velocity: rho.Box, *, speed: float = 0.0, moving: bool = True, span: float = 20.0
) -> rho.Scenario:
    """Return a flight of ten seconds past two walls and, by default, a moving box."""
    obstacles: list[rho.Obstacle] = [
        rho.Obstacle(rho.Box([6, -8, -5], [7, 2, 15])),
        rho.Obstacle(rho.Box([12, -2, -5], [13, 8, 15])),
    ]
    if moving:
        obstacles.append(rho.Obstacle(rho.Box([9, -1, 0], [10, 0, 10]), velocity=[0, 0.1, 0]))
    ends = (rho.State([0, 0, 5], [speed, 0, 0]), rho.State([span, 0, 5], [speed, 0, 0]))
    limits = rho.Limits(
        position=rho.Box([-5, -10, 0], [25, 10, 10]),
        velocity=velocity,
        acceleration=rho.Box([-4] * 3, [4] * 3),
    )
    vehicle = rho.Vehicle("v", *ends, radius=0.2)
    return rho.Scenario("door", rho.Grid(0.25, 41), [vehicle], limits, obstacles)


SLOW_CLIMB = rho.Box([-5, -5, -0.02], [5, 5, 0.02])
FORWARD = rho.Box([0.5, -5, -5], [5, 5, 5])


@pytest.mark.parametrize(
    ("case", "most"), [("slow_climb", 1e7), ("forward_only", 1e8), ("fast_descent", 1e7)]
)
def test_a_search_respects_its_memory_limit(case: str, most: float) -> None:
    scenario = rho.load_scenario(CASES / f"{case}.yaml")
    find_paths(scenario, max_memory=most)  # loads and caches what is used once
    tracemalloc.start()
    try:
        found = find_paths(scenario, max_memory=most)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.searched.points > 0
    assert peak < most + 2e7  # arrays in use at the same time


def test_a_lattice_takes_the_memory_predicted_for_it() -> None:
    scenario = door(rho.Box([-5] * 3, [5] * 3))
    for size, fleet in ((space_size, FleetSpaceSearch), (space_time_size, FleetSpaceTimeSearch)):
        *_, finest = resolutions(scenario, 5e3, partial(size, scenario), 1e8)
        tracemalloc.start()
        try:
            searched = fleet(scenario, finest)
            if isinstance(searched, FleetSpaceTimeSearch):
                searched.prioritised(searched.first_order())
            else:
                searched.trajectories(0, 1)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        reported = size(scenario, finest).bytes
        assert 0.2 * reported < peak < reported


def test_grids_are_coarser_with_less_memory() -> None:
    scenario = door(rho.Box([-5] * 3, [5] * 3))
    finest = []
    for most in (1e7, 1e8, 1e9):
        *_, last = resolutions(scenario, 5e3, partial(space_time_size, scenario), most)
        assert space_time_size(scenario, last).bytes <= most
        finest.append(last.length)
    assert finest[0] > finest[1] > finest[2]


@pytest.mark.parametrize("moving", [False, True])
def test_an_error_says_that_no_grid_is_small_enough(moving: bool) -> None:
    scenario = door(SLOW_CLIMB, moving=moving)
    found = find_paths(scenario, max_memory=1.0)
    assert found.references == ()
    assert "max_memory" in str(found.searched)
    options = rho.Options()
    object.__setattr__(options, "max_memory", 1.0)  # less than users may request
    along = plan_along_paths(Problem.of(scenario), options=options)
    assert along.plan is None
    assert "max_memory" in str(along.spent.searched)


def test_too_many_blocked_moves_are_too_large() -> None:
    lattice = Lattice(Raster.filling(np.zeros(3), np.full(3, 9.0), np.ones(3)), (), 0.0)
    times = np.arange(9.0)
    body = rho.Obstacle(rho.Sphere([4, 4, 4], 2.0), velocity=[0.1, 0, 0])
    moving = MovingObstacle(body, 0.1, times)
    taken = sum(each.nbytes for each in TimeExpandedGraph(lattice, 8, [moving]).blocked)
    assert TimeExpandedGraph(lattice, 8, [moving], most=taken).count == 8
    with pytest.raises(TooLargeError):
        TimeExpandedGraph(lattice, 8, [moving], most=taken - 1)


def test_a_memory_error_does_not_end_a_planner(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def without(*_: object) -> None:
        raise MemoryError

    scenario = door(SLOW_CLIMB)
    with monkeypatch.context() as patch:
        patch.setattr("drake_rho.planning.path_search.prioritized.Lattice", without)
        with pytest.raises(rho.InfeasibleError, match="max_memory"):
            rho.plan(scenario)
    monkeypatch.setattr("drake_rho.planning.scp.cutting_planes.CuttingPlanes.keep_to", without)
    for planner in (rho.plan, rho.plan_convex, rho.plan_rho):
        with pytest.raises(rho.SolverError, match="memory"):
            planner(scenario)


def test_moves_are_as_long_as_speeds_allow_along_each_axis() -> None:
    for velocity, speed, ratio in ((SLOW_CLIMB, 0.0, [1, 1, 0.125]), (FORWARD, 2.0, [1, 1, 1])):
        scenario = door(velocity, speed=speed)
        first = next(resolutions(scenario, 5e3, partial(space_time_size, scenario), 1e9))
        assert np.allclose(first.spacing[0] / first.spacing[0].max(), ratio)


def test_no_path_leads_where_a_vehicle_cannot_be_in_time() -> None:
    """Over one wall it could climb in twice the time; the other leaves no time for the goal."""
    scenario = door(rho.Box([-5, -5, -0.5], [5, 5, 0.5]), moving=False)
    high = rho.Box([12, -10, 0], [13, 10, 7.3])
    blocked = dataclasses.replace(
        scenario,
        obstacles=(high, rho.Obstacle(rho.Sphere([0, 9, 9], 0.1), velocity=[0.1, 0, 0])),
    )
    assert find_paths(blocked).references == ()
    low = rho.Box([12, -10, 0], [13, 10, 5.8])
    passed = dataclasses.replace(blocked, obstacles=(low, *blocked.obstacles[1:]))
    assert len(find_paths(passed).references) == 1


def test_plans_stay_within_reach() -> None:
    for case in ("slow_climb", "forward_only"):
        scenario = rho.load_scenario(CASES / f"{case}.yaml")
        plan = rho.plan(scenario, options=rho.Options(max_iterations=1))
        times = np.linspace(0.0, scenario.grid.duration, 201)
        reachable = reachable_bounds(scenario)
        lower, upper = reachable.of(0, times)
        x = plan.motion().at("position", times)[0]
        assert np.all((x >= lower - 1e-3) & (x <= upper + 1e-3))  # straight between samples
    # no motion goes further and comes back in time
    assert reachable.upper[0, :, 0].max() == pytest.approx(20.0)


def test_reach_follows_from_speeds_and_accelerations() -> None:
    scenario = door(rho.Box([-5, -5, -0.1], [5, 5, 0.2]))
    reachable = reachable_bounds(scenario)
    lower, upper = reachable.of(0, np.array([0.0, 5.0, 10.0]))
    assert np.allclose(lower[[0, 2]], [[0, 0, 5], [20, 0, 5]])
    assert np.allclose(upper[[0, 2]], [[0, 0, 5], [20, 0, 5]])
    # up at 0.2 m/s and down at 0.1 m/s: the height at 5 s leaves time to come down
    assert upper[1, 2] == pytest.approx(5.5, abs=0.02)
    assert lower[1, 2] == pytest.approx(4.5, abs=0.02)
    assert np.all(reachable.speeds <= [5.0, 5.0, 0.2])


def test_a_vehicle_without_spare_time_has_a_path() -> None:
    """It flies at 2 m/s throughout; its speed may vary by a hundredth."""
    scenario = door(rho.Box([1.98, -5, -5], [2.02, 5, 5]), speed=2.0)
    plan = rho.plan(scenario, options=rho.Options(max_iterations=1))
    assert rho.verify(plan).ok
