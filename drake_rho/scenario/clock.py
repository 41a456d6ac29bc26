"""Text of times on the scenario's clock."""

from __future__ import annotations

_FAR = 1e5
"""Magnitude from which times are written to the millisecond, to distinguish instants [s]."""


def clock_time(time: float, digits: int = 6) -> str:
    """Return a time [s] as text with its unit, such as '12.5 s'; digits as in `clock_number`."""
    return f"{clock_number(time, digits)} s"


def clock_number(time: float, digits: int = 6) -> str:
    """Return a time [s] as text: `digits` significant digits; to the millisecond from 1e5 s on."""
    if abs(time) < _FAR:
        return f"{time:.{digits}g}"
    return f"{time:.3f}".rstrip("0").rstrip(".")
