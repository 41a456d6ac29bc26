"""Figures of a campaign: success, times, costs of methods compared, failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drake_rho.campaigns.results import Results
from drake_rho.display.common.names import as_text, brief, in_lines
from drake_rho.display.common.style import LIMIT_STYLE, vehicle_colours, vehicle_marker
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_format, check_width
from drake_rho.display.plots.legends import add_below
from drake_rho.display.plots.publish import save_figure, styled

_LINE = 0.26
"""Height of a line of a figure with names at its side [in]."""
_DASHES = ("-", (0, (5, 1.5)), (0, (2, 1)), (0, (6, 1.5, 1.5, 1.5)))
"""Of the methods' lines in turn."""
_MAX_LINES = 40
"""Sources, or kinds of failure, that a figure has room for."""
_MAX_POINTS = 2000
"""Points of a curve: more cannot be told apart."""


def write_campaign_figures(
    results: Results,
    folder: str | Path,
    *,
    file_format: str = "png",
    width: float = DOUBLE_COLUMN,
) -> list[Path]:
    """Draw a campaign into a folder, made if it is not there; what says nothing is left out.

    Args:
        results: of the campaign.
        folder: where to draw.
        file_format: png, pdf or svg.
        width: of each figure [in], 3.5 in one column of a journal of the IEEE, 7.16 in both.

    Returns:
        The files.

    Raises:
        ValueError: there is no such format, or the width is none that letters can be read at.
        OSError: the folder cannot be written to.
    """
    check_format(file_format)
    draw = {"success": success_figure, "times": times_figure}
    if any(each.both for each in results.comparisons):
        draw["costs"] = costs_figure
    if results.failures:
        draw["failures"] = failures_figure
    figures = {name: each(results, width=width) for name, each in draw.items()}
    Path(folder).mkdir(parents=True, exist_ok=True)
    return [
        save_figure(figure, Path(folder) / f"{name}.{file_format}")
        for name, figure in figures.items()
    ]


@styled
def success_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Success of each method on each source of scenarios, with 95 % intervals."""
    lines = min(len(results.scenarios), _MAX_LINES) * len(results.methods) / 2 + 2
    figure, ax = _lines(lines, width)
    draw_success(ax, results)
    _legend(figure, ax)
    return figure


@styled
def times_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Part of all runs that each method has solved within a time."""
    figure, ax = _lines(8, width)
    draw_times(ax, results)
    _legend(figure, ax)
    return figure


@styled
def costs_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Costs of each method over those of the first, from the least to the greatest."""
    figure, ax = _lines(8, width)
    draw_cost_ratios(ax, results)
    _legend(figure, ax)
    return figure


@styled
def failures_figure(results: Results, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Runs without a plan that holds, by method and status."""
    figure, ax = _lines(min(len(results.failures), _MAX_LINES) + 2, width)
    draw_failures(ax, results)
    return figure


def draw_success(ax: Axes, results: Results) -> None:
    """Draw points and intervals, a line for each source, methods one above the other."""
    shown = results.scenarios[:_MAX_LINES]
    colours = vehicle_colours(len(results.methods))
    for j, method in enumerate(results.methods):
        groups = [each for each in results.groups if each.method == method]
        groups = [each for each in groups if each.scenario in shown]
        if not groups:
            continue
        rates = 100.0 * np.array([each.success.rate for each in groups])
        ends = 100.0 * np.array([each.success.interval for each in groups]).T
        aside = 0.5 * ((j + 0.5) / len(results.methods) - 0.5)
        heights = np.array([shown.index(each.scenario) for each in groups]) + aside
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
    ax.set_xlabel("success, with 95 % intervals [%]")


def draw_times(ax: Axes, results: Results) -> None:
    """Draw a curve for each method, up to its success."""
    for method in results.methods:
        seconds, runs = results.seconds_of(method), results.runs_of(method)
        if not len(seconds):
            continue
        parts = 100.0 * np.arange(1, len(seconds) + 1) / runs
        here = _spread_places(len(seconds))
        ax.step(seconds[here], parts[here], where="post", **_line(results, method))
    ax.set_xscale("log")
    ax.set_ylim(0.0, 103.0)
    ax.set_xlabel("planning time [s]")
    ax.set_ylabel("runs solved [%]")


def draw_cost_ratios(ax: Axes, results: Results) -> None:
    """Draw a curve for each method but the first."""
    base, *others = results.methods
    for method in others:
        ratios = results.cost_ratios(method, base)
        if not len(ratios):
            continue
        here = _spread_places(len(ratios))
        parts = 100.0 * np.arange(1, len(ratios) + 1) / len(ratios)
        ax.plot(parts[here], ratios[here], **_line(results, method))
    ax.axhline(1.0, **LIMIT_STYLE)
    ax.set_yscale("log")
    for axis_of in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        axis_of("{x:.3g}")
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("runs that both solve, by ratio [%]")
    ax.set_ylabel(f"cost over that of {as_text(brief(base))}")


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
    status = {"solved": "breaks a constraint"}
    names = [
        f"{as_text(brief(each.method))}: {status.get(each.status, each.status)}" for each in shown
    ]
    ax.set_yticks(range(len(shown)), names)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("runs without a plan that holds")


def _line(results: Results, method: str) -> dict[str, Any]:
    """A method's colour and dashes, by which lines on each other are told apart, and its name."""
    number = results.methods.index(method)
    colour = vehicle_colours(len(results.methods))[number]
    dashes = _DASHES[number % len(_DASHES)]
    return {"color": colour, "linestyle": dashes, "label": as_text(in_lines(method))}


def _spread_places(count: int) -> np.ndarray:
    """Places among so many, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_POINTS)).astype(np.int64))


def _lines(count: float, width: float) -> tuple[Figure, Axes]:
    height = 0.7 + _LINE * max(count, 3)
    figure = Figure(figsize=(check_width(width), height), layout="constrained")
    return figure, figure.add_subplot()


def _legend(figure: Figure, ax: Axes) -> None:
    """The methods below, in as many columns as there is room for."""
    handles, _ = ax.get_legend_handles_labels()
    if handles:
        add_below(figure, handles)
