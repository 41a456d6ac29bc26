"""Plans among maps: clear of every cell and triangle at every instant, whatever covers them."""

import dataclasses
from collections.abc import Callable
from functools import cached_property

import numpy as np
import pytest

import drake_rho as rho
from drake_rho.scenario.maps.cells import covering_boxes
from drake_rho.scenario.maps.parts import Boxes, Triangles
from tests.maps import (
    QUARTER,
    Array,
    box_distances,
    crossing,
    triangle_distances,
    turned,
    wall_with_gap,
)


def sampled(plan: rho.Plan, count: int = 2001) -> Array:
    """Return positions of all vehicles at many times, shape (N, M, 3)."""
    elapsed = np.linspace(0.0, plan.scenario.grid.duration, count)
    positions: Array = plan.motion().at("position", elapsed)
    return positions


def clearance(plan: rho.Plan, voxels: rho.Voxels) -> float:
    """Return the least distance of any vehicle from any cell, by brute force, less its radius."""
    cells = voxels.occupied * voxels.resolution + voxels.origin
    x = sampled(plan).reshape(-1, 3)
    least = box_distances(x, cells, cells + voxels.resolution).min()
    return float(least) - plan.scenario.vehicles[0].radius


def square(half: float, hole: float) -> rho.Mesh:
    """Return a sheet across the way along x, with a square hole; a surface without an inside."""
    y = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = np.concatenate([half * y, hole * y + [1.2, 0.0]])
    vertices = np.column_stack([np.zeros(8), corners + np.array([0.0, 1.5])])
    triangles = [[k, (k + 1) % 4, 4 + (k + 1) % 4] for k in range(4)]
    triangles += [[k, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    return rho.Mesh(vertices, triangles)


def test_a_wall_is_passed_through_its_gap_and_has_an_effect() -> None:
    voxels = wall_with_gap()
    free, plan = rho.plan(crossing([])), rho.plan(crossing([voxels]))
    assert clearance(free, voxels) < -0.1
    assert clearance(plan, voxels) >= -plan.scenario.bodies[0].shape.tolerance
    report = rho.verify(plan)
    assert report.ok
    assert report.clearance is not None
    assert report.clearance.value == pytest.approx(0.2 + clearance(plan, voxels), abs=1e-5)
    assert plan.cost > free.cost


def test_one_cell_is_a_box() -> None:
    voxels = rho.Voxels([[0, 0, 0]], 1.0, [-0.5, -0.9, 1.0])
    as_cell = rho.plan(crossing([voxels]))
    as_box = rho.plan(crossing([rho.Box([-0.5, -0.9, 1.0], [0.5, 0.1, 2.0])]))
    assert as_cell.cost == pytest.approx(as_box.cost, rel=1e-3)
    assert rho.verify(as_cell).ok


def test_a_sheet_is_passed_through_its_hole() -> None:
    mesh = square(3.0, 0.4)
    scenario = crossing([mesh])
    plan = rho.plan(scenario)
    assert rho.verify(plan).ok
    least = triangle_distances(sampled(plan).reshape(-1, 3), mesh.corners).min()
    assert least >= 0.2 - mesh.tolerance
    straight = rho.plan(crossing([]))
    blind = rho.Plan.from_accelerations(scenario, straight.accelerations)
    assert not rho.verify(blind).ok  # a sheet is crossed between two knots, far from each


@pytest.mark.parametrize("change", ["removed", "shrunk"])
def test_a_wrong_cover_never_gets_a_plan_past_verify(
    change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(self: rho.Voxels) -> Boxes:
        lower, upper = covering_boxes(self.occupied)
        near = int(np.argmax(upper[:, 1]))  # beside the gap
        if change == "removed":
            lower, upper = np.delete(lower, near, axis=0), np.delete(upper, near, axis=0)
        else:
            lower = np.array(lower, dtype=float)
            lower[near, 1] += 0.9 * (upper - lower)[near, 1]
        h = self.resolution
        return Boxes(h * lower + self.origin, h * upper + self.origin)

    scenario = crossing([wall_with_gap()])
    assert rho.verify(rho.plan(scenario)).ok
    fooled = cached_property(wrong)
    fooled.__set_name__(rho.Voxels, "cover")
    monkeypatch.setattr(rho.Voxels, "cover", fooled)
    high = dataclasses.replace(scenario.vehicles[0].start, position=np.array([-3.0, 1.6, 1.5]))
    far = dataclasses.replace(scenario.vehicles[0].goal, position=np.array([3.0, 1.6, 1.5]))
    vehicle = dataclasses.replace(scenario.vehicles[0], start=high, goal=far)
    plan = rho.plan(crossing([wall_with_gap()], vehicles=[vehicle]))
    assert clearance(plan, wall_with_gap()) < -0.01
    assert not rho.verify(plan).ok


def test_a_triangle_left_out_never_gets_a_plan_past_verify(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mesh = square(3.0, 0.4)
    fooled = cached_property(lambda self: Triangles(self.corners[2:4]))
    fooled.__set_name__(rho.Mesh, "cover")
    monkeypatch.setattr(rho.Mesh, "cover", fooled)
    assert not rho.verify(rho.plan(crossing([mesh]))).ok


def test_a_map_at_rest_may_be_moved_or_turned_with_everything_else() -> None:
    def cost(change: Callable[[Array], Array], voxels: rho.Voxels) -> float:
        scenario = crossing([voxels], limits=rho.Limits(max_speed=4.0, max_acceleration=6.0))
        (vehicle,) = scenario.vehicles
        start, goal = (
            dataclasses.replace(state, position=change(state.position))
            for state in (vehicle.start, vehicle.goal)
        )
        moved = dataclasses.replace(
            scenario, vehicles=(dataclasses.replace(vehicle, start=start, goal=goal),)
        )
        plan = rho.plan(moved)
        assert rho.verify(plan).ok
        return plan.cost

    voxels = wall_with_gap()
    here = cost(lambda x: x, voxels)
    offset = np.array([7.0, -3.0, 11.0])
    there = dataclasses.replace(voxels, origin=voxels.origin + offset)
    assert cost(lambda x: x + offset, there) == pytest.approx(here, rel=1e-6)
    assert cost(lambda x: QUARTER @ x, turned(voxels)) == pytest.approx(here, rel=2e-2)


def test_a_moving_map_is_avoided_and_equals_its_box() -> None:
    voxels = rho.Voxels([[0, 0, 0], [0, 1, 0]], 0.5, [-0.25, -3.0, 1.25])
    box = rho.Box([-0.25, -3.0, 1.25], [0.25, -2.0, 1.75])
    scenarios = [crossing([rho.Obstacle(each, velocity=[0, 0.8, 0])]) for each in (voxels, box)]
    first = rho.plan(scenarios[0])
    second = rho.plan(scenarios[1], reference=first)  # without it, other sides are tried
    assert rho.verify(first).ok
    assert rho.verify(second).ok
    assert first.cost == pytest.approx(second.cost, rel=2e-2)


def test_errors_name_the_cell_and_ask_for_a_radius() -> None:
    voxels = rho.Voxels([[0, 0, 0], [6, 2, 3]], 0.5, [-3.2, -1.0, 0.0])
    with pytest.raises(rho.ScenarioError, match=r"cell \[6, 2, 3\] of 2 cells of 0.5 m"):
        crossing(
            [voxels],
            vehicles=[
                rho.Vehicle("a", rho.State([0, 0.2, 1.6]), rho.State([3, 0, 1.5]), radius=0.2)
            ],
        )
    point = rho.Vehicle("a", rho.State([-3, 0, 1.5]), rho.State([3, 0, 1.5]))
    with pytest.raises(
        rho.ScenarioError, match=r"vehicles\[0\].radius: got 0.0, expected at least"
    ):
        crossing([wall_with_gap()], vehicles=[point])


def test_wind_and_windows_keep_the_tube_clear_of_cells() -> None:
    voxels = wall_with_gap()
    scenario = crossing([voxels], disturbance=rho.Disturbance(0.1))
    flight = rho.plan_rho(scenario, replan_every=8)
    assert rho.verify(flight).ok
    simulation = rho.simulate(scenario, replan_every=8)
    assert rho.verify(simulation).ok
    attacked = rho.attack(scenario, rho.plan(scenario))
    assert attacked.clearance >= -1e-6


def test_plans_and_flights_among_maps_are_read_as_they_were_written(tmp_path: object) -> None:
    flight = rho.plan_rho(crossing([wall_with_gap(), square(3.0, 0.7)]), replan_every=8)
    rho.save(flight, f"{tmp_path}/flight.npz")
    read = rho.load(f"{tmp_path}/flight.npz")
    assert read.scenario == flight.scenario
    assert np.array_equal(read.plan.positions, flight.plan.positions)


def test_windows_plan_against_the_cells_that_are_known_then() -> None:
    wall = wall_with_gap()
    block = rho.Voxels([[6, y, z] for y in range(-8, 4) for z in range(12)], 0.25, wall.origin)
    seen = dataclasses.replace(wall, occupied=np.concatenate([wall.occupied, block.occupied]))
    left = dataclasses.replace(wall, occupied=wall.occupied[::2])
    flown = rho.RecedingHorizon(crossing([wall]), replan_every=4)
    newer = {8: seen, 16: left}
    for knot in flown.knots:
        time = float(flown.scenario.grid.times[knot])
        now = crossing([newer[knot]]) if knot in newer else None
        flown.step(flown.planned(knot), time, scenario=now)
    flight, scenario = flown.flight, flown.scenario
    assert [window.learned for window in flown.windows if window.learned] == [(2,)]
    assert rho.verify(flight).ok
    cells = {
        each.name: len(each.shape.occupied)
        for each in scenario.bodies
        if isinstance(each.shape, rho.Voxels)
    }
    gone = len(wall.occupied) - len(left.occupied)
    names = [None, "map from 2 s", "map until 4 s"]
    assert cells == dict(zip(names, [len(left.occupied), len(block.occupied), gone], strict=True))
    blind = rho.plan(crossing([wall]))
    assert not rho.verify(rho.Plan.from_accelerations(scenario, blind.accelerations)).ok
    with pytest.raises(ValueError, match="time"):
        flown.step(flown.planned(20), 0.5, scenario=crossing([wall]))
    assert flown.scenario is scenario


def test_a_mesh_or_another_grid_replaces_a_map_as_a_whole() -> None:
    wall, sheet = wall_with_gap(), square(3.0, 0.7)
    scenario = crossing([rho.Obstacle(wall, name="wall"), rho.Obstacle(sheet, name="sheet")])
    flown = rho.RecedingHorizon(scenario, replan_every=8)
    flown.step(flown.planned(0), 0.0)
    finer = wall_with_gap(0.125)
    now = crossing([rho.Obstacle(finer, name="wall"), scenario.bodies[1]])
    flown.step(flown.planned(8), 2.0, scenario=now)
    bodies = flown.scenario.bodies
    assert [each.name for each in bodies] == ["wall", "sheet", "wall from 2 s"]
    assert bodies[0].active is not None
    assert bodies[0].active[1] == pytest.approx(2.0)
    assert bodies[1].active is None
    assert bodies[2].shape == finer
