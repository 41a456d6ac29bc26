"""Whole figures of a plan or a flight, and by them the paper's sixteen, 3 to 18."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_rho.assurance.study import Study
from drake_rho.display.plots import (
    LIMIT_STYLE,
    draw_accelerations,
    draw_distances,
    draw_obstacles,
    draw_paths,
    draw_velocities,
    draw_windows,
    frame_scene,
    vehicle_handles,
    window_colours,
)
from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.files import replacing
from drake_rho.scenario.records import Sphere

NUMBERS = range(3, 19)
"""Numbers of the figures; 1 and 2 of the paper are diagrams of the method."""

_WIDTH = 6.5
"""Width of a page's text [in]."""


def draw_figure(number: int, study: Study) -> Figure:
    """Figure `number` of the paper, 3 to 18.

    Raises:
        ValueError: the paper has no such figure.
    """
    if number not in NUMBERS:
        raise ValueError(f"number: got {number}, expected 3 to 18")
    index, view = divmod(number - 3, 4)
    example, obstacles = study.examples[index], study.scenario.obstacles
    draw = (
        partial(paths_figure, obstacles=obstacles),
        partial(distances_figure, obstacles=obstacles),
        velocities_figure,
        accelerations_figure,
    )[view]
    figure = draw(example.flight or example.plan)
    figure.suptitle(f"Example {example.number}: {example.title}", fontsize=10)
    return figure


def write_figures(
    study: Study, folder: str | Path, advance: Callable[[str], None] = lambda done: None
) -> list[Path]:
    """Write `fig03.png` to `fig18.png`, each whole or not at all.

    Args:
        study: the examples to draw.
        folder: made if it is not there.
        advance: called with the file's name after each.

    Raises:
        OSError: a file cannot be written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in NUMBERS:
        path = folder / f"fig{number:02}.png"
        # Without the writer's version inside, the same drawing is the same file.
        with replacing(path) as file:
            draw_figure(number, study).savefig(
                file, format="png", dpi=200, metadata={"Software": None}
            )
        paths.append(path)
        advance(path.name)
    return paths


def paths_figure(flown: Plan | Flight, *, obstacles: Sequence[Sphere] | None = None) -> Figure:
    """The vehicles' paths in space, around the obstacles; each window of a flight in its colour.

    Args:
        flown: what to draw.
        obstacles: what to draw in the way, if not the scenario's own.
    """
    plan = _plan(flown)
    spheres = plan.scenario.obstacles if obstacles is None else tuple(obstacles)
    figure = Figure(figsize=(_WIDTH, 4.8))
    ax = figure.add_axes((-0.03, 0.03, 0.93, 0.95), projection="3d")
    frame_scene(ax, plan.positions, spheres)
    draw_obstacles(ax, spheres)
    if isinstance(flown, Flight):
        draw_windows(ax, flown, spheres)
        _add_window_bar(figure, len(flown.windows))
        note = "thick: flown; thin: the rest of each window's prediction; ring: start; star: goal"
    else:
        draw_paths(ax, plan, spheres)
        handles = vehicle_handles(plan.scenario)
        figure.legend(handles=handles, loc="center right", fontsize=9, frameon=False)
        note = "ring: start; star: goal; a mark at every knot"
    figure.text(0.02, 0.02, note, fontsize=8)
    return figure


def distances_figure(flown: Plan | Flight, *, obstacles: Sequence[Sphere] | None = None) -> Figure:
    """The vehicles' distances from the centre of each obstacle over time.

    Args:
        flown: what to draw.
        obstacles: measured from these, if not from the scenario's own.

    Raises:
        ValueError: there is no obstacle.
    """
    plan = _plan(flown)
    spheres = plan.scenario.obstacles if obstacles is None else tuple(obstacles)
    if not spheres:
        raise ValueError("obstacles: got none, expected at least one to measure from")
    figure = Figure(figsize=(_WIDTH, 0.6 + 3.2 * len(spheres)), layout="constrained")
    axes = figure.subplots(len(spheres), squeeze=False)[:, 0]
    for number, (ax, sphere) in enumerate(zip(axes, spheres, strict=True), start=1):
        draw_distances(ax, plan, sphere)
        if len(spheres) > 1:
            ax.set_title(f"obstacle {number}", fontsize=9)
    return _with_legend(figure, plan)


def velocities_figure(flown: Plan | Flight) -> Figure:
    """The components of the velocities over time, with their bounds."""
    return _components(_plan(flown), draw_velocities)


def accelerations_figure(flown: Plan | Flight) -> Figure:
    """The components of the accelerations over time, with their bounds."""
    return _components(_plan(flown), draw_accelerations)


def _components(plan: Plan, draw: Callable[[Sequence[Axes], Plan], list[Line2D]]) -> Figure:
    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    draw(list(figure.subplots(3, sharex=True)), plan)
    return _with_legend(figure, plan)


def _with_legend(figure: Figure, plan: Plan) -> Figure:
    limit = Line2D([], [], label="limit", **LIMIT_STYLE)
    handles = [*vehicle_handles(plan.scenario), limit]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    return figure


def _plan(flown: Plan | Flight) -> Plan:
    return flown.plan if isinstance(flown, Flight) else flown


def _add_window_bar(figure: Figure, count: int) -> None:
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    bar = figure.colorbar(mappable, cax=figure.add_axes((0.90, 0.2, 0.025, 0.6)))
    bar.set_ticks(range(1, count + 1), labels=[str(number) for number in range(1, count + 1)])
    bar.minorticks_off()
    bar.set_label("window")
