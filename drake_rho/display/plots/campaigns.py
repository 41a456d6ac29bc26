"""Figures of a campaign: success rates, planning times, cost ratios, failures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullLocator

from drake_rho.campaigns.results import Results
from drake_rho.display.common.names import as_text, brief, in_lines
from drake_rho.display.common.style import LIMIT_STYLE, vehicle_colours, vehicle_marker
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_format, check_width
from drake_rho.display.plots.legends import add_below
from drake_rho.display.plots.publish import save_figures, styled

_LINE = 0.26
"""Height per line in a figure with names at its side [in]."""
_DASHES = ("-", (0, (5, 1.5)), (0, (2, 1)), (0, (6, 1.5, 1.5, 1.5)))
"""Line styles of the methods, repeated if there are more methods."""
_MAX_LINES = 40
"""Largest number of sources, or kinds of failure, in a figure."""
_MAX_POINTS = 2000
"""Largest number of points of a curve; more cannot be distinguished."""


def write_campaign_figures(
    results: Results,
    folder: str | Path,
    *,
    file_format: str = "png",
    width: float = DOUBLE_COLUMN,
) -> list[Path]:
    """Write the figures of a campaign into a folder, without empty ones.

    Args:
        results: results of the campaign.
        folder: folder of the files, created if it does not exist.
        file_format: png, pdf or svg.
        width: width of each figure [in]; in IEEE journals 3.5 for one column, 7.16 for two.

    Returns:
        Paths of the files.

    Raises:
        ValueError: the format is unknown, or the text would be illegible at the width.
        OSError: the folder cannot be written to.
    """
    check_format(file_format)
    draw = {"success": success_figure, "times": times_figure}
    if any(each.both for each in results.comparisons):
        draw["costs"] = costs_figure
    if results.failures:
        draw["failures"] = failures_figure
    figures = {name: each(results, width=width) for name, each in draw.items()}
    return save_figures(figures, folder, file_format)


@styled
def success_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot each method's success rate on each source of scenarios, with 95 % intervals."""
    lines = min(len(results.scenarios), _MAX_LINES) * len(results.methods) / 2 + 2
    return _figure_of_lines(lines, width, draw_success, results)


@styled
def times_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the percentage of runs that each method solves, over planning time."""
    return _figure_of_lines(8, width, draw_times, results)


@styled
def costs_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the ratios of each method's costs to those of the first method, in ascending order."""
    return _figure_of_lines(8, width, draw_cost_ratios, results)


@styled
def failures_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the number of runs without a valid plan, by method and status."""
    lines = min(len(results.failures), _MAX_LINES) + 2
    return _figure_of_lines(lines, width, draw_failures, results)


def draw_success(ax: Axes, results: Results) -> None:
    """Draw success rates with intervals, one line per source, methods stacked within a line."""
    shown = results.scenarios[:_MAX_LINES]
    colours = vehicle_colours(len(results.methods))
    for j, method in enumerate(results.methods):
        groups = [each for each in results.groups if each.method == method]
        groups = [each for each in groups if each.scenario in shown]
        if not groups:
            continue
        rates = 100.0 * np.array([each.success.rate for each in groups])
        ends = 100.0 * np.array([each.success.interval for each in groups]).T
        offset = 0.5 * ((j + 0.5) / len(results.methods) - 0.5)
        heights = np.array([shown.index(each.scenario) for each in groups]) + offset
        ax.errorbar(
            rates,
            heights,
            xerr=np.maximum(np.abs(ends - rates), 0.0),
            fmt=vehicle_marker(j),
            color=colours[j],
            markersize=4.0,
            capsize=2.0,
            label=as_text(in_lines(method)),
        )
    ax.set_yticks(range(len(shown)), [as_text(brief(name)) for name in shown])
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xlim(-3.0, 103.0)
    ax.set_xlabel("success rate, with 95 % confidence intervals [%]")


def draw_times(ax: Axes, results: Results) -> None:
    """Draw a curve of solved runs over planning time for each method."""
    for method in results.methods:
        seconds, runs = results.seconds_of(method), results.runs_of(method)
        if not len(seconds):
            continue
        parts = 100.0 * np.arange(1, len(seconds) + 1) / runs
        here = _sampled_indices(len(seconds))
        ax.step(seconds[here], parts[here], where="post", **_line(results, method))
    ax.set_xscale("log")
    ax.set_ylim(0.0, 103.0)
    ax.set_xlabel("planning time [s]")
    ax.set_ylabel("runs solved [%]")


def draw_cost_ratios(ax: Axes, results: Results) -> None:
    """Draw a curve of sorted cost ratios for each method except the first."""
    base, *others = results.methods
    for method in others:
        ratios = results.cost_ratios(method, base)
        if not len(ratios):
            continue
        here = _sampled_indices(len(ratios))
        parts = 100.0 * np.arange(1, len(ratios) + 1) / len(ratios)
        ax.plot(parts[here], ratios[here], **_line(results, method))
    ax.axhline(1.0, **LIMIT_STYLE)
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    ax.yaxis.set_major_locator(_few_ticks(high / low))
    ax.yaxis.set_major_formatter("{x:.4g}")
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("runs solved by both methods, sorted by ratio [%]")
    ax.set_ylabel(f"cost relative to {as_text(brief(base))}")


def _few_ticks(span: float) -> Locator:
    """Return ticks of a logarithmic axis: few enough to be legible, enough to read off values.

    Args:
        span: ratio of the axis's upper to its lower end.
    """
    if span < 2.0:
        return MaxNLocator(nbins=6, steps=[1, 2, 5, 10])
    if span < 20.0:
        return LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
    return LogLocator(subs=(1.0, 2.0, 5.0)) if span < 1e4 else LogLocator()


def draw_failures(ax: Axes, results: Results) -> None:
    """Draw a bar for each method and status."""
    shown = results.failures[:_MAX_LINES]
    colours = dict(zip(results.methods, vehicle_colours(len(results.methods)), strict=True))
    ax.barh(
        range(len(shown)),
        [each.runs for each in shown],
        height=0.6,
        color=[colours.get(each.method, "black") for each in shown],
    )
    status = {"solved": "violates a constraint"}
    names = [
        f"{as_text(brief(each.method))}: {status.get(each.status, each.status)}" for each in shown
    ]
    ax.set_yticks(range(len(shown)), names)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("runs without a valid plan")


def _line(results: Results, method: str) -> dict[str, Any]:
    """Return a method's name and line style, with dashes that distinguish overlapping lines."""
    number = results.methods.index(method)
    colour = vehicle_colours(len(results.methods))[number]
    dashes = _DASHES[number % len(_DASHES)]
    return {"color": colour, "linestyle": dashes, "label": as_text(in_lines(method))}


def _sampled_indices(count: int) -> np.ndarray:
    """Return at most `_MAX_POINTS` evenly spaced indices, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_POINTS)).astype(np.int64))


def _figure_of_lines(
    count: float, width: float, draw: Callable[[Axes, Results], None], results: Results
) -> Figure:
    """Return a figure of results, as high as a number of lines, with a legend of the methods."""
    height = 0.7 + _LINE * max(count, 3)
    figure = Figure(figsize=(check_width(width), height), layout="constrained")
    ax = figure.add_subplot()
    draw(ax, results)
    add_below(figure, ax.get_legend_handles_labels()[0])
    return figure
