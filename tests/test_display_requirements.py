"""Requirements in figures, in the scene and on the page: what is left, where and when."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.requirements import RequiredPositions, required_positions
from drake_rho.display.common.set_surfaces import near_bounds, surface_within
from drake_rho.display.common.style import NOTHING_LEFT, PLENTY_LEFT, reddened
from drake_rho.display.meshcat.animation import Stage
from drake_rho.display.meshcat.requirements import (
    COLOURS,
    colours_of,
    margins_while_shown,
    shown_interval,
)
from drake_rho.display.meshcat.scene import Scene
from drake_rho.display.plots.figures import write_figures
from drake_rho.display.plots.requirements import draw_links, draw_margins, draw_sets
from drake_rho.display.viewer.payload import payload
from drake_rho.scenario.fields import unchecked
from tests.browser import open_page
from tests.scenarios import straight
from tests.test_animation_obstacles import _corners, _open, _seek, _visible

START = 64.0
"""First time on the clock of these tests' flights of 10 s [s]."""


class OwnBall:
    """A user's own set: the ball of a radius of 3 m around (5, 5, 5)."""

    def support(self, n: np.ndarray) -> np.ndarray:
        """Return the largest n · x."""
        support: np.ndarray = n @ np.full(3, 5.0) + 3.0 * np.linalg.norm(n, axis=-1)
        return support

    def signed_distance(self, x: np.ndarray) -> np.ndarray:
        """Return distances from the surface."""
        distance: np.ndarray = np.linalg.norm(x - 5.0, axis=-1) - 3.0
        return distance

    def outward(self, x: np.ndarray) -> np.ndarray:
        """Return directions from the centre."""
        away = x - 5.0 + 1e-12
        outward: np.ndarray = away / np.linalg.norm(away, axis=-1, keepdims=True)
        return outward


TRACK = rho.Track(START + np.array([1.0, 4.0, 9.0]), [[0, 0, 0], [9, 2, 3], [4, 9, 9]], 0.25)
REQUIREMENTS = (
    rho.KeepIn(rho.Sphere([0, 0, 0], 12.0), vehicles=["v1", "v2"], relative_to="v0", name="a/b $"),
    rho.KeepIn(rho.Box([-9] * 3, [9] * 3), relative_to=TRACK, active=(START + 2, START + 7.5)),
    rho.KeepIn(rho.HalfSpace([0, 0, -1], 0.0), name="floor"),
    rho.KeepIn(rho.Box([-1, -1, 0], [11, 8, 12]), vehicles="v2", active=(START + 3, START + 5)),
    rho.KeepIn(rho.Sphere([5, 5, 5], 8.0), vehicles="v1", active=(START + 4, START + 4)),
    rho.KeepIn(rho.Box([-9] * 3, [9] * 3), of="velocity"),
    rho.KeepIn(OwnBall(), vehicles="v1", name="own"),
)
NUMBERS = [1, 2, 3, 4, 5, 7]
"""Numbers of those of positions."""


def _plan(
    requirements: tuple[rho.KeepIn, ...] = REQUIREMENTS, obstacles: tuple[Any, ...] = ()
) -> rho.Plan:
    """Return straight flights of three vehicles in a cube of 10 m, whatever is required of them."""
    free = straight(3)
    grid = dataclasses.replace(free.scenario.grid, start=START)
    empty = dataclasses.replace(free.scenario, grid=grid, obstacles=obstacles)
    scenario = unchecked(empty, requirements=requirements)
    return rho.Plan.from_accelerations(scenario, free.accelerations)


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    return _plan()


def _brute(plan: rho.Plan, number: int, vehicle: int, times: np.ndarray) -> np.ndarray:
    """Return what is left by hand, at times since the first knot; infinite while not active."""
    asked, places = plan.scenario.requirements[number - 1], plan.motion().at("position", times)
    origin: Any = 0.0
    if isinstance(asked.relative_to, str):
        origin = places[plan.scenario.names.index(asked.relative_to)]
    elif asked.relative_to is not None:
        origin = asked.relative_to.at(START + times)
    left = -asked.set.signed_distance(places[vehicle] - origin)
    left = left - (0.0 if asked.track is None else asked.track.deviation)
    first, last = asked.active or (-np.inf, np.inf)
    return np.where((START + times >= first) & (START + times <= last), left, np.inf)


def _required(plan: rho.Plan) -> list[RequiredPositions]:
    return list(required_positions(plan.scenario))


def test_what_is_left_and_its_least_are_those_of_dense_samples(plan: rho.Plan) -> None:
    times = np.linspace(0.0, 10.0, 20_001)
    assert [required.number for required in _required(plan)] == NUMBERS
    for required in _required(plan):
        minima = required.minima(drawn(plan))
        when, least = minima.times, minima.values
        for row, vehicle in enumerate(required.members):
            brute = _brute(plan, required.number, vehicle, times)
            np.testing.assert_allclose(required.margins(drawn(plan), times)[row], brute, atol=1e-12)
            assert least[row] == pytest.approx(brute.min(), abs=1e-5)
            assert least[row] <= brute.min() + 1e-9
            at = _brute(plan, required.number, vehicle, when[row : row + 1])
            assert least[row] == pytest.approx(at[0], abs=1e-9)


def test_of_equal_values_the_first_is_the_least() -> None:
    still = rho.KeepIn(rho.Sphere([0, 0, 0], 5.0), relative_to="a", name="formation")
    vehicles = [
        rho.Vehicle(n, rho.State([0, y, 0]), rho.State([9, y, 0])) for n, y in (("a", 0), ("b", 2))
    ]
    scenario = rho.Scenario("pair", rho.Grid(0.5, 9), vehicles, requirements=[still])
    (required,) = required_positions(scenario)
    minima = required.minima(drawn(scenario))
    when, least = minima.times, minima.values
    assert when.tolist() == [0.0]
    assert least == pytest.approx([3.0])


def test_requirements_that_are_over_or_of_other_quantities_are_not_drawn() -> None:
    over = rho.KeepIn(rho.Sphere([0, 0, 0], 1.0), active=(START - 9, START - 3))
    plan = _plan((over, REQUIREMENTS[5]))
    assert _required(plan) == []
    with pytest.raises(ValueError, match="obstacles: got none"):
        rho.distances_figure(plan)
    data = payload(Stage.of(plan))
    assert data["requirements"] == []
    assert "Requirements" not in str(data["layers"])


LOWER, UPPER = np.array([-2.0, -3.0, -4.0]), np.array([8.0, 7.0, 6.0])
"""Box in which surfaces are drawn."""
SETS = (
    rho.Sphere([1, 2, 3], 2.0),
    rho.Sphere([0, 0, 0], 7.0),
    rho.Box([-9, -1, -1], [20, 1, 1]),
    rho.Cylinder([3, 0, 0], 2.0),
    rho.Cylinder([3, 0, 0], 2.0, 30.0, "x"),
    rho.Ellipsoid([5, 5, 5], [3, 4, 1]),
    rho.Polytope(np.random.default_rng(0).normal(size=(12, 3)) * 4.0),
    rho.HalfSpace([1, 2, -3], 2.0),
    rho.Cone([6, 0, 0], [-1, 0.3, 0.2], 0.6),
    OwnBall(),
)


@pytest.mark.parametrize("convex_set", SETS, ids=lambda each: type(each).__name__)
def test_surfaces_are_those_of_the_sets_within_the_scene(convex_set: Any) -> None:
    found = surface_within(convex_set, LOWER, UPPER)
    corners = np.concatenate([*found.faces, *found.edges])
    assert np.all((corners >= LOWER - 1e-9) & (corners <= UPPER + 1e-9))
    middles = np.array([face.mean(axis=0) for face in found.faces])
    cut = np.any(np.isclose(corners, LOWER) | np.isclose(corners, UPPER), axis=1)
    rough = 0.06 * float(getattr(convex_set, "size", 3.0))  # curved surfaces have flat faces
    for points, most in ((corners[~cut], 1e-6), (corners, rough), (middles, rough)):
        np.testing.assert_allclose(convex_set.signed_distance(points), 0.0, atol=most)
    # wherever a line crosses the surface in the scene, something is drawn near
    rng = np.random.default_rng(1)
    ends = rng.uniform(LOWER, UPPER, (2, 300, 3))
    inside, outside = (convex_set.signed_distance(each) for each in ends)
    crossed = inside * outside < 0.0
    low, high = (each[crossed] for each in ends)
    for _ in range(40):
        middle = (low + high) / 2.0
        same = (convex_set.signed_distance(middle) < 0) == (convex_set.signed_distance(low) < 0)
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    assert len(low) > 5
    first = np.array([face[0] for face in found.faces])
    wide = np.array([np.linalg.norm(face - face[0], axis=1).max() for face in found.faces])
    for point in low:
        reached = np.linalg.norm(first - point, axis=1) < wide + rough + 1e-6
        faces = [found.faces[k] for k in np.flatnonzero(reached)]  # no other is as near
        assert any(_distance_from_face(point, face) < rough + 1e-6 for face in faces)


def _distance_from_face(point: np.ndarray, face: np.ndarray) -> float:
    """Return at most a distance of a point from a convex polygon: by its triangles' samples."""
    s, t = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21)))
    s, t = s[s + t <= 1.0], t[s + t <= 1.0]
    best = np.inf
    for k in range(1, len(face) - 1):
        a, b = face[k] - face[0], face[k + 1] - face[0]
        near = face[0] + s[:, None] * a + t[:, None] * b - point
        spread = 0.05 * max(np.linalg.norm(a), np.linalg.norm(b))
        best = min(best, max(0.0, float(np.linalg.norm(near, axis=1).min() - spread)))
    return best


def test_sets_far_away_neither_enlarge_the_scene_nor_are_drawn_in_it() -> None:
    plain, lower, upper = Scene.of(drawn(_plan(()))), np.zeros(3), np.full(3, 10.0)
    far = rho.KeepIn(rho.Box([-999] * 3, [999] * 3))
    for each in (far, rho.KeepIn(rho.HalfSpace([1, 1, 1], 900.0))):
        scene = Scene.of(drawn(_plan((each,))))
        np.testing.assert_array_equal(scene.lower, plain.lower)
        np.testing.assert_array_equal(scene.upper, plain.upper)
        found = surface_within(each.set, scene.lower, scene.upper)
        assert found.faces == found.edges == []
    near = rho.Box([-1] * 3, [11, 99, 11])
    found_bounds = near_bounds(near, lower, upper)
    assert found_bounds is not None
    np.testing.assert_array_equal(found_bounds, [[-1, -1, -1], [11, 10, 11]])
    assert near_bounds(rho.Sphere([99, 0, 0], 1.0), lower, upper) is None
    scene = Scene.of(drawn(_plan((rho.KeepIn(near),))))
    assert np.all(scene.lower[:2] < -1.0)
    assert np.all(scene.upper[[0, 2]] > 11.0)
    assert scene.upper[1] < 20.0


def test_sets_of_users_without_bounds_are_not_drawn() -> None:
    class Above(OwnBall):
        def support(self, n: np.ndarray) -> np.ndarray:
            """Return infinity: it has no bound."""
            return np.full(n.shape[:-1], np.inf)

    assert surface_within(Above(), LOWER, UPPER).faces == []


def test_curves_are_what_is_left_in_the_interval_only(plan: rho.Plan) -> None:
    for required in _required(plan):
        ax = Figure().add_subplot()
        *curves, ring = draw_margins(ax, drawn(plan), [required])
        assert len(curves) == len(required.members)
        for line, vehicle in zip(curves, required.members, strict=True):
            assert line.get_label() == plan.scenario.names[vehicle]
            times, values = np.array(line.get_data())
            brute = _brute(plan, required.number, vehicle, times - START)
            np.testing.assert_allclose(values, brute, atol=1e-9)
            active = plan.scenario.requirements[required.number - 1].active or (START, START + 10.0)
            assert (times[0], times[-1]) == pytest.approx(active)
        least = min(np.asarray(line.get_ydata()).min() for line in curves)
        assert float(np.asarray(ring.get_ydata())[0]) == pytest.approx(least)
        assert ax.get_xlim() == (START, START + 10.0)
        assert any(np.all(np.asarray(line.get_ydata()) == 0.0) for line in ax.lines)
        words = [text.get_text() for text in ax.texts]
        assert ("not active" in words) == (required.requirement.active is not None)


def test_each_of_few_requirements_has_a_panel_below_those_of_obstacles(tmp_path: Path) -> None:
    ball = rho.Sphere([20, 0, 0], 1.0)
    figure = rho.distances_figure(_plan(REQUIREMENTS[:3], (ball,)))
    titles = [ax.get_title() for ax in figure.axes]
    assert titles[1:] == [r"requirement 1 (a/b \$)", "requirement 2", "requirement 3 (floor)"]
    figure = rho.distances_figure(_plan(REQUIREMENTS[:4], (ball,)))
    assert len(figure.axes) == 2
    words = {text.get_text() for text in figure.axes[1].texts}
    assert {r"a/b \$", "requirement 2", "floor"} <= words
    names = {path.name for path in write_figures(_plan(REQUIREMENTS[:1]), tmp_path)}
    assert "distances.png" in names


def test_axes_with_several_requirements_end_above_what_is_ever_least() -> None:
    far = rho.KeepIn(rho.Sphere([0, 0, 0], 1e4), name="far")
    plan = _plan((*REQUIREMENTS[2:3], far))
    ax = Figure().add_subplot()
    draw_margins(ax, drawn(plan), _required(plan))
    assert ax.get_ylim()[1] < 50.0
    assert "far" not in [text.get_text() for text in ax.texts]


def _in_space(plan: rho.Plan) -> Any:
    ax = Figure().add_subplot(projection="3d")
    ax.set(xlim=(LOWER[0], UPPER[0]), ylim=(LOWER[1], UPPER[1]), zlim=(LOWER[2], UPPER[2]))
    return ax


def test_links_are_drawn_from_vehicle_to_vehicle_when_least_is_left(plan: rho.Plan) -> None:
    lines = [
        line for line in draw_links(_in_space(plan), drawn(plan)) if len(line.get_data_3d()[0]) > 1
    ]
    links = [
        (required, row) for required in _required(plan)[:2] for row in range(len(required.members))
    ]
    for line, (required, row) in zip(lines, links, strict=True):
        ends = np.array(line.get_data_3d())[:, [0, -1]].T
        minima = required.minima(drawn(plan))
        times, left = minima.times, minima.values
        places = plan.motion().at("position", times[row : row + 1])[:, 0]
        begin = places[0] if required.number == 1 else TRACK.at(START + times[row])
        np.testing.assert_allclose(ends, [begin, places[required.members[row]]])
        plenty = 6.0 if required.number == 1 else 4.5
        assert required.plenty(drawn(plan)) == plenty
        assert line.get_color() == reddened(left[row] / plenty)


def test_links_turn_from_grey_to_red() -> None:
    assert reddened(1.0) == reddened(2.0) == to_hex(PLENTY_LEFT)
    assert reddened(0.0) == reddened(-1.0) == to_hex(NOTHING_LEFT)
    mixed = np.array([to_rgb(reddened(part)) for part in np.linspace(0.0, 1.0, 11)])
    assert np.all(np.diff(mixed[:, 0]) < 0.0)
    assert np.all(np.diff(mixed[:, 1:], axis=0) > 0.0)


def test_sets_of_single_vehicles_are_drawn_where_they_are(plan: rho.Plan) -> None:
    ax = _in_space(plan)
    artists = draw_sets(ax, drawn(plan))
    words = [text.get_text() for text in ax.texts]
    timed = [
        f"requirement 4, active {START + 3:g} to {START + 5:g} s",
        f"requirement 5, active at {START + 4:g} s",
    ]
    assert words == ["floor", *timed, "own"]
    assert len(artists) == 4 + len(words) + 2  # faces, labels, and edges of floor and box
    floor = artists[0]
    np.testing.assert_allclose(floor._faces[..., 2], 0.0, atol=1e-9)  # type: ignore[attr-defined]
    for figure in (rho.paths_figure(plan), rho.paths_figure(plan.scenario)):
        notes = " ".join(text.get_text() for text in figure.texts)
        assert "green: sets in which vehicles stay" in notes
        assert "dashed, grey to red: links when least is left" in notes


def test_the_page_lists_what_is_left_now(plan: rho.Plan) -> None:
    data: Any = payload(Stage.of(plan))
    times = np.array(data["times"])
    listed = data["requirements"]
    labels = ["a/b $", "requirement 2", "floor", "requirement 4", "requirement 5", "own"]
    assert [each["label"] for each in listed] == labels
    assert listed[1]["title"].startswith(
        "requirement 2: v0, v1, v2 relative to a moving point; in box"
    )
    assert listed[5]["title"] == "requirement 7 (own): v1; in a set of its own functions"
    for each, required in zip(listed, _required(plan), strict=True):
        brute = np.min([_brute(plan, required.number, i, times) for i in required.members], axis=0)
        if required.number == 5:  # an instant, shown for a second
            at = _brute(plan, 5, 1, np.array([4.0]))[0]
            brute = np.where((times >= 3.5) & (times < 4.5), at, np.inf)
        left = np.array([np.inf if value is None else value for value in each["left"]])
        ends = np.isfinite(brute) != np.isfinite(left)  # the last instant counts as over
        assert np.sum(ends) <= 1
        np.testing.assert_allclose(left[~ends], brute[~ends], atol=1e-4)
    curve = data["curves"][-1]
    assert curve["title"] == "Least left of a requirement"
    least = min(required.minima(drawn(plan)).values.min() for required in _required(plan))
    assert curve["least"][1] == pytest.approx(least, abs=1e-6)
    texts = [each["text"] for each in data["legend"]]
    assert "link to another vehicle; red: nothing left" in texts
    assert "set in which vehicles stay; shown while required" in texts


def test_of_many_requirements_the_page_lists_the_tightest() -> None:
    links = tuple(
        rho.KeepIn(rho.Sphere([0, 0, 0], radius), vehicles="v1", relative_to="v0", name=f"{radius}")
        for radius in range(40, 20, -1)
    )
    data: Any = payload(Stage.of(_plan(links)))
    assert [each["label"] for each in data["requirements"]] == [str(r) for r in range(30, 20, -1)]


def test_instants_are_shown_for_a_second(plan: rho.Plan) -> None:
    stage = Stage.of(plan)
    shown = {
        required.number: shown_interval(required, drawn(plan), stage.playback)
        for required in _required(plan)
    }
    assert shown[4] == pytest.approx((3.0, 5.0))
    assert shown[5] == pytest.approx((3.5, 4.5))


def test_lines_join_vehicles_and_redden_in_the_scene(plan: rho.Plan) -> None:
    scene, playback = Scene.of(drawn(plan)), Stage.of(plan).playback
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        _open(page, meshcat)
        for time in (0.0, 1.5, 3.25, 4.0, 6.5, 9.0):
            _seek(page, time)
            places = plan.motion().at("position", time)[:, 0]
            for required in _required(plan)[:2]:
                active = required.number == 1 or 2.0 <= time < 7.5
                begin = places[0] if required.number == 1 else TRACK.at(np.array(START + time))
                left = margins_while_shown(required, drawn(plan), np.array([time]), playback)
                colours = colours_of(left, required.plenty(drawn(plan)))[:, 0]
                for vehicle, colour in zip(required.members, colours, strict=True):
                    path = ("links", str(required.number), f"v{vehicle}")
                    children = page.evaluate(
                        "path => Object.keys(viewer.scene_tree.find(path).children)",
                        ["flight", *path],
                    )
                    seen = [
                        int(each)
                        for each in children
                        if each != "<object>" and _visible(page, *path, each)
                    ]
                    assert seen == ([colour] if active else [])
                    if not active:
                        continue
                    brute = _brute(plan, required.number, vehicle, np.array([time]))[0]
                    part = np.clip(brute / required.plenty(drawn(plan)), 0.0, 1.0)
                    assert abs(colour / (COLOURS - 1) - part) < 1.0 / (COLOURS - 1)
                    across = places[vehicle] - begin
                    length = float(np.linalg.norm(across))
                    if length == 0.0:
                        continue
                    corners = _corners(page, *path, str(colour)) - begin
                    along = corners @ across / length
                    assert along.min() == pytest.approx(0.0, abs=1e-3)
                    assert along.max() == pytest.approx(length, abs=1e-3)
                    off = np.linalg.norm(corners - along[:, None] * across / length, axis=1)
                    assert off.max() < 2.0 * scene.trail_radius
            assert _visible(page, "points", "2") == (2.0 <= time < 7.5)
            mark = _corners(page, "points", "2")
            middle = (mark.min(axis=0) + mark.max(axis=0)) / 2.0
            np.testing.assert_allclose(middle, TRACK.at(np.array(START + time)), atol=1e-3)
            assert _visible(page, "sets", "4") == (3.0 <= time < 5.0)
            assert _visible(page, "sets", "3")
        box = _corners(page, "sets", "4", "faces")
        np.testing.assert_allclose(box.min(axis=0), [-1, -1, 0], atol=1e-5)
        np.testing.assert_allclose(box.max(axis=0), [11, 8, 12], atol=1e-5)
        floor = _corners(page, "sets", "3", "faces")
        np.testing.assert_allclose(floor[:, 2], 0.0, atol=1e-5)
        assert errors == []


@pytest.mark.slow
def test_the_page_shows_what_is_left_and_reddens_it(plan: rho.Plan, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(rho.viewer_page(plan))
    with open_page(offline=True) as (page, errors):
        page.goto(file.as_uri())
        page.wait_for_function("window.drakeRho", timeout=60_000)
        page.evaluate("drakeRho.play(false)")
        for time in (1.0, 3.75, 9.0):
            page.evaluate("time => drakeRho.seek(time)", time)
            rows = page.locator(".left div").all_inner_texts()
            for row, required in zip(rows, _required(plan), strict=True):
                instant = required.number == 5 and time == 3.75  # shown for a second
                at = np.array([4.0 if instant else time])
                brute = min(_brute(plan, required.number, i, at)[0] for i in required.members)
                text = row.split("\n")[-1].replace("\N{MINUS SIGN}", "-")
                if np.isfinite(brute):
                    assert float(text) == pytest.approx(brute, rel=6e-3, abs=6e-4)
                else:
                    assert text == "\N{EN DASH}"
        page.evaluate("drakeRho.show('Requirements', false)")
        assert not any(_visible(page, each) for each in ("links", "points", "sets"))
        assert errors == []


def test_previews_of_scenarios_show_requirements(tmp_path: Path) -> None:
    plan = _plan(REQUIREMENTS[:2])
    data: Any = payload(Stage.of(plan.scenario))
    assert len(data["requirements"]) == 2
    assert isinstance(rho.paths_figure(plan.scenario), Figure)


def test_reports_name_what_a_requirement_is_about() -> None:
    words = {check.what for check in rho.verify(_plan()).checks if check.kind == "requirements"}
    assert "requirement 6 of velocity" in words
    assert "requirement 1 (a/b $) relative to v0 at all times" in words
    assert "requirement 2 relative to a moving point at knots" in words
