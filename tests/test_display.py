"""Figures by their geometry: they show the planned motion."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Sequence
from io import StringIO
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.path import Path as Outline
from matplotlib.text import Text
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.axes3d import Axes3D
from rich.console import Console

import drake_rho as rho
from drake_rho.cli.study_tables import claims_table, study_table
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.obstacle_snapshots import snapshots
from drake_rho.display.common.style import view
from drake_rho.display.plots import curves, space
from drake_rho.display.plots.axes3d import frame_scene
from drake_rho.display.plots.distances import draw_distances
from drake_rho.display.plots.figures import write_figures
from drake_rho.display.plots.formats import SINGLE_COLUMN
from drake_rho.display.plots.lines3d import FAINT
from drake_rho.paper.figures import NUMBERS, draw_figure, write_paper_figures
from drake_rho.scenario.parts import Quantity
from tests.conftest import Study
from tests.scenarios import box, slow, straight
from tests.scenarios import fleet as fleet_of
from tests.tolerances import ROUNDING


@pytest.fixture(scope="module")
def plan() -> rho.Plan:
    """Return the plan of Example 2."""
    return rho.plan_convex(rho.load_scenario("paper"))


def _points(lines: Sequence[Any]) -> np.ndarray:
    """Return the points of lines in space, one line after the other."""
    return np.concatenate([np.array(line.get_data_3d()).T for line in lines])


def test_paths_are_the_exact_motion_with_the_knots_marked(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    lines = space.draw_paths(ax, drawn(plan))
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


def test_paths_are_faint_where_the_line_of_sight_meets_an_obstacle(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    near = rho.Obstacle(rho.Sphere([1500.0, 500.0, 1500.0], 300.0))
    spheres = snapshots(drawn(plan), (*plan.scenario.bodies, near))
    frame_scene(ax, plan.positions, spheres)
    bodies = space.draw_obstacles(ax, spheres)
    lines = space.draw_paths(ax, drawn(plan), spheres)
    _, _, towards = view()
    counts = []
    for line in lines:
        assert line.get_zorder() > max(body.get_zorder() for body in bodies)
        points = _points([line])
        points = points[np.isfinite(points[:, 0])]
        behind = np.zeros(len(points), dtype=bool)
        for each in spheres:  # the nearest point of the line of sight to the centre is inside
            x = points - each.center
            ahead = np.maximum(-(x @ towards), 0.0)
            missed = np.linalg.norm(x + ahead[:, None] * towards, axis=1)
            behind |= missed < each.shape.size
        counts.append(behind.sum())
        assert behind.mean() > 0.9 if line.get_alpha() == FAINT else behind.sum() <= 5
    assert max(counts) > 20


def test_axes_are_equal_and_hold_the_scene(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    frame_scene(ax, plan.positions, snapshots(drawn(plan), plan.scenario.bodies))
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    aspect = ax._box_aspect  # matplotlib has no public accessor
    ratio = np.diff(limits)[:, 0] / aspect
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert np.all(plan.positions.min(axis=(0, 1)) > limits[:, 0])
    assert np.all(plan.positions.max(axis=(0, 1)) < limits[:, 1])
    assert ax.get_xlabel() == "x [m]"


def test_a_sphere_has_its_centre_and_radius(plan: rho.Plan) -> None:
    ax = Figure().add_subplot(projection="3d")
    (sphere,) = plan.scenario.spheres
    (ball,) = space.draw_obstacles(ax, snapshots(drawn(plan), plan.scenario.bodies))
    assert 0.0 < ball.get_alpha() < 0.6
    corners = ball._faces.reshape(-1, 3)  # matplotlib has no public accessor
    distances = np.linalg.norm(corners - sphere.center, axis=1)
    np.testing.assert_allclose(distances, sphere.radius, rtol=1e-9)


def test_distances_show_the_radius_as_threshold(plan: rho.Plan) -> None:
    ax = Figure().add_subplot()
    (sphere,) = plan.scenario.spheres
    lines = draw_distances(ax, drawn(plan), plan.scenario.bodies[0], radius=sphere.radius)
    for index, line in enumerate(lines):
        times, distances = np.array(line.get_data())
        exact = plan.motion().at("position", times)[index] - sphere.center
        np.testing.assert_allclose(distances, np.linalg.norm(exact, axis=1), rtol=ROUNDING)
    assert sphere.radius in _levels(ax)


def _levels(ax: Axes) -> set[float]:
    """Return the heights of the level lines."""
    heights = [np.asarray(line.get_ydata()) for line in ax.lines]
    return {float(height[0]) for height in heights if np.ptp(height) == 0}


def _dashed(ax: Axes) -> list[Line2D]:
    """Return the limits, in black, and overlapping curves, in their colours."""
    return [line for line in ax.lines if line.get_linestyle() == "--"]


@pytest.mark.parametrize(
    ("quantity", "name", "bound"),
    [("velocity", "velocities", 200.0), ("acceleration", "accelerations", 20.0)],
)
def test_components_show_their_bounds(
    plan: rho.Plan, quantity: Quantity, name: str, bound: float
) -> None:
    axes = list(Figure().subplots(3))
    lines = curves.draw_components(axes, drawn(plan), quantity)
    assert len(lines) == 12
    values = getattr(plan, name)
    for axis, ax in enumerate(axes):
        assert {-bound, bound} <= _levels(ax)
        shown = np.concatenate([line.get_ydata() for line in ax.lines[:8]])
        assert np.isclose(shown.max(), values[:, :, axis].max())
        assert ax.get_ylabel().endswith("[m/s]" if bound == 200.0 else "[m/s²]")


def test_acceleration_is_constant_in_every_step(plan: rho.Plan) -> None:
    axes = list(Figure().subplots(3))
    line = curves.draw_components(axes, drawn(plan), "acceleration")[0]
    times, values = np.array(line.get_data())
    np.testing.assert_array_equal(values[::2], values[1::2])
    np.testing.assert_array_equal(times[1:-1:2], times[2::2])


def test_windows_have_distinct_colours_and_make_up_the_flight(study: Study) -> None:
    flight = study.examples[3].flight
    assert flight is not None
    ax = Figure().add_subplot(projection="3d")
    windows = space.draw_windows(ax, drawn(flight))
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
    """Return twenty vehicles with the separation of flat ellipsoids."""
    scenario = rho.random_transitions(20, np.random.default_rng(1), duration=9.8, step=0.2)
    return rho.plan_scp(scenario)


def test_separation_is_the_least_distance_of_any_pair_with_its_limit(fleet: rho.Plan) -> None:
    ax = Figure().add_subplot()
    curve, ring = curves.draw_separation(ax, drawn(fleet))
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
    assert ax.get_ylabel() == "minimum vehicle distance, z / 2 [m]"


def test_separation_is_drawn_where_there_is_one(plan: rho.Plan) -> None:
    with pytest.raises(ValueError, match="separation: got none"):
        rho.separation_figure(plan)
    scenario = dataclasses.replace(
        plan.scenario,
        vehicles=plan.scenario.vehicles[:1],
        separation=rho.Separation(1.0),
    )
    with pytest.raises(ValueError, match="a single vehicle"):
        rho.separation_figure(rho.plan_convex(scenario))


def _oklab(colours: Sequence[Any]) -> np.ndarray:
    """Return colours in Ottosson's OKLab, where distances are perceptual, shape (N, 3)."""
    srgb = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    cones = np.array(
        [
            [0.4122214708, 0.5363325363, 0.0514459929],
            [0.2119034982, 0.6806995451, 0.1073969566],
            [0.0883024619, 0.2817188376, 0.6299787005],
        ]
    )
    opponents = np.array(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ]
    )
    lab: np.ndarray = np.cbrt(linear @ cones.T) @ opponents.T
    return lab


def _apart(colours: Sequence[Any]) -> np.ndarray:
    """Return the distances of all colours, infinite on the diagonal, shape (N, N)."""
    lab = _oklab(colours)
    distances: np.ndarray = np.linalg.norm(lab[:, None] - lab[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return distances


def test_no_two_of_36_vehicles_look_alike() -> None:
    plan = straight(36)
    ax = Figure().add_subplot(projection="3d")
    lines = space.draw_paths(ax, drawn(plan))
    colours = [line.get_color() for line in lines]
    assert colours[:6] == ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]
    marks = [line for line in ax.lines if line.get_linestyle() == "None"]
    knots = [mark for mark in marks if mark.get_fillstyle() != "none"]  # starts and goals are open
    assert [line.get_color() for line in knots] == colours
    markers = np.array([line.get_marker() for line in knots])
    assert len(set(markers[:6])) == 6
    apart = _apart(colours)
    assert apart.min() > 0.1  # the first six have distances of 0.155
    assert apart[markers[:, None] == markers].min() > 0.155
    assert _apart([*colours, "white"])[-1].min() > 0.15
    assert _apart([*colours, "black"])[-1].min() > 0.15


@pytest.mark.parametrize(
    "figure", [rho.paths_figure, rho.velocities_figure, rho.accelerations_figure]
)
def test_the_legend_shows_36_vehicles_as_they_are_drawn(
    figure: Callable[[rho.Plan], Figure],
) -> None:
    plan = straight(36)
    drawn = figure(plan)
    (legend,) = drawn.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"v{i}" for i in range(36)]
    looks = [(line.get_color(), line.get_marker()) for line in legend.get_lines()]
    assert len(set(looks)) == 36
    lines = drawn.axes[0].lines
    assert set(looks) <= {(line.get_color(), line.get_marker()) for line in lines}


def test_no_two_vehicles_of_a_flight_look_alike() -> None:
    """Starts and knots distinguish the vehicles where colours are those of the windows."""
    plan = straight(36)
    flown = rho.Flight(plan, (rho.Window(0, plan, plan),))
    drawn = rho.paths_figure(flown)
    starts = [
        line
        for line in drawn.axes[0].lines
        if line.get_marker() == "o" and line.get_fillstyle() == "none"
    ]
    looks = [line.get_color() for line in starts]
    assert len(set(looks)) == 36
    (legend,) = drawn.legends
    assert [line.get_color() for line in legend.get_lines()] == looks


@pytest.mark.parametrize("count", [37, *slow(200)])
def test_a_swarm_is_drawn_without_knots_and_names(count: int) -> None:
    plan = straight(count)
    ax = Figure().add_subplot(projection="3d")
    space.draw_paths(ax, drawn(plan))
    assert len(ax.lines) == 3 * count  # a path, a start and a goal each
    quantities: tuple[Quantity, ...] = ("velocity", "acceleration")
    for quantity in quantities:
        axes = list(Figure().subplots(3))
        curves.draw_components(axes, drawn(plan), quantity)
        assert [len(each.lines) for each in axes] == [count] * 3
    window = rho.Window(0, plan, plan)
    for figure in (rho.paths_figure(plan), rho.paths_figure(rho.Flight(plan, (window,)))):
        assert figure.legends == []
        assert "knot" not in " ".join(text.get_text() for text in figure.texts)
        assert {line.get_marker() for line in figure.axes[0].lines} == {"None", "o", "*"}


@pytest.mark.parametrize(
    ("limits", "velocities", "accelerations"),
    [
        (rho.Limits(), False, False),
        (rho.Limits(velocity=box(50.0)), True, False),
        (rho.Limits(acceleration=box(50.0)), False, True),
        (rho.Limits(velocity=box(50.0), max_speed=50.0), True, False),
        (rho.Limits(acceleration=box(50.0), max_thrust=50.0, max_tilt=1.0), False, True),
    ],
)
def test_the_legend_names_the_limits(
    limits: rho.Limits, velocities: bool, accelerations: bool
) -> None:
    scenario = dataclasses.replace(straight(3).scenario, limits=limits)
    plan = rho.plan_convex(scenario)
    for figure, limited in (
        (rho.velocities_figure(plan), velocities),
        (rho.accelerations_figure(plan), accelerations),
    ):
        entries = [text.get_text() for text in figure.legends[0].get_texts()]
        assert entries == ["v0", "v1", "v2"] + ["limit"] * limited
        dashed = [line for line in _dashed(figure.axes[0]) if line.get_color() == "black"]
        assert bool(dashed) == limited


def test_limited_speeds_are_drawn_with_their_limits() -> None:
    """A vehicle's own limit is drawn beside the scenario's; the curves are the norms."""
    free = straight(3)
    assert len(rho.velocities_figure(free).axes) == 3
    own = dataclasses.replace(free.scenario.vehicles[0], limits=rho.Limits(max_speed=1.5))
    vehicles = (own, *free.scenario.vehicles[1:])
    limits = rho.Limits(max_speed=1.6)
    plan = rho.plan_convex(dataclasses.replace(free.scenario, vehicles=vehicles, limits=limits))
    ax = rho.velocities_figure(plan).axes[3]
    dashed = [line.get_ydata() for line in _dashed(ax) if line.get_color() == "black"]
    assert sorted(float(np.asarray(y)[0]) for y in dashed) == [1.5, 1.6]
    for vehicle, norms in zip(
        plan.scenario.vehicles, np.linalg.norm(plan.velocities, axis=2), strict=True
    ):
        (curve,) = (line for line in ax.lines if line.get_label() == vehicle.name)
        shown = float(np.max(np.asarray(curve.get_ydata())))
        assert shown == pytest.approx(norms.max(), abs=1e-5 * norms.max())


def test_limited_norms_of_accelerations_are_drawn_with_their_limits() -> None:
    free = straight(2)
    limits = rho.Limits(max_acceleration=1.0, max_thrust=10.4, max_tilt=0.2)
    plan = rho.plan_convex(dataclasses.replace(free.scenario, limits=limits))
    axes = rho.accelerations_figure(plan).axes
    thrusts = plan.accelerations + np.array([0.0, 0.0, 9.81])
    tilts = np.arctan2(np.hypot(thrusts[..., 0], thrusts[..., 1]), thrusts[..., 2])
    norms = [np.linalg.norm(each, axis=2) for each in (plan.accelerations, thrusts)]
    for ax, most, values in zip(axes[3:], (1.0, 10.4, 0.2), (*norms, tilts), strict=True):
        (dashed,) = (line for line in _dashed(ax) if line.get_color() == "black")
        assert float(np.asarray(dashed.get_ydata())[0]) == most
        (curve,) = (line for line in ax.lines if line.get_label() == "v1")
        np.testing.assert_allclose(
            np.asarray(curve.get_ydata())[::2], values[1], atol=1e-5 * np.max(values)
        )
    assert [ax.get_xlabel() for ax in axes] == [""] * 5 + ["time [s]"]
    assert len(rho.velocities_figure(plan).axes) == 3


@pytest.mark.parametrize(
    "ends",
    [
        pytest.param([[[0, 0, 1], [20, 3, 1]], [[0, 8, 1], [20, 0, 1]]], id="flat"),
        pytest.param(
            [[[0, 0, 1], [20, 3, 1.3]], [[0, 8, 1.5], [20, 0, 1]]],
            id="nearly flat",
            marks=pytest.mark.slow,
        ),
        pytest.param([[[0, 0, 1], [20, 0, 1]]], id="line", marks=pytest.mark.slow),
        pytest.param(
            [[[0, 0, 1], [0, 20, 9]], [[0, 0, 5], [0, 20, 1]]], id="wall", marks=pytest.mark.slow
        ),
        pytest.param([[[0, 0, 0], [3, 0, 20]], [[0, 2, 0], [0, 0, 20]]], id="tower"),
        pytest.param([[[0, 0, 1], [0, 0, 1]]], id="point", marks=pytest.mark.slow),
        pytest.param([[[-2e3, 0, -2e3], [3e3, 0, 0]]], id="upright"),
        pytest.param(
            [[[0, 0, 0], [16, 8, 5]], [[0, 8, 5], [16, 0, 0]]], id="long", marks=pytest.mark.slow
        ),
    ],
)
def test_labels_of_the_axes_overlap_nothing(ends: list[list[list[float]]]) -> None:
    scenario = _between(ends)
    vehicles = tuple(
        dataclasses.replace(each, name=f"scout {n}") for n, each in enumerate(scenario.vehicles)
    )
    figure = rho.paths_figure(rho.plan_convex(dataclasses.replace(scenario, vehicles=vehicles)))
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    figure.draw(renderer)
    ax = figure.axes[0]
    assert isinstance(ax, Axes3D)
    axes = (ax.xaxis, ax.yaxis, ax.zaxis)
    texts = [each.label for each in axes] + figure.texts + figure.legends[0].get_texts()
    for each in axes:
        low, high = each.get_view_interval()
        ticks = [tick for tick in each.get_major_ticks() if low <= tick.get_loc() <= high]
        assert len(ticks) >= 2
        texts += [tick.label1 for tick in ticks]
    outlines = [_outline(text, renderer) for text in texts]
    for handle in figure.legends[0].legend_handles:
        assert isinstance(handle, Line2D)
        outlines.append(Outline(handle.get_window_extent(renderer).corners()[[0, 1, 3, 2]]))
    for one, other in combinations(outlines, 2):
        assert not one.intersects_path(other, filled=True)
    corners = np.concatenate([outline.vertices for outline in outlines])
    assert np.all(corners >= 0.0)
    assert np.all(corners <= [figure.bbox.width, figure.bbox.height])


def _outline(text: Text, renderer: RendererBase) -> Outline:
    """Return the rectangle around a text, turned like the text."""
    centre = text.get_window_extent(renderer).get_points().mean(axis=0)
    angle = np.radians(text.get_rotation())
    text.set_rotation(0.0)
    size = text.get_window_extent(renderer).size
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return Outline(centre + corners @ turn.T, closed=False)


def _between(ends: list[list[list[float]]]) -> rho.Scenario:
    """Return vehicles with these starts and goals and without separation."""
    starts, goals = np.array(ends, dtype=np.float64).swapaxes(0, 1)
    return dataclasses.replace(fleet_of(starts, goals), separation=None, between_knots=False)


def test_waypoints_are_drawn_as_diamonds_and_named_in_the_legend() -> None:
    free = straight(2)
    by = rho.Waypoint(time=1.0, position=[1.0, 40.0, 1.0], within=100.0)  # beyond all paths
    own = dataclasses.replace(free.scenario.vehicles[0], waypoints=(by,))
    vehicles = (own, *free.scenario.vehicles[1:])
    plan = rho.plan_convex(dataclasses.replace(free.scenario, vehicles=vehicles))
    figure = rho.paths_figure(plan)
    ax = figure.axes[0]
    assert isinstance(ax, Axes3D)
    (mark,) = (line for line in ax.lines if line.get_marker() == "D")
    assert isinstance(mark, Line3D)
    np.testing.assert_array_equal(np.ravel(mark.get_data_3d()), by.position)
    low, high = ax.get_ylim()
    assert low < 40.0 < high
    assert any("diamond: waypoint" in text.get_text() for text in figure.texts)
    assert not any("diamond" in text.get_text() for text in rho.paths_figure(free).texts)


def test_rounding_errors_are_not_magnified_on_axes_of_constants() -> None:
    plan = rho.plan_convex(_between([[[0, 0, 1], [20, 0, 1]]]))
    accelerations = np.array(plan.accelerations)
    accelerations[..., 1] = 1e-16 * (-1.0) ** np.arange(accelerations.shape[1])
    flown = rho.Plan.from_accelerations(plan.scenario, accelerations)
    largest = np.abs(accelerations).max()
    for figure in (rho.accelerations_figure(flown), rho.velocities_figure(flown)):
        low, high = figure.axes[1].get_ylim()
        assert high - low > 0.01 * largest
    low, high = rho.accelerations_figure(flown).axes[0].get_ylim()
    assert low < -largest < largest < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "names"),
    [
        ("paper", ["paths", "distances", "velocities", "accelerations"]),
        ("fleet", ["paths", "separation", "velocities", "accelerations"]),
    ],
)
def test_all_figures_of_a_plan_are_written(
    scenario: str, names: list[str], plan: rho.Plan, fleet: rho.Plan, tmp_path: Path
) -> None:
    drawn = plan if scenario == "paper" else fleet
    paths = write_figures(drawn, tmp_path / "new", width=SINGLE_COLUMN)
    assert [path.stem for path in paths] == names
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(
        f"{name}.png" for name in names
    )
    assert all(imread(path).std() > 0.05 for path in paths)


@pytest.mark.slow
def test_sixteen_figures_are_written(study: Study, tmp_path: Path) -> None:
    done: list[str] = []
    paths = write_paper_figures(study, tmp_path / "new" / "figures", done.append)
    names = [f"fig{number:02}.png" for number in range(3, 19)]
    assert [path.name for path in paths] == names == done
    assert sorted(path.name for path in paths[0].parent.iterdir()) == names
    images = [imread(path) for path in paths]
    assert all(image.shape[1] == 2148 for image in images)  # 7.16 in of 300 dots
    assert all(image.std() > 0.05 for image in images)  # none is blank


def test_a_figure_that_looks_the_same_is_not_rewritten(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A figure that looks different is written, and so is one over a file that is no image."""
    grey = np.full((20, 30, 3), 100, np.uint8)

    def drawn(number: int, *_: object, **__: object) -> Figure:
        figure = Figure(figsize=(0.1, 0.1), dpi=300)
        figure.figimage(grey + {3: 0, 4: 1, 5: 2}.get(number, 0))
        return figure

    monkeypatch.setattr("drake_rho.paper.figures.draw_figure", drawn)
    paths = write_paper_figures(study, tmp_path)
    before = [path.read_bytes() for path in paths]
    for path in (*paths[1:3], tmp_path / "fig07.png"):
        path.write_bytes(before[0])
    paths[3].write_text("no picture")
    write_paper_figures(study, tmp_path)
    assert [path.read_bytes() for path in paths] == [before[0], before[0], *before[2:]]


@pytest.mark.slow
def test_every_figure_names_its_example(study: Study) -> None:
    titles = [draw_figure(number, study).get_suptitle() for number in NUMBERS]
    assert [title.split(":")[0] for title in titles] == [
        f"Example {number}" for number in (1, 2, 3, 4) for _ in range(4)
    ]
    with pytest.raises(ValueError, match="3 to 18"):
        draw_figure(2, study)


def test_the_tables_show_every_required_number(study: Study) -> None:
    console = Console(width=80, record=True, file=StringIO())
    console.print(study_table(study), claims_table(study))
    text = console.export_text()
    for words in ("20920.353", "17027.239", "UAV-4 [m]", "speed [m/s]", "programs", "[ms]"):
        assert words in text
    for number in range(1, 7):
        assert re.search(rf"^{number}  \w", text, re.MULTILINE)
