"""Formats and widths of figures, in a module that does not import matplotlib."""

from __future__ import annotations

FORMATS = ("png", "pdf", "svg")
"""File formats, by their endings."""
SINGLE_COLUMN, DOUBLE_COLUMN = 3.5, 7.16
"""Widths of figures in IEEE journals, for one column and for two [in]."""
_NARROWEST, _WIDEST = 3.0, 20.0
"""Range of widths for which the font sizes of the style sheet are suitable [in]."""


def check_format(file_format: str) -> str:
    """Return the format if it is known.

    Raises:
        ValueError: the format is unknown.
    """
    if file_format not in FORMATS:
        raise ValueError(f"format: got {file_format!r}, expected {', '.join(FORMATS)}")
    return file_format


def check_width(width: float) -> float:
    """Return the width of a figure [in] if its text is legible at it.

    Raises:
        ValueError: the width is too small, too large or not a number.
    """
    if not _NARROWEST <= width <= _WIDEST:
        raise ValueError(f"width: got {width:g}, expected {_NARROWEST:g} to {_WIDEST:g} inches")
    return width
