"""Formats and widths of figures: what is known of them without loading what draws."""

from __future__ import annotations

FORMATS = ("png", "pdf", "svg")
"""Of files, by their endings."""
SINGLE_COLUMN, DOUBLE_COLUMN = 3.5, 7.16
"""Widths of figures in journals of the IEEE, in one column and across both [in]."""
_NARROWEST, _WIDEST = 3.0, 20.0
"""Widths between which letters of the sheet's sizes suit a figure [in]."""


def check_format(file_format: str) -> str:
    """The format, if there is such a one.

    Raises:
        ValueError: there is none.
    """
    if file_format not in FORMATS:
        raise ValueError(f"format: got {file_format!r}, expected {', '.join(FORMATS)}")
    return file_format


def check_width(width: float) -> float:
    """The width of a figure [in], if letters can be read at it.

    Raises:
        ValueError: it is too narrow or too wide, or no number.
    """
    if not _NARROWEST <= width <= _WIDEST:
        raise ValueError(f"width: got {width:g}, expected {_NARROWEST:g} to {_WIDEST:g} inches")
    return width
