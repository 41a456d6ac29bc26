"""Complete figures of a plan, a flight or a simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_rho.display.common.drawable import Drawn, drawn, planned
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.obstacle_snapshots import (
    as_obstacles,
    short_label,
)
from drake_rho.display.common.style import LIMIT_STYLE, PLANNED_STYLE
from drake_rho.display.plots.curves import (
    draw_accelerations,
    draw_norm,
    draw_separation,
    draw_velocities,
)
from drake_rho.display.plots.distances import (
    draw_distances,
    draw_distances_from_centre,
    draw_least_clearances,
)
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_format, check_width
from drake_rho.display.plots.legends import (
    add_below,
    vehicle_handles,
)
from drake_rho.display.plots.path_figure import paths_figure
from drake_rho.display.plots.publish import save_figure, styled
from drake_rho.display.plots.tube_errors import LABELS, draw_errors, tube_handle
from drake_rho.motion.flown import Flown
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.quadrics import Sphere

_MAX_PANELS = 4
"""Largest number of obstacles with one panel each."""
_ONE_ROW = 0.25
"""Height of a one-row legend, for which the figure need not grow [in]."""


@checked
@styled
def distances_figure(
    flown: Flown,
    *,
    obstacles: Sequence[Shape | Obstacle] | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """Plot the vehicles' distances from the obstacles over time.

    Up to four obstacles have one panel each, with distances from the centre if all obstacles are
    spheres, else from the surface. With more obstacles, one panel shows each vehicle's least
    clearance: the distance from the surface minus the vehicle's radius.

    Args:
        flown: plan, flight or simulation to draw.
        obstacles: obstacles to measure from; the scenario's if not given.
        width: of the figure [in], see `paths_figure`.

    Raises:
        ValueError: there is no obstacle, or the text would be illegible at the width.
    """
    plan = drawn(flown)
    bodies = as_obstacles(plan.scenario.obstacles if obstacles is None else obstacles)
    if not bodies:
        raise ValueError("obstacles: got none, expected at least one to measure from")
    handles = [*vehicle_handles(plan.scenario), _limit_handle(), *_planned_handles(plan)]
    if len(bodies) > _MAX_PANELS:
        figure = _panels(width, 1, 1.35)
        draw_least_clearances(figure.subplots(), plan, bodies)
        return _with_legend(figure, handles)
    figure = _panels(width, len(bodies), 1.1)
    axes = figure.subplots(len(bodies), squeeze=False)[:, 0]
    spheres = [each.shape for each in bodies if isinstance(each.shape, Sphere)]
    for index, (ax, body) in enumerate(zip(axes, bodies, strict=True)):
        name = None if body.name is None else as_text(brief(body.name))
        title = f"obstacle {short_label(index + 1, body) if len(bodies) > 1 else name}"
        title_of = title if len(bodies) > 1 or name is not None else None
        if len(spheres) == len(bodies):
            draw_distances_from_centre(ax, plan, body, spheres[index], title=title_of)
        else:
            draw_distances(ax, plan, body, title=title_of)
    return _with_legend(figure, handles)


@checked
@styled
def separation_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the exact minimum distance between vehicles over time, with the required separation.

    Raises:
        ValueError: the scenario has no separation, or only one vehicle.
    """
    figure = _panels(width, 1, 1.1)
    plan = drawn(flown)
    draw_separation(figure.subplots(), plan)
    return _with_legend(figure, _planned_handles(plan))


@checked
@styled
def errors_figure(simulation: Simulation, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the tracking errors and the feedback over time, with the radii of the error tube.

    If a window starts from the measured state, its errors and its tube start anew.
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


@checked
@styled
def velocities_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot velocity components over time with their bounds, and the speeds if they are limited."""
    return _components(drawn(flown), draw_velocities, "velocity", width)


@checked
@styled
def accelerations_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot acceleration components over time, with their bounds.

    Further panels show norms (of the jerk too), thrusts and tilts, each if it is limited.
    """
    return _components(drawn(flown), draw_accelerations, "acceleration", width)


def write_figures(
    flown: Flown, folder: str | Path, *, file_format: str = "png", width: float = DOUBLE_COLUMN
) -> list[Path]:
    """Write all applicable figures of a plan, flight or simulation into files such as `paths.png`.

    Args:
        flown: plan, flight or simulation to draw.
        folder: folder of the files, created if it does not exist.
        file_format: png, pdf or svg.
        width: of each figure [in], see `paths_figure`.

    Raises:
        ValueError: the format is unknown, or the text would be illegible at the width.
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
    if flown.simulation is not None:
        draw["errors"] = errors_figure
    figures = {name: each(flown, width=width) for name, each in draw.items()}
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [
        save_figure(figure, folder / f"{name}.{file_format}") for name, figure in figures.items()
    ]


def _components(
    plan: Drawn,
    draw: Callable[[Sequence[Axes], Drawn], list[Line2D]],
    quantity: Quantity,
    width: float,
) -> Figure:
    """Plot the components of a quantity and, below them, its limited norms."""
    limited = plan.scenario.fleet.norms
    shown = (quantity, "jerk") if quantity == "acceleration" else (quantity,)
    norms = [norm for norm in limited if limited[norm].kind.quantity in shown]
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
    """Return the legend entry of planned motions, if they are drawn beside the true motion."""
    if not planned(plan):
        return []
    return [Line2D([], [], label="planned", color="black", **PLANNED_STYLE)]


def _limit_handle() -> Line2D:
    return Line2D([], [], label="limit", **LIMIT_STYLE)


def _with_legend(figure: Figure, handles: Sequence[Line2D]) -> Figure:
    """Add a legend below the axes, and enlarge the figure so that these keep their height."""
    height = add_below(figure, handles)
    figure.set_figheight(figure.get_figheight() + max(0.0, height - _ONE_ROW))
    return figure


def _panels(width: float, count: int, part: float) -> Figure:
    """Return an empty figure for stacked panels, each of `part` times the default height."""
    height = 0.5 + count * part * (1.15 + 0.21 * check_width(width))
    return Figure(figsize=(width, height), layout="constrained")
