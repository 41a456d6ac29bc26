"""Legends of the vehicles, beside a drawing or below it, never over it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from drake_rho.display.names import as_text, in_lines
from drake_rho.display.style import MOST_NAMED, vehicle_colours, vehicle_marker
from drake_rho.scenario.records import Scenario

_MOST_LARGE = 14
"""Most entries in letters of the usual size, and in one column."""
_MOST_BESIDE = 0.7
"""Widest name in a legend beside a drawing [in]."""
_AROUND = 4.8
"""Width of an entry's line and the gaps around it, in sizes of the letters."""


def vehicle_handles(scenario: Scenario) -> list[Line2D]:
    """Legend entries of the vehicles, as they are drawn; none with more than `MOST_NAMED`."""
    if len(scenario.vehicles) > MOST_NAMED:
        return []
    colours = vehicle_colours(len(scenario.vehicles))
    return [
        _entry(vehicle.name, color=colours[index], marker=vehicle_marker(index), markersize=4)
        for index, vehicle in enumerate(scenario.vehicles)
    ]


def start_handles(scenario: Scenario) -> list[Line2D]:
    """Legend entries of the vehicles' starts; none with more than `MOST_NAMED`."""
    handles = vehicle_handles(scenario)
    for handle in handles:
        handle.set(linestyle="none", marker="o", markersize=6, markerfacecolor="white")
    return handles


def _entry(name: str, **style: Any) -> Line2D:
    return Line2D([], [], linewidth=1.2, label=as_text(in_lines(name)), **style)


def fits_beside(figure: Figure, handles: Sequence[Line2D]) -> bool:
    """Whether a legend is so small that there is room for it at the right of a drawing."""
    return 0 < len(handles) <= _MOST_LARGE and _widest(figure, handles) <= _MOST_BESIDE


def add_beside(figure: Figure, handles: Sequence[Line2D]) -> Legend:
    """A legend at the right."""
    return figure.legend(handles=handles, loc="center right", fontsize=9, frameon=False)


def add_below(figure: Figure, handles: Sequence[Line2D]) -> float:
    """A legend at the bottom, in as many columns as there is room for.

    Args:
        figure: where to draw.
        handles: the entries; the legend's labels are theirs.

    Returns:
        Its height [in].
    """
    if not handles:
        return 0.0
    size = _letters(handles)
    column = _widest(figure, handles) + _AROUND * size / 72
    columns = min(len(handles), max(1, int(figure.get_figwidth() // column)))
    legend = figure.legend(
        handles=handles, loc="outside lower center", ncols=columns, fontsize=size, frameon=False
    )
    extent = legend.get_window_extent(_renderer(figure))
    return float(extent.height / figure.dpi)


def _renderer(figure: Figure) -> Any:  # matplotlib has no types for it
    return FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]


def _letters(handles: Sequence[Line2D]) -> float:
    return 9.0 if len(handles) <= _MOST_LARGE else 7.0


def _widest(figure: Figure, handles: Sequence[Line2D]) -> float:
    """Width of the widest name [in]."""
    renderer = _renderer(figure)
    font = FontProperties(size=_letters(handles))
    lines = [line for handle in handles for line in str(handle.get_label()).split("\n")]
    widths = [renderer.get_text_width_height_descent(line, font, False)[0] for line in lines]
    return float(max(widths, default=0.0)) / figure.dpi
