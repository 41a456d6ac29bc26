"""Legends beside or below a drawing, never over it, and explanations of marks above axes."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from drake_rho.display.common.names import as_text, in_lines
from drake_rho.display.common.style import MAX_NAMED, vehicle_colours, vehicle_marker
from drake_rho.scenario.records import Scenario

_MAX_LARGE = 14
"""Largest number of entries in the default font size, and in a legend beside a drawing."""
_MAX_BESIDE = 0.7
"""Largest width of a name in a legend beside a drawing [in]."""
_AROUND = 3.8
"""Width of an entry's line and the gaps around it, over the font size."""
_BESIDE_AXES = 0.75
"""Largest width of ticks and labels beside the axes [in]."""


def vehicle_handles(scenario: Scenario) -> list[Line2D]:
    """Return the vehicles' legend entries; none for more than `MAX_NAMED` vehicles."""
    if len(scenario.vehicles) > MAX_NAMED:
        return []
    colours = vehicle_colours(len(scenario.vehicles))
    style: dict[str, Any] = {"markersize": 3.5}
    return [
        Line2D([], [], label=label, color=colours[index], marker=vehicle_marker(index), **style)
        for index, label in enumerate(as_text(in_lines(name)) for name in scenario.names)
    ]


def start_handles(scenario: Scenario) -> list[Line2D]:
    """Return legend entries of the vehicles' starts; none for more than `MAX_NAMED` vehicles."""
    handles = vehicle_handles(scenario)
    for handle in handles:
        handle.set(linestyle="none", marker="o", markersize=5, fillstyle="none")
    return handles


def width_beside(figure: Figure, handles: Sequence[Line2D]) -> float | None:
    """Return the width of a legend to the right of a drawing [in]; None if it does not fit."""
    widest = _widest(figure, handles)
    if not 0 < len(handles) <= _MAX_LARGE or widest > _MAX_BESIDE:
        return None
    return widest + _AROUND * _font_size(handles) / 72


def add_beside(figure: Figure, handles: Sequence[Line2D], left: float) -> Legend:
    """Add a legend to the right of the abscissa `left` [in]."""
    at = (left / figure.get_figwidth(), 0.5)
    return figure.legend(handles=handles, loc="center left", bbox_to_anchor=at)


def add_below(figure: Figure, handles: Sequence[Artist]) -> float:
    """Add a legend at the bottom, in as many columns as fit.

    Args:
        figure: figure to draw in.
        handles: labelled artists, one for each entry.

    Returns:
        The legend's height [in].
    """
    if not handles:
        return 0.0
    size = _font_size(handles)
    column = _widest(figure, handles) + _AROUND * size / 72
    most = max(1, int(figure.get_figwidth() // column))
    columns = ceil(len(handles) / ceil(len(handles) / most))  # rows of about the same length
    legend = figure.legend(
        handles=handles, loc="outside lower center", ncols=columns, fontsize=size
    )
    return float(legend.get_window_extent(renderer_of(figure)).height / figure.dpi)


def add_above(ax: Axes, handles: Sequence[Line2D], title: str | None = None) -> Legend:
    """Explain marks above the right end of the axes, in lines no wider than the axes."""
    legend = ax.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), handlelength=1.0
    )
    figure = figure_of(ax)
    width = figure.get_figwidth() - _BESIDE_AXES - 2.5 * 7.0 / 72
    for text in legend.get_texts():
        text.set_text(in_width(figure, text.get_text(), width))
    if title is not None:
        height = legend.get_window_extent(renderer_of(figure)).height / figure.dpi
        ax.set_title(title, pad=72 * height + 2.0)
    return legend


def figure_of(ax: Axes) -> Figure:
    """Return the figure that contains the axes."""
    figure = ax.get_figure(True)
    if figure is None:
        raise ValueError("ax: got axes that were removed, expected axes of a figure")
    return figure


def width_of(ax: Axes) -> float:
    """Return the width of the figure that contains the axes [in]."""
    return float(figure_of(ax).get_figwidth())


def in_width(figure: Figure, words: str, width: float, size: float = 7.0) -> str:
    """Break a text into lines of at most a width [in], unless a single word is wider."""
    lines = [""]
    for word in words.split(" "):
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and text_width(figure, longer, size) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return "\n".join(lines)


def renderer_of(figure: Figure) -> Any:  # untyped in matplotlib
    """Return a renderer that measures texts."""
    return FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]


def text_width(figure: Figure, line: str, size: float) -> float:
    """Return the width of a line of text [in]."""
    font = FontProperties(size=size)
    measured = renderer_of(figure).get_text_width_height_descent(line, font, False)
    return float(measured[0]) / figure.dpi


def _font_size(handles: Sequence[Artist]) -> float:
    return 7.0 if len(handles) <= _MAX_LARGE else 6.0


def _widest(figure: Figure, handles: Sequence[Artist]) -> float:
    """Return the width of the widest label [in]."""
    lines = [line for handle in handles for line in str(handle.get_label()).split("\n")]
    return max((text_width(figure, line, _font_size(handles)) for line in lines), default=0.0)
