"""Style sheet of the figures, and their files in three formats.

Equal drawings give equal files, byte for byte: no file contains a date or its author.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib import style
from matplotlib.figure import Figure

from drake_rho.display.plots.formats import FORMATS
from drake_rho.scenario.arguments import checked
from drake_rho.system.files import atomic_write

SHEET = "drake_rho.display.drake_rho"
"""The style sheet, as matplotlib names it."""
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"Creator": None, "Producer": None, "CreationDate": None},
    "svg": {"Creator": None, "Date": None, "Format": None, "Type": None},
}
"""Metadata that suppress matplotlib's defaults."""

styled = style.context(SHEET, after_reset=True)
"""Decorator of drawing functions: applies the sheet to matplotlib's defaults, not to the user's
settings."""


@checked
@styled
def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure atomically, in the format of the file's ending.

    Args:
        figure: figure to write.
        path: path of the file, ending in .png (300 dots per inch), .pdf (embedded fonts) or .svg
            (text remains text).

    Returns:
        The path.

    Raises:
        ValueError: the file has another ending.
        OSError: the file cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        endings = ", ".join(f".{each}" for each in FORMATS)
        raise ValueError(f"path: got {str(path)!r}, expected a file ending in one of {endings}")
    with atomic_write(path) as file:
        figure.savefig(file, format=ending, metadata=_METADATA[ending])
    return path


def save_figures(figures: Mapping[str, Figure], folder: str | Path, file_format: str) -> list[Path]:
    """Write figures into a folder, created if it does not exist, in files with their names."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return [save_figure(each, folder / f"{name}.{file_format}") for name, each in figures.items()]
