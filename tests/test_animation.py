"""The Meshcat scene in a real browser: it shows the planned motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

import drake_rho as rho
from drake_rho.display.meshcat import ports
from drake_rho.display.meshcat.animation import start_meshcat
from drake_rho.display.meshcat.meshes import (
    ground_grid,
    nice_step,
    octahedron,
    scattered,
    tube,
)
from drake_rho.display.meshcat.poses import headings, poses
from tests.browser import open_page
from tests.scenarios import single

SCREENSHOTS = Path(__file__).parent / "screenshots"


@pytest.fixture(scope="module")
def flight() -> rho.Flight:
    """Return Example 4."""
    return rho.plan_rho(rho.load_scenario("paper"))


def _children(page: Page, *path: str) -> list[str]:
    names: list[str] = page.evaluate(
        "path => Object.keys(viewer.scene_tree.find(path).children)", ["flight", *path]
    )
    return names


def _seek(page: Page, time: float) -> None:
    page.evaluate("time => { viewer.animator.pause(); viewer.animator.seek(time); }", time)


def _pose(page: Page, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the position of a vehicle in the scene and the direction of its nose."""
    matrix: Any = page.evaluate(
        """name => {
            const vehicle = viewer.scene_tree.find(["flight", "vehicles", name]).object;
            vehicle.updateMatrix();
            return vehicle.matrix.elements;
        }""",
        name,
    )
    columns = np.array(matrix).reshape(4, 4)
    return columns[3, :3], columns[0, :3] / np.linalg.norm(columns[0, :3])  # it may be scaled


def _visible(page: Page, *path: str) -> bool:
    seen: bool = page.evaluate(
        "path => viewer.scene_tree.find(path).object.visible", ["flight", *path]
    )
    return seen


def _wait_for_scene(page: Page) -> None:
    page.wait_for_function(
        "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=60_000
    )


def _look(page: Page, flight: rho.Flight, picture: str) -> None:
    """Check what holds both for the live page and for the page in a file."""
    _wait_for_scene(page)
    names = [vehicle.name for vehicle in flight.scenario.vehicles]
    assert sorted(_children(page, "vehicles")) == names
    assert _children(page, "obstacles") == ["1"]
    assert page.evaluate("viewer.animator.duration") == 49.0
    motion = flight.plan.motion()
    for time in (0.0, 10.0, 30.5, 49.0):
        _seek(page, time)
        position, velocity = (motion.at(q, time)[:, 0] for q in ("position", "velocity"))
        for index, name in enumerate(names):
            seen, nose = _pose(page, name)
            np.testing.assert_allclose(seen, position[index], atol=1e-3)
            speed = float(np.linalg.norm(velocity[index]))
            if speed > 1.0:
                np.testing.assert_allclose(nose, velocity[index] / speed, atol=1e-3)
    _seek(page, 30.0)
    page.wait_for_timeout(500)
    SCREENSHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SCREENSHOTS / picture)


def test_the_live_page_shows_the_swarm(flight: rho.Flight) -> None:
    meshcat = rho.animate(flight)
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        _look(page, flight, "live.png")
        assert errors == []


@pytest.mark.slow
def test_trails_grow_and_predictions_change_with_the_windows(flight: rho.Flight) -> None:
    meshcat = rho.animate(flight)
    with open_page() as (page, _):
        page.goto(meshcat.web_url())
        _wait_for_scene(page)
        pieces = _children(page, "trails", "UAV-1")
        assert len(pieces) == 49
        for time in (0.0, 12.2, 33.3, 49.0):
            _seek(page, time)
            flown = [piece for piece in pieces if _visible(page, "trails", "UAV-1", piece)]
            assert abs(len(flown) - time) <= 1.0
            seen = [n for n in _children(page, "predictions") if _visible(page, "predictions", n)]
            assert seen == [str(min(int(time // 5), 9) + 1)]


@pytest.mark.slow
def test_one_page_in_a_file_does_the_same_without_a_network(
    flight: rho.Flight, tmp_path: Path
) -> None:
    page_file = tmp_path / "flight.html"
    page_file.write_text(rho.animate(flight).StaticHtml())
    assert page_file.stat().st_size < 5e6
    with open_page(offline=True) as (page, errors):
        page.goto(page_file.as_uri())
        _look(page, flight, "file.png")
        assert errors == []


@pytest.mark.slow
def test_a_plan_in_a_small_room_is_visible() -> None:
    plan = rho.plan_convex(single(obstacles=(rho.Sphere([5.0, 2.3, -1.0], 1.0),)))
    meshcat = rho.animate(plan, rate=2.0)
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        _wait_for_scene(page)
        assert page.evaluate("viewer.animator.duration") == 4.0
        _seek(page, 2.0)
        seen, _ = _pose(page, "solo")
        np.testing.assert_allclose(seen, plan.motion().at("position", 4.0)[0, 0], atol=1e-6)
        page.screenshot(path=SCREENSHOTS / "room.png")
        assert errors == []


def crossing(vehicles: int, *, separation: rho.Separation | None = None) -> rho.Plan:
    """Return vehicles that swap places in a small room; without separation they collide."""
    rng = np.random.default_rng(0)
    room = rho.flight_cube(vehicles)
    room_each = rho.Separation(0.3, 2.0)
    transitions = rho.random_transitions(
        vehicles, rng, volume=room, duration=10.0, step=0.5, separation=room_each
    )
    plan = rho.plan_convex(dataclasses.replace(transitions, separation=None))
    scenario = dataclasses.replace(transitions, separation=separation)
    return rho.Plan.from_accelerations(scenario, plan.accelerations)


def _count(page: Page, *path: str) -> int:
    """Count the objects drawn under a path."""
    drawn: int = page.evaluate(
        """path => {
            let count = 0;
            const object = viewer.scene_tree.find(path).object;
            object.traverse(each => { if (each.isMesh || each.isLine) count += 1; });
            return count;
        }""",
        ["flight", *path],
    )
    return drawn


@pytest.mark.slow
def test_a_lightweight_scene_holds_little_besides_the_vehicles() -> None:
    plan = crossing(60)
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        _wait_for_scene(page)
        assert set(_children(page)) == {"flyable", "goals", "ground", "trails", "vehicles"}
        assert len(_children(page, "vehicles")) == _count(page, "vehicles") == 60
        assert _count(page, "goals") == 6  # one for each colour
        assert _count(page, "trails") == 6 * 20  # one for each colour and step
        for time in (0.0, 3.3, 10.0):
            _seek(page, time)
            positions = plan.motion().at("position", time)[:, 0]
            for index in (0, 17, 59):
                seen, _ = _pose(page, f"v{index + 1}")
                np.testing.assert_allclose(seen, positions[index], atol=1e-3)
            pieces = _children(page, "trails", "1")
            flown = [piece for piece in pieces if _visible(page, "trails", "1", piece)]
            assert abs(len(flown) - 2 * time) <= 1.0
        page.screenshot(path=SCREENSHOTS / "sixty.png")
        assert errors == []


@pytest.mark.slow
def test_the_page_of_a_thousand_vehicles_has_one_object_each(tmp_path: Path) -> None:
    plan = crossing(1000)
    page_file = tmp_path / "thousand.html"
    page_file.write_text(rho.viewer_page(plan))
    assert page_file.stat().st_size < 15e6
    with open_page(offline=True) as (page, errors):
        page.goto(page_file.as_uri())
        page.wait_for_function("window.drakeRho", timeout=60_000)
        assert set(_children(page)) == {"flyable", "goals", "ground", "vehicles"}
        assert _count(page) == 1000 + 6 + 2
        page.evaluate("drakeRho.frame(5, 1)")
        page.screenshot(path=SCREENSHOTS / "thousand.png")
        assert errors == []


@pytest.mark.parametrize(
    ("vehicles", "trails", "drawn"),
    [(3, None, True), (3, False, False), (60, False, False), (101, None, False), (101, True, True)],
)
def test_trails_are_drawn_for_up_to_a_hundred_vehicles_or_on_request(
    vehicles: int, trails: bool | None, drawn: bool
) -> None:
    meshcat = rho.animate(crossing(vehicles), trails=trails)
    assert meshcat.HasPath("/flight/trails") == drawn


def test_a_lightweight_scene_draws_no_predictions() -> None:
    plan = crossing(30)
    flight = rho.Flight(plan, (rho.Window(0, plan, plan),))
    assert not rho.animate(flight).HasPath("/flight/predictions")
    few = plan.only(np.arange(3))
    assert rho.animate(rho.Flight(few, (rho.Window(0, few, few),))).HasPath("/flight/predictions")


def test_localhost_is_served_where_no_name_service_knows_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert ports.address_of("localhost") in ("localhost", "127.0.0.1")
    assert ports.address_of("*") == "*"

    def unknown(*_: object) -> None:
        raise OSError("Name or service not known")

    monkeypatch.setattr("socket.getaddrinfo", unknown)
    assert ports.address_of("localhost") == "127.0.0.1"
    assert start_meshcat(port=7750).web_url().startswith("http://127.0.0.1:")


def test_a_port_in_use_is_skipped() -> None:
    first = start_meshcat(port=7700)
    second = start_meshcat(port=first.port())
    assert second.port() > first.port()


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_the_rate_is_positive(flight: rho.Flight, rate: float) -> None:
    with pytest.raises(ValueError, match="rate: got"):
        rho.animate(flight, rate=rate)


def test_a_hovering_vehicle_keeps_its_heading() -> None:
    velocities = np.zeros((2, 5, 3))
    velocities[0, 2] = [0.0, 2.0, 0.0]
    found = headings(velocities)
    np.testing.assert_array_equal(found[0], [[0.0, 1.0, 0.0]] * 5)
    np.testing.assert_array_equal(found[1], [[1.0, 0.0, 0.0]] * 5)


def test_shapes_have_their_requested_sizes() -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0], [2, 2, 3]])
    vertices, faces = tube(line, 0.1)
    rings = vertices.T.reshape(4, 3, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - line[:, None], axis=2), 0.1)
    assert faces.max() < vertices.shape[1]
    lines = ground_grid(np.array([-1000.0, -1000, -2000]), np.array([6000.0, 5000, 4000]))
    assert set(lines[..., 2].ravel()) == {-2000.0}
    assert np.all(lines[:, 0, :2] <= lines[:, 1, :2])
    steps = [nice_step(value) for value in (0.3, 0.5, 7.0, 1000.0, 1100.0)]
    assert steps == pytest.approx([0.5, 0.5, 10.0, 1000.0, 2000.0])


def test_octahedra_are_scattered_as_one_mesh() -> None:
    places = np.array([[0.0, 0, 0], [5.0, 6, 7], [-1.0, 2, 0]])
    vertices, faces = scattered(octahedron(0.5), places)
    assert (vertices.shape, faces.shape) == ((3, 18), (3, 24))
    corners = vertices.T[faces.T].reshape(3, 8, 3, 3) - places[:, None, None]
    np.testing.assert_allclose(np.linalg.norm(corners, axis=3), 0.5)
    outwards = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    assert np.all(np.sum(outwards * corners.mean(axis=2), axis=2) > 0)


@pytest.mark.parametrize("heading", [[1.0, 0, 0], [0, 0, 1.0], [0.6, 0, -0.8], [0, -1.0, 0]])
def test_poses_point_the_nose_ahead_with_level_wings(heading: list[float]) -> None:
    (((nose, left, above, place),),) = np.moveaxis(
        poses(np.array([[[1.0, 2, 3]]]), np.array([[heading]])), 3, 2
    )
    np.testing.assert_allclose(nose, heading)
    np.testing.assert_allclose(place, [1.0, 2.0, 3.0])
    assert left[2] == 0.0
    turn = np.stack([nose, left, above])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
