"""Obstacles that are active for a time are shown, named and measured from only then."""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import drake_rho as rho
from drake_rho.display.common.clearances import least_clearances
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.obstacle_snapshots import obstacle_paths, snapshots
from drake_rho.display.viewer.film import Footage, write_film
from drake_rho.display.viewer.readings import Readings
from tests.browser import open_page
from tests.scenarios import slow
from tests.test_animation_obstacles import _open, _seek, _visible

ZONE = rho.Obstacle(rho.Box([8, -4, 0], [12, 4, 6]), active=(0.0, 4.5), name="zone")
BALL = rho.Obstacle(rho.Sphere([15, 3, 2], 1.0), active=(6.0, 9.0), name="ball")
CROSSER = rho.Obstacle(
    rho.Sphere([5, -4, 2], 0.8), velocity=[0.3, 0.9, 0], active=(2.0, 5.0), name="crosser"
)
NEVER = rho.Obstacle(rho.Box([2, 2, 0], [4, 4, 1]), active=(20.0, 30.0), name="never")
PILLAR = rho.Cylinder([17, -3.5, 2], 0.5)
BODIES = (ZONE, BALL, CROSSER, PILLAR, NEVER)


def _plan(*obstacles: rho.Obstacle | rho.Cylinder, start: float = 0.0) -> rho.Plan:
    """Return a straight flight of 10 s that ignores obstacles, on a clock that begins at a time."""
    vehicles = [rho.Vehicle("scout", rho.State([0, 0, 2]), rho.State([20, 0, 2]), radius=0.2)]
    grid = rho.Grid.lasting(10.0, step=0.25, start=start)
    later = [_later(each, start) for each in obstacles]
    scenario = rho.Scenario("zones", grid, vehicles, obstacles=later)
    free = rho.plan_convex(scenario.without_obstacles())
    return rho.Plan.from_accelerations(scenario, free.accelerations)


def _later(obstacle: rho.Obstacle | rho.Cylinder, start: float) -> rho.Obstacle | rho.Cylinder:
    """Return an obstacle on a clock that begins at a time; it does not move if that is not 0."""
    if isinstance(obstacle, rho.Cylinder):
        return obstacle
    assert obstacle.active is not None
    first, last = obstacle.active
    return dataclasses.replace(obstacle, active=(first + start, last + start))


def _saved(figure: Figure) -> Figure:
    """Return a figure after it was drawn, when its labels are placed."""
    figure.savefig(io.BytesIO(), format="png")
    return figure


@pytest.mark.parametrize(
    "bodies", [*slow((BALL,), (BALL, CROSSER), (ZONE, BALL)), (CROSSER, PILLAR)]
)
def test_distances_are_drawn_only_in_the_interval(bodies: tuple[rho.Obstacle, ...]) -> None:
    """From the centres of balls, from the surfaces of others."""
    figure = _saved(rho.distances_figure(_plan(*bodies)))
    for ax, each in zip(figure.axes, bodies, strict=True):
        first, last = getattr(each, "active", None) or (0.0, 10.0)
        for line in ax.lines:
            times, values = (np.asarray(data, dtype=float) for data in line.get_data())
            if line.get_label() == "scout":
                np.testing.assert_array_equal(
                    np.isfinite(values), (times >= first) & (times <= last)
                )
            elif len(times) == 41:  # the marks at the knots
                assert np.isnan(values[(times < first) | (times > last)]).all()
        words = [text.get_text() for text in ax.texts]
        assert words.count("not active") == (first > 0.0) + (last < 10.0)


def test_the_least_clearance_has_gaps_while_nothing_is_active() -> None:
    balls = [dataclasses.replace(BALL, active=(1.0 + i, 1.5 + i)) for i in range(5)]
    figure = _saved(rho.distances_figure(_plan(*balls)))
    (curve,) = (line for line in figure.axes[0].lines if line.get_label() == "scout")
    times, values = (np.asarray(data, dtype=float) for data in curve.get_data())
    inside = (times >= 1.0) & (times <= 5.5) & (times % 1.0 <= 0.5)
    np.testing.assert_array_equal(np.isfinite(values), inside)
    never = [dataclasses.replace(BALL, active=(20.0, 30.0 + i)) for i in range(5)]
    (ax,) = _saved(rho.distances_figure(_plan(*never))).axes
    assert "no obstacle is active in the flight" in [text.get_text() for text in ax.texts]
    assert ax.get_ylim()[1] < 1.0
    _saved(rho.distances_figure(_plan(NEVER)))


def test_an_interval_between_samples_is_found() -> None:
    """It is shorter than what is drawn straight, and contains the least clearance of all."""
    short = dataclasses.replace(ZONE, active=(4.0011, 4.0012))
    plan = _plan(short, *[dataclasses.replace(BALL, active=(6.0, 6.5 + i)) for i in range(4)])
    assert least_clearances(drawn(plan), plan.scenario.bodies).nearest.min() == 0
    shown = Readings.of(drawn(plan), np.linspace(0.0, 10.0, 51)).obstacles
    assert shown is not None
    assert shown.closest == (0, 0)
    (place,) = plan.at([4.0012]).positions[0]
    assert np.nanmin(shown.values) == pytest.approx(8.0 - place[0] - 0.2, abs=1e-3)


def test_paths_show_when_obstacles_are_active() -> None:
    plan = _plan(*BODIES)
    shown = snapshots(drawn(plan), plan.scenario.bodies)
    labels = [each.label for each in shown]
    assert "1 zone, active 0 to 4.5 s" in labels
    assert any(each.startswith("3 crosser, ") and "active 2 to 5 s" in each for each in labels)
    for each in shown:
        assert each.faint == (each.number == 5 or each.label in ("2 s", "5 s"))
    (way,) = obstacle_paths(drawn(plan), plan.scenario.bodies)
    np.testing.assert_allclose(way[[0, -1], 1], [-4.0 + 0.9 * 2.0, -4.0 + 0.9 * 5.0])
    notes = [text.get_text() for text in _saved(rho.paths_figure(plan)).texts]
    assert "faint: obstacles at rest that are not active in the flight" in notes
    late = _plan(ZONE, start=1.7e9)
    (only,) = snapshots(drawn(late), late.scenario.bodies)
    assert only.label == "1 zone, active 1700000000 to 1700000004.5 s"


def test_a_moving_obstacle_that_is_never_active_is_told() -> None:
    never = dataclasses.replace(CROSSER, active=(20.0, 30.0))
    notes = [text.get_text() for text in rho.paths_figure(_plan(ZONE, never)).texts]
    assert "obstacles never near the scene while active, not shown: 2" in notes


ACTIVE = {"1": (0.0, 4.5), "2": (6.0, 9.0), "3": (2.0, 5.0), "4": (0.0, 10.0), "5": (20.0, 30.0)}
"""Intervals of the obstacles by number [s]; the pillar is always there."""


@pytest.mark.slow
@pytest.mark.parametrize("start", [*slow(0.0), 64.0])
def test_obstacles_are_in_the_scene_only_while_they_are_active(start: float) -> None:
    """The animation lasts as long as the flight, however late or long an interval is."""
    plan = _plan(ZONE, BALL, _still(CROSSER), PILLAR, NEVER, start=start)
    over = dataclasses.replace(_still(BALL), active=(start - 9.0, start - 1.0))
    scenario = dataclasses.replace(plan.scenario, obstacles=(*plan.scenario.obstacles, over))
    plan = rho.Plan.from_accelerations(scenario, plan.accelerations)
    meshcat = rho.animate(plan)
    with open_page() as (page, errors):
        _open(page, meshcat)
        assert page.evaluate("viewer.animator.duration") == pytest.approx(10.0, abs=0.04)
        for time in (0.0, 1.9, 2.1, 4.4, 4.6, 5.1, 5.9, 6.1, 8.9, 9.1, 10.0):
            _seek(page, time)
            for number, (first, last) in ACTIVE.items():
                assert _visible(page, "obstacles", number) == (first <= time <= last)
            assert not _visible(page, "obstacles", "6")
        assert errors == []


def _still(obstacle: rho.Obstacle) -> rho.Obstacle:
    """Return an obstacle at rest."""
    return dataclasses.replace(obstacle, velocity=None)


@pytest.mark.slow
def test_names_on_the_page_are_those_of_active_obstacles() -> None:
    source = rho.viewer_page(_plan(*BODIES))
    with open_page() as (page, errors):
        page.set_content(source)
        page.wait_for_function("window.drakeRho")
        for time, names in ((1.0, ["zone"]), (4.7, ["crosser"]), (7.0, ["ball"]), (9.5, [])):
            page.evaluate("time => drakeRho.frame(time, 1)", time)
            page.wait_for_function(
                "names => [...document.querySelectorAll('.label.thing')]"
                ".filter((each) => each.style.display !== 'none')"
                ".map((each) => each.textContent).join() === names.join()",
                arg=names,
            )
        assert errors == []


@pytest.mark.slow
def test_frames_of_a_film_show_an_obstacle_only_while_it_is_active(tmp_path: Path) -> None:
    with open_page():  # skips without a browser
        pass
    obstacle, path = np.array([144, 148, 160]), tmp_path / "film.gif"
    page = rho.viewer_page(_plan(dataclasses.replace(ZONE, active=(3.0, 6.0))), trails=False)
    write_film(page, path, Footage(np.array([1.0, 4.5, 7.0]), 1.0), size=(640, 360))
    grey = []
    with Image.open(path) as film:
        for frame in range(3):
            film.seek(frame)
            scene = np.asarray(film.convert("RGB"), dtype=int)[:, :400]
            grey.append(np.mean(np.abs(scene - obstacle).max(axis=2) < 14))
    assert grey[1] > 0.05
    assert max(grey[0], grey[2]) < 0.2 * grey[1]
