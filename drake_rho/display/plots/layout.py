"""Space in figures for titles above and legends below."""

from __future__ import annotations

from matplotlib.figure import Figure

from drake_rho.display.plots.publish import styled

EDGE = 0.06
"""Margin between a figure's contents and its edge [in]."""
_TITLE = 0.2
"""Height of a title [in]."""


@styled
def add_title(figure: Figure, words: str) -> None:
    """Write a title above a figure's contents."""
    if figure.get_layout_engine() is None:
        grow(figure, above=_TITLE)
    figure.suptitle(words, y=None if figure.get_layout_engine() else 1.0 - EDGE / 2, va="top")


def grow(figure: Figure, *, below: float = 0.0, above: float = 0.0) -> None:
    """Enlarge a figure by space below or above its contents [in]."""
    old = figure.get_figheight()
    new = old + below + above
    figure.set_figheight(new)
    for ax in figure.axes:
        x, y, wide, high = ax.get_position(original=True).bounds
        ax.set_position((x, (y * old + below) / new, wide, high * old / new))
    for text in figure.texts:
        text.set_y((text.get_position()[1] * old + below) / new)
