"""Simulations in Meshcat in a real browser: true motion, ghosts, tubes and wind."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page

import drake_rho as rho
from drake_rho.display.meshcat.meshes import arrow, tube
from drake_rho.display.meshcat.tubes_and_wind import strongest_wind
from tests.browser import open_page
from tests.test_display_flight import NAMES, in_noise, mission

SCREENSHOTS = Path(__file__).parent / "screenshots"
TIMES = (0.5, 3.25, 4.0, 9.5)
"""Interval of frames [s]: 32 a second."""


@pytest.fixture(scope="module")
def simulation() -> rho.Simulation:
    """Return the mission in noise."""
    return in_noise()


def _seek(page: Page, time: float) -> None:
    page.evaluate("time => { viewer.animator.pause(); viewer.animator.seek(time); }", time)


def _matrix(page: Page, *path: str) -> np.ndarray:
    """Return the pose and scale of an object, shape (4, 4)."""
    elements = page.evaluate(
        """path => {
            const found = viewer.scene_tree.find(path).object;
            found.updateMatrix();
            return found.matrix.elements;
        }""",
        ["flight", *path],
    )
    return np.array(elements).reshape(4, 4).T


def _children(page: Page, *path: str) -> list[str]:
    names: list[str] = page.evaluate(
        "path => Object.keys(viewer.scene_tree.find(path).children)", ["flight", *path]
    )
    return names


def _visible(page: Page, *path: str) -> bool:
    seen: bool = page.evaluate(
        "path => viewer.scene_tree.find(path).object.visible", ["flight", *path]
    )
    return seen


def _at(simulation: rho.Simulation, time: float) -> int:
    return int(np.searchsorted(simulation.times, time - 1e-9))


def _look(page: Page, simulation: rho.Simulation, picture: str) -> None:
    """Check what holds both for the live page and for the page in a file."""
    page.wait_for_function(
        "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=60_000
    )
    for time in TIMES:
        _seek(page, time)
        m = _at(simulation, time)
        assert simulation.times[m] == pytest.approx(time)
        nominal = simulation.nominal("position", [time])[0]
        for index, name in enumerate(NAMES):
            true = simulation.positions[m, index]
            np.testing.assert_allclose(_matrix(page, "vehicles", name)[:3, 3], true, atol=1e-3)
            ghost = _matrix(page, "planned", name)
            np.testing.assert_allclose(ghost[:3, 3], nominal[index], atol=1e-3)
            ball = _matrix(page, "tube", name)
            np.testing.assert_allclose(ball[:3, 3], nominal[index], atol=1e-3)
            sizes = np.linalg.norm(ball[:3, :3], axis=0)
            np.testing.assert_allclose(sizes, simulation.radii()[m], atol=1e-3)
            blown = _matrix(page, "wind", name)
            np.testing.assert_allclose(blown[:3, 3], true, atol=1e-3)
            part = simulation.wind[m, index] / 0.6
            np.testing.assert_allclose(blown[:3, 0], part, atol=0.05)  # it turns within a frame
        for kind in ("predictions", "tubes"):
            seen = [number for number in _children(page, kind) if _visible(page, kind, number)]
            assert seen == [str(min(int(time / 1.25), 7) + 1)]
    _seek(page, 4.0)
    page.wait_for_timeout(500)
    SCREENSHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SCREENSHOTS / picture)


@pytest.mark.slow
def test_the_live_page_shows_the_true_motion_and_the_tube(simulation: rho.Simulation) -> None:
    meshcat = rho.animate(simulation)
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        _look(page, simulation, "simulation.png")
        assert errors == []


@pytest.mark.slow
def test_one_page_in_a_file_does_the_same_without_a_network(
    simulation: rho.Simulation, tmp_path: Path
) -> None:
    page_file = tmp_path / "simulation.html"
    page_file.write_text(rho.animate(simulation).StaticHtml())
    assert page_file.stat().st_size < 6e6
    with open_page(offline=True) as (page, errors):
        page.goto(page_file.as_uri())
        _look(page, simulation, "simulation_file.png")
        assert errors == []


def test_missing_tubes_and_winds_are_not_shown() -> None:
    """Without a disturbance there is no tube, and without wind there are no arrows."""
    still = rho.simulate(dataclasses.replace(mission(), disturbance=None))
    meshcat = rho.animate(still)
    assert meshcat.HasPath("/flight/planned/scout")
    for part in ("tube", "tubes", "wind"):
        assert not meshcat.HasPath(f"/flight/{part}")
    calm = rho.animate(rho.simulate(mission()))
    assert calm.HasPath("/flight/tube/scout")
    assert not calm.HasPath("/flight/wind")


def test_an_arrow_of_full_length_is_the_strongest_wind() -> None:
    scenario = mission()
    blown = {factor: winds_times(scenario, factor) for factor in (0.0, 0.5, 1.0, 2.0)}
    expected = {0.0: 0.0, 0.5: 0.6, 1.0: 0.6, 2.0: 1.2}
    for factor, simulation in blown.items():
        assert strongest_wind(simulation) == pytest.approx(expected[factor])


def winds_times(scenario: rho.Scenario, factor: float) -> rho.Simulation:
    """Simulate the mission in a constant wind of a multiple of its strongest."""
    still = rho.simulate(scenario)
    wind = np.broadcast_to([0.0, 0.6 * factor, 0.0], still.wind.shape)
    return dataclasses.replace(still, wind=wind)


@pytest.mark.slow
def test_a_light_scene_of_a_simulation_has_little_but_the_vehicles() -> None:
    rng = np.random.default_rng(1)
    scenario = rho.random_transitions(30, rng, duration=8.0, step=0.4)
    around = rho.Disturbance(0.01, feedback_every=0.1)
    simulation = rho.simulate(dataclasses.replace(scenario, disturbance=around), replan_every=40)
    meshcat = rho.animate(simulation)
    assert meshcat.HasPath("/flight/vehicles")
    for part in ("planned", "tube", "tubes", "wind", "predictions"):
        assert not meshcat.HasPath(f"/flight/{part}")


@pytest.mark.slow
def test_the_page_of_a_long_flight_with_many_windows_stays_small() -> None:
    scenario = mission()
    longer = dataclasses.replace(scenario, grid=rho.Grid(0.25, 161))
    page = rho.animate(rho.simulate(longer, replan_every=2)).StaticHtml()
    assert len(page) < 25e6


def test_an_arrow_has_the_requested_length() -> None:
    vertices, faces = arrow(2.0)
    assert vertices[0].min() == 0.0
    assert vertices[0].max() == 2.0
    corners = vertices.T[faces.T]
    assert np.linalg.norm(np.cross(*np.diff(corners, axis=1).transpose(1, 0, 2)), axis=1).min() > 0
    # closed surface: by the divergence theorem its volume is that of shaft and head
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    shaft, head = 0.68 * 0.06**2, 0.32 * 0.18**2 / 3.0
    assert volume == pytest.approx(8.0 * (shaft + head))


def test_a_tube_has_the_requested_radius_everywhere() -> None:
    line = np.column_stack([np.linspace(0.0, 4.0, 9), np.zeros(9), np.zeros(9)])
    radii = np.linspace(0.1, 0.5, 9)
    vertices, faces = tube(line, radii, 12)
    rings = vertices.T.reshape(9, 12, 3)
    np.testing.assert_allclose(
        np.linalg.norm(rings - line[:, None], axis=2), np.repeat(radii[:, None], 12, axis=1)
    )
    assert faces.shape == (3, 8 * 12 * 2)
