"""How long work tells what it is doing: a function that takes a few words, as `print` does."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str], None]
"""Called with a few words on what is being done, as 'linearised 4 times, cost 12.3 m²/s⁴'."""


def tell(progress: Progress | None, words: str) -> None:
    """Say what is being done to whoever wants to know."""
    if progress is not None:
        progress(words)


def within(progress: Progress | None, part: str) -> Progress | None:
    """For a part of the work: its words come after those that say which part it is."""
    if progress is None:
        return None
    return lambda words: progress(f"{part}: {words}")
