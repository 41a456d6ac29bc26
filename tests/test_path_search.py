"""Paths among obstacles and vehicles, checked by dense sampling of the references."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.planning.path_search.initial_guesses import find_paths
from tests.arrays import FloatArray
from tests.scenarios import slow
from tests.shapes import Shape

PARTS = 16
"""Samples of each step of a reference."""


def flight(
    obstacles: Sequence[rho.Obstacle | Shape] = (),
    *,
    ends: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = (((0, 0, 0), (10, 0, 0)),),
    box: rho.Box | None = None,
    separation: rho.Separation | None = None,
    duration: float = 10.0,
    radius: float = 0.2,
) -> rho.Scenario:
    """Return vehicles that fly between given ends, at most 3 m/s along each axis."""
    vehicles = [
        rho.Vehicle(f"v{n}", rho.State(start), rho.State(goal), radius=radius)
        for n, (start, goal) in enumerate(ends)
    ]
    box = box or rho.Box([-2, -3, -2], [12, 3, 2])
    limits = rho.Limits(position=box, velocity=rho.Box([-3] * 3, [3] * 3))
    grid = rho.Grid.lasting(duration, step=0.25)
    return rho.Scenario("flight", grid, vehicles, limits, obstacles, separation)


def sampled(plan: rho.Plan) -> tuple[FloatArray, FloatArray]:
    """Return times on the scenario's clock (M,) and positions (N, M, 3), linear between knots."""
    knots = np.arange(plan.scenario.grid.knots)
    at = np.linspace(0, knots[-1], knots[-1] * PARTS + 1)
    positions = [
        np.stack([np.interp(at, knots, axis) for axis in each.T], axis=-1)
        for each in plan.positions
    ]
    return plan.scenario.grid.start + plan.scenario.grid.step * at, np.array(positions)


def clearance(plan: rho.Plan) -> float:
    """Return the least distance from an obstacle, less the radius [m]."""
    times, positions = sampled(plan)
    radii = plan.scenario.fleet.radii[:, None]
    return min(
        float(np.min(body.shape.local_distance(positions - body.centers(times)) - radii))
        for _, body in plan.scenario.known
    )


def least_distance(plan: rho.Plan) -> float:
    """Return the least distance of two vehicles, z divided by the downwash [m]."""
    assert plan.scenario.separation is not None
    _, positions = sampled(plan)
    x = plan.scenario.separation.scaled(positions)
    return min(
        float(np.linalg.norm(x[i] - x[j], axis=-1).min()) for i in range(len(x)) for j in range(i)
    )


def wall(x: float, gap: tuple[float, float]) -> tuple[rho.Box, rho.Box]:
    """Return two boxes across the path at x, with a gap between from one y to another."""
    return (
        rho.Box([x, -4, -3], [x + 0.5, gap[0], 3]),
        rho.Box([x, gap[1], -3], [x + 0.5, 4, 3]),
    )


def test_a_reference_is_straight_between_knots_from_start_to_goal() -> None:
    scenario = flight((rho.Sphere([5, 0, 0], 1.0),))
    (reference, *_) = find_paths(scenario).references
    assert np.array_equal(reference.positions[0, 0], [0, 0, 0])
    assert np.allclose(reference.positions[0, -1], [10, 0, 0], atol=1e-12)
    between = reference.motion().at("position", reference.times[:-1] + 0.1)
    straight = 0.6 * reference.positions[:, :-1] + 0.4 * reference.positions[:, 1:]
    assert np.allclose(between, straight, atol=1e-12)
    assert not reference.accelerations.any()


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 8))])
def test_paths_are_clear_of_shapes_of_all_kinds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centers = rng.uniform([1.5, -3, -2], [8.5, 3, 2], (20, 3))
    sizes = rng.uniform(0.3, 0.8, (20, 3))
    obstacles: tuple[Shape, ...] = (
        *(rho.Sphere(c, s[0]) for c, s in zip(centers[:5], sizes, strict=False)),
        *(rho.Box(c - s, c + s) for c, s in zip(centers[5:10], sizes, strict=False)),
        *(rho.Cylinder(c, s[0], s[1]) for c, s in zip(centers[10:13], sizes, strict=False)),
        *(rho.Cylinder(c, s[0] / 2) for c, s in zip(centers[13:15], sizes, strict=False)),
        *(rho.Ellipsoid(c, s) for c, s in zip(centers[15:], sizes, strict=False)),
    )
    references = find_paths(flight(obstacles), most=5).references
    assert references
    for reference in references:
        assert clearance(reference) > -0.15  # a step of up to 0.5 m cuts the corners of the path
        knots = reference.positions[0]
        for _, body in reference.scenario.known:
            assert np.all(body.shape.local_distance(knots - body.shape.center) > 0.2 - 1e-5)
    lengths = [np.linalg.norm(np.diff(each.positions[0], axis=0), axis=1) for each in references]
    assert lengths[0].sum() == min(each.sum() for each in lengths)


def test_paths_differ_in_the_side_of_an_obstacle() -> None:
    references = find_paths(flight((rho.Sphere([5, 0, 0], 1.0),)), most=4).references
    sides = [each.positions[0, 20, 1:] for each in references]
    sides = [side / np.linalg.norm(side) for side in sides]
    assert len(references) >= 3
    for i, side in enumerate(sides):
        assert all(side @ other < 0.6 for other in sides[:i])


def test_a_gap_as_wide_as_the_vehicle_is_passed() -> None:
    """To certify it, the grid has to be as fine as the remaining clearance."""
    reference = find_paths(flight(wall(5, (0.9, 1.5)))).references[0]
    assert clearance(reference) >= -1e-6
    assert np.any(np.abs(reference.positions[0, :, 1] - 1.2) < 0.11)


@pytest.mark.parametrize("gap", [(0.0, 0.0), (0.9, 1.29)])
def test_a_wall_without_a_wide_enough_gap_has_no_path(gap: tuple[float, float]) -> None:
    found = find_paths(flight(wall(5, gap)))
    assert found.references == ()
    assert found.searched is not None
    assert found.searched.points > 5e4
    assert f"{found.searched.spacing:.2g} m" in str(found.searched)


@pytest.mark.parametrize("height", [4.3, 4.6, 7.1])
def test_the_last_points_of_a_grid_are_clear_too(height: float) -> None:
    """The wall leaves less than its radius to a vehicle at the far face of its box."""
    box = rho.Box([-2, -0.3, 0], [6, height, 2.5])
    pillar = rho.Box([1, -0.25, 0], [1.5, height - 0.05, 2.5])
    ends = (((-1.0, 0.0, 1.0), (5.0, 0.0, 1.0)),)
    assert find_paths(flight((pillar,), ends=ends, box=box)).references == ()


def test_a_sealed_room_has_no_space_time_path() -> None:
    moving = rho.Obstacle(rho.Sphere([2, 0, 0], 0.3), velocity=[0, 0.1, 0])
    found = find_paths(flight((*wall(5, (0.0, 0.0)), moving)))
    assert found.references == ()
    assert found.searched is not None
    assert found.searched.layers > 0


def test_a_maze_is_passed_from_end_to_end() -> None:
    walls = wall(2, (-2.9, -2.3)) + wall(4, (2.3, 2.9)) + wall(6, (-2.9, -2.3))
    reference = find_paths(flight(walls, duration=20.0)).references[0]
    assert clearance(reference) > -0.02
    y = [np.interp(x, reference.positions[0, :, 0], reference.positions[0, :, 1]) for x in (4.2,)]
    assert y[0] > 2.0


def test_a_gate_that_opens_later_is_waited_for() -> None:
    gate = rho.Obstacle(
        rho.Box([5, -0.6, -3], [5.5, 0.6, 3]),
        track=rho.Track([0, 6, 8], [[5.25, 0, 0], [5.25, 0, 0], [5.25, 5, 0]]),
    )
    reference = find_paths(flight((*wall(5, (-0.5, 0.5)), gate), duration=15.0)).references[0]
    assert clearance(reference) > -1e-6
    passed = np.interp(5.25, reference.positions[0, :, 0], reference.times)
    assert passed > 6.0


def test_unknown_obstacles_are_not_avoided() -> None:
    later = rho.Obstacle(rho.Sphere([5, 0, 0], 1.0), known_from=3.0)
    assert abs(find_paths(flight((later,))).references[0].positions[0, :, 1:]).max() < 0.3


@pytest.mark.parametrize("downwash", [1.0, 2.0])
def test_vehicles_swap_in_a_corridor(downwash: float) -> None:
    """Side by side they do not fit, so they pass above each other."""
    corridor = rho.Box([-1, -0.2, -1], [11, 0.2, 1])
    ends = (((0, 0, 0), (10, 0, 0)), ((10, 0, 0), (0, 0, 0)))
    separation = rho.Separation(0.6, downwash)
    found = find_paths(flight(ends=ends, box=corridor, separation=separation))
    assert found.conflicts == 0
    assert least_distance(found.references[0]) >= 0.6 - 1e-9


def circle(count: int, radius: float) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
    """Return the ends of vehicles that swap sides of a circle."""
    turns = 2.0 * np.pi * np.arange(count) / count
    places = radius * np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=-1)
    return tuple((tuple(place.tolist()), tuple((-place).tolist())) for place in places)


def test_paths_of_a_fleet_are_separated_and_clear_of_moving_obstacles() -> None:
    obstacles = (
        rho.Box([-0.5, 1, -2], [0.5, 2, 2]),
        rho.Obstacle(rho.Sphere([-2, -2, 0], 0.5), velocity=[0.4, 0.4, 0]),
    )
    box = rho.Box([-5, -5, -2], [5, 5, 2])
    ends, separation = circle(6, 4.0), rho.Separation(0.6, 2.0)
    found = find_paths(flight(obstacles, ends=ends, box=box, separation=separation))
    assert found.conflicts == 0
    assert least_distance(found.references[0]) >= 0.6 - 1e-9
    assert clearance(found.references[0]) >= -1e-6


def test_paths_of_relabelled_vehicles_are_the_same() -> None:
    scenario = flight(
        (rho.Sphere([0.3, 0.2, 0], 1.0),),
        ends=circle(5, 4.0),
        box=rho.Box([-5, -5, -2], [5, 5, 2]),
        separation=rho.Separation(0.6),
    )
    other = dataclasses.replace(scenario, vehicles=scenario.vehicles[::-1])
    ways, others = (find_paths(each).references[0].positions for each in (scenario, other))
    assert np.array_equal(ways, others[::-1])


def test_paths_of_a_mirrored_world_have_the_same_lengths() -> None:
    obstacles = (rho.Box([3, -1, -2.5], [4, 2, 2.5]), rho.Sphere([7, 0.5, 0], 1.0))
    mirrored = (rho.Box([3, -2, -2.5], [4, 1, 2.5]), rho.Sphere([7, -0.5, 0], 1.0))
    ways, others = (
        [each.positions[0] for each in find_paths(flight(world), most=3).references]
        for world in (obstacles, mirrored)
    )
    assert np.allclose(ways[0] * [1, -1, 1], others[0], atol=0.6)
    lengths, theirs = (
        np.linalg.norm(np.diff(each[0], axis=0), axis=1).sum() for each in (ways, others)
    )
    assert lengths == pytest.approx(theirs, rel=1e-6)


def test_vehicles_of_other_sizes_have_grids_of_their_own() -> None:
    gaps = (
        rho.Box([5, -4, -3], [5.5, -1.6, 3]),
        rho.Box([5, -0.6, -3], [5.5, 1.0, 3]),
        rho.Box([5, 2.4, -3], [5.5, 4, 3]),
    )
    scenario = flight(gaps, ends=(((0, -1, 0), (10, -1, 0)), ((0, -2, 0), (10, -2, 0))))
    small, large = scenario.vehicles
    scenario = dataclasses.replace(
        scenario, vehicles=(small, dataclasses.replace(large, radius=0.5))
    )
    reference = find_paths(scenario).references[0]
    assert clearance(reference) > -0.02
    at = [np.interp(5.25, each[:, 0], each[:, 1]) for each in reference.positions]
    assert at[0] < 0.0 < 1.0 < at[1]


@pytest.mark.parametrize("moving", [False, True])
def test_paths_pass_waypoints_at_their_times(moving: bool) -> None:
    obstacles: list[rho.Obstacle | Shape] = [rho.Sphere([5, 0, 0], 1.0)]
    if moving:
        obstacles.append(rho.Obstacle(rho.Sphere([2, 2, 1], 0.3), velocity=[0.1, 0, 0]))
    scenario = flight(obstacles, duration=20.0)
    waypoints = (rho.Waypoint(12.0, [2, -2, 0.5]), rho.Waypoint(6.0, [8, 2, -1]))
    vehicle = dataclasses.replace(scenario.vehicles[0], waypoints=waypoints)
    scenario = dataclasses.replace(scenario, vehicles=(vehicle,))
    for reference in find_paths(scenario, most=3).references:
        assert np.allclose(reference.positions[0, 24], [8, 2, -1], atol=1e-9)
        assert np.allclose(reference.positions[0, 48], [2, -2, 0.5], atol=1e-9)
        assert clearance(reference) > -0.05
