"""How figures leave: the style sheet, the widths of print, and files of three formats.

The same drawing is the same file, byte for byte: nothing in it tells the time, or who wrote it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import style
from matplotlib.figure import Figure

from drake_rho.scenario.files import replacing

SINGLE_COLUMN, DOUBLE_COLUMN = 3.5, 7.16
"""Widths of figures in journals of the IEEE, in one column and across both [in]."""
NARROWEST, WIDEST = 3.0, 20.0
"""Widths between which letters of the sheet's sizes suit a figure [in]."""
FORMATS = ("png", "pdf", "svg")
"""Of files, by their endings."""
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


def check_format(file_format: str) -> str:
    """The format, if there is such a one.

    Raises:
        ValueError: there is none.
    """
    if file_format not in FORMATS:
        raise ValueError(f"format: got {file_format!r}, expected {_listed(FORMATS)}")
    return file_format


def check_width(width: float) -> float:
    """The width of a figure [in], if letters can be read at it.

    Raises:
        ValueError: it is too narrow or too wide, or no number.
    """
    if not NARROWEST <= width <= WIDEST:
        expected = f"{NARROWEST:g} to {WIDEST:g} inches"
        raise ValueError(f"width: got {width!r}, expected {expected}")
    return width


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
        expected = f"a file ending in {_listed(tuple(f'.{each}' for each in FORMATS))}"
        raise ValueError(f"path: got {str(path)!r}, expected {expected}")
    with replacing(path) as file:
        figure.savefig(file, format=ending, metadata=_METADATA[ending])
    return path


def _listed(words: tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"
