"""The paper's sixteen figures, 3 to 18."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread

from drake_rho.display.plots.figures import (
    accelerations_figure,
    distances_figure,
    velocities_figure,
)
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_format
from drake_rho.display.plots.layout import add_title
from drake_rho.display.plots.path_figure import paths_figure
from drake_rho.display.plots.publish import save_figure
from drake_rho.paper.study import Study
from drake_rho.system.files import atomic_write

_GREY = 1.5 / 255.0
"""Difference below which two pixels count as equal: more than one grey level, less than two."""

NUMBERS = range(3, 19)
"""Numbers of the reproduced figures; Figs 1 and 2 of the paper are diagrams of the method."""


def draw_figure(number: int, study: Study, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Draw figure `number` of the paper, 3 to 18.

    Args:
        number: number of the figure in the paper.
        study: the examples to draw.
        width: width of the figure [in].

    Raises:
        ValueError: the paper has no such figure, or text could not be read at the width.
    """
    if number not in NUMBERS:
        raise ValueError(f"number: got {number}, expected 3 to 18")
    index, view = divmod(number - 3, 4)
    example, obstacles = study.examples[index], study.scenario.spheres
    draw = (
        partial(paths_figure, obstacles=obstacles),
        partial(distances_figure, obstacles=obstacles),
        velocities_figure,
        accelerations_figure,
    )[view]
    figure = draw(example.flight or example.plan, width=width)
    add_title(figure, f"Example {example.number}: {example.title}")
    return figure


def write_paper_figures(
    study: Study,
    folder: str | Path,
    advance: Callable[[str], None] = lambda done: None,
    *,
    file_format: str = "png",
    width: float = DOUBLE_COLUMN,
) -> list[Path]:
    """Write `fig03.png` to `fig18.png`, each completely or not at all.

    An existing PNG that looks the same is not replaced: the last digits of a solution differ from
    machine to machine, and with them a few pixels by one grey level.

    Args:
        study: the examples to draw.
        folder: folder of the files, created if it does not exist.
        advance: called with the name of each file that is done.
        file_format: png, pdf or svg.
        width: width of each figure [in].

    Raises:
        ValueError: there is no such format, or text could not be read at the width.
        OSError: a file cannot be written.
    """
    check_format(file_format)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in NUMBERS:
        path = folder / f"fig{number:02}.{file_format}"
        figure = draw_figure(number, study, width=width)
        with TemporaryDirectory() as drawn:
            new = save_figure(figure, Path(drawn) / path.name)
            if not _look_the_same(new, path):
                with atomic_write(path) as file:
                    file.write(new.read_bytes())
        paths.append(path)
        advance(path.name)
    return paths


def _look_the_same(new: Path, old: Path) -> bool:
    """Return whether both are PNGs of equal size that differ by at most a grey level."""
    if new.suffix != ".png" or not old.is_file():
        return False
    try:
        pixels = [imread(path) for path in (new, old)]
    except (OSError, SyntaxError):  # the existing file is not a picture
        return False
    return pixels[0].shape == pixels[1].shape and bool(
        np.all(np.abs(pixels[0] - pixels[1]) < _GREY)
    )
