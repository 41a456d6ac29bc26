"""Scenarios before they are planned, figures in given axes, and records in notebooks."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.style import CONFLICT
from drake_rho.display.meshcat.animation import Stage
from drake_rho.display.viewer.payload import payload
from tests.disturbed import disturbed
from tests.scenarios import single, through_the_middle
from tests.test_cli import run

WAYPOINT = rho.Waypoint(3.0, [4.0, 3.0, -2.0], 0.3)


def blocked() -> tuple[rho.Scenario, rho.InfeasibleError]:
    """Return a scenario with a wall through its flyable volume, and the error of planning it."""
    other = rho.Sphere([3.0, -3.5, 3.5], 0.2)
    wall = rho.Box([5.0, -6.0, -6.0], [6.0, 6.0, 6.0])
    volume = rho.Box([-1.0, -5.0, -5.0], [11.0, 5.0, 5.0])
    scenario = single(
        waypoints=[WAYPOINT],
        obstacles=[other, wall],
        limits=rho.Limits(position=volume),
        between_knots=True,
    )
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    return scenario, caught.value


def test_straight_lines_pass_waypoints_at_their_times() -> None:
    scenario = single(waypoints=[WAYPOINT])
    lines, (vehicle,) = drawn(scenario), scenario.vehicles
    motion, grid = lines.motion(), scenario.grid
    for time, place in (
        (grid.start, vehicle.start.position),
        (float(WAYPOINT.time or 0.0), WAYPOINT.position),
        (grid.end, vehicle.goal.position),
    ):
        found = motion.at("position", [time - grid.start])[0, 0]
        np.testing.assert_allclose(found, place, atol=1e-12)
    # between two knots of one segment the motion is straight
    k = 2
    middle = motion.at("position", [(k + 0.5) * grid.step])[0, 0]
    np.testing.assert_allclose(middle, lines.positions[0, k : k + 2].mean(axis=0), atol=1e-12)


def test_a_scenario_is_drawn_without_being_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, _ = blocked()  # there is no plan

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("planned")

    monkeypatch.setattr(rho, "plan", refuse)
    figure = rho.paths_figure(scenario)
    (ax,) = figure.axes
    dashed = [line for line in ax.lines if line.get_linestyle() == "--"]
    assert dashed
    assert "not planned" in " ".join(text.get_text() for text in figure.texts)
    assert not any(_is_red(line.get_color()) for line in ax.lines)


def test_conflicts_are_red_and_only_these() -> None:
    scenario, error = blocked()
    (numbers,) = error.obstacles.values()
    assert numbers == {2}
    figure = rho.paths_figure(scenario, conflicts=error)
    (ax,) = figure.axes
    rings = [line for line in ax.lines if _is_red(line.get_color())]
    assert len(rings) == 1
    places = np.array(rings[0].get_data_3d()).T  # type: ignore[attr-defined]  # a line in space
    (vehicle,) = scenario.vehicles
    np.testing.assert_allclose(places, [vehicle.start.position, vehicle.goal.position])
    bodies = [each for each in ax.collections if isinstance(each, Poly3DCollection)]
    red = [each for each in bodies if _is_red(each.get_facecolor()[0])]
    assert (len(bodies), len(red)) == (3, 1)  # both obstacles in grey, one in red over it
    assert "cannot meet together" in " ".join(text.get_text() for text in figure.texts)


def _is_red(colour: object) -> bool:
    return bool(np.allclose(to_rgba(colour)[:3], to_rgba(CONFLICT)[:3]))  # type: ignore[arg-type]


def test_the_page_of_a_scenario_says_that_it_is_not_planned() -> None:
    scenario, error = blocked()
    stage = Stage.of(scenario, conflicts=error)
    data = payload(stage)
    assert data["notice"] == "straight lines, not planned"
    assert data["windows"] == []
    signs = {each["sign"] for each in data["legend"]}  # type: ignore[attr-defined]
    assert {"conflict", "goal"} <= signs
    page = rho.viewer_page(scenario, conflicts=error)
    assert json.dumps("straight lines, not planned")[1:-1] in page
    planned = payload(Stage.of(rho.plan(single())))
    assert planned["notice"] == ""


def test_figures_draw_in_given_axes() -> None:
    plan = rho.plan(through_the_middle(3))
    figure = plt.figure()
    space = figure.add_subplot(2, 1, 1, projection="3d")
    assert rho.paths_figure(plan, ax=space) is figure
    assert len({line.get_label() for line in space.lines} & set(plan.scenario.names)) == 3
    plane = figure.add_subplot(2, 1, 2)
    assert rho.separation_figure(plan, ax=plane) is figure
    own = rho.separation_figure(plan).axes[0]
    np.testing.assert_array_equal(plane.lines[0].get_ydata(), own.lines[0].get_ydata())
    assert not figure.legends  # legends are the user's
    figure, axes = plt.subplots(3)
    assert rho.velocities_figure(plan, ax=axes) is figure
    assert rho.accelerations_figure(plan, ax=list(axes)) is figure
    simulation = rho.simulate(disturbed(3))
    assert rho.errors_figure(simulation, ax=plt.subplots(3)[1]) is not figure
    figure.savefig(io.BytesIO())
    plt.close("all")


def test_wrong_axes_are_one_error() -> None:
    plan = rho.plan(through_the_middle(3))
    figure = plt.figure()
    space, plane = figure.add_subplot(2, 1, 1, projection="3d"), figure.add_subplot(2, 1, 2)
    for draw, axes, words in (
        (rho.paths_figure, plane, "ax: got axes of a plane, expected three-dimensional ones"),
        (rho.separation_figure, space, "ax: got three-dimensional axes, expected axes of a plane"),
        (rho.velocities_figure, [plane], "ax: got 1 axes, expected 3, one for each panel"),
        (rho.velocities_figure, [plane, plane, space], "ax: got three-dimensional axes"),
        (rho.velocities_figure, [plane, plane, 1], "ax: got"),
    ):
        with pytest.raises((ValueError, TypeError), match=words):
            draw(plan, ax=axes)  # type: ignore[arg-type]
    plt.close("all")


class _Cells(HTMLParser):
    """Cells of a table, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.styles: set[str] = set()
        self.inside = True

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.styles.add(str(dict(attrs)["style"]))

    def handle_data(self, data: str) -> None:
        if self.inside and self.rows and self.rows[-1]:
            self.rows[-1][-1] += data

    def handle_endtag(self, tag: str) -> None:
        self.inside = self.inside and tag != "table"


def test_reports_and_certificates_show_the_printed_cells_in_a_notebook() -> None:
    plan = rho.plan(single(obstacles=[rho.Sphere([5.0, 0.2, 0.0], 1.0)], between_knots=True))
    for record in (rho.verify(plan), rho.certify(plan)):
        cells = _Cells()
        cells.feed(record._repr_html_())
        printed = str(record).split("\n")
        for row in cells.rows:
            assert any(all(cell in line for cell in row) for line in printed), row
        assert all("nowrap" in style for style in cells.styles)
        assert len(cells.rows) > 1
    named = replace(plan.scenario.vehicles[0], name="<b>&")
    scenario = replace(plan.scenario, vehicles=(named,))
    assert "<b>&</td>" not in rho.verify(rho.plan(scenario))._repr_html_()


def test_plans_and_scenarios_show_themselves_in_a_notebook() -> None:
    scenario = single()
    plan = rho.plan(scenario)
    for record in (scenario, plan, rho.plan_rho(scenario), rho.simulate(disturbed(3))):
        html = str(record._repr_html_())
        (encoded,) = re.findall(r"base64,([^\"]+)\"", html)
        assert min(Image.open(io.BytesIO(base64.b64decode(encoded))).size) > 200
    assert "<div>Plan of" in str(plan._repr_html_())


def test_a_page_shows_itself_in_a_frame_and_is_short_in_print() -> None:
    page = rho.viewer_page(rho.plan(single()))
    assert isinstance(page, str)
    assert page._repr_html_().startswith('<iframe title="viewer" srcdoc="&lt;!DOCTYPE html')
    assert len(repr(page)) < 100


def test_a_figure_is_returned_for_a_scenario_with_moving_obstacles() -> None:
    moving = rho.Obstacle(rho.Sphere([5.0, 3.0, 0.0], 0.5), velocity=[0.0, -0.5, 0.0])
    assert isinstance(rho.paths_figure(single(obstacles=[moving])), Figure)


@pytest.mark.slow
def test_show_before_writes_a_page_and_names_the_conflict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, _ = blocked()
    file, page = tmp_path / "blocked.yaml", tmp_path / "before.html"
    rho.save_scenario(scenario, file)
    _, out, err = run(capsys, monkeypatch, "show", str(file), "--before", "--html", str(page))
    assert "cannot meet together" in out + err
    assert "straight lines, not planned" in page.read_text()
