"""Panels of values over time: curves of vehicles, their minima, limits and planned values.

Times are those of the scenario's clock on the axes, and since the first knot in arguments. Every
function takes the axes first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common.drawable import Drawn, Prediction
from drake_rho.display.common.minima import Minima, Minimum
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.style import (
    EXTREMUM_STYLE,
    FORBIDDEN,
    LIMIT_STYLE,
    MAX_NAMED,
    MEASURED_STYLE,
    PLANNED_STYLE,
    vehicle_colours,
    vehicle_marker,
    with_gaps,
)
from drake_rho.display.plots.labels import Labels, along, around, beside
from drake_rho.display.plots.legends import add_above, width_of
from drake_rho.display.plots.overlapping_curves import marks_every, show_overlapping
from drake_rho.scenario.fields import FloatArray

MAX_ANNOTATED = 14
"""Largest number of vehicles whose minima are marked."""
_BELOW = 0.08
"""Space below the lowest value, over the range of values: enough for a line of text."""


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """Values of some vehicles over time, with their minima; values that are not finite are gaps."""

    times: FloatArray
    """times of the curves since the first knot [s], shape (M,) or (V, M)"""
    values: FloatArray
    """values at these times, shape (V, M)"""
    minima: Minima
    """minima, which name the vehicles"""
    knots: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    """times of marks since the first knot [s], shape (K,)"""
    at_knots: FloatArray | None = None
    """values at the marks, shape (V, K)"""
    labels: Sequence[str] = ()
    """texts beside the minima, one for each vehicle, or none"""


def draw_curves(ax: Axes, plan: Drawn, curves: Curves) -> list[Line2D]:
    """Draw curves in the vehicles' colours, and open marks at their minima; return the curves."""
    start, colours = plan.scenario.grid.start, vehicle_colours(len(plan.positions))
    lines = []
    for row, index in enumerate(curves.minima.vehicles.tolist()):
        times = np.broadcast_to(curves.times, curves.values.shape)[row]
        times, values = with_gaps(plan, times, _finite(curves.values[row]))
        lines.append(draw_curve(ax, plan, index, start + times, values))
        if curves.at_knots is not None:
            mark_knots(ax, plan, index, start + curves.knots, _finite(curves.at_knots[row]))
        least = start + float(curves.minima.times[row]), float(curves.minima.values[row])
        if len(curves.values) <= MAX_ANNOTATED and np.isfinite(least[1]):
            open_mark = {"markersize": 4.5, "markerfacecolor": "white", "zorder": 2.8}
            _mark(ax, index, *least, color=colours[index], **open_mark)
            if curves.labels:
                words, spots = curves.labels[row], around(ax, *least)
                Labels.of(ax).add(words, spots, rank=1, color=colours[index])
    return lines


def _finite(values: FloatArray) -> FloatArray:
    """Return values with NaN, which is not drawn, in place of infinite ones."""
    return np.where(np.isfinite(values), values, np.nan)


def draw_curve(ax: Axes, plan: Drawn, index: int, times: FloatArray, values: FloatArray) -> Line2D:
    """Draw a vehicle's curve in its colour, at times on the scenario's clock [s], shape (M,)."""
    colour = vehicle_colours(len(plan.positions))[index]
    name = as_text(plan.scenario.vehicles[index].name)
    (line,) = ax.plot(times, values, color=colour, label=name)
    return line


def mark_knots(ax: Axes, plan: Drawn, index: int, times: FloatArray, values: FloatArray) -> None:
    """Mark a vehicle's values at knots, or at some of them, if vehicles are named."""
    if len(plan.positions) <= MAX_NAMED:
        every = marks_every(len(times), width_of(ax))
        colour = vehicle_colours(len(plan.positions))[index]
        _mark(ax, index, times[::every], values[::every], color=colour, markersize=2.4)


def _mark(ax: Axes, index: int, *place: object, **style: object) -> None:
    """Draw a vehicle's markers, whole at both ends of the flight."""
    marker = vehicle_marker(index)
    ax.plot(*place, linestyle="none", marker=marker, clip_on=False, **style)  # type: ignore[arg-type]


def draw_planned(
    ax: Axes, piece: Prediction, times: FloatArray, values: FloatArray
) -> list[Line2D]:
    """Draw a window's planned values for each vehicle as dotted lines.

    Args:
        ax: axes to draw in.
        piece: prediction whose part in force is drawn.
        times: times since its first knot [s], shape (M,) or (N, M).
        values: values of all vehicles at these times, shape (N, M).
    """
    start, colours = piece.shown.scenario.grid.start, vehicle_colours(len(values))
    lines = []
    for each, at, colour in zip(values, np.broadcast_to(times, values.shape), colours, strict=True):
        shown = piece.in_force(at)
        lines += ax.plot(start + at[shown], _finite(each[shown]), color=colour, **PLANNED_STYLE)
    return lines


def draw_measured(ax: Axes, plan: Drawn, values: FloatArray) -> list[Line2D]:
    """Draw values (N, M) of measured samples, with gaps where they are not finite."""
    assert plan.measured is not None  # noqa: S101  # the values are of its samples
    times = plan.scenario.grid.start + plan.measured.elapsed
    return [line for each in values for line in ax.plot(times, _finite(each), **MEASURED_STYLE)]


def draw_limit(ax: Axes, least: float, name: str, bottom: float = 0.0) -> None:
    """Draw a required distance [m] with its name, and shade the range down to `bottom`."""
    ax.axhspan(bottom, least, color=FORBIDDEN, alpha=0.18, linewidth=0)
    ax.axhline(least, **LIMIT_STYLE)
    Labels.of(ax).add(name, along(ax, least), bbox=None)


def draw_inactive(ax: Axes, plan: Drawn, active: tuple[float, float] | None) -> None:
    """Shade the times of the flight outside the interval of a constraint."""
    if active is None:
        return
    grid, (first, last) = plan.scenario.grid, active
    for begin, end in ((grid.start, min(first, grid.end)), (max(last, grid.start), grid.end)):
        if grid.clock.before(begin, end):
            ax.axvspan(begin, end, color=FORBIDDEN, alpha=0.08, linewidth=0)
            Labels.of(ax).add("not active", beside(ax, begin))


def draw_ring(
    ax: Axes, place: tuple[float, float], words: str, *more: Line2D, title: str | None = None
) -> Line2D:
    """Draw a ring at the least or greatest value of all, and explain it above the axes."""
    (ring,) = ax.plot(*place, label=words, **EXTREMUM_STYLE)
    add_above(ax, [ring, *more], title)
    return ring


def draw_minimum(
    ax: Axes,
    plan: Drawn,
    minimum: Minimum,
    other: str,
    *more: Line2D,
    tolerance: float = 0.0,
    title: str | None = None,
) -> Line2D:
    """Draw a ring at the minimum of all vehicles, described by distance, time and names.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        minimum: the minimum.
        other: words after the vehicle's name.
        more: further entries of the legend above the axes.
        tolerance: distance below which 0 is written [m].
        title: title of the axes.
    """
    value, time = minimum.value, plan.scenario.grid.start + minimum.time
    far = "0" if abs(value) <= tolerance else f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    name = as_text(brief(plan.scenario.vehicles[minimum.vehicle].name))
    return draw_ring(
        ax, (time, value), f"{far} m at {time:.4g} s: {name}{other}", *more, title=title
    )


def bottom_of(values: FloatArray) -> float:
    """Return the lower end of an axis with values of any shape and zero, below the lowest."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    return low - _BELOW * max(high - low, 1e-9)


def finish(ax: Axes, plan: Drawn, lines: Sequence[Line2D]) -> None:
    """Set the time axis and, if vehicles are named, make overlapping curves visible."""
    ax.set_xlabel("time [s]")
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
    if lines and len(plan.positions) <= MAX_NAMED:
        show_overlapping(ax, lines)
