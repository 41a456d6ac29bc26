"""How figures leave: the style sheet, and files of three formats.

The same drawing is the same file, byte for byte: nothing in it tells the time, or who wrote it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import style
from matplotlib.figure import Figure

from drake_rho.display.plots.formats import FORMATS
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.files import replacing

SHEET = "drake_rho.display.drake_rho"
"""The style sheet, as matplotlib names it."""
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"Creator": None, "Producer": None, "CreationDate": None},
    "svg": {"Creator": None, "Date": None, "Format": None, "Type": None},
}
"""What matplotlib would write that is not the drawing, taken out."""

styled = style.context(SHEET, after_reset=True)
"""Decorator of what draws: the sheet over matplotlib's defaults, whatever else is set."""


@checked
@styled
def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure in the format of the file's ending, whole or not at all.

    Args:
        figure: what to write.
        path: ending in .png (300 dots per inch), .pdf (fonts embedded) or .svg (text as text).

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
    with replacing(path) as file:
        figure.savefig(file, format=ending, metadata=_METADATA[ending])
    return path
