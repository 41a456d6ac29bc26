"""Whole figures of a plan, a flight, or a simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from drake_rho.display.frame import frame_scene
from drake_rho.display.legends import (
    add_below,
    add_beside,
    fits_beside,
    start_handles,
    vehicle_handles,
)
from drake_rho.display.names import as_text, brief
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
from drake_rho.display.style import LIMIT_STYLE, PLANNED_STYLE, window_colours
from drake_rho.motion.plan import Flight
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.files import replacing
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.quadrics import Sphere
from drake_rho.scenario.shapes import Shape

_WIDTH = 6.5
"""Width of a page's text [in]."""
_MOST_PANELS = 4
"""Most obstacles with a panel each."""
_ONE_ROW = 0.3
"""Height of a legend for which curves have room anyway [in]."""


def paths_figure(flown: Flown, *, obstacles: Sequence[Shape | Obstacle] | None = None) -> Figure:
    """The vehicles' paths in space, around the obstacles; each window of a flight in its colour.

    Args:
        flown: what to draw.
        obstacles: what to draw in the way, if not the scenario's own.
    """
    plan = drawn(flown)
    bodies = as_bodies(plan.scenario.obstacles if obstacles is None else obstacles)
    shown = snapshots(plan, bodies)
    figure = Figure(figsize=(_WIDTH, 4.8))
    ax = figure.add_axes((-0.03, 0.03, 0.93, 0.95), projection="3d")
    passed = [each.position for vehicle in plan.scenario.vehicles for each in vehicle.waypoints]
    places = np.array([*plan.positions.reshape(-1, 3), *passed])
    has_room = frame_scene(ax, places, shown)
    draw_obstacles(ax, shown)
    draw_ways(ax, ways(plan, bodies), shown)
    draw_approaches(ax, approaches(plan, bodies))
    draw_obstacle_labels(ax, shown)
    windows = windows_of(flown)
    in_windows = len(windows) > 1 or isinstance(flown, Flight)
    if in_windows:
        draw_windows(ax, flown, shown)
        _add_window_bar(figure, len(windows))
        named = len(plan.positions) <= MOST_LABELLED
        handles = [] if named else start_handles(plan.scenario)
        note = "thick: flown; thin: the rest of each window's prediction; ring: start; star: goal"
    else:
        draw_paths(ax, plan, shown)
        handles = vehicle_handles(plan.scenario)
        note = "ring: start; star: goal" + ("; a mark at every knot" if handles else "")
        note += "; dotted: planned" if draw_planned_paths(ax, plan, shown) else ""
    note += "; diamond: waypoint" if passed else ""
    for line, words in enumerate([note, *obstacle_notes(plan, bodies)]):
        figure.text(0.02, 0.02 + 0.03 * line, words, fontsize=8)
    if has_room and not in_windows and fits_beside(figure, handles):
        add_beside(figure, handles)
    else:
        _lift(figure, add_below(figure, handles))
    return figure


def distances_figure(
    flown: Flown, *, obstacles: Sequence[Shape | Obstacle] | None = None
) -> Figure:
    """The vehicles' distances from the obstacles over time.

    From each of a few: from their centres if all are spheres, else from their surfaces. Of more
    obstacles, each vehicle's least clearance from all of them: the distance from the surface less
    the vehicle's radius.

    Args:
        flown: what to draw.
        obstacles: measured from these, if not from the scenario's own.

    Raises:
        ValueError: there is no obstacle.
    """
    plan = drawn(flown)
    bodies = as_bodies(plan.scenario.obstacles if obstacles is None else obstacles)
    if not bodies:
        raise ValueError("obstacles: got none, expected at least one to measure from")
    handles = [*vehicle_handles(plan.scenario), _limit_handle(), *_planned_handles(plan)]
    if len(bodies) > _MOST_PANELS:
        figure = Figure(figsize=(_WIDTH, 3.8), layout="constrained")
        draw_least_clearances(figure.subplots(), plan, bodies)
        return _with_legend(figure, handles)
    figure = Figure(figsize=(_WIDTH, 0.6 + 3.2 * len(bodies)), layout="constrained")
    axes = figure.subplots(len(bodies), squeeze=False)[:, 0]
    spheres = [each.shape for each in bodies if isinstance(each.shape, Sphere)]
    for index, (ax, body) in enumerate(zip(axes, bodies, strict=True)):
        if len(spheres) == len(bodies):
            draw_distances_from_centre(ax, plan, body, spheres[index])
        else:
            draw_distances(ax, plan, body)
        if len(bodies) > 1:
            ax.set_title(f"obstacle {called(index + 1, body)}", fontsize=9)
        elif body.name is not None:
            ax.set_title(f"obstacle {as_text(brief(body.name))}", fontsize=9)
    return _with_legend(figure, handles)


def separation_figure(flown: Flown) -> Figure:
    """The least distance of any two vehicles over time, exact, with the separation.

    Raises:
        ValueError: the scenario has no separation, or one vehicle only.
    """
    figure = Figure(figsize=(_WIDTH, 3.4), layout="constrained")
    plan = drawn(flown)
    draw_separation(figure.subplots(), plan)
    return _with_legend(figure, _planned_handles(plan))


def errors_figure(simulation: Simulation) -> Figure:
    """How far the vehicles were off their plans, and what the feedback did, beside the tube.

    Where a window begins anew, so do the errors and the tube.
    """
    figure = Figure(figsize=(_WIDTH, 6.2), layout="constrained")
    axes = figure.subplots(len(LABELS), sharex=True, height_ratios=(2, 1, 1))
    for ax, quantity in zip(axes, LABELS, strict=True):
        draw_errors(ax, simulation, quantity)
    for ax in axes[:-1]:
        ax.set_xlabel("")
    handles = vehicle_handles(simulation.scenario)
    for handle in handles:
        handle.set_marker("none")
    return _with_legend(figure, [*handles, tube_handle()])


def velocities_figure(flown: Flown) -> Figure:
    """The components of the velocities over time, with their bounds; speeds if they are limited."""
    return _components(drawn(flown), draw_velocities, "velocity")


def accelerations_figure(flown: Flown) -> Figure:
    """The components of the accelerations over time, with their bounds.

    Below them norms, thrusts and tilts, each if it is limited.
    """
    return _components(drawn(flown), draw_accelerations, "acceleration")


def write_figures(flown: Flown, folder: str | Path) -> list[Path]:
    """Write every figure that there is of a plan, flight or simulation, as `paths.png`.

    Args:
        flown: what to draw.
        folder: made if it is not there.

    Raises:
        OSError: a file cannot be written.
    """
    scenario = flown.scenario
    draw: dict[str, Callable[[Flown], Figure]] = {"paths": paths_figure}
    if scenario.obstacles:
        draw["distances"] = distances_figure
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        draw["separation"] = separation_figure
    draw |= {"velocities": velocities_figure, "accelerations": accelerations_figure}
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    figures = {name: each(flown) for name, each in draw.items()}
    if isinstance(flown, Simulation):
        figures["errors"] = errors_figure(flown)
    return [write_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]


def write_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, whole or not at all; the same drawing is the same file.

    Raises:
        OSError: the file cannot be written.
    """
    with replacing(path) as file:  # without the version of the writer inside
        figure.savefig(file, format="png", dpi=200, metadata={"Software": None})
    return path


def _components(
    plan: Drawn, draw: Callable[[Sequence[Axes], Drawn], list[Line2D]], quantity: Quantity
) -> Figure:
    """The components of a quantity, and below them what limits on norms of it are about."""
    limited = plan.scenario.fleet.norms
    norms = [norm for norm in limited if limited[norm].kind.quantity == quantity]
    figure = Figure(figsize=(_WIDTH, 5.6 + 1.6 * len(norms)), layout="constrained")
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


def _lift(figure: Figure, height: float) -> None:
    """Make room below all that is in a figure [in]."""
    old = figure.get_figheight()
    new = old + height
    figure.set_figheight(new)
    for ax in figure.axes:
        x, y, wide, high = ax.get_position(original=True).bounds
        ax.set_position((x, (y * old + height) / new, wide, high * old / new))
    for text in figure.texts:
        text.set_y((text.get_position()[1] * old + height) / new)


def _add_window_bar(figure: Figure, count: int) -> None:
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    bar = figure.colorbar(mappable, cax=figure.add_axes((0.90, 0.2, 0.025, 0.6)))
    bar.set_ticks(range(1, count + 1), labels=[str(number) for number in range(1, count + 1)])
    bar.minorticks_off()
    bar.set_label("window")
