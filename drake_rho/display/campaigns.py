"""Figures of a campaign: success, times, costs of methods compared, failures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drake_rho.campaigns.results import Results
from drake_rho.display.names import as_text
from drake_rho.display.style import LIMIT_STYLE, vehicle_colours, vehicle_marker
from drake_rho.scenario.files import replacing

_WIDTH = 6.5
"""Width of a page's text [in]."""
_LINE = 0.32
"""Height of a line of a figure with names at its side [in]."""
_MOST_LINES = 40
"""Sources, or kinds of failure, that a figure has room for."""
_MOST_POINTS = 2000
"""Points of a curve: more cannot be told apart."""


def write_campaign_figures(results: Results, folder: str | Path) -> list[Path]:
    """Draw a campaign into a folder, made if it is not there; what says nothing is left out.

    Returns:
        The files.

    Raises:
        OSError: the folder cannot be written to.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    figures = {"success": success_figure(results), "times": times_figure(results)}
    if any(each.both for each in results.comparisons):
        figures["costs"] = costs_figure(results)
    if results.failures:
        figures["failures"] = failures_figure(results)
    paths = [Path(folder) / f"{name}.png" for name in figures]
    for path, figure in zip(paths, figures.values(), strict=True):
        with replacing(path) as file:
            figure.savefig(file, dpi=150, format="png")
    return paths


def success_figure(results: Results) -> Figure:
    """Success of each method on each source of scenarios, with 95 % intervals."""
    figure, ax = _lines(min(len(results.scenarios), _MOST_LINES) * len(results.methods) / 2 + 2)
    draw_success(ax, results)
    _legend(figure, ax, len(results.methods))
    return figure


def times_figure(results: Results) -> Figure:
    """Part of all runs that each method has solved within a time."""
    figure, ax = _lines(10)
    draw_times(ax, results)
    _legend(figure, ax, len(results.methods))
    return figure


def costs_figure(results: Results) -> Figure:
    """Costs of each method over those of the first, from the least to the greatest."""
    figure, ax = _lines(10)
    draw_cost_ratios(ax, results)
    _legend(figure, ax, len(results.methods) - 1)
    return figure


def failures_figure(results: Results) -> Figure:
    """Runs without a plan that holds, by method and status."""
    figure, ax = _lines(min(len(results.failures), _MOST_LINES) + 2)
    draw_failures(ax, results)
    return figure


def draw_success(ax: Axes, results: Results) -> None:
    """Draw points and intervals, a line for each source, methods one above the other."""
    shown = results.scenarios[:_MOST_LINES]
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
            linewidth=1.0,
            label=as_text(method),
        )
    ax.set_yticks(range(len(shown)), [as_text(name) for name in shown])
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xlim(-3.0, 103.0)
    ax.set_xlabel("success, with 95 % intervals [%]")


def draw_times(ax: Axes, results: Results) -> None:
    """Draw a curve for each method, up to its success."""
    for method, colour in zip(results.methods, vehicle_colours(len(results.methods)), strict=True):
        seconds, runs = results.seconds_of(method), results.runs_of(method)
        if not len(seconds):
            continue
        parts = 100.0 * np.arange(1, len(seconds) + 1) / runs
        here = _spread_places(len(seconds))
        ax.step(seconds[here], parts[here], where="post", color=colour, label=as_text(method))
    ax.set_xscale("log")
    ax.set_ylim(0.0, 103.0)
    ax.set_xlabel("planning time [s]")
    ax.set_ylabel("runs solved [%]")


def draw_cost_ratios(ax: Axes, results: Results) -> None:
    """Draw a curve for each method but the first."""
    base, *others = results.methods
    for method, colour in zip(others, vehicle_colours(len(results.methods))[1:], strict=True):
        ratios = results.cost_ratios(method, base)
        if not len(ratios):
            continue
        here = _spread_places(len(ratios))
        parts = 100.0 * np.arange(1, len(ratios) + 1) / len(ratios)
        ax.plot(parts[here], ratios[here], color=colour, label=as_text(method))
    ax.axhline(1.0, **LIMIT_STYLE)
    ax.set_yscale("log")
    for axis_of in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        axis_of("{x:.3g}")
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("runs that both solve, by ratio [%]")
    ax.set_ylabel(f"cost over that of {as_text(base)}")


def draw_failures(ax: Axes, results: Results) -> None:
    """Draw a bar for each method and status."""
    shown = results.failures[:_MOST_LINES]
    colours = dict(zip(results.methods, vehicle_colours(len(results.methods)), strict=True))
    ax.barh(
        range(len(shown)),
        [each.runs for each in shown],
        height=0.6,
        color=[colours.get(each.method, "black") for each in shown],
    )
    status = {"solved": "breaks a constraint"}
    names = [f"{as_text(each.method)}: {status.get(each.status, each.status)}" for each in shown]
    ax.set_yticks(range(len(shown)), names)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("runs without a plan that holds")


def _spread_places(count: int) -> np.ndarray:
    """Places among so many, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_POINTS)).astype(np.int64))


def _lines(count: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(_WIDTH, 1.0 + _LINE * max(count, 3)), layout="constrained")
    return figure, figure.add_subplot()


def _legend(figure: Figure, ax: Axes, methods: int) -> None:
    if methods > 1 and ax.get_legend_handles_labels()[0]:
        figure.legend(loc="outside upper center", ncols=min(methods, 4), frameon=False)
