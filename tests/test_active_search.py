"""Path search among obstacles that are active for a time: paths pass before, or after."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.path_search.initial_guesses import find_paths
from drake_rho.planning.path_search.lattice import Lattice, Raster
from drake_rho.planning.path_search.moving_obstacles import MovingObstacle, blocked_moves
from tests.sampled import flown, least_clearances
from tests.scenarios import sampled_separation, single, slow
from tests.shapes import Shape
from tests.tolerances import INDEX

ROOM = rho.Box([-1, -4, 0], [11, 4, 4])
AROUND_START, AROUND_GOAL = rho.Box([-2, -2, -1], [2, 2, 5]), rho.Box([8, -2, -1], [12, 2, 5])
LIMITS = rho.Limits(position=ROOM, max_speed=5.0, max_acceleration=4.0)


def _wall(at: float = 0.0, half: float = 0.7) -> list[rho.Box]:
    """Return a wall across the room, with a door at a place along it."""
    return [
        rho.Box([4.5, -5, -1], [5.5, at - half, 5]),
        rho.Box([4.5, at + half, -1], [5.5, 5, 5]),
    ]


def _closed(first: float, last: float, at: float = 0.0, half: float = 0.8) -> rho.Obstacle:
    """Return what closes the door of a wall for a time."""
    return rho.Obstacle(rho.Box([4.4, at - half, -1], [5.6, at + half, 5]), active=(first, last))


def _room(obstacles: Sequence[Shape | rho.Obstacle], start: float = 0.0) -> rho.Scenario:
    """Return a vehicle that flies in 10 s from one half of a room to the other."""
    vehicle = rho.Vehicle("a", rho.State([0, 0, 2]), rho.State([10, 0, 2]), radius=0.2)
    grid = rho.Grid.lasting(10.0, step=0.25, start=start)
    return rho.Scenario("room", grid, [vehicle], LIMITS, obstacles)


def _in_door(plan: rho.Plan) -> np.ndarray:
    """Return the times at which the vehicle is in the wall's plane [s]."""
    times = np.linspace(0.0, 10.0, 20_001)
    x = flown(plan, times)[0, :, 0]
    return times[np.abs(x - 5.0) < 0.7]


@pytest.mark.parametrize("at", [0.0, *slow(2.0)])
@pytest.mark.parametrize(
    "active", [(0.0, 6.0), (0.0, 8.0), (4.0, 10.0), (2.0, 10.0), (3.5, 6.5), (3.0, 9.0), (1.0, 7.0)]
)
def test_a_door_is_passed_before_or_after_it_is_closed(
    active: tuple[float, float], at: float
) -> None:
    plan = rho.plan(_room([*_wall(at), _closed(*active, at)]))
    assert rho.verify(plan).ok
    assert least_clearances(plan).min() >= -1e-6
    passing = _in_door(plan)
    assert passing[-1] <= active[0] or passing[0] >= active[1]


def test_a_door_that_is_closed_all_the_time_is_not_passed() -> None:
    with pytest.raises(rho.InfeasibleError, match="no path was found"):
        rho.plan(_room([*_wall(), _closed(0.0, 10.0)]))


@pytest.mark.parametrize("active", [(0.0, 6.0), (6.0, 10.0)])
def test_a_corridor_is_flown_while_it_is_not_blocked(active: tuple[float, float]) -> None:
    corridor = [rho.Box([2, -5, -1], [8, -0.7, 5]), rho.Box([2, 0.7, -1], [8, 5, 5])]
    block = rho.Obstacle(rho.Box([3, -1, -1], [7, 1, 5]), active=active)
    plan = rho.plan(_room([*corridor, block]))
    assert rho.verify(plan).ok
    assert least_clearances(plan).min() >= -1e-6


def test_starts_are_left_and_goals_reached_while_nothing_is_around_them() -> None:
    """Also on paths, whose first and last moves are not those of the grid."""
    around = [rho.Obstacle(AROUND_START, active=(5, 10)), rho.Obstacle(AROUND_GOAL, active=(0, 5))]
    for active, kept in (((0.0, 6.0), around[:1]), ((4.0, 10.0), around[1:]), ((0.0, 5.2), around)):
        plan = rho.plan(_room([*_wall(), _closed(*active), *kept]))
        assert plan.statistics.searched is not None
        assert rho.verify(plan).ok
        assert least_clearances(plan).min() >= -1e-6


def _known(seed: int) -> tuple[rho.Plan, rho.Scenario]:
    """Return a motion through a door, and the scenario with the door closed before and after it."""
    rng = np.random.default_rng(seed)
    at, half, when = rng.uniform(-2.5, 2.5), rng.uniform(0.5, 1.0), rng.uniform(2.2, 7.8)
    start, goal = (rho.State([x, rng.uniform(-3, 3), 2]) for x in (0, 10))
    door = rho.Waypoint(when, [5, at, 2])
    vehicle = rho.Vehicle("a", start, goal, radius=0.2, waypoints=[door])
    scenario = dataclasses.replace(_room(_wall(at, half)), vehicles=(vehicle,))
    known = rho.plan(scenario)
    passing, kind = _in_door(known), int(rng.integers(3))
    early, late = passing[0] - rng.uniform(0.2, 0.6), passing[-1] + rng.uniform(0.2, 0.6)
    closed = [(0.0, early)] * (kind != 1) + [(late, 10.0)] * (kind != 0)
    obstacles: list[Shape | rho.Obstacle] = list(_wall(at, half))
    obstacles += [_closed(a, b, at, half + 0.1) for a, b in closed if b - a > 0.1]
    free = dataclasses.replace(vehicle, waypoints=())
    return known, dataclasses.replace(_room(obstacles), vehicles=(free,))


@pytest.mark.parametrize("seed", [*range(4), *slow(*range(4, 8))])
def test_a_plan_is_found_where_a_motion_is_known(seed: int) -> None:
    known, scenario = _known(seed)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert least_clearances(plan).min() >= -1e-6
    assert plan.cost <= known.cost * (1.0 + INDEX)


BESIDE, PILLAR = rho.Box([4.5, -5, -1], [5.5, 2.5, 5]), rho.Cylinder([7.5, 1.5, 2.0], 0.5)
"""A wall with a gap at its side, for which paths are searched, and a pillar behind it."""


@pytest.mark.parametrize("start", [*slow(0.0), 1.7e9])
def test_an_interval_that_covers_the_flight_changes_nothing(start: float) -> None:
    """The plan is equal to the last digit also where paths are looked for."""
    always = rho.plan(_room([BESIDE, PILLAR], start))
    for active in ((start, start + 10.0), (start - 5.0, start + 30.0)):
        zones = [rho.Obstacle(each, active=active) for each in (BESIDE, PILLAR)]
        plan = rho.plan(_room(zones, start))
        np.testing.assert_array_equal(plan.accelerations, always.accelerations)


@pytest.mark.parametrize("active", [(-9.0, -0.5), (10.5, 30.0)])
def test_an_interval_beside_the_flight_is_as_no_obstacle(active: tuple[float, float]) -> None:
    without = rho.plan(_room([BESIDE]))
    zones = [_closed(*active), rho.Obstacle(rho.Sphere([0, 0, 2], 3.0), active=active)]
    plan = rho.plan(_room([zones[0], BESIDE, zones[1]]))
    np.testing.assert_array_equal(plan.accelerations, without.accelerations)
    assert rho.verify(plan).ok


def test_what_is_active_for_a_time_is_searched_in_space_and_time_alone_then() -> None:
    steady = find_paths(_room([BESIDE]), most=4)
    assert steady.searched.layers is None or steady.searched.layers == 0
    assert find_paths(_room([BESIDE, _closed(0.0, 3.0)]), most=4).searched.layers > 0


@pytest.mark.parametrize("shape", [rho.Sphere([1, 1, 1], 0.9), rho.Box([0, 0, -9], [0.9, 2, 9])])
def test_an_obstacle_at_rest_blocks_the_same_moves_in_all_layers_in_which_it_is_active(
    shape: Shape, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are looked for in two layers only, and the same as if they were in every one."""
    lattice = Lattice(Raster.filling(np.zeros(3), np.full(3, 2.0), np.full(3, 0.25)), [], 0.1)
    times, points = np.linspace(0.0, 8.0, 17), lattice.points
    moving = MovingObstacle(rho.Obstacle(shape, active=(2.2, 6.1)), 0.1, times)
    found = blocked_moves(lattice, moving)
    monkeypatch.setattr(rho.Obstacle, "moves", True)
    every = blocked_moves(
        lattice, MovingObstacle(rho.Obstacle(shape, active=(2.2, 6.1)), 0.1, times)
    )
    for layer, (one, other) in enumerate(zip(found, every, strict=True)):
        np.testing.assert_array_equal(np.sort(one), np.sort(other))
        assert (len(one) > 0) == (4 <= layer <= 12)
    assert len(found[4]) > len(found[5])  # moves from inside are blocked once
    assert len(points) == 9**3


@pytest.mark.parametrize("size", [0.01, 1.0, 1000.0])
@pytest.mark.parametrize("moved", [0.0, 1e-7])
def test_a_vehicle_that_hovers_makes_way_for_what_appears_around_it(
    size: float, moved: float
) -> None:
    zone = rho.Obstacle(rho.Box([-size, -size, -2 * size], [size, 2 * size, size]), active=(3, 6))
    goal = rho.State([moved, 0, 0])
    scenario = single(start=rho.State([0, 0, 0]), goal=goal, obstacles=[zone], between_knots=True)
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    assert least_clearances(plan).min() >= -1e-6 * size


@pytest.mark.parametrize("active", [*slow((0.0, 6.0), (3.0, 10.0)), (4.0, 6.5)])
def test_a_fleet_passes_a_door_one_after_another_while_it_is_open(
    active: tuple[float, float],
) -> None:
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State([0, 1.5 * i, 2]), rho.State([10, -1.5 * i, 2]), radius=0.2)
        for i in (-1, 0, 1)
    ]
    room = _room([*_wall(), _closed(*active)])
    apart = rho.Separation(0.6)
    plan = rho.plan(dataclasses.replace(room, vehicles=tuple(vehicles), separation=apart))
    assert rho.verify(plan).ok
    assert least_clearances(plan).min() >= -1e-6
    assert sampled_separation(plan, 100) >= 1.0 - 1e-6


@pytest.mark.parametrize("active", [*slow((0.0, 6.0)), (3.5, 6.5)])
def test_windows_in_wind_pass_a_door_while_it_is_open(active: tuple[float, float]) -> None:
    wind = rho.Disturbance(
        acceleration=0.1, position_error=0.01, velocity_error=0.02, feedback_every=0.125, share=0.4
    )
    scenario = dataclasses.replace(_room([*_wall(), _closed(*active)]), disturbance=wind)
    rng = np.random.default_rng(0)
    flown = rho.simulate(scenario, wind=rho.winds.coloured_noise(scenario, rng), rng=rng)
    assert rho.verify(flown).ok
    assert not any(window.infeasible for window in flown.windows)
    times = np.linspace(*active, 2001)
    x = flown.at(times).positions.reshape(-1, 3)[:, 0]
    assert np.abs(x - 5.0).min() >= 0.8 - 1e-6  # the radius beside the closed door
