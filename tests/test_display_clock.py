"""A flight that begins late on the scenario's clock looks like one that begins at 0."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydrake.math import RigidTransform

import drake_rho as rho
from drake_rho.display.common.drawable import drawn
from drake_rho.display.meshcat.playback import Playback
from drake_rho.display.meshcat.scene import Scene
from drake_rho.display.meshcat.trails import add_light_trails, add_predictions, add_trails
from drake_rho.display.meshcat.tree import Tree
from drake_rho.display.meshcat.vehicles import Vehicles, add_vehicles
from drake_rho.display.plots import space
from tests.scenarios import straight

LATE = 128.0
"""Start of the late flight [s], exact in binary."""


def _plan(start: float) -> rho.Plan:
    """Return three vehicles beside a sphere, with separation and a largest speed."""
    plan = straight(3)
    scenario = dataclasses.replace(
        plan.scenario,
        grid=dataclasses.replace(plan.scenario.grid, start=start),
        obstacles=(rho.Sphere([20.0, 5.0, 5.0], 1.0),),
        limits=rho.Limits(max_speed=50.0, max_acceleration=50.0, max_thrust=90.0),
        separation=rho.Separation(1e-6),
    )
    return rho.Plan.from_accelerations(scenario, plan.accelerations)


def _flight(start: float) -> rho.Flight:
    """Return the plan, flown by windows from its first and its eighth knot."""
    plan = _plan(start)
    windows = tuple(rho.Window(knot, plan.tail(knot), plan.tail(knot)) for knot in (0, 7))
    return rho.Flight(plan, windows)


@pytest.mark.parametrize(
    "draw",
    [
        rho.distances_figure,
        rho.separation_figure,
        rho.velocities_figure,
        rho.accelerations_figure,
    ],
)
def test_curves_are_drawn_on_the_clock_of_the_scenario(
    draw: Callable[[rho.Plan], Figure],
) -> None:
    early, late = draw(_plan(0.0)), draw(_plan(LATE))
    for one, other in zip(early.axes, late.axes, strict=True):
        np.testing.assert_allclose(np.array(other.get_xlim()), np.array(one.get_xlim()) + LATE)
        pairs = zip(_curves(one.lines), _curves(other.lines), strict=True)
        for (times, values), (later, same) in pairs:
            np.testing.assert_allclose(later, times + LATE, rtol=1e-12)
            np.testing.assert_array_equal(values, same)


def _curves(lines: Sequence[Line2D]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the points of all lines except horizontal ones from side to side."""
    points = [(np.asarray(line.get_xdata()), np.asarray(line.get_ydata())) for line in lines]
    return [(x, y) for x, y in points if list(x) != [0, 1]]


def test_windows_are_flown_up_to_the_same_positions() -> None:
    paths = []
    for start in (0.0, LATE):
        ax = Figure().add_subplot(projection="3d")
        windows = space.draw_windows(ax, drawn(_flight(start)))
        paths.append([np.array(line.get_data_3d()) for lines in windows for line in lines])
    for one, other in zip(*paths, strict=True):
        np.testing.assert_array_equal(one, other)


class _Recorder:
    """Recorder of the calls of a Meshcat."""

    def __init__(self) -> None:
        self.told: list[tuple[object, ...]] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        def note(*args: object, **options: object) -> None:
            plain = [
                each.GetAsMatrix34() if isinstance(each, RigidTransform) else each for each in args
            ]
            self.told.append((name, *plain))

        return note


def test_meshcat_receives_the_same_calls() -> None:
    reported = []
    for start in (0.0, LATE):
        shown, meshcat = drawn(_flight(start)), _Recorder()
        playback, scene = Playback.of(shown, None), Scene.of(shown)
        tree = Tree(meshcat, playback)
        add_trails(tree, scene, shown)
        add_light_trails(tree, shown)
        add_predictions(tree, shown.windows)
        add_vehicles(tree, scene, shown, Vehicles.of(scene, shown, playback))
        reported.append(meshcat.told)
    for one, other in zip(*reported, strict=True):
        assert one[:2] == other[:2]
        for mine, theirs in zip(one[2:], other[2:], strict=True):
            np.testing.assert_array_equal(mine, theirs)
