"""Obstacles in Meshcat in a real browser: every shape at its size, moving ones in place."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from playwright.sync_api import Page
from pydrake.geometry import Meshcat

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.obstacle_snapshots import truncated
from drake_rho.display.meshcat.obstacles import _turns
from drake_rho.display.meshcat.scene import Scene
from tests.browser import open_page
from tests.scenarios import single, slow

_CUBE = np.array(list(np.ndindex(2, 2, 2)), dtype=np.float64)
SHAPES = (
    rho.Sphere([20, 1, 2], 1.5),
    rho.Ellipsoid([20, 6, 2], [3.0, 1.0, 0.5]),
    rho.Box([20, 9, 0], [21, 11, 3]),
    rho.Cylinder([20, 15, 2], 0.5, 4.0, "x"),
    rho.Cylinder([20, 20, 2], 0.5, 3.0, "y"),
    rho.Cylinder([20, 25, 2], 0.5, 2.0, "z"),
    rho.Polytope(_CUBE * [1, 2, 3] + [20, 30, 1]),
    rho.Cylinder([20, 35, 2], 0.5, axis="y"),
    rho.Cylinder([20, 40, 2], 0.5),
)


def _plan(obstacles: tuple[rho.Obstacle | rho.Sphere, ...], start: float = 0.0) -> rho.Plan:
    """Return a flight of 8 s from the origin that comes near no obstacle."""
    scenario = single(grid=rho.Grid(0.5, 17, start))
    vehicles = (dataclasses.replace(scenario.vehicles[0], radius=0.2),)
    scenario = dataclasses.replace(scenario, vehicles=vehicles, obstacles=obstacles)
    accelerations = rho.plan_convex(scenario.without_obstacles()).accelerations
    return rho.Plan.from_accelerations(scenario, accelerations)


def _open(page: Page, meshcat: Meshcat) -> None:
    page.goto(meshcat.web_url())
    page.wait_for_function(
        "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=60_000
    )


def _corners(page: Page, *path: str) -> np.ndarray:
    """Return corners of the meshes under a path in the scenario's coordinates, shape (V, 3)."""
    points, matrix, root = page.evaluate(
        """path => {
            const root = viewer.scene_tree.find(["flight"]).object;
            root.parent.updateMatrixWorld(true);
            const found = [];
            viewer.scene_tree.find(path).object.traverse(each => {
                if (each.isMesh)
                    found.push([Array.from(each.geometry.attributes.position.array),
                                each.matrixWorld.elements, root.matrixWorld.elements]);
            });
            return found[0];
        }""",
        ["flight", *path],
    )
    local = np.linalg.inv(np.reshape(root, (4, 4)).T) @ np.reshape(matrix, (4, 4)).T
    corners: np.ndarray = np.reshape(points, (-1, 3)) @ local[:3, :3].T + local[:3, 3]
    return corners


def _seek(page: Page, time: float) -> None:
    page.evaluate("time => { viewer.animator.pause(); viewer.animator.seek(time); }", time)


def _visible(page: Page, *path: str) -> bool:
    seen: bool = page.evaluate(
        "path => viewer.scene_tree.find(path).object.visible", ["flight", *path]
    )
    return seen


def test_every_shape_has_its_place_and_size() -> None:
    plan = _plan(SHAPES)  # type: ignore[arg-type]
    scene = Scene.of(drawn(plan))
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        _open(page, meshcat)
        for number, shape in enumerate(SHAPES, start=1):
            corners = _corners(page, "obstacles", str(number), "known")
            endless = np.isinf(shape.extent)
            lower = np.where(endless, scene.lower, shape.center - shape.extent)
            upper = np.where(endless, scene.upper, shape.center + shape.extent)
            rough = 0.02 * shape.size + 1e-6  # curved surfaces are drawn with corners
            np.testing.assert_allclose(corners.min(axis=0), lower, atol=rough)
            np.testing.assert_allclose(corners.max(axis=0), upper, atol=rough)
            center = np.where(endless, (scene.lower + scene.upper) / 2.0, shape.center)
            distances = shape.local_distance(corners - center)
            if not np.any(endless):  # drawn ends of infinite shapes lie inside them
                np.testing.assert_allclose(distances, 0.0, atol=1e-5 * shape.size)
        assert errors == []


@pytest.mark.parametrize("start", [*slow(0.0), 64.0])
def test_moving_obstacles_are_in_place_and_transparent_until_known(start: float) -> None:
    bent = rho.Track(np.array([1.0, 3.0, 3.5]) + start, [[5, 8, 0], [9, 8, 1], [9, 6, 3]])
    obstacles = (
        rho.Obstacle(rho.Box([-1, -1, -1], [1, 1, 1]), track=bent, name="a/b <c>"),
        rho.Obstacle(
            rho.Cylinder([20 - start, 9, 0], 1.0), velocity=[1, 0, 2], known_from=start + 2.5
        ),
        rho.Sphere([30, 0, 0], 1.0),
    )
    plan = _plan(obstacles, start)
    scene = Scene.of(drawn(plan))
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        _open(page, meshcat)
        assert page.evaluate("viewer.animator.duration") == pytest.approx(8.0, abs=0.04)
        for time in (0.0, 1.0, 2.0, 2.75, 3.25, 7.5):
            _seek(page, time)
            for number, obstacle in enumerate(plan.scenario.bodies, start=1):
                corners = _corners(page, "obstacles", str(number), "known")
                (center,) = obstacle.centers(np.array([start + time]))
                _, center = truncated(obstacle.shape, center, *scene.bounds)
                middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
                np.testing.assert_allclose(middle, center, atol=1e-3)
            assert _visible(page, "obstacles", "2", "known") == (time >= 2.5)
            assert _visible(page, "obstacles", "2", "unknown") == (time < 2.5)
        children = {
            number: page.evaluate(
                "path => Object.keys(viewer.scene_tree.find(path).children)",
                ["flight", "obstacles", number],
            )
            for number in ("1", "2", "3")
        }
        assert sorted(children["1"]) == ["edges", "known"]
        assert sorted(children["2"]) == ["edges", "known", "unknown"]
        assert children["3"] == ["known"]
        ball = _corners(page, "radii", "solo")
        position = plan.motion().at("position", 7.5)[0]
        np.testing.assert_allclose(np.linalg.norm(ball - position, axis=1), 0.2, rtol=1e-3)
        assert errors == []


def test_the_scene_holds_all_obstacles_but_not_the_whole_track_of_distant_ones() -> None:
    far = rho.Obstacle(rho.Sphere([-1000, 3, 0], 1.0), velocity=[250, 0, 0])
    plan = _plan((rho.Sphere([30, 0, 0], 1.0), far))
    scene = Scene.of(drawn(plan))
    assert scene.upper[0] > 31.0
    assert scene.size < 150.0


def test_only_corners_of_a_track_are_recorded() -> None:
    times = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.1])
    places = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0], [2, 2.2, 0]])
    np.testing.assert_array_equal(_turns(times, places), [True, False, True, False, False, True])
