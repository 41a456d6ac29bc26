"""Complete figures of a plan, a flight or a simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_rho.display.common.drawable import Drawn, drawn
from drake_rho.display.common.names import as_text
from drake_rho.display.common.obstacle_snapshots import as_obstacles
from drake_rho.display.common.requirements import required_positions
from drake_rho.display.common.scenes import scenes_of
from drake_rho.display.common.style import LIMIT_STYLE, MEASURED_STYLE, PLANNED_STYLE
from drake_rho.display.plots.curves import (
    draw_components,
    draw_norm,
    draw_separation,
)
from drake_rho.display.plots.distances import MAX_PANELS, obstacle_panels
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_format, check_width
from drake_rho.display.plots.given_axes import given_axes
from drake_rho.display.plots.legends import add_below, figure_of, vehicle_handles
from drake_rho.display.plots.path_figure import paths_figure
from drake_rho.display.plots.publish import save_figures, styled
from drake_rho.display.plots.requirements import draw_margins
from drake_rho.display.plots.scenes_figure import scenes_figure
from drake_rho.display.plots.tube_errors import LABELS, draw_errors, tube_handle
from drake_rho.motion.flown import Flown
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.shapes.base import Solid

_ONE_ROW = 0.25
"""Height of a one-row legend, for which the figure need not grow [in]."""


@checked
@styled
def distances_figure(
    flown: Flown,
    *,
    obstacles: Sequence[Solid | Obstacle] | None = None,
    ax: Axes | Sequence[Axes] | None = None,
    width: float = DOUBLE_COLUMN,
) -> Figure:
    """Plot distances from obstacles, and margins inside required sets, over time.

    Up to four obstacles have one panel each, with distances from the centre if all obstacles are
    spheres, else from the surface. With more obstacles, one panel shows each vehicle's least
    clearance: the distance from the surface minus the vehicle's radius.

    Requirements of positions follow, one panel each for up to four panels in all, otherwise
    together: the margin is the distance from the boundary of the set, positive inside.

    Args:
        flown: plan, flight or simulation to draw.
        obstacles: obstacles to measure from; the scenario's if not given.
        ax: axes to draw in, one for each panel, without a legend; a new figure if not given.
        width: width of a new figure [in], see `paths_figure`.

    Raises:
        ValueError: there is neither an obstacle nor a requirement of positions, the number of axes
            differs from that of the panels, or the text would be illegible at the width.
    """
    plan = drawn(flown)
    bodies = as_obstacles(plan.scenario.obstacles if obstacles is None else obstacles)
    required = list(required_positions(plan.scenario))
    if not bodies and not required:
        raise ValueError("obstacles: got none, expected at least one to measure from")
    panels = obstacle_panels(plan, bodies)
    if len(panels) + len(required) <= MAX_PANELS:
        titles = [as_text(each.requirement.called(each.number)) for each in required]
        panels += [
            partial(draw_margins, plan=plan, required=[each], title=title)
            for each, title in zip(required, titles, strict=True)
        ]
    else:
        panels += [partial(draw_margins, plan=plan, required=required)] if required else []
    alone = len(panels) == 1 and len(bodies) + len(required) > 1
    axes = _panels(ax, width, len(panels), 1.35 if alone else 1.1)
    for each, draw in zip(axes, panels, strict=True):
        draw(each)
    handles = [*vehicle_handles(plan.scenario), _limit_handle(), *_beside_handles(plan)]
    return _with_legend(ax, axes, handles)


@checked
@styled
def separation_figure(
    flown: Flown, *, ax: Axes | None = None, width: float = DOUBLE_COLUMN
) -> Figure:
    """Plot the exact minimum distance between vehicles over time, with the required separation.

    Args:
        flown: plan, flight or simulation to draw.
        ax: axes to draw in; a new figure if not given.
        width: width of a new figure [in], see `paths_figure`.

    Raises:
        ValueError: the scenario has no separation, or only one vehicle.
    """
    axes = _panels(ax, width, 1, 1.1)
    plan = drawn(flown)
    draw_separation(axes[0], plan)
    return _with_legend(ax, axes, _beside_handles(plan))


@checked
@styled
def errors_figure(
    simulation: Simulation, *, ax: Sequence[Axes] | None = None, width: float = DOUBLE_COLUMN
) -> Figure:
    """Plot the tracking errors and the feedback over time, with the radii of the error tube.

    If a window starts from the measured state, its errors and its tube start anew.

    Args:
        simulation: simulation to draw.
        ax: three axes to draw in: position error, velocity error and feedback; a new figure if not
            given.
        width: width of a new figure [in], see `paths_figure`.

    Raises:
        ValueError: the number of axes is not three.
    """
    axes = _panels(ax, width, len(LABELS), 0.8, rows=4, sharex=True, height_ratios=(2, 1, 1))
    for panel, quantity in zip(axes, LABELS, strict=True):
        draw_errors(panel, simulation, quantity)
    for panel in axes[:-1]:
        panel.set_xlabel("")
    handles = vehicle_handles(simulation.scenario)
    for handle in handles:
        handle.set_marker("none")
    return _with_legend(ax, axes, [*handles, tube_handle()])


@checked
@styled
def velocities_figure(
    flown: Flown, *, ax: Sequence[Axes] | None = None, width: float = DOUBLE_COLUMN
) -> Figure:
    """Plot velocity components over time with their bounds, and the speeds if they are limited.

    Args:
        flown: plan, flight or simulation to draw.
        ax: axes to draw in: three, and one for each limited norm; a new figure if not given.
        width: width of a new figure [in], see `paths_figure`.

    Raises:
        ValueError: the number of axes is wrong.
    """
    return _components(drawn(flown), "velocity", ax, width)


@checked
@styled
def accelerations_figure(
    flown: Flown, *, ax: Sequence[Axes] | None = None, width: float = DOUBLE_COLUMN
) -> Figure:
    """Plot acceleration components over time, with their bounds.

    Further panels show norms (of the jerk too), thrusts and tilts, each if it is limited.

    Args:
        flown: plan, flight or simulation to draw.
        ax: axes to draw in: three, and one for each further panel; a new figure if not given.
        width: width of a new figure [in], see `paths_figure`.

    Raises:
        ValueError: the number of axes is wrong.
    """
    return _components(drawn(flown), "acceleration", ax, width)


def write_figures(
    flown: Flown, folder: str | Path, *, file_format: str = "png", width: float = DOUBLE_COLUMN
) -> list[Path]:
    """Write all applicable figures of a plan, flight or simulation into files such as `paths.png`.

    Args:
        flown: plan, flight or simulation to draw.
        folder: folder of the files, created if it does not exist.
        file_format: png, pdf or svg.
        width: width of each figure [in], see `paths_figure`.

    Raises:
        ValueError: the format is unknown, or the text would be illegible at the width.
        OSError: a file cannot be written.
    """
    check_format(file_format)
    scenario = flown.scenario
    draw: dict[str, Callable[..., Figure]] = {"paths": paths_figure}
    if scenario.obstacles or any(required_positions(scenario)):
        draw["distances"] = distances_figure
    if scenario.separation is not None and len(scenario.vehicles) > 1:
        draw["separation"] = separation_figure
    draw |= {"velocities": velocities_figure, "accelerations": accelerations_figure}
    if flown.simulation is not None:
        draw["errors"] = errors_figure
    if scenes_of(scenario):
        draw["scenes"] = scenes_figure
    figures = {name: each(flown, width=width) for name, each in draw.items()}
    return save_figures(figures, folder, file_format)


def _components(
    plan: Drawn,
    quantity: Quantity,
    ax: Sequence[Axes] | None,
    width: float,
) -> Figure:
    """Plot the components of a quantity and, below them, its limited norms."""
    limited = plan.scenario.fleet.norms
    shown = (quantity, "jerk") if quantity == "acceleration" else (quantity,)
    norms = [norm for norm in limited if limited[norm].kind.quantity in shown]
    axes = _panels(ax, width, 3 + len(norms), 0.6, sharex=True)
    draw_components(axes[:3], plan, quantity)
    for norm, panel in zip(norms, axes[3:], strict=True):
        draw_norm(panel, plan, norm)
    for panel in axes[:-1]:
        panel.set_xlabel("")
    handles = vehicle_handles(plan.scenario)
    if norms or plan.scenario.fleet.bounds(quantity) is not None:
        handles.append(_limit_handle())
    handles += _beside_handles(plan) if quantity == "velocity" else []
    return _with_legend(ax, axes, handles)


def _beside_handles(plan: Drawn) -> list[Line2D]:
    """Return the legend entries of planned motions and of measured samples, if drawn beside."""
    handles = list[Line2D]()
    if plan.planned:
        handles.append(Line2D([], [], label="planned", color="black", **PLANNED_STYLE))
    if plan.measured is not None:
        handles.append(Line2D([], [], label="measured", **MEASURED_STYLE))
    return handles


def _limit_handle() -> Line2D:
    return Line2D([], [], label="limit", **LIMIT_STYLE)


def _with_legend(
    ax: Axes | Sequence[Axes] | None, axes: Sequence[Axes], handles: Sequence[Line2D]
) -> Figure:
    """Return the figure; a new one with a legend below axes that keep their height."""
    figure = figure_of(axes[0])
    if ax is None:
        height = add_below(figure, handles)
        figure.set_figheight(figure.get_figheight() + max(0.0, height - _ONE_ROW))
    return figure


def _panels(
    ax: Axes | Sequence[Axes] | None,
    width: float,
    count: int,
    part: float,
    *,
    rows: int | None = None,
    **options: Any,
) -> list[Axes]:
    """Return the given axes or, in a new figure, stacked panels.

    Args:
        ax: given axes, if any.
        width: width of a new figure [in].
        count: number of panels.
        part: height of a row, relative to the default height.
        rows: height of the panels in rows; their number if not given.
        options: further options of `Figure.subplots`.
    """
    if ax is not None:
        return given_axes(ax, count)
    height = 0.5 + (rows or count) * part * (1.15 + 0.21 * check_width(width))
    figure = Figure(figsize=(width, height), layout="constrained")
    return list(figure.subplots(count, squeeze=False, **options)[:, 0])
