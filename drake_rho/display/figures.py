"""The paper's sixteen figures, 3 to 18: four views of each of its four examples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_rho.assurance.study import Example, Study
from drake_rho.display.plots import (
    LIMIT_STYLE,
    draw_accelerations,
    draw_distances,
    draw_paths,
    draw_sphere,
    draw_velocities,
    draw_windows,
    frame_scene,
    window_colours,
)
from drake_rho.motion.plan import Plan
from drake_rho.scenario.files import replacing

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
    example, view = divmod(number - 3, 4)
    return (_paths, _distances, _velocities, _accelerations)[view](study, study.examples[example])


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


def _paths(study: Study, example: Example) -> Figure:
    figure = Figure(figsize=(_WIDTH, 4.8))
    ax = figure.add_axes((-0.03, 0.03, 0.93, 0.95), projection="3d")
    for sphere in study.scenario.obstacles:
        draw_sphere(ax, sphere)
    frame_scene(ax, study.scenario, example.plan.positions)
    if example.flight is None:
        lines = draw_paths(ax, example.plan)
        figure.legend(handles=lines, loc="center right", fontsize=9, frameon=False)
    else:
        draw_windows(ax, example.flight)
        _add_window_bar(figure, len(example.flight.windows))
        note = "thick: flown, thin: the rest of each window's prediction"
        figure.text(0.02, 0.02, note, fontsize=8)
    _entitle(figure, example)
    return figure


def _add_window_bar(figure: Figure, count: int) -> None:
    colours = ListedColormap(window_colours(count))
    edges = [number + 0.5 for number in range(count + 1)]
    mappable = ScalarMappable(BoundaryNorm(edges, count), colours)
    bar = figure.colorbar(mappable, cax=figure.add_axes((0.90, 0.2, 0.025, 0.6)))
    bar.set_ticks(range(1, count + 1), labels=[str(number) for number in range(1, count + 1)])
    bar.set_label("window")


def _distances(study: Study, example: Example) -> Figure:
    spheres = study.scenario.obstacles
    figure = Figure(figsize=(_WIDTH, 3.8 * len(spheres)), layout="constrained")
    for ax, sphere in zip(figure.subplots(len(spheres), squeeze=False)[:, 0], spheres, strict=True):
        lines = draw_distances(ax, example.plan, sphere)
    figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    _entitle(figure, example)
    return figure


def _velocities(study: Study, example: Example) -> Figure:
    return _components(example, draw_velocities)


def _accelerations(study: Study, example: Example) -> Figure:
    return _components(example, draw_accelerations)


def _components(example: Example, draw: Callable[[Sequence[Axes], Plan], list[Line2D]]) -> Figure:
    figure = Figure(figsize=(_WIDTH, 5.6), layout="constrained")
    lines = draw(list(figure.subplots(3, sharex=True)), example.plan)
    limit = Line2D([], [], label="limit", **LIMIT_STYLE)
    handles = [*lines[: len(example.plan.positions)], limit]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    _entitle(figure, example)
    return figure


def _entitle(figure: Figure, example: Example) -> None:
    figure.suptitle(f"Example {example.number}: {example.title}", fontsize=10)
