"""How times on the scenario's clock are written."""

from __future__ import annotations

_FAR = 1e5
"""From where on a time is written with all digits that tell instants of a flight apart [s]."""


def clock_time(time: float, digits: int = 6) -> str:
    """Return a time [s] in words, as in '12.5 s', also where the clock is far from 0."""
    return f"{clock_number(time, digits)} s"


def clock_number(time: float, digits: int = 6) -> str:
    """Return a time [s] as a number, to the millisecond where the clock is far from 0."""
    if abs(time) < _FAR:
        return f"{time:.{digits}g}"
    return f"{time:.3f}".rstrip("0").rstrip(".")
