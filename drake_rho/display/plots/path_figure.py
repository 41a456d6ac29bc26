"""Three-dimensional figure of the paths of a plan, a flight or a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from drake_rho.display.common.drawable import drawn, planned
from drake_rho.display.common.obstacle_snapshots import (
    approaches,
    as_obstacles,
    obstacle_notes,
    obstacle_paths,
    snapshots,
)
from drake_rho.display.common.style import MAX_NAMED, window_colours
from drake_rho.display.plots.axes3d import Area, SceneAxes, fit_scene, frame_scene
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.plots.layout import EDGE, grow
from drake_rho.display.plots.legends import (
    add_below,
    add_beside,
    in_width,
    start_handles,
    vehicle_handles,
    width_beside,
)
from drake_rho.display.plots.overlapping_curves import marks_every
from drake_rho.display.plots.publish import styled
from drake_rho.display.plots.space import (
    MAX_LABELLED,
    draw_approaches,
    draw_obstacle_labels,
    draw_obstacle_paths,
    draw_obstacles,
    draw_paths,
    draw_planned_paths,
    draw_windows,
)
from drake_rho.motion.flown import Flown
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape

_LINE = 0.135
"""Height of a line of notes [in]."""
_BAR = 0.7
"""Width of the colour bar of windows with its labels [in]."""
_BAR_WIDTH = 0.12
"""Width of the colour bar without its labels [in]."""
_MAX_TICKS = 12
"""Largest number of windows that are numbered."""
_MIN_BESIDE = 5.0
"""Least width of a figure with a legend beside its scene [in]."""
_HIGHEST = (1.1, 0.45)
"""Largest height of a scene: a constant [in] plus a fraction of the figure's width."""


@checked
@styled
def paths_figure(
    flown: Flown,
    *,
    obstacles: Sequence[Shape | Obstacle] | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """Plot the vehicles' paths and the obstacles in space, with a colour for each window.

    A plan has no windows; each of its vehicles has a colour of its own.

    Args:
        flown: plan, flight or simulation to draw.
        obstacles: obstacles to draw; the scenario's if not given.
        width: of the figure [in]; in IEEE journals 3.5 for one column, 7.16 for two.

    Raises:
        ValueError: the text would be illegible at the width.

    Examples:
        >>> figure = rho.paths_figure(rho.plan(rho.load_scenario("paper")))
        >>> path = rho.save_figure(figure, folder / "paths.png")
    """
    plan, figure = drawn(flown), Figure(figsize=(check_width(width), width))
    bodies = as_obstacles(plan.scenario.obstacles if obstacles is None else obstacles)
    shown, windows = snapshots(plan, bodies), flown.windows
    in_windows = len(windows) > 1 or flown.kind == "flight"
    ax = figure.add_subplot(axes_class=SceneAxes)
    passed = [each.position for vehicle in plan.scenario.vehicles for each in vehicle.waypoints]
    flights = [plan, *(window.plan for window in windows)]
    places = [each.positions.reshape(-1, 3) for each in flights]
    frame_scene(ax, np.concatenate([*places, np.reshape(passed, (-1, 3))]), shown)
    named = in_windows and len(plan.positions) <= MAX_LABELLED
    handles = (start_handles if in_windows else vehicle_handles)(plan.scenario)
    handles = [] if named else handles
    notes = _notes(figure, flown, bodies)
    below = 2 * EDGE + _LINE * len(notes)
    beside = _BAR if in_windows else width_beside(figure, handles)
    if beside is None or not (in_windows or width >= _MIN_BESIDE):
        beside = 0.0
    max_height = _HIGHEST[0] + _HIGHEST[1] * width
    area = Area(EDGE, below, width - 2 * EDGE - beside, max_height)
    scene = fit_scene(figure, ax, area)
    beside_at = scene.x1 + (area.left + area.width - scene.x1) / 2  # middle of the unused width
    grow(figure, above=EDGE)
    draw_obstacles(ax, shown)
    draw_obstacle_paths(ax, obstacle_paths(plan, bodies), shown)
    draw_approaches(ax, approaches(plan, bodies))
    draw_obstacle_labels(ax, shown)
    if in_windows:
        draw_windows(ax, flown, shown)
        place = (beside_at + EDGE, scene.y0 + 0.2 * scene.height, _BAR_WIDTH, 0.6 * scene.height)
        _add_window_bar(figure, len(windows), place)
    else:
        draw_paths(ax, plan, shown)
        draw_planned_paths(ax, plan, shown)
    for line, words in enumerate(notes):
        at = (EDGE + _LINE * line) / figure.get_figheight()
        figure.text(EDGE / width, at, words, fontsize=7, va="bottom")
    if beside > 0.0 and not in_windows:
        add_beside(figure, handles, beside_at)
    else:
        grow(figure, below=add_below(figure, handles))
    return figure


def _notes(figure: Figure, flown: Flown, bodies: Sequence[Obstacle]) -> list[str]:
    """Explain the marks and lines of paths, in lines as wide as the figure, the lowest first."""
    plan, windows = drawn(flown), flown.windows
    words = ["ring: start", "star: goal"]
    if len(windows) > 1 or flown.kind == "flight":
        words = ["thick: flown", "thin: the rest of each window's prediction", *words]
    else:
        if len(plan.positions) <= MAX_NAMED:
            every = marks_every(len(plan.times), figure.get_figwidth())
            words.append("a mark at every knot" if every == 1 else f"a mark every {every} knots")
        words += ["dotted: planned"] if planned(plan) else []
    if any(vehicle.waypoints for vehicle in plan.scenario.vehicles):
        words.append("diamond: waypoint")
    width = figure.get_figwidth() - 2 * EDGE
    notes = ["; ".join(words), *obstacle_notes(plan, bodies)]
    return [line for note in notes for line in in_width(figure, note, width).split("\n")][::-1]


def _add_window_bar(figure: Figure, count: int, place: tuple[float, ...]) -> None:
    """Add the colour bar of the windows at a place: left, bottom, width and height [in]."""
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    x, y, wide, high = np.array(place) / np.tile(figure.get_size_inches(), 2)
    bar = figure.colorbar(mappable, cax=figure.add_axes((x, y, wide, high)))
    numbers = range(1, count + 1, ceil(count / _MAX_TICKS))
    bar.set_ticks(numbers, labels=[str(number) for number in numbers])
    bar.minorticks_off()
    bar.set_label("window")
