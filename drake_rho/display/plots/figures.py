"""Whole figures of a plan, a flight, or a simulation."""

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
"""Most obstacles with a panel each."""
_ONE_ROW = 0.25
"""Height of a legend for which curves have room anyway [in]."""


@checked
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
    """The least distance of any two vehicles over time, exact, with the separation.

    Raises:
        ValueError: the scenario has no separation, or one vehicle only.
    """
    figure = _panels(width, 1, 1.1)
    plan = drawn(flown)
    draw_separation(figure.subplots(), plan)
    return _with_legend(figure, _planned_handles(plan))


@checked
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


@checked
@styled
def velocities_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """The components of the velocities over time, with their bounds; speeds if they are limited."""
    return _components(drawn(flown), draw_velocities, "velocity", width)


@checked
@styled
def accelerations_figure(flown: Flown, *, width: float = DOUBLE_COLUMN) -> Figure:
    """The components of the accelerations over time, with their bounds.

    Below them norms, also of the jerk, thrusts and tilts, each if it is limited.
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
    """The components of a quantity, and below them what limits on norms of it are about."""
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
    height = 0.5 + count * part * (1.15 + 0.21 * check_width(width))
    return Figure(figsize=(width, height), layout="constrained")
