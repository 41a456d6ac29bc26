"""The page over the scene in a real browser: it shows the plan's values in every view."""

from __future__ import annotations

import itertools
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

import drake_rho as rho
from drake_rho.display.viewer.serve import serve
from tests.browser import TOUCH, open_page
from tests.test_animation import crossing
from tests.test_display_flight import in_noise

SCREENSHOTS = Path(__file__).parent / "screenshots"
TIMES = (0.0, 10.5, 24.5, 31.25, 49.0)
"""Interval of frames [s]: 32 a second."""
NAMES = ('<img src=x onerror="document.title=1">', "</script>'&amp;\"", "third")
"""Markup and quotes, which are text wherever a name is shown."""


@contextmanager
def _opened(html: str, folder: Path, **options: Any) -> Iterator[Page]:
    """Open a page from disk offline; check that it requests nothing and its console stays empty."""
    file = folder / "page.html"
    file.write_text(html)
    requested: list[str] = []
    with open_page(offline=True, **options) as (page, said):
        page.on("request", lambda request: requested.append(request.url))
        page.goto(file.as_uri())
        page.wait_for_function("window.drakeRho", timeout=60_000)
        page.evaluate("drakeRho.play(false)")
        yield page
        assert [url for url in requested if not url.startswith("data:")] == [file.as_uri()]
        assert said == []


def _read(page: Page, time: float) -> dict[str, Any]:
    found: dict[str, Any] = page.evaluate(
        "time => { drakeRho.seek(time); return drakeRho.readings(); }", time
    )
    return found


def _number(text: str) -> float:
    return float(text.replace("\N{MINUS SIGN}", "-"))


def _keep(page: Page, picture: str) -> None:
    page.evaluate("() => new Promise(requestAnimationFrame)")
    SCREENSHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"viewer_{picture}.png")


def _on_screen(page: Page) -> np.ndarray:
    """Return the window positions of the vehicles [px], by three.js from their objects, (N, 2)."""
    places = page.evaluate(
        """() => {
            viewer.render();
            const pane = viewer.dom_element;
            return drakeRho.data.vehicles.map(({ path }) => {
                const { object } = viewer.scene_tree.find(["flight", "vehicles", path]);
                object.updateWorldMatrix(true, false);
                const place = new MeshCat.THREE.Vector3().setFromMatrixPosition(object.matrixWorld);
                const { x, y } = place.project(viewer.camera);
                return [(x + 1) / 2 * pane.offsetWidth, (1 - y) / 2 * pane.offsetHeight];
            });
        }"""
    )
    return np.array(places)


def _yard() -> rho.Plan:
    """Return three separated vehicles with a radius between boxes, one of which moves."""
    vehicles = [
        rho.Vehicle(name, rho.State([0, 1.5 * i, 1.5]), rho.State([12, 3 - 1.5 * i, 2]), radius=0.2)
        for i, name in enumerate(NAMES)
    ]
    cart = rho.Obstacle(rho.Box([8, -3, 0], [9, -2, 1]), velocity=[0, 0.4, 0], name="<cart>")
    scenario = rho.Scenario(
        "yard",
        rho.Grid(0.25, 33),
        vehicles,
        rho.Limits(acceleration=rho.Box([-4] * 3, [4] * 3), max_tilt=0.6),
        [rho.Box([5, -2, 0], [6, 0.7, 3]), cart],
        rho.Separation(0.5, 1.5),
    )
    return rho.plan(scenario)


@pytest.fixture(scope="module")
def paper() -> rho.Flight:
    """Return Example 4."""
    return rho.plan_rho(rho.load_scenario("paper"))


def test_the_papers_page_shows_the_values_of_the_plan(paper: rho.Flight, tmp_path: Path) -> None:
    html = rho.viewer_page(paper)
    assert len(html.encode()) < 6e6
    (sphere,), motion = paper.scenario.spheres, paper.plan.motion()
    with _opened(html, tmp_path) as page:
        for time in TIMES:
            said = _read(page, time)
            position, velocity = (motion.at(q, time)[:, 0] for q in ("position", "velocity"))
            clear = np.linalg.norm(position - sphere.center, axis=1) - sphere.radius
            apart = [np.linalg.norm(a - b) for i, a in enumerate(position) for b in position[:i]]
            np.testing.assert_allclose(said["speeds"], np.linalg.norm(velocity, axis=1), atol=1e-3)
            np.testing.assert_allclose(said["clearances"], clear, atol=1e-3)
            np.testing.assert_allclose(said["curves"], [min(apart), clear.min()], atol=1e-3)
            rows = page.locator(".panel tbody tr").all_inner_texts()
            shown = [row.split("\t") for row in rows]
            assert [row[0].strip() for row in shown] == ["UAV-1", "UAV-2", "UAV-3", "UAV-4"]
            for row, speed, least in zip(
                shown, np.linalg.norm(velocity, axis=1), clear, strict=True
            ):
                numbers = [_number(text) for text in row[1:]]
                np.testing.assert_allclose(numbers, [speed, least], rtol=5e-3, atol=5e-4)
            _keep(page, f"paper_{time:g}")
        least = page.evaluate("drakeRho.data.curves[1].least")
        times = np.linspace(0.0, 49.0, 100_001)
        offsets = np.linalg.norm(motion.at("position", times) - sphere.center, axis=2)
        assert least[1] == pytest.approx(offsets.min() - sphere.radius, abs=1e-3)
        assert "window 10 of 10" in page.locator(".headline").inner_text()
        page.evaluate("drakeRho.seek(20)")
        for view in ("top", "side"):
            page.evaluate("view => drakeRho.look(view, 0)", view)
            _keep(page, f"paper_{view}")


SIZES = {"desk": (1280, 800), "tablet": (820, 1180), "phone": (390, 844)}
"""Windows, width and height [px]."""


def _boxes(page: Page) -> dict[str, np.ndarray]:
    """Return the edges of everything laid over the scene [px]: left, top, right, bottom."""
    boxes: dict[str, np.ndarray] = page.evaluate(
        """() => Object.fromEntries([".headline", ".tools", ".panel", ".transport", ".gauge"].map(
            name => [name, document.querySelector(name).getBoundingClientRect()]
        ).filter(([, box]) => box.width > 0).map(
            ([name, box]) => [name, [box.left, box.top, box.right, box.bottom]]
        ))"""
    )
    return {name: np.array(box) for name, box in boxes.items()}


def _overlap(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.all(one[:2] < other[2:]) and np.all(other[:2] < one[2:]))


FINGER = 44.0
"""Least width and height of what is touched [px]."""

_TOUCHED = """() => [...document.querySelectorAll(
    "#overlay button, #overlay select, .transport input, .panel tbody tr, .menu label"
)].map(each => each.getBoundingClientRect()).filter(box => box.width > 0).map(
    box => [box.left, box.top, box.right, box.bottom]
)"""
"""Edges of all that is pressed [px]."""


def _drag(page: Page, *paths: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """Put a finger down at the start of each path [px], move it to the end, and lift it."""
    session = page.context.new_cdp_session(page)
    starts, ends = ([{"x": x, "y": y} for x, y in each] for each in zip(*paths, strict=True))
    for kind, points in (("Start", starts), ("Move", ends), ("End", [])):
        session.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    page.evaluate("() => new Promise(requestAnimationFrame)")


def _check_cards(page: Page, size: np.ndarray) -> None:
    """Check that all cards are on the screen, apart from each other and from vehicles."""
    page.evaluate("() => new Promise(requestAnimationFrame)")
    boxes = _boxes(page)
    for name, box in boxes.items():
        assert np.all(box >= 0.0), name
        assert np.all(box <= size), name
    for (name, box), (other, another) in combinations(boxes.items(), 2):
        assert not _overlap(box, another), (name, other)
    for time in (0.0, 4.0, 8.0):
        _read(page, time)
        for place in _on_screen(page):
            point = np.concatenate([place, place])
            under = [name for name, box in boxes.items() if _overlap(box, point)]
            assert under in ([], [".gauge"]), time


@pytest.mark.slow
@pytest.mark.parametrize("device", TOUCH)
def test_fingers_reach_everything_on_phones_and_tablets(tmp_path: Path, device: str) -> None:
    """Phones show pages without a viewport tag as ones of 980 pixels, at 0.4 of their size."""
    screen = TOUCH[device]["viewport"]
    size = np.array([screen["width"], screen["height"]] * 2)
    with _opened(rho.viewer_page(_yard()), tmp_path, **TOUCH[device]) as page:
        assert page.evaluate("[innerWidth, innerHeight]") == size[:2].tolist()
        assert page.evaluate("document.documentElement.scrollWidth") == size[0]
        for folded in (True, False):
            page.evaluate("folded => { drakeRho.fold(folded); drakeRho.look('free', 0) }", folded)
            _check_cards(page, size)
            _keep(page, f"{device.replace(' ', '_')}_{'folded' if folded else 'open'}")
        page.get_by_role("button", name="Show").tap()
        touched = np.array(page.evaluate(_TOUCHED))
        assert np.all(touched[:, 2:] - touched[:, :2] >= FINGER - 0.01)
        menu = page.locator(".menu .card").bounding_box()
        assert menu is not None
        edges = menu["x"], menu["y"], menu["x"] + menu["width"], menu["y"] + menu["height"]
        assert np.all(np.array(edges) >= 0.0)
        assert np.all(np.array(edges) <= size)
        page.locator(".menu label").last.tap()  # scrolls there
        assert page.locator(".label:visible").count() == 0  # that was the names' box
        page.get_by_role("button", name="Show").tap()
        page.locator(".panel tbody tr").nth(2).tap()
        assert page.locator(".panel tr.followed").inner_text().startswith(NAMES[2])


@pytest.mark.slow
def test_fingers_turn_and_enlarge_the_scene(tmp_path: Path) -> None:
    with _opened(rho.viewer_page(_yard()), tmp_path, **TOUCH["Pixel 7"]) as page:
        camera = """() => {
            const { position } = viewer.camera;
            return [...position.toArray(), viewer.controls.target.distanceTo(position)];
        }"""
        page.evaluate("drakeRho.look('free', 0)")
        before = page.evaluate(camera)
        _drag(page, ((200, 350), (260, 350)))
        turned = page.evaluate(camera)
        assert np.linalg.norm(np.subtract(turned, before)[:3]) > 0.1 * before[3]
        assert turned[3] == pytest.approx(before[3], rel=1e-3)
        _drag(page, ((180, 350), (120, 350)), ((220, 350), (280, 350)))
        assert page.evaluate(camera)[3] < 0.8 * before[3]


@pytest.mark.slow
@pytest.mark.parametrize("folded", [False, True])
@pytest.mark.parametrize("device", ["desk", "iPhone SE", "iPhone 13 landscape"])
def test_the_least_clearance_is_in_sight_at_once(
    paper: rho.Flight, tmp_path: Path, device: str, folded: bool
) -> None:
    with _opened(rho.viewer_page(paper), tmp_path, **TOUCH.get(device, {})) as page:
        page.evaluate("folded => drakeRho.fold(folded)", folded)
        page.evaluate("() => new Promise(requestAnimationFrame)")
        when, least = page.evaluate("drakeRho.data.curves[1].least")
        line = page.locator(".headline .least")  # none for the separation, which is not limited
        words = line.inner_text().replace("\N{NO-BREAK SPACE}", " ")
        found = re.fullmatch(
            r"least clearance (\S+) m at (\S+) s, checked at the knots only", words
        )
        assert found is not None, words
        assert _number(found[1]) == pytest.approx(least, rel=5e-3)
        assert float(found[2]) == pytest.approx(when, abs=0.05)
        on_top = """each => {
            const { left, top, right, bottom } = each.getBoundingClientRect();
            return left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight
                && each.checkVisibility({ opacityProperty: true, visibilityProperty: true });
        }"""
        assert line.evaluate(on_top)
        boxes = _boxes(page)
        headline = boxes.pop(".headline")
        assert [name for name, box in boxes.items() if _overlap(headline, box)] == []


@pytest.mark.slow
def test_cards_overlap_neither_each_other_nor_a_vehicle_at_three_sizes(tmp_path: Path) -> None:
    plan = _yard()
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        for size, (wide, high) in SIZES.items():
            page.set_viewport_size({"width": wide, "height": high})
            for folded in (True, False):
                page.evaluate("folded => drakeRho.fold(folded)", folded)
                for view in ("free", "top", "side"):
                    page.evaluate("view => drakeRho.look(view, 0)", view)
                    page.evaluate("() => new Promise(requestAnimationFrame)")
                    boxes = _boxes(page)
                    assert (".panel" in boxes) != folded
                    for name, box in boxes.items():
                        assert np.all(box >= 0.0), (size, name)
                        assert np.all(box <= [wide, high] * 2), (size, name)
                    for (name, box), (other, another) in combinations(boxes.items(), 2):
                        assert not _overlap(box, another), (size, folded, name, other)
                    for time in (0.0, 4.0, 8.0):
                        _read(page, time)
                        for place in _on_screen(page):
                            point = np.concatenate([place, place])
                            under = [name for name, box in boxes.items() if _overlap(box, point)]
                            assert under in ([], [".gauge"]), (size, folded, view, time)
                _keep(page, f"yard_{size}_{'folded' if folded else 'open'}")


@pytest.mark.slow
def test_the_scale_bar_is_as_long_as_it_says_and_axes_point_as_in_the_scene(tmp_path: Path) -> None:
    with _opened(rho.viewer_page(_yard()), tmp_path) as page:
        for view in ("free", "top", "side"):
            page.evaluate("view => drakeRho.look(view, 0)", view)
            page.evaluate("() => new Promise(requestAnimationFrame)")
            found = page.evaluate(
                """() => {
                    viewer.render();
                    const { camera, controls } = viewer;
                    const { offsetWidth, offsetHeight } = viewer.dom_element;
                    const pixels = (point) => {
                        const { x, y } = point.clone().project(camera);
                        return [x * offsetWidth / 2, y * offsetHeight / 2];
                    };
                    const right = new MeshCat.THREE.Vector3();
                    right.setFromMatrixColumn(camera.matrixWorld, 0);
                    const { target } = controls;
                    const [a, b] = [target, target.clone().add(right)].map(pixels);
                    const ends = [[1, 0, 0], [0, 0, -1], [0, 1, 0]].map((unit) => pixels(
                        target.clone().addScaledVector(new MeshCat.THREE.Vector3(...unit), 1e-3)
                    ).map((value, index) => value - a[index]));
                    return {
                        metre: Math.hypot(b[0] - a[0], b[1] - a[1]),
                        bar: document.querySelector(".gauge .length").offsetWidth,
                        words: document.querySelector(".gauge .scale").innerText,
                        ends,
                        drawn: [...document.querySelectorAll(".gauge line")].map(
                            (line) => [line.x2.baseVal.value, -line.y2.baseVal.value]
                        ),
                    };
                }"""
            )
            length = float(found["words"].split()[0])
            assert found["words"].split()[1] == "m"
            assert found["bar"] == pytest.approx(length * found["metre"], abs=4.0)
            for end, drawn in zip(np.array(found["ends"]), np.array(found["drawn"]), strict=True):
                if np.linalg.norm(drawn) > 4.0:  # the axis does not point at the viewer
                    assert end @ drawn > 0.95 * np.linalg.norm(end) * np.linalg.norm(drawn)


@pytest.mark.slow
def test_colours_are_by_vehicle_speed_or_clearance(paper: rho.Flight, tmp_path: Path) -> None:
    speeds = np.linalg.norm(paper.plan.motion().at("velocity", np.array(TIMES)), axis=2)
    with _opened(rho.viewer_page(paper), tmp_path) as page:
        colour = """name => '#' + viewer.scene_tree.find(
            ['flight', 'vehicles', name, '<object>']).object.material.color.getHexString()"""
        assert page.evaluate(colour, "UAV-1") == "#0072b2"
        page.evaluate("drakeRho.colourBy('speed')")
        green = []
        for time in TIMES:
            page.evaluate("time => drakeRho.seek(time)", time)
            green.append([int(page.evaluate(colour, f"UAV-{i}")[3:5], 16) for i in (1, 2, 3, 4)])
        order = np.argsort(speeds.T.ravel())  # viridis has more green for higher values
        assert np.all(np.diff(np.array(green).ravel()[order]) >= -1)
        _keep(page, "paper_speed")
        page.evaluate("drakeRho.theme(true); drakeRho.colourBy('clearance'); drakeRho.seek(31.6)")
        red, *_ = (int(page.evaluate(colour, "UAV-1")[i : i + 2], 16) for i in (1, 3, 5))
        assert page.evaluate(colour, "UAV-1") == "#c4161c"  # no clearance is left
        assert red > 0
        _keep(page, "paper_clearance_dark")
        page.evaluate("drakeRho.theme(false); drakeRho.colourBy('vehicle')")
        assert page.evaluate(colour, "UAV-1") == "#0072b2"


@pytest.mark.slow
def test_the_page_of_a_fleet_shows_clearances_and_escapes_names(tmp_path: Path) -> None:
    plan = _yard()
    motion, bodies = plan.motion(), plan.scenario.bodies
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        for time in (0.0, 2.5, 4.25, 5.5, 8.0):
            said = _read(page, time)
            position = motion.at("position", time)[:, 0]
            clear = np.min([b.distances(position, np.full(3, time)) for b in bodies], axis=0) - 0.2
            ways = position[:, None] - position + np.diag([np.inf] * 3)[..., None]
            apart = np.linalg.norm(ways / [1.0, 1.0, 1.5], axis=2).min(axis=1)
            np.testing.assert_allclose(
                said["clearances"], np.minimum(clear, apart - 0.5), atol=1e-3
            )
            np.testing.assert_allclose(said["curves"], [apart.min(), clear.min()], atol=1e-3)
        texts = [each.strip() for each in page.locator(".panel td:first-child").all_inner_texts()]
        page.locator(".label", has_text="<cart>").wait_for(state="attached")  # with the next frame
        labels = [each.strip() for each in page.locator(".label").all_inner_texts()]
        options = page.locator(".tools select").first.locator("option").all_inner_texts()
        for name in NAMES[1:]:
            assert name in texts
            assert name in labels
            assert name in options
        # long, so shortened in the middle
        assert any(each.startswith("<img src=x o") for each in texts)
        assert page.locator(f'tr[title^="{NAMES[2]}"]').count() == 1
        assert "<cart>" in labels
        assert page.locator("#overlay img").count() == 0
        assert page.title() == "yard \N{EN DASH} drake_rho"
        _keep(page, "yard")


@pytest.mark.slow
def test_layers_can_be_selected_and_the_table_sorted(tmp_path: Path) -> None:
    plan = _yard()
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        seen = """path => viewer.scene_tree.find(["flight", ...path]).object.visible"""
        for layer, path in (
            ("Trails", "trails"),
            ("Radii", "radii"),
            ("Starts and goals", "goals"),
        ):
            assert page.evaluate(seen, [path])
            page.get_by_text("Show ▾").click()
            page.locator(f'[data-layer="{layer}"]').click()
            page.get_by_text("Show ▾").click()
            assert not page.evaluate(seen, [path])
        page.evaluate("drakeRho.seek(4); drakeRho.show('Shells', true)")
        shells = page.evaluate(
            """() => viewer.scene_tree.find(["flight"]).object.children
                .filter((each) => each.isMesh)
                .map((each) => [each.position.toArray(), each.scale.toArray()])"""
        )
        places = plan.motion().at("position", 4.0)[:, 0]
        np.testing.assert_allclose([place for place, _ in shells], places, atol=1e-3)
        np.testing.assert_allclose([size for _, size in shells], [[0.25, 0.25, 0.375]] * 3)
        speeds = np.linalg.norm(plan.motion().at("velocity", 4.0)[:, 0], axis=1)
        page.locator("th", has_text="m/s").click()
        rows = page.locator(".panel tbody tr td:nth-child(2)").all_inner_texts()
        np.testing.assert_allclose([float(row) for row in rows], np.sort(speeds)[::-1], rtol=5e-3)
        page.evaluate("drakeRho.theme(true); drakeRho.look('top', 0)")
        _keep(page, "yard_top_dark")


@pytest.mark.slow
def test_the_camera_follows_and_names_face_it_from_four_sides(tmp_path: Path) -> None:
    with _opened(rho.viewer_page(_yard()), tmp_path) as page:
        page.evaluate("drakeRho.follow(1, 0)")
        panel, headline, transport = (
            page.locator(f".{name}").evaluate("each => each.getBoundingClientRect().toJSON()")
            for name in ("panel", "headline", "transport")
        )
        middle = panel["left"] / 2, (headline["bottom"] + transport["top"]) / 2
        for quarter in range(4):
            page.evaluate(
                """quarter => {
                    const { camera, controls } = viewer, angle = quarter * Math.PI / 2;
                    const away = camera.position.distanceTo(controls.target);
                    camera.position.set(Math.cos(angle), 0.3, Math.sin(angle))
                        .normalize().multiplyScalar(away).add(controls.target);
                }""",
                quarter,
            )
            for time in (0.5, 3.0, 6.5):
                page.evaluate("time => drakeRho.seek(time)", time)
                where = _on_screen(page)
                np.testing.assert_allclose(where[1], middle, atol=1.0)
                names = page.locator(".label:not(.thing)")
                for i, label in enumerate(names.all()):
                    box = label.bounding_box()
                    if box is None:  # behind the camera, or outside the window
                        continue
                    turned = label.evaluate("each => getComputedStyle(each).transform")
                    assert turned.startswith("matrix(1, 0, 0, 1, ")  # upright, and not mirrored
                    assert box["x"] + box["width"] / 2 == pytest.approx(where[i, 0], abs=1.5)
                    assert box["y"] + box["height"] < where[i, 1]
                assert names.nth(1).is_visible()
            _keep(page, f"followed_{quarter}")


_NAMES_OVER_TIME = """count => Array.from({ length: count }, (_, m) => {
    drakeRho.seek(m * drakeRho.data.duration / (count - 1));
    viewer.render_callback();
    const shown = drakeRho.tags.filter(({ label }) => label?.checkVisibility());
    return Object.fromEntries(shown.map(({ label, text }) => {
        const { left, top, right, bottom } = label.getBoundingClientRect();
        return [text, [left, top, right, bottom]];
    }));
})"""
"""Edges of the visible names [px] at times that span the flight, as text: edges."""


def _twelve() -> rho.Plan:
    """Return twelve vehicles that cross through one point."""
    limits, apart = rho.Limits(max_acceleration=6.0), rho.Separation(0.7, downwash=1.5)
    swap = rho.circle_swap(
        12, radius=6.0, duration=10.0, step=0.2, height=2.0, limits=limits, separation=apart
    )
    return rho.plan(swap)


@pytest.mark.slow
def test_names_never_overlap_where_vehicles_meet(tmp_path: Path) -> None:
    count = 301  # thirty a second, as in a film
    with _opened(rho.viewer_page(_twelve()), tmp_path) as page:
        clearances = np.array(page.evaluate("drakeRho.data.clearances"))
        lead = 0.1 * page.evaluate("drakeRho.data.ranges.clearance[1]")
        names = page.evaluate("drakeRho.data.vehicles.map(({ label }) => label)")
        for size, followed in (("desk", None), ("phone", None), ("phone", 4)):
            wide, high = SIZES[size]
            page.set_viewport_size({"width": wide, "height": high})
            page.evaluate("index => drakeRho.follow(index, 0)", followed)
            page.evaluate("drakeRho.look('free', 0)")
            frames = page.evaluate(_NAMES_OVER_TIME, count)
            for frame in frames:
                for one, other in combinations(map(np.array, frame.values()), 2):
                    assert not _overlap(one, other), frame
                assert followed is None or names[followed] in frame
            seen = np.array([[name in frame for name in names] for frame in frames])
            assert np.abs(np.diff(seen.astype(int), axis=0)).sum(axis=0).max() <= 12  # no flicker
            if followed is None:
                assert seen.any(axis=0).all()
                assert seen.sum(axis=1).min() < 12  # some are hidden
                times = page.evaluate("drakeRho.data.times")
                for m, time in enumerate(np.linspace(0.0, 10.0, count)):
                    now = np.array([np.interp(time, times, each) for each in clearances])
                    assert now[seen[m]].min() <= now.min() + lead
            page.evaluate("drakeRho.seek(5)")
            _keep(page, f"twelve_{size}_{followed}")


@pytest.mark.slow
def test_the_keyboard_reaches_all_controls_and_presses_them(tmp_path: Path) -> None:
    with _opened(rho.viewer_page(_yard()), tmp_path) as page:
        assert page.evaluate("document.documentElement.lang") == "en"
        for role, name in (
            *(("main", "scene"), ("banner", "time"), ("complementary", "numbers")),
            *(("region", "camera and display"), ("region", "playback")),
        ):
            assert page.locator(f'role={role}[name="{name}"s]').count() == 1
        focused = """() => {
            const { activeElement } = document;
            return [activeElement.tagName, getComputedStyle(activeElement).outlineStyle];
        }"""
        count = page.locator("#overlay :is(button, select, input):visible").count()
        for _ in range(count):
            page.keyboard.press("Tab")
            tag, outline = page.evaluate(focused)
            assert tag in {"BUTTON", "SELECT", "INPUT"}
            assert outline == "solid"
        third = page.get_by_role("button", name=NAMES[2])
        third.focus()
        page.keyboard.press("Space")
        assert third.get_attribute("aria-pressed") == "true"
        assert page.locator("tr.followed").count() == 1
        top = page.get_by_role("button", name="Top")
        top.click()
        page.keyboard.press("Space")  # plays: the pointer has left no focus on the button
        assert page.evaluate("document.querySelector('.play').textContent") == "❚❚"
        for control in page.locator("#overlay :is(button, select, input)").all():
            named = "each => each.ariaLabel || each.labels?.[0]?.textContent || each.textContent"
            assert re.search("[a-z]", control.evaluate(named))


@pytest.mark.slow
def test_a_collapsed_fleet_expands_and_a_single_vehicle_is_named(tmp_path: Path) -> None:
    plan = crossing(40, separation=rho.Separation(0.1))
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        page.evaluate("drakeRho.seek(5)")
        assert page.locator(".panel tbody tr").count() == 8
        assert page.locator(".label").count() == 0
        least = page.evaluate("Math.min(...drakeRho.readings().clearances)")
        first = page.locator(".panel tbody tr td:nth-child(3)").first.inner_text()
        assert _number(first) == pytest.approx(least, abs=6e-4)
        _keep(page, "forty")
        page.get_by_text("all 40 vehicles").click()
        assert page.locator(".panel tbody tr:visible").count() == 40
        page.evaluate("drakeRho.follow(17, 0); drakeRho.theme(true)")
        page.evaluate("() => new Promise(requestAnimationFrame)")
        assert page.locator(".label").all_inner_texts() == ["v18"]
        _keep(page, "forty_followed_dark")


@pytest.mark.slow
def test_the_page_of_a_simulation_has_its_wind_and_tubes(tmp_path: Path) -> None:
    simulation = in_noise()
    with _opened(rho.viewer_page(simulation), tmp_path) as page:
        for time in (0.5, 3.25, 4.0, 6.5, 9.5):
            m = int(np.searchsorted(simulation.times, time - 1e-9))
            speeds = np.linalg.norm(simulation.velocities[m], axis=1)
            np.testing.assert_allclose(_read(page, time)["speeds"], speeds, atol=1e-3)
        layers = [each.strip() for each in page.locator(".menu label").all_text_contents()]
        assert {"Tubes", "Plans", "Wind", "Predictions"} <= set(layers)
        page.evaluate("drakeRho.seek(4)")
        _keep(page, "simulation")
        for layer, path in (("Tubes", "tubes"), ("Predictions", "predictions"), ("Wind", "wind")):
            page.evaluate("layer => drakeRho.show(layer, false)", layer)
            assert not page.evaluate(
                "path => viewer.scene_tree.find(['flight', path]).object.visible", path
            )


@pytest.mark.slow
def test_time_runs_stops_and_restarts(tmp_path: Path) -> None:
    plan = crossing(3)
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        page.evaluate("drakeRho.seek(9.5); drakeRho.play(true)")
        page.wait_for_function("drakeRho.readings().time < 9", timeout=30_000)  # from the start
        page.evaluate("drakeRho.loop(false); drakeRho.seek(9.8); drakeRho.play(true)")
        page.wait_for_function("drakeRho.readings().time === 10", timeout=30_000)
        page.keyboard.press("Home")
        assert page.evaluate("drakeRho.readings().time") == 0
        page.keyboard.press("ArrowRight")
        assert page.evaluate("drakeRho.readings().time") == plan.scenario.grid.step
        shown = page.evaluate(
            "viewer.scene_tree.find(['flight', 'vehicles', 'v1']).object.position.toArray()"
        )
        np.testing.assert_allclose(shown, plan.positions[0, 1], atol=1e-3)


@pytest.mark.slow
def test_the_served_page_is_the_same(tmp_path: Path) -> None:
    html = rho.viewer_page(crossing(3))
    first, second = serve(html, port=7750), serve("second", port=7750)
    try:
        assert first.url != second.url
        with open_page() as (page, said):
            page.goto(first.url)
            page.wait_for_function("window.drakeRho", timeout=60_000)
            page.evaluate("drakeRho.play(false)")
            assert _read(page, 5.0)["time"] == 5.0
            answer = page.request.get(f"{first.url}/etc/passwd")
            assert answer.status == 404
            assert said == []
    finally:
        first.close()
        second.close()
    with pytest.raises(OSError, match=r"host: got 'nowhere\.invalid'"):
        serve(html, host="nowhere.invalid")


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads Linux's table of sockets")
def test_show_serves_on_this_machine_alone_and_ends_on_interrupt() -> None:
    command = [sys.executable, "-m", "drake_rho", "show", "paper", "--no-browser", "--port", "7800"]
    ran = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert ran.stdout is not None
        address = re.search(r"http://(localhost|127\.0\.0\.1):(\d+)", ran.stdout.readline())
        assert address is not None
        port = int(address[2])
        with socket.create_connection((address[1], port), timeout=5):
            listening = _addresses(port)
        assert listening
        assert set(listening) <= {"0100007F", "00000000000000000000000001000000"}
        ran.send_signal(signal.SIGINT)
        out, err = ran.communicate(timeout=30)
    finally:
        ran.kill()
    assert ran.returncode == 0
    assert "stopped" in out
    assert "Traceback" not in err


def _addresses(port: int) -> list[str]:
    """Return the local addresses that listen on a port, from the kernel's table."""
    rows = [
        line.split()[1:4]
        for table in ("/proc/net/tcp", "/proc/net/tcp6")
        for line in Path(table).read_text().splitlines()[1:]
    ]
    return [
        local.split(":")[0]
        for local, _, state in rows
        if state == "0A" and int(local.split(":")[1], 16) == port
    ]


@pytest.mark.slow
def test_the_choices_are_not_cut_off_at_any_size(tmp_path: Path) -> None:
    """The text of a choice, with the arrow beside it, fits its box."""
    with _opened(rho.viewer_page(_yard()), tmp_path) as page:
        for wide, high in SIZES.values():
            page.set_viewport_size({"width": wide, "height": high})
            needed, there = page.evaluate(
                """() => {
                    const all = [...document.querySelectorAll("select")];
                    const choice = all.find((each) => each.value === "vehicle");
                    const pen = document.createElement("canvas").getContext("2d");
                    pen.font = getComputedStyle(choice).font;
                    const text = choice.selectedOptions[0].text;
                    return [pen.measureText(text).width + 20, choice.clientWidth];
                }"""
            )
            assert needed <= there, (wide, needed, there)


def _show() -> rho.Plan:
    """Return a show of six vehicles in two colours and white, with one long name."""
    forms, above = rho.formations, [0, 0, 8]
    long = "a name that is far too long for its part of the bar, whatever the window"
    scenes = [
        rho.Scene("ring", forms.Ring(6, 3.0, center=above), 1.0, colours=["#ff0000"]),
        rho.Scene(long, forms.Ring(6, 4.0, center=above), 0.0, colours=["#0000ff"]),
        rho.Scene("wall", forms.Grid(3, 2, spacing=2.5, center=above), 1.0),
    ]
    limits, up = rho.Limits(max_speed=5.0, max_acceleration=3.0), rho.TakeOff(2.0)
    pads = forms.Grid(3, 2, spacing=2.0)
    show = rho.Show("show", pads, scenes, limits, rho.Separation(1.0), take_off=up)
    return rho.plan_show(show, solver=rho.Daqp())


def test_scenes_of_a_show_are_named_on_the_time_bar_and_lights_shine(tmp_path: Path) -> None:
    plan = _show()
    stops = plan.scenario.vehicles[0].waypoints
    with _opened(rho.viewer_page(plan), tmp_path) as page:
        chapters = page.locator(".scenes button")
        assert chapters.all_inner_texts() == [stop.name for stop in stops]
        boxes = chapters.evaluate_all(
            "all => all.map(each => each.getBoundingClientRect().toJSON())"
        )
        slider = page.locator(".transport input").bounding_box()
        assert slider
        for box, stop in zip(boxes, stops, strict=True):  # the knob's middle is over the name
            share = (stop.time or 0.0) / plan.scenario.grid.duration
            begin = slider["x"] + 8.0 + share * (slider["width"] - 16.0)
            assert box["left"] == pytest.approx(begin, abs=2.0)
            assert box["width"] > 24.0
        for box, other in itertools.pairwise(boxes):
            assert box["right"] <= other["left"] + 0.5
        for index, (stop, light) in enumerate(zip(stops, (RED, BLUE, WHITE), strict=True)):
            chapters.nth(index).click()
            assert (stop.name or "?") in page.locator(".headline").inner_text()
            assert _lamp(page) == pytest.approx(light, abs=0.01)
        _read(page, 0.0)
        assert "to ring" in page.locator(".headline").inner_text()
        red, green, blue = _lamp(page)  # off: grey
        assert max(red, green, blue) - min(red, green, blue) < 0.15
        _keep(page, "show")


RED, BLUE, WHITE = (1, 0, 0), (0, 0, 1), (1, 1, 1)


def _lamp(page: Page) -> tuple[float, float, float]:
    """Return the colour of the first vehicle in the table, from 0 to 1."""
    style = page.locator(".panel tbody tr i").first.get_attribute("style") or ""
    red, green, blue = (int(each) / 255.0 for each in re.findall(r"\d+", style)[:3])
    return red, green, blue
