"""Figures by their geometry: what is drawn is what was planned."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from rich.console import Console

import drake_rho as rho
from drake_rho.display import curves, space
from drake_rho.display.figures import write_figures
from drake_rho.paper.figures import NUMBERS, draw_figure, write_paper_figures
from drake_rho.paper.study import Study
from drake_rho.paper.tables import claims_table, study_table
from tests.tolerances import ROUNDING


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    """Example 2."""
    return rho.plan_convex(rho.load_scenario("paper"))


def _points(lines: Sequence[Any]) -> np.ndarray:
    """Points of lines in space, one after the other."""
    return np.concatenate([np.array(line.get_data_3d()).T for line in lines])


def test_paths_are_the_exact_motion_with_the_knots_marked(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    lines = space.draw_paths(ax, plan)
    assert [line.get_label() for line in lines] == ["UAV-1", "UAV-2", "UAV-3", "UAV-4"]
    assert len({line.get_color() for line in lines}) == 4
    for index, line in enumerate(lines):
        path = _points([line])
        times = np.linspace(0, 49, len(path))
        assert len(path) > 10 * 49
        exact = plan.motion().at("position", times)[index]
        np.testing.assert_allclose(path, exact, rtol=ROUNDING, atol=1e-6)
    marked = [_points([line]) for line in ax.lines if line.get_linestyle() == "None"]
    for knots in plan.positions:
        assert any(m.shape == knots.shape and np.allclose(m, knots) for m in marked)


def test_what_is_in_front_of_an_obstacle_is_drawn_over_it(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    spheres = (*plan.scenario.obstacles, rho.Sphere([1500.0, 500.0, 1500.0], 300.0))
    space.frame_scene(ax, plan.positions, spheres)
    assert ax.computed_zorder is False
    balls = space.draw_obstacles(ax, spheres)
    lines = space.draw_paths(ax, plan, spheres)
    towards = np.array(
        [
            np.cos(np.radians(ax.azim)) * np.cos(np.radians(ax.elev)),
            np.sin(np.radians(ax.azim)) * np.cos(np.radians(ax.elev)),
            np.sin(np.radians(ax.elev)),
        ]
    )
    for ball, sphere in zip(balls, spheres, strict=True):
        sides = set()
        for line in lines:
            nearer = (_points([line])[:-1] - sphere.center) @ towards > 0
            assert np.all(nearer) or not np.any(nearer)
            assert (line.get_zorder() > ball.get_zorder()) == nearer[0]
            sides.add(bool(nearer[0]))
        assert sides == {True, False}


def test_axes_are_equal_and_hold_the_scene(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    space.frame_scene(ax, plan.positions, plan.scenario.obstacles)
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    aspect = ax._box_aspect  # matplotlib has no public name to read it back
    ratio = np.diff(limits)[:, 0] / aspect
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert np.all(plan.positions.min(axis=(0, 1)) > limits[:, 0])
    assert np.all(plan.positions.max(axis=(0, 1)) < limits[:, 1])
    assert ax.get_xlabel() == "x [m]"


def test_a_sphere_has_its_centre_and_radius(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    (sphere,) = plan.scenario.obstacles
    (ball,) = space.draw_obstacles(ax, (sphere,))
    assert 0.0 < ball.get_alpha() < 0.6
    corners = ball._faces.reshape(-1, 3)  # matplotlib has no public name to read them back
    distances = np.linalg.norm(corners - sphere.center, axis=1)
    np.testing.assert_allclose(distances, sphere.radius, rtol=1e-9)


def test_distances_show_the_radius_as_threshold(plan: rho.Plan) -> None:
    ax = Figure().add_subplot()
    (sphere,) = plan.scenario.obstacles
    lines = curves.draw_distances(ax, plan, sphere)
    for index, line in enumerate(lines):
        times, distances = np.array(line.get_data())
        exact = plan.motion().at("position", times)[index] - sphere.center
        np.testing.assert_allclose(distances, np.linalg.norm(exact, axis=1), rtol=ROUNDING)
    assert sphere.radius in _levels(ax)


def _levels(ax: Axes) -> set[float]:
    """Heights of the level lines."""
    heights = [np.asarray(line.get_ydata()) for line in ax.lines]
    return {float(height[0]) for height in heights if np.ptp(height) == 0}


@pytest.mark.parametrize(
    ("draw", "quantity", "bound"),
    [
        (curves.draw_velocities, "velocities", 200.0),
        (curves.draw_accelerations, "accelerations", 20.0),
    ],
)
def test_components_show_their_bounds(
    plan: rho.Plan, draw: object, quantity: str, bound: float
) -> None:
    axes = list(Figure().subplots(3))
    lines = draw(axes, plan)  # type: ignore[operator]  # one of the two above
    assert len(lines) == 12
    values = getattr(plan, quantity)
    for axis, ax in enumerate(axes):
        assert {-bound, bound} <= _levels(ax)
        drawn = np.concatenate([line.get_ydata() for line in ax.lines[:8]])
        assert np.isclose(drawn.max(), values[:, :, axis].max())
        assert ax.get_ylabel().endswith("[m/s]" if bound == 200.0 else "[m/s²]")


def test_acceleration_is_constant_in_every_step(plan: rho.Plan) -> None:
    axes = list(Figure().subplots(3))
    line = curves.draw_accelerations(axes, plan)[0]
    times, values = np.array(line.get_data())
    np.testing.assert_array_equal(values[::2], values[1::2])
    np.testing.assert_array_equal(times[1:-1:2], times[2::2])


def test_windows_have_colours_of_their_own_and_make_up_the_flight(study: Study) -> None:
    flight = study.examples[3].flight
    assert flight is not None
    ax = Figure().add_subplot(projection="3d")
    windows = space.draw_windows(ax, flight)
    colours = [{line.get_color() for line in lines} for lines in windows]
    assert all(len(colour) == 1 for colour in colours)
    assert len(set.union(*colours)) == 10
    for index in range(4):
        path = _points([lines[index] for lines in windows])
        assert np.allclose(path[0], flight.plan.positions[index, 0])
        assert np.allclose(path[-1], flight.plan.positions[index, -1])
        longest = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
        assert longest < 25.0  # no gap: a twelfth of a step at most
    thin = [line for line in ax.lines if line.get_linewidth() < 1.0]
    for number, window in enumerate(flight.windows):
        (colour,) = colours[number]
        ends = [_points([line])[-1] for line in thin if line.get_color() == colour]
        assert np.allclose(ends, window.plan.positions[:, -1])


@pytest.fixture(scope="module")
def fleet() -> rho.Plan:
    """Twenty vehicles that keep apart, as flat ellipsoids."""
    asked = rho.random_transitions(20, np.random.default_rng(1), duration=9.8, step=0.2)
    return rho.plan_scp(asked)


def test_separation_is_the_least_distance_of_any_two_with_the_limit(fleet: rho.Plan) -> None:
    ax = Figure().add_subplot()
    curve, ring = curves.draw_separation(ax, fleet)
    times, distances = np.array(curve.get_data())
    positions = fleet.motion().at("position", times)
    one, other = np.triu_indices(20, 1)
    apart = np.linalg.norm((positions[one] - positions[other]) / [1.0, 1.0, 2.0], axis=2)
    np.testing.assert_allclose(distances, apart.min(axis=0), rtol=ROUNDING)
    assert set(fleet.times.round(9)) <= set(times.round(9))
    assert len(times) > 10 * 49
    m = np.argmin(distances)
    assert tuple(np.array(ring.get_data())[:, 0]) == (times[m], distances[m])
    names = {f"v{1 + one[p]} and v{1 + other[p]}" for p in [np.argmin(apart[:, m])]}
    assert any(name in str(ring.get_label()) for name in names)
    assert 0.35 in _levels(ax)
    low, high = ax.get_ylim()
    assert low < 0.35 <= distances.max() < high
    assert ax.get_ylabel() == "least distance of any two, z / 2 [m]"


def test_separation_is_drawn_where_there_is_one(plan: rho.Plan) -> None:
    with pytest.raises(ValueError, match="separation: got none"):
        rho.separation_figure(plan)
    asked = dataclasses.replace(
        plan.scenario,
        vehicles=plan.scenario.vehicles[:1],
        separation=rho.Separation(1.0),
    )
    with pytest.raises(ValueError, match="a single vehicle"):
        rho.separation_figure(rho.plan_convex(asked))


def test_a_large_fleet_is_drawn_without_knots_and_names(fleet: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    space.draw_paths(ax, fleet)
    marked = [line for line in ax.lines if line.get_linestyle() == "None"]
    assert marked == []
    assert len(ax.lines) == 3 * 20  # a path, a start and a goal each
    assert rho.paths_figure(fleet).legends[0].get_texts() == []


@pytest.mark.parametrize(
    ("scenario", "names"),
    [
        ("paper", ["paths", "distances", "velocities", "accelerations"]),
        ("fleet", ["paths", "separation", "velocities", "accelerations"]),
    ],
)
def test_every_figure_there_is_of_a_plan_is_written(
    scenario: str, names: list[str], plan: rho.Plan, fleet: rho.Plan, tmp_path: Path
) -> None:
    paths = write_figures(plan if scenario == "paper" else fleet, tmp_path / "new")
    assert [path.stem for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(
        f"{name}.png" for name in names
    )
    assert all(imread(path).std() > 0.05 for path in paths)


def test_sixteen_figures_are_written(study: Study, tmp_path: Path) -> None:
    done: list[str] = []
    paths = write_paper_figures(study, tmp_path / "new" / "figures", done.append)
    names = [f"fig{number:02}.png" for number in range(3, 19)]
    assert [path.name for path in paths] == names == done
    assert sorted(path.name for path in paths[0].parent.iterdir()) == names
    images = [imread(path) for path in paths]
    assert all(image.shape[1] == 1300 for image in images)
    assert all(image.std() > 0.05 for image in images)  # none is blank


def test_every_figure_names_its_example(study: Study) -> None:
    titles = [draw_figure(number, study).get_suptitle() for number in NUMBERS]
    assert [title.split(":")[0] for title in titles] == [
        f"Example {number}" for number in (1, 2, 3, 4) for _ in range(4)
    ]
    with pytest.raises(ValueError, match="3 to 18"):
        draw_figure(2, study)


def test_the_tables_show_every_figure_asked_for(study: Study) -> None:
    console = Console(width=80, record=True, file=StringIO())
    console.print(study_table(study), claims_table(study))
    text = console.export_text()
    for words in ("20920.353", "17027.239", "UAV-4 [m]", "speed [m/s]", "programs", "[ms]"):
        assert words in text
    for number in range(1, 7):
        assert f"│ {number} │" in text
