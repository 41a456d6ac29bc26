"""Obstacles in the figures: every shape, moving ones at the relevant times, names as text."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import drake_rho as rho
from drake_rho.display.common.clearances import least_clearances, nearest
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.hidden import hidden
from drake_rho.display.common.obstacle_snapshots import (
    Snapshot,
    approaches,
    as_obstacles,
    obstacle_paths,
    snapshots,
)
from drake_rho.display.common.shape_faces import surface
from drake_rho.display.common.style import view
from drake_rho.display.plots import space
from drake_rho.display.plots.axes3d import frame_scene
from drake_rho.display.plots.distances import draw_distances, draw_least_clearances
from drake_rho.display.plots.figures import write_figures
from drake_rho.motion.obstacle_clearances import closest
from drake_rho.scenario.fields import unchecked
from tests.scenarios import straight
from tests.shapes import Shape

START = 32.0
"""Duration of these tests' flights [s]."""
TRACK = rho.Track(START + np.array([1.0, 5.0, 9.0]), [[-3, 0, 5], [5, 5, 5], [5, 14, 4]], 0.1)
OBSTACLES = (
    rho.Sphere([3, 3, 3], 0.8),
    rho.Box([6, 6, 0], [7, 8, 4]),
    rho.Ellipsoid([8, 2, 6], [1.0, 0.5, 0.3]),
    rho.Cylinder([2, 8, 5], 0.5),
    rho.Polytope(np.random.default_rng(0).normal(size=(12, 3)) + 5.0),
    rho.Obstacle(rho.Box([-0.5] * 3, [0.5] * 3), track=TRACK, name="$x^$", known_from=START + 4),
    rho.Obstacle(rho.Cylinder([5, 10 - START, 5], 0.4, 2.0, "y"), velocity=[0, 1, -0.1]),
)


def _plan(
    obstacles: Sequence[Shape | rho.Obstacle], vehicles: int = 3, radius: float = 0.2
) -> rho.Plan:
    """Return straight flights across a cube of 10 m, through any obstacle."""
    free = straight(vehicles)
    flown = tuple(dataclasses.replace(each, radius=radius) for each in free.scenario.vehicles)
    grid = dataclasses.replace(free.scenario.grid, start=START)
    empty = dataclasses.replace(free.scenario, vehicles=flown, grid=grid)
    # unchecked: these tests do not care about obstacles at a start
    scenario = unchecked(empty, obstacles=tuple(obstacles), bodies=as_obstacles(obstacles))
    return rho.Plan.from_accelerations(scenario, free.accelerations)


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    return _plan(OBSTACLES)


def _brute(plan: rho.Plan, obstacle: rho.Obstacle, times: np.ndarray) -> np.ndarray:
    """Return distances by hand at times since the first knot, shape (N, M)."""
    centers = obstacle.centers(START + times)
    return obstacle.shape.local_distance(plan.motion().at("position", times) - centers)


def test_closest_approaches_are_those_of_dense_samples(plan: rho.Plan) -> None:
    times = np.linspace(0.0, 10.0, 40_001)
    for obstacle in plan.scenario.bodies:
        found, brute = closest(plan, obstacle), _brute(plan, obstacle, times)
        np.testing.assert_allclose(found.distances, brute.min(axis=1), atol=1e-5)
        assert np.all(found.distances <= brute.min(axis=1) + 1e-9)
        at = [_brute(plan, obstacle, np.array([time]))[i, 0] for i, time in enumerate(found.times)]
        np.testing.assert_allclose(found.distances, at, atol=1e-12)


def test_a_figure_shows_moving_obstacles_when_a_vehicle_is_closest(plan: rho.Plan) -> None:
    bodies = plan.scenario.bodies
    shown = snapshots(drawn(plan), bodies)
    assert len([each for each in shown if not each.faint]) == len(bodies)
    for obstacle, ends in zip(bodies[5:], approaches(drawn(plan), bodies), strict=True):
        at = nearest(drawn(plan), obstacle)
        (center,) = obstacle.centers(np.array([START + at.time]))
        (each,) = (s for s in shown if s.shape is obstacle.shape and not s.faint)
        np.testing.assert_array_equal(each.center, center)
        assert each.label.endswith(f", {round(START + at.time, 2):g} s")
        np.testing.assert_allclose(ends[0], plan.motion().at("position", at.time)[at.vehicle, 0])
        assert obstacle.shape.local_distance(ends[1:] - center) == pytest.approx(0.0, abs=1e-9)
        distance = closest(plan, obstacle).distances[at.vehicle]
        assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(abs(distance))
        faint = [s for s in shown if s.shape is obstacle.shape and s.faint]
        assert 1 <= len(faint) <= 2
    assert shown[5].label.startswith(r"6 \$x^\$, ")
    for way, obstacle in zip(obstacle_paths(drawn(plan), bodies), bodies[5:], strict=True):
        on = obstacle.centers(START + np.linspace(0.0, 10.0, 241))
        assert all(np.min(np.linalg.norm(on - point, axis=1)) < 1e-9 for point in way)


def test_each_of_many_moving_obstacles_is_drawn_once() -> None:
    rng = np.random.default_rng(1)
    moving = [
        rho.Obstacle(rho.Sphere(rng.uniform(0, 10, 3) - START, 0.2), velocity=[1, 1, 1])
        for _ in range(50)
    ]
    plan = _plan(moving)
    shown = snapshots(drawn(plan), plan.scenario.bodies)
    assert len(shown) == 50
    assert (
        obstacle_paths(drawn(plan), plan.scenario.bodies)
        == approaches(drawn(plan), plan.scenario.bodies)
        == []
    )
    assert {each.label for each in shown} == {str(number) for number in range(1, 51)}


def test_distant_obstacles_do_not_shrink_the_scene() -> None:
    fast = rho.Obstacle(rho.Sphere([5 - 100 * (START + 5), 5, 5], 0.2), velocity=[100, 0, 0])
    plan = _plan([fast])
    ax = Figure().add_subplot(projection="3d")
    frame_scene(ax, plan.positions, snapshots(drawn(plan), plan.scenario.bodies))
    assert np.ptp(ax.get_xlim()) < 25.0
    for way in obstacle_paths(drawn(plan), plan.scenario.bodies):
        assert np.ptp(way[:, 0]) < 25.0
    never = rho.Obstacle(rho.Sphere([500, 5, 5], 0.2), velocity=[0, 0, 0.1])
    plan = _plan([fast, never])
    assert all(
        each.shape is not never.shape for each in snapshots(drawn(plan), plan.scenario.bodies)
    )
    assert len(approaches(drawn(plan), plan.scenario.bodies)) == 1
    notes = [text.get_text() for text in rho.paths_figure(plan).texts]
    assert "obstacles never near the scene, not shown: 2" in notes


def test_an_obstacle_that_moves_before_the_flight_is_drawn_once() -> None:
    arrived = rho.Track([0.0, START - 1.0], [[0, 0, 0], [5, 5, 5]])
    plan = _plan([rho.Obstacle(rho.Sphere([0, 0, 0], 0.5), track=arrived)])
    (shown,) = snapshots(drawn(plan), plan.scenario.bodies)
    assert not shown.faint


def test_bodies_are_drawn_in_place_and_infinite_ones_to_the_edge(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    shown = snapshots(drawn(plan), plan.scenario.bodies)
    frame_scene(ax, plan.positions, shown)
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    cut = space.within(ax, shown)
    bodies = space.draw_obstacles(ax, cut)
    farthest_first = np.argsort([each.center @ view()[2] for each in cut], kind="stable")
    for body, each in zip(bodies, [shown[i] for i in farthest_first], strict=True):
        padding = np.broadcast_to(body._invalid_vertices, body._faces.shape[:2])
        corners = body._faces[~padding]  # matplotlib has no public accessor
        lower, upper = corners.min(axis=0), corners.max(axis=0)
        endless = np.isinf(each.shape.extent)
        np.testing.assert_allclose(lower[endless], limits[endless, 0])
        np.testing.assert_allclose(upper[endless], limits[endless, 1])
        middle = (lower + upper)[~endless] / 2.0
        np.testing.assert_allclose(middle, each.center[~endless], atol=0.01 * each.shape.size)
        assert body.get_alpha() == (0.1 if each.faint else 0.25)


def _sides(points: np.ndarray, each: Snapshot) -> np.ndarray:
    """Return 1 where a shape hides a point, -1 where it is behind it, 0 elsewhere, shape (M,).

    The planes of the drawn faces decide: a line of sight crosses each of them once.
    """
    _, _, towards = view()
    faces = surface(each.shape).faces
    rings = [face - face.mean(axis=0) for face in faces]
    normals = np.array([np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0) for ring in rings])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.array([n @ face[0] for n, face in zip(normals, faces, strict=True)])
    along, rest = normals @ towards, offsets - (points - each.center) @ normals.T
    crossed = rest / np.where(np.abs(along) < 1e-12, 1e-12, along)
    enters, leaves = crossed[:, along < 0.0].max(axis=1), crossed[:, along > 0.0].min(axis=1)
    return np.where(enters > leaves, 0.0, np.sign(leaves))


def _forest(rng: np.random.Generator) -> list[Shape]:
    pillars = [rng.uniform(-5, 5, 2) for _ in range(12)]
    return [rho.Box([*(p - 0.25), 0], [*(p + 0.25), 2.5 + i % 3]) for i, p in enumerate(pillars)]


def _mixed(rng: np.random.Generator) -> list[Shape]:
    walls: list[Shape] = [rho.Box([-4, -0.1, 0], [4, 0.1, 3]), rho.Box([-5, -5, -1], [5, 5, -0.9])]
    balls = [rho.Ellipsoid(rng.uniform(-4, 4, 3), rng.uniform(0.2, 1.0, 3)) for _ in range(6)]
    return [*walls, *balls]


@pytest.mark.parametrize("scene", [_forest, _mixed])
def test_points_behind_shapes_are_those_whose_line_of_sight_they_block(
    scene: Callable[[np.random.Generator], list[Shape]],
) -> None:
    """Compared with drawn faces, which are a little inside of round shapes."""
    rng = np.random.default_rng(2)
    shown = snapshots(drawn(_plan(())), as_obstacles(scene(rng)))
    points = rng.uniform([-5, -5, -0.5], [5, 5, 3], (300, 3))
    blocked = np.any([_sides(points, each) > 0.0 for each in shown], axis=0)
    assert 0.1 < blocked.mean() < 0.9
    assert np.mean(hidden(points, shown) == blocked) > 0.98


def _levels(ax: Axes) -> list[float]:
    """Return the heights of the dashed lines, which are black."""
    dashed = [
        line for line in ax.lines if line.get_linestyle() == "--" and line.get_color() == "black"
    ]
    return [float(np.asarray(line.get_ydata())[0]) for line in dashed]


def test_distances_are_from_the_surface_with_the_required_distance(plan: rho.Plan) -> None:
    for obstacle in plan.scenario.bodies:
        ax = Figure().add_subplot()
        for i, line in enumerate(draw_distances(ax, drawn(plan), obstacle)):
            times, values = np.array(line.get_data())
            np.testing.assert_allclose(values, _brute(plan, obstacle, times - START)[i], atol=1e-9)
        assert _levels(ax) == pytest.approx([0.2 + obstacle.deviation])
        assert ax.get_xlim() == (START, START + 10.0)
        texts = [text.get_text() for text in ax.texts]
        known = f"known from {START + 4:g} s"
        assert (known in texts) == (obstacle.known_from > START)


def test_the_least_clearance_of_many_obstacles_is_drawn(plan: rho.Plan) -> None:
    ax, bodies = Figure().add_subplot(), plan.scenario.bodies
    *curves, ring = draw_least_clearances(ax, drawn(plan), bodies)
    lows = []
    for i, line in enumerate(curves):
        times, values = np.array(line.get_data())
        every = [_brute(plan, each, times - START)[i] - 0.2 - each.deviation for each in bodies]
        np.testing.assert_allclose(values, np.min(every, axis=0), atol=1e-9)
        lows.append((values.min(), 1 + int(np.argmin(np.min(every, axis=1)))))
    least, number = min(lows)
    assert float(np.asarray(ring.get_ydata())[0]) == least
    name = plan.scenario.vehicles[lows.index((least, number))].name
    assert f"{name} and obstacle {number}" in str(ring.get_label())
    numbers = [text.get_text().split()[0] for text in ax.texts[:3]]
    assert numbers == [str(low[1]) for low in lows]
    assert _levels(ax) == [0.0]
    fine = np.linspace(0.0, 10.0, 20_001)
    exact = np.min([_brute(plan, each, fine) - 0.2 - each.deviation for each in bodies], axis=0)
    found = least_clearances(drawn(plan), bodies).clearances.min(axis=1)
    np.testing.assert_allclose(found, exact.min(axis=1), atol=1e-4)


def test_the_clearance_of_touching_vehicles_is_printed_as_0() -> None:
    """Planners go as close as allowed, so the remaining clearance is rounding."""
    plan = _plan((), radius=0.0)
    path = plan.motion().at("position", np.linspace(0.0, 10.0, 1001))[0]
    top = path[np.argmax(path[:, 2])]
    box = rho.Obstacle(rho.Box(top - np.array([9, 9, -1e-12]), top + np.array([9, 9, 1])))
    far = [rho.Obstacle(rho.Sphere([100, 0, 0], 1.0))] * 5
    *_, ring = draw_least_clearances(
        Figure().add_subplot(), drawn(plan.only(np.array([0]))), [box, *far]
    )
    assert str(ring.get_label()).startswith("0 m at ")


@pytest.mark.parametrize("count", [1, 4, 5])
def test_each_of_few_obstacles_has_a_panel(count: int) -> None:
    plan = _plan(OBSTACLES[1 : 1 + count])
    figure = rho.distances_figure(plan)
    assert len(figure.axes) == (count if count <= 4 else 1)
    assert {ax.get_ylabel() for ax in figure.axes} == {
        "distance from the obstacle [m]"
        if count <= 4
        else "clearance from the nearest obstacle [m]"
    }


def test_distances_from_spheres_are_from_their_centres() -> None:
    moving = rho.Obstacle(rho.Sphere([5, 5 - START, 5], 0.5), velocity=[0, 1, 0], name="ball")
    plan = _plan([rho.Sphere([3, 3, 3], 0.8), moving])
    figure = rho.distances_figure(plan)
    for ax, obstacle in zip(figure.axes, plan.scenario.bodies, strict=True):
        (curve,) = (line for line in ax.lines if line.get_label() == "v0")
        times, values = np.array(curve.get_data())
        assert isinstance(obstacle.shape, rho.Sphere)
        radius = obstacle.shape.radius
        np.testing.assert_allclose(values, _brute(plan, obstacle, times - START)[0] + radius)
        assert _levels(ax) == pytest.approx([radius + 0.2])
    assert [ax.get_title() for ax in figure.axes] == ["obstacle 1", "obstacle 2 ball"]


def test_notes_state_required_distances_and_times_of_moving_obstacles(plan: rho.Plan) -> None:
    notes = " ".join(text.get_text() for text in rho.paths_figure(plan).texts)
    assert "vehicles keep 0.2 m from obstacles" in notes
    assert "moving obstacles: at the closest approach" in notes
    still = _plan(OBSTACLES[:1], radius=0.0)
    assert len(rho.paths_figure(still).texts) == 1


@pytest.mark.slow
def test_fifty_obstacles_and_forty_vehicles_are_drawn(tmp_path: object) -> None:
    rng = np.random.default_rng(3)
    boxes = [rho.Box(low, low + 0.5) for low in rng.uniform(0, 10, (50, 3))]
    plan = _plan(boxes, vehicles=40)
    figure = rho.distances_figure(plan)
    (ax,) = figure.axes
    assert len([text for text in ax.texts if text.get_text().isdecimal()]) == 0
    assert len(write_figures(plan, str(tmp_path))) == 4
