"""Progress reports of long computations, as calls of a function that takes a text."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str], None]
"""Function that takes a text on the current activity, as 'linearised 4 times, cost 12.3 m²/s⁴'."""


def tell(progress: Progress | None, words: str) -> None:
    """Report the current activity, if there is a function to report it to."""
    if progress is not None:
        progress(words)


def within(progress: Progress | None, part: str) -> Progress | None:
    """Return a progress function for a part of the work, which puts `part` before each text."""
    if progress is None:
        return None
    return lambda words: progress(f"{part}: {words}")
