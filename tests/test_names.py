"""Names are text: drawn as written, whatever they would mean as markup or as a path."""

from __future__ import annotations

import dataclasses
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from playwright.sync_api import Page

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.names import as_path, brief
from drake_rho.display.plots import curves, space
from drake_rho.display.plots.figures import write_figures
from tests.browser import open_page
from tests.scenarios import slow, straight

LONG = "w" * 80
NAMES = ("$x^$", "a", "a/b", "a%2Fb", "<b>&amp;</b>", "<object>", "_hidden", r"\$5", "..", LONG)


def _shown(figure: Figure) -> list[str]:
    """Return the texts of a legend as handed to the renderer."""
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    drawn: list[str] = []
    draw_text = renderer.draw_text

    def note(*args: object, **kwargs: object) -> None:
        assert not kwargs["ismath"]
        drawn.append(str(args[3]))
        draw_text(*args, **kwargs)

    renderer.draw_text = note
    for text in figure.legends[0].get_texts():
        text.draw(renderer)
    return drawn


def test_figures_show_names_literally() -> None:
    plan = straight(len(NAMES), NAMES)
    for figure in (rho.paths_figure(plan), rho.velocities_figure(plan)):
        assert _shown(figure) == [*NAMES[:-1], LONG[:40], LONG[40:]]
    flown = rho.Flight(plan, (rho.Window(0, plan, plan),))
    assert _shown(rho.paths_figure(flown)) == [*NAMES[:-1], LONG[:40], LONG[40:]]


@pytest.mark.slow
def test_figures_with_any_names_are_written(tmp_path: Path) -> None:
    assert len(write_figures(straight(len(NAMES), NAMES), tmp_path)) == 3


def test_names_beside_starts_and_of_the_closest_pair_are_text() -> None:
    scenario = dataclasses.replace(
        straight(2, ["$x^$", LONG]).scenario, separation=rho.Separation(1e-3)
    )
    plan = rho.plan_scp(scenario)
    figure = Figure()
    space.draw_paths(figure.add_subplot(121, projection="3d"), drawn(plan))
    _, ring = curves.draw_separation(figure.add_subplot(122), drawn(plan))
    assert str(ring.get_label()).endswith(r": \$x^\$ and wwwwwwwwwwww…wwwwwwwwwww")
    assert [text.get_text() for text in figure.axes[0].texts] == [
        r"\$x^\$",
        "wwwwwwwwwwww…wwwwwwwwwww",
    ]
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]


@pytest.mark.slow
@pytest.mark.parametrize("count", [*slow(1, 6, 14), 36])
@pytest.mark.parametrize("length", [*slow(3), 10, 80])
def test_a_legend_is_complete_and_never_covers_the_plot(count: int, length: int) -> None:
    names = [f"{index:02}" + "W" * (length - 2) for index in range(count)]
    plan = straight(count, names)
    for figure in (rho.paths_figure(plan), rho.velocities_figure(plan)):
        renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
        figure.draw(renderer)
        legend = figure.legends[0].get_window_extent(renderer)
        assert legend.x0 >= 0
        assert legend.y0 >= 0
        assert legend.x1 <= figure.bbox.width
        assert legend.y1 <= figure.bbox.height
        texts = [text for ax in figure.axes for text in (ax.xaxis.label, ax.yaxis.label)]
        for text in [*texts, *figure.texts]:
            assert not text.get_window_extent(renderer).overlaps(legend)
        assert all(ax.bbox.height / figure.dpi > 1.2 for ax in figure.axes)


def test_long_names_are_shortened_in_the_middle() -> None:
    assert brief("UAV-1") == "UAV-1"
    assert brief("x" * 24) == "x" * 24
    assert brief("first part, second part and last") == "first part, …rt and last"
    assert len(brief(LONG)) == 24


def test_every_name_is_one_distinct_part_of_a_path() -> None:
    paths = [as_path(name) for name in (*NAMES, "constructor", "%63onstructor", "__proto__")]
    assert all("/" not in path and not path.startswith("<") for path in paths)
    assert all(one != other for one, other in combinations(paths, 2))
    assert as_path("UAV-1 (é)") == "UAV-1 (é)"
    assert as_path("a/b") == "a%2Fb"


def _vehicles(page: Page) -> dict[str, list[str]]:
    """Return the names under /flight/vehicles, with those of their children."""
    found: dict[str, list[str]] = page.evaluate(
        """() => {
            const tree = viewer.scene_tree.find(["flight", "vehicles"]).children;
            return Object.fromEntries(Object.keys(tree).map(
                name => [name, Object.keys(tree[name].children)]));
        }"""
    )
    return found


@pytest.mark.slow
def test_every_vehicle_of_any_name_is_an_object_of_its_own_in_the_page() -> None:
    names = [*NAMES, " ", "constructor", "<img src=x onerror=alert(1)>"]
    meshcat = rho.animate(straight(len(names), names))
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        page.wait_for_function(
            "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=60_000
        )
        found = _vehicles(page)
        assert sorted(found) == sorted(map(as_path, names))
        assert set(map(tuple, found.values())) == {("<object>",)} or not any(found.values())
        assert errors == []


@pytest.mark.slow
def test_36_vehicles_have_colours_of_their_own_in_the_page() -> None:
    meshcat = rho.animate(straight(36))
    with open_page() as (page, errors):
        page.goto(meshcat.web_url())
        page.wait_for_function(
            "typeof viewer !== 'undefined' && viewer.animator.duration > 0", timeout=60_000
        )
        colours: list[list[float]] = page.evaluate(
            """() => {
                const colours = [];
                viewer.scene_tree.find(["flight", "vehicles"]).object.traverse(
                    each => { if (each.isMesh) colours.push(each.material.color.toArray()); });
                return colours;
            }"""
        )
        assert len(np.unique(np.round(colours, 3), axis=0)) == len(colours) == 36
        assert errors == []


@pytest.mark.parametrize("length", [81, 1000])
def test_a_name_has_at_most_eighty_characters(length: int) -> None:
    state = rho.State([0.0, 0.0, 0.0])
    assert rho.Vehicle("w" * 80, state, state).name == LONG
    with pytest.raises(rho.ScenarioError, match=r"vehicle\.name: got 'www.*at most 80 characters"):
        rho.Vehicle("w" * length, state, state)


MANY = [*NAMES, " ", "constructor", *(f"v{number}" for number in range(20))]


@pytest.mark.parametrize("names", [["a", "a/b"], ["$x^$", "<object>", LONG], MANY])
def test_no_name_overlaps_another_in_the_scene(names: list[str]) -> None:
    meshcat = rho.animate(straight(len(names), names))
    assert not meshcat.HasPath("/flight/vehicles/a/b")
    assert all(meshcat.HasPath(f"/flight/vehicles/{as_path(name)}") for name in names)
