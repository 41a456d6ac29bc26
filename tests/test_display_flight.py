"""Simulations in figures: the true motion beside its plans, errors beside the tube's radii."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3D

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.common.style import vehicle_colours
from drake_rho.display.plots import curves, distances, space
from drake_rho.display.plots import tube_errors as errors
from drake_rho.display.plots.figures import write_figures
from drake_rho.display.plots.formats import SINGLE_COLUMN

NAMES = ("scout", "cargo")


def mission(start: float = 0.0, wind: float = 0.6) -> rho.Scenario:
    """Return two vehicles that pass each other and a sphere, in wind."""
    ends = (([0.0, 0.0, 1.0], [10.0, 0.5, 1.5]), ([10.0, 1.2, 1.2], [0.0, 0.3, 1.0]))
    vehicles = [
        rho.Vehicle(name, rho.State(begin), rho.State(end), radius=0.1)
        for name, (begin, end) in zip(NAMES, ends, strict=True)
    ]
    return rho.Scenario(
        name="gap",
        grid=rho.Grid(0.25, 41, start),
        vehicles=vehicles,
        limits=rho.Limits(acceleration=rho.Box([-3.0] * 3, [3.0] * 3), max_speed=4.0),
        obstacles=[rho.Sphere([5.0, 0.2, 1.2], 1.0), rho.Box([2.5, -2.0, 0.0], [3.2, -0.2, 2.5])],
        separation=rho.Separation(0.6),
        disturbance=rho.Disturbance(wind, 0.01, 0.03, feedback_every=0.05, delay=1, share=0.4),
    )


def in_noise(start: float = 0.0) -> rho.Simulation:
    """Return the mission in noise, with errors of the estimate."""
    scenario = mission(start)
    wind = rho.winds.coloured_noise(scenario, np.random.default_rng(1), intensity=0.8)
    return rho.simulate(scenario, wind=wind, rng=np.random.default_rng(2))


@pytest.fixture(scope="module")
def simulation() -> rho.Simulation:
    """Return the mission in noise."""
    return in_noise()


def _curve(line: Line2D) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def _dotted(ax: Axes) -> list[Line2D]:
    return [line for line in ax.lines if line.get_linestyle() == ":"]


@pytest.mark.parametrize("worst", [False, True])
def test_the_drawn_paths_are_the_true_positions(worst: bool) -> None:
    """The times of the record include those at which the wind switches."""
    scenario = mission(start=3.0)
    wind = rho.worst_case(scenario, [1.0, 2.0, 3.0], 7.3) if worst else None
    simulation = rho.simulate(scenario, wind=wind)
    elapsed = simulation.times - scenario.grid.start
    shown = drawn(simulation)
    for quantity, true in (("position", simulation.positions), ("velocity", simulation.velocities)):
        found = shown.motion().at(quantity, elapsed)  # type: ignore[arg-type]
        off = np.linalg.norm(np.swapaxes(found, 0, 1) - true, axis=2).max()
        step = 0.05 / 10.0
        allowed = 0.6 * (step**2 / 4.0 if quantity == "position" else step)
        assert off <= (allowed if worst else 1e-9)
    knots = np.searchsorted(simulation.times, scenario.grid.times - 1e-9)
    np.testing.assert_allclose(
        np.swapaxes(shown.positions, 0, 1), simulation.positions[knots], atol=1e-9
    )
    times, values = shown.commands
    np.testing.assert_array_equal(times, simulation.times)
    np.testing.assert_array_equal(values[1], simulation.commands[:-1, 1])


def test_records_of_constant_accelerations_are_drawn_exactly_at_any_times() -> None:
    scenario = dataclasses.replace(mission(), disturbance=None)
    flight = rho.plan_rho(scenario)
    motion, rng = flight.plan.motion(), np.random.default_rng(3)
    times = np.unique([*scenario.grid.times, *rng.uniform(0.0, 10.0, 25)])
    p, v, a = (motion.at(each, times) for each in ("position", "velocity", "acceleration"))
    p, v, a = (np.swapaxes(each, 0, 1) for each in (p, v, a))
    by_hand = rho.Simulation(flight, times, p, v, np.zeros_like(a), a)
    times = np.linspace(0.0, 10.0, 501)
    off = drawn(by_hand).motion().at("position", times) - motion.at("position", times)
    # knots within a step of the drawn motion change the acceleration there
    assert np.linalg.norm(off, axis=2).max() <= 6.0 * 0.25**2 / 4.0


def test_errors_are_drawn_below_the_radii_of_each_window(simulation: rho.Simulation) -> None:
    ax = Figure().subplots()
    lines = errors.draw_errors(ax, simulation, "position")
    starts = [window.plan.scenario.grid.start for window in simulation.flight.windows]
    assert len(lines) == 2 * len(starts) + 1
    bodies = [each for each in ax.collections if isinstance(each, PolyCollection)]
    assert len(bodies) == len(starts)
    for number, (begin, end) in enumerate(zip(starts, [*starts[1:], 10.0], strict=True)):
        for index, colour in enumerate(vehicle_colours(2)):
            line = lines[2 * number + index]
            assert line.get_color() == colour
            times, found = _curve(line)
            assert times[0] == pytest.approx(begin)
            assert times[-1] == pytest.approx(end)
            here = (simulation.times >= begin - 1e-9) & (simulation.times < end - 1e-9)
            np.testing.assert_array_equal(found[: here.sum()], simulation.errors()[here, index])
            radii = simulation.tubes[number].position(times)
            assert np.all(found <= radii * (1 + 1e-9) + 1e-12)
            drawn_radii = np.asarray(bodies[number].get_paths()[0].vertices)[:, 1]
            assert drawn_radii.min() == pytest.approx(radii.min())  # grey is above
    times, found = _curve(lines[-1])
    assert found == pytest.approx(max(_curve(line)[1].max() for line in lines[:-1]))
    label = str(lines[-1].get_label())
    assert label.startswith(f"{found[0]:.3g} m at {times[0]:.4g} s: ")
    assert "of the radius" in label


def test_where_a_tube_is_replaced_both_errors_are_drawn(
    simulation: rho.Simulation,
) -> None:
    before, after = errors.errors_of(simulation, "position")[:2]
    assert before.times[-1] == after.times[0] == 1.25
    m = int(np.searchsorted(simulation.times, 1.25 - 1e-9))
    planned_then = simulation.flight.windows[0].plan.positions[:, 5]
    missed = np.linalg.norm(simulation.positions[m] - planned_then, axis=1)
    np.testing.assert_allclose(before.errors[-1], missed, atol=1e-12)
    assert before.radii[-1] > 5.0 * after.radii[0]


@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration"])
def test_the_worst_wind_is_drawn_at_the_edge_of_the_tube(quantity: str) -> None:
    scenario = mission()
    wind = rho.worst_case(scenario, [0.0, 0.0, 1.0], 6.0, quantity)  # type: ignore[arg-type]
    simulation = rho.simulate(
        scenario, wind=wind, replan_every=40
    )  # one window: no tube is replaced
    (found,) = errors.errors_of(simulation, quantity)  # type: ignore[arg-type]
    m = int(np.searchsorted(found.times, 6.0 - 1e-9))
    assert found.errors[m, 0] == pytest.approx(found.radii[m], rel=1e-9)
    assert errors.greatest_ratio([found]) == pytest.approx(1.0, rel=1e-9)


def test_without_a_disturbance_errors_have_no_radius() -> None:
    simulation = rho.simulate(dataclasses.replace(mission(), disturbance=None))
    ax = Figure().subplots()
    lines = errors.draw_errors(ax, simulation, "position")
    assert "radius" not in str(lines[-1].get_label())
    rho.errors_figure(simulation)


def test_distances_are_those_of_the_true_motion_with_the_planned_ones_dotted(
    simulation: rho.Simulation,
) -> None:
    obstacle = simulation.scenario.bodies[0]
    ax = Figure().subplots()
    lines = distances.draw_distances(ax, drawn(simulation), obstacle)
    true = np.swapaxes(simulation.positions, 0, 1)
    expected = obstacle.distances(true, simulation.times)
    for index, line in enumerate(lines):
        times, found = _curve(line)
        np.testing.assert_allclose(
            np.interp(simulation.times, times, found), expected[index], atol=1e-3
        )
    nominal = np.swapaxes(simulation.nominal("position"), 0, 1)
    beside = obstacle.distances(nominal, simulation.times)
    dotted = _dotted(ax)
    assert len(dotted) == 2 * len(simulation.flight.windows)
    for number, line in enumerate(dotted):
        times, found = _curve(line)
        inside = (simulation.times > times[0]) & (simulation.times < times[-1])
        at = np.interp(simulation.times[inside], times, found)
        np.testing.assert_allclose(at, beside[number % 2, inside], atol=1e-3)


def test_separation_is_that_of_the_true_motion(simulation: rho.Simulation) -> None:
    ax = Figure().subplots()
    curve, ring = curves.draw_separation(ax, drawn(simulation))
    apart = np.linalg.norm(simulation.positions[:, 0] - simulation.positions[:, 1], axis=1)
    times, found = _curve(curve)
    np.testing.assert_allclose(np.interp(simulation.times, times, found), apart, atol=1e-4)
    assert _curve(ring)[1] == pytest.approx(apart.min(), abs=1e-5)
    assert len(_dotted(ax)) == len(simulation.flight.windows)


def test_paths_are_the_true_motion_in_the_colours_of_the_windows(
    simulation: rho.Simulation,
) -> None:
    ax = Figure().add_subplot(projection="3d")
    windows = space.draw_windows(ax, drawn(simulation))
    assert len(windows) == len(simulation.flight.windows)
    for index in range(2):
        pieces = [np.array(lines[index].get_data_3d()).T for lines in windows]
        assert all(np.allclose(one[-1], other[0]) for one, other in pairwise(pieces))
        np.testing.assert_allclose(pieces[0][0], simulation.positions[0, index], atol=1e-9)
        np.testing.assert_allclose(pieces[-1][-1], simulation.positions[-1, index], atol=1e-9)


def test_a_single_window_has_vehicle_colours_and_a_dotted_plan() -> None:
    scenario = mission()
    wind = rho.winds.constant(scenario, [0.0, 0.0, 1.0])
    simulation = rho.simulate(scenario, wind=wind, replan_every=40)
    figure = rho.paths_figure(simulation)
    assert len(figure.axes) == 1  # no bar of windows
    assert any("dotted: planned" in text.get_text() for text in figure.texts)
    (ax,) = figure.axes
    for index, colour in enumerate(vehicle_colours(2)):
        lines = [line for line in ax.lines if isinstance(line, Line3D)]
        mine = [line for line in lines if line.get_color() == colour]
        for true, dotted in ((simulation.positions, False), (simulation.nominal("position"), True)):
            pieces = [line for line in mine if (line.get_linestyle() == ":") == dotted]
            points = np.concatenate([np.array(line.get_data_3d()).T for line in pieces])
            points = points[np.isfinite(points[:, 0])]
            away = np.linalg.norm(true[::50, index, None] - points, axis=2).min(axis=1)
            assert away.max() <= 1e-3


def test_plans_are_drawn_beside_the_true_motion_of_small_fleets(simulation: rho.Simulation) -> None:
    assert len(drawn(simulation).planned) == len(simulation.flight.windows)
    assert drawn(simulation.flight).planned == ()
    scenario = mission()
    many = [
        rho.Vehicle(f"{n}", rho.State([0.0, n, 5.0]), rho.State([9.0, n, 5.0])) for n in range(15)
    ]
    assert drawn(rho.simulate(dataclasses.replace(scenario, vehicles=tuple(many)))).planned == ()


@pytest.mark.slow
def test_a_simulation_that_begins_late_looks_the_same() -> None:
    for early, late in zip(
        rho.errors_figure(in_noise()).axes, rho.errors_figure(in_noise(64.0)).axes, strict=True
    ):
        for line, other in zip(early.lines, late.lines, strict=True):
            (times, values), (later, same) = _curve(line), _curve(other)
            np.testing.assert_allclose(later, times + 64.0, atol=1e-9)
            np.testing.assert_allclose(same, values, atol=1e-6)


@pytest.mark.slow
def test_all_figures_of_a_simulation_are_written(
    simulation: rho.Simulation, tmp_path: Path
) -> None:
    names = ("paths", "distances", "separation", "velocities", "accelerations", "errors")
    assert [path.stem for path in write_figures(simulation, tmp_path, width=SINGLE_COLUMN)] == list(
        names
    )
