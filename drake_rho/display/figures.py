"""Whole figures of a plan, a flight, or a simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_rho.display.curves import (
    draw_accelerations,
    draw_norm,
    draw_separation,
    draw_velocities,
)
from drake_rho.display.distances import (
    draw_distances,
    draw_distances_from_centre,
    draw_least_clearances,
)
from drake_rho.display.errors import LABELS, draw_errors, tube_handle
from drake_rho.display.flown import Drawn, Flown, drawn, planned, windows_of
from drake_rho.display.frame import Room, fit_scene, frame_scene
from drake_rho.display.hidden import marks_every
from drake_rho.display.legends import (
    add_below,
    add_beside,
    in_width,
    start_handles,
    vehicle_handles,
    width_beside,
)
from drake_rho.display.names import as_text, brief
from drake_rho.display.publish import (
    DOUBLE_COLUMN,
    check_format,
    check_width,
    save_figure,
    styled,
)
from drake_rho.display.snapshots import (
    approaches,
    as_bodies,
    called,
    obstacle_notes,
    snapshots,
    ways,
)
from drake_rho.display.space import (
    MOST_LABELLED,
    draw_approaches,
    draw_obstacle_labels,
    draw_obstacles,
    draw_paths,
    draw_planned_paths,
    draw_ways,
    draw_windows,
)
from drake_rho.display.style import LIMIT_STYLE, MOST_NAMED, PLANNED_STYLE, window_colours
from drake_rho.motion.plan import Flight
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.quadrics import Sphere
from drake_rho.scenario.shapes import Shape

_MOST_PANELS = 4
"""Most obstacles with a panel each."""
_ONE_ROW = 0.25
"""Height of a legend for which curves have room anyway [in]."""
_EDGE = 0.06
"""Between what is in a figure and its edge [in]."""
_LINE = 0.135
"""Height of a line of notes [in]."""
_TITLE = 0.2
"""Height of a title [in]."""
_BAR = 0.7
"""Width of the bar of windows with its labels [in]."""
_BAR_WIDTH = 0.12
"""Without them [in]."""
_MOST_TICKS = 12
"""Most windows that are numbered."""


_LEAST_BESIDE = 5.0
"""Narrowest figure with a legend beside its scene [in]."""
_HIGHEST = (1.1, 0.45)
"""Most height of a scene: so much [in], and so much of its figure's width."""


@styled
def paths_figure(
    flown: Flown,
    *,
    obstacles: Sequence[Shape | Obstacle] | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """The vehicles' paths in space, around the obstacles; each window of a flight in its colour.

    Args:
        flown: what to draw.
        obstacles: what to draw in the way, if not the scenario's own.
        width: of the figure [in], 3.5 in one column of a journal of the IEEE, 7.16 in both.

    Raises:
        ValueError: the width is none that letters can be read at.
    """
    plan, figure = drawn(flown), Figure(figsize=(check_width(width), width))
    bodies = as_bodies(plan.scenario.obstacles if obstacles is None else obstacles)
    shown, windows = snapshots(plan, bodies), windows_of(flown)
    in_windows = len(windows) > 1 or isinstance(flown, Flight)
    ax = figure.add_subplot(projection="3d")
    passed = [each.position for vehicle in plan.scenario.vehicles for each in vehicle.waypoints]
    flights = [plan, *(window.plan for window in windows)]
    places = [each.positions.reshape(-1, 3) for each in flights]
    frame_scene(ax, np.concatenate([*places, np.reshape(passed, (-1, 3))]), shown)
    named = in_windows and len(plan.positions) <= MOST_LABELLED
    handles = (start_handles if in_windows else vehicle_handles)(plan.scenario)
    handles = [] if named else handles
    notes = _notes(figure, flown, bodies)
    below = 2 * _EDGE + _LINE * len(notes)
    aside = _BAR if in_windows else width_beside(figure, handles)
    beside = aside is not None and (in_windows or width >= _LEAST_BESIDE)
    room = Room(
        _EDGE,
        below,
        width - 2 * _EDGE - (aside if beside else 0.0),
        _HIGHEST[0] + _HIGHEST[1] * width,
    )
    scene = fit_scene(figure, ax, room)
    aside_at = scene.x1 + (room.left + room.width - scene.x1) / 2  # half of what is left between
    _grow(figure, above=_EDGE)
    draw_obstacles(ax, shown)
    draw_ways(ax, ways(plan, bodies), shown)
    draw_approaches(ax, approaches(plan, bodies))
    draw_obstacle_labels(ax, shown)
    if in_windows:
        draw_windows(ax, flown, shown)
        place = (aside_at + _EDGE, scene.y0 + 0.2 * scene.height, _BAR_WIDTH, 0.6 * scene.height)
        _add_window_bar(figure, len(windows), place)
    else:
        draw_paths(ax, plan, shown)
        draw_planned_paths(ax, plan, shown)
    for line, words in enumerate(notes):
        at = (_EDGE + _LINE * line) / figure.get_figheight()
        figure.text(_EDGE / width, at, words, fontsize=7, va="bottom")
    if beside and not in_windows:
        add_beside(figure, handles, aside_at)
    else:
        _grow(figure, below=add_below(figure, handles))
    return figure


def _notes(figure: Figure, flown: Flown, bodies: Sequence[Obstacle]) -> list[str]:
    """What the marks and lines of paths mean, in lines from below as wide as the figure."""
    plan, windows = drawn(flown), windows_of(flown)
    words = ["ring: start", "star: goal"]
    if len(windows) > 1 or isinstance(flown, Flight):
        words = ["thick: flown", "thin: the rest of each window's prediction", *words]
    else:
        if len(plan.positions) <= MOST_NAMED:
            every = marks_every(len(plan.times), figure.get_figwidth())
            words.append("a mark at every knot" if every == 1 else f"a mark every {every} knots")
        words += ["dotted: planned"] if planned(plan) else []
    if any(vehicle.waypoints for vehicle in plan.scenario.vehicles):
        words.append("diamond: waypoint")
    room = figure.get_figwidth() - 2 * _EDGE
    notes = ["; ".join(words), *obstacle_notes(plan, bodies)]
    return [line for note in notes for line in in_width(figure, note, room).split("\n")][::-1]


@styled
def distances_figure(
    flown: Flown,
    *,
    obstacles: Sequence[Shape | Obstacle] | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """The vehicles' distances from the obstacles over time.

    From each of a few: from their centres if all are spheres, else from their surfaces. Of more
    obstacles, each vehicle's least clearance from all of them: the distance from the surface less
    the vehicle's radius.

    Args:
        flown: what to draw.
        obstacles: measured from these, if not from the scenario's own.
        width: of the figure [in], see `paths_figure`.

    Raises:
        ValueError: there is no obstacle, or the width is none that letters can be read at.
    """
    plan = drawn(flown)
    bodies = as_bodies(plan.scenario.obstacles if obstacles is None else obstacles)
    if not bodies:
        raise ValueError("obstacles: got none, expected at least one to measure from")
    handles = [*vehicle_handles(plan.scenario), _limit_handle(), *_planned_handles(plan)]
    if len(bodies) > _MOST_PANELS:
        figure = _panels(width, 1, 1.35)
        draw_least_clearances(figure.subplots(), plan, bodies)
        return _with_legend(figure, handles)
    figure = _panels(width, len(bodies), 1.1)
    axes = figure.subplots(len(bodies), squeeze=False)[:, 0]
    spheres = [each.shape for each in bodies if isinstance(each.shape, Sphere)]
    for index, (ax, body) in enumerate(zip(axes, bodies, strict=True)):
        name = None if body.name is None else as_text(brief(body.name))
        title = f"obstacle {called(index + 1, body) if len(bodies) > 1 else name}"
        title_of = title if len(bodies) > 1 or name is not None else None
        if len(spheres) == len(bodies):
            draw_distances_from_centre(ax, plan, body, spheres[index], title=title_of)
        else:
            draw_distances(ax, plan, body, title=title_of)
    return _with_legend(figure, handles)


@styled
def separation_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """The least distance of any two vehicles over time, exact, with the separation.

    Raises:
        ValueError: the scenario has no separation, or one vehicle only.
    """
    figure = _panels(width, 1, 1.1)
    plan = drawn(flown)
    draw_separation(figure.subplots(), plan)
    return _with_legend(figure, _planned_handles(plan))


@styled
def errors_figure(simulation: Simulation, *, width: float = DOUBLE_COLUMN) -> Figure:
    """How far the vehicles were off their plans, and what the feedback did, beside the tube.

    Where a window begins anew, so do the errors and the tube.
    """
    figure = _panels(width, 4, 0.8)
    axes = figure.subplots(len(LABELS), sharex=True, height_ratios=(2, 1, 1))
    for ax, quantity in zip(axes, LABELS, strict=True):
        draw_errors(ax, simulation, quantity)
    for ax in axes[:-1]:
        ax.set_xlabel("")
    handles = vehicle_handles(simulation.scenario)
    for handle in handles:
        handle.set_marker("none")
    return _with_legend(figure, [*handles, tube_handle()])


@styled
def velocities_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """The components of the velocities over time, with their bounds; speeds if they are limited."""
    return _components(drawn(flown), draw_velocities, "velocity", width)


@styled
def accelerations_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """The components of the accelerations over time, with their bounds.

    Below them norms, thrusts and tilts, each if it is limited.
    """
    return _components(drawn(flown), draw_accelerations, "acceleration", width)


def write_figures(
    flown: Flown, folder: str | Path, *, file_format: str = "png", width: float = DOUBLE_COLUMN
) -> list[Path]:
    """Write every figure that there is of a plan, flight or simulation, as `paths.png`.

    Args:
        flown: what to draw.
        folder: made if it is not there.
        file_format: png, pdf or svg.
        width: of each figure [in], see `paths_figure`.

    Raises:
        ValueError: there is no such format, or the width is none that letters can be read at.
        OSError: a file cannot be written.
    """
    check_format(file_format)
    scenario = flown.scenario
    draw: dict[str, Callable[..., Figure]] = {"paths": paths_figure}
    if scenario.obstacles:
        draw["distances"] = distances_figure
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        draw["separation"] = separation_figure
    draw |= {"velocities": velocities_figure, "accelerations": accelerations_figure}
    if isinstance(flown, Simulation):
        draw["errors"] = errors_figure
    figures = {name: each(flown, width=width) for name, each in draw.items()}
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [
        save_figure(figure, folder / f"{name}.{file_format}") for name, figure in figures.items()
    ]


@styled
def add_title(figure: Figure, words: str) -> None:
    """Write a title above all that is in a figure."""
    if figure.get_layout_engine() is None:
        _grow(figure, above=_TITLE)
    figure.suptitle(words, y=None if figure.get_layout_engine() else 1.0 - _EDGE / 2, va="top")


def _components(
    plan: Drawn,
    draw: Callable[[Sequence[Axes], Drawn], list[Line2D]],
    quantity: Quantity,
    width: float,
) -> Figure:
    """The components of a quantity, and below them what limits on norms of it are about."""
    limited = plan.scenario.fleet.norms
    norms = [norm for norm in limited if limited[norm].kind.quantity == quantity]
    figure = _panels(width, 3 + len(norms), 0.6)
    axes = list(figure.subplots(3 + len(norms), sharex=True))
    draw(axes[:3], plan)
    for norm, ax in zip(norms, axes[3:], strict=True):
        draw_norm(ax, plan, norm)
    for ax in axes[:-1]:
        ax.set_xlabel("")
    handles = vehicle_handles(plan.scenario)
    if norms or plan.scenario.fleet.bounds(quantity) is not None:
        handles.append(_limit_handle())
    return _with_legend(figure, handles)


def _planned_handles(plan: Drawn) -> list[Line2D]:
    """Legend entry of what was planned, where it is drawn beside the true motion."""
    if not planned(plan):
        return []
    return [Line2D([], [], label="planned", color="black", **PLANNED_STYLE)]


def _limit_handle() -> Line2D:
    return Line2D([], [], label="limit", **LIMIT_STYLE)


def _with_legend(figure: Figure, handles: Sequence[Line2D]) -> Figure:
    """The figure with a legend below the axes, which keep their height."""
    height = add_below(figure, handles)
    figure.set_figheight(figure.get_figheight() + max(0.0, height - _ONE_ROW))
    return figure


def _panels(width: float, count: int, part: float) -> Figure:
    """A figure for panels below each other, each so high in parts of the usual height."""
    height = 0.5 + count * part * (1.0 + 0.23 * check_width(width))
    return Figure(figsize=(width, height), layout="constrained")


def _grow(figure: Figure, *, below: float = 0.0, above: float = 0.0) -> None:
    """Make room below or above all that is in a figure [in]."""
    old = figure.get_figheight()
    new = old + below + above
    figure.set_figheight(new)
    for ax in figure.axes:
        x, y, wide, high = ax.get_position(original=True).bounds
        ax.set_position((x, (y * old + below) / new, wide, high * old / new))
    for text in figure.texts:
        text.set_y((text.get_position()[1] * old + below) / new)


def _add_window_bar(figure: Figure, count: int, place: tuple[float, ...]) -> None:
    """The colours of the windows, at left, bottom, width and height [in]."""
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    x, y, wide, high = np.array(place) / np.tile(figure.get_size_inches(), 2)
    bar = figure.colorbar(mappable, cax=figure.add_axes((x, y, wide, high)))
    numbers = range(1, count + 1, ceil(count / _MOST_TICKS))
    bar.set_ticks(numbers, labels=[str(number) for number in numbers])
    bar.minorticks_off()
    bar.set_label("window")
