"""Requirements of positions, drawn on given axes: sets and links in space, margins over time.

Every function takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_text
from drake_rho.display.common.obstacle_snapshots import Snapshot, active_in_words
from drake_rho.display.common.requirements import RequiredPositions, required_positions, tightest
from drake_rho.display.common.set_surfaces import surface_within
from drake_rho.display.common.style import ALLOWED, dense_times, reddened
from drake_rho.display.plots.labels import Labels, around
from drake_rho.display.plots.lines3d import draw_line
from drake_rho.display.plots.panels import (
    Curves,
    bottom_of,
    draw_curves,
    draw_inactive,
    draw_limit,
    draw_minimum,
    draw_planned,
    finish,
)

_MAX_LABELLED = 8
"""Largest number of sets, or of links, that are labelled in space."""
_ABOVE = 1.5
"""Upper end of axes with several requirements, over the peak of their smallest margin."""
_PARTS = 24
"""Number of parts of a link, each in front of or behind an obstacle."""


def draw_sets(ax: Axes3D, plan: Drawn) -> list[Artist]:
    """Draw the sets required of single vehicles, faint, within the limits of the axes."""
    lower, upper = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T
    sets = [each for each in required_positions(plan.scenario) if not each.is_link]
    artists: list[Artist] = []
    for required in sets:
        skin = surface_within(required.requirement.set, lower, upper)
        if skin.faces:
            style: dict[str, Any] = {"facecolors": ALLOWED, "alpha": 0.07, "linewidth": 0}
            artists.append(ax.add_collection3d(Poly3DCollection(skin.faces, **style)))
        if skin.edges:
            style = {"colors": ALLOWED, "alpha": 0.7, "linewidths": 0.6}
            artists.append(ax.add_collection3d(Line3DCollection(skin.edges, **style)))
        if skin.faces and len(sets) <= _MAX_LABELLED:
            corners = np.concatenate(skin.faces)
            top = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            top[2] = corners[:, 2].max()
            words = ", ".join(
                filter(
                    None, (as_text(required.label), active_in_words(required.requirement.active))
                )
            )
            spots = around(ax, *top)
            artists.append(Labels.of(ax).add(words, spots, rank=1, color=ALLOWED))
    return artists


def draw_links(ax: Axes3D, plan: Drawn, shown: Sequence[Snapshot] = ()) -> list[Line3D]:
    """Draw each link at its smallest margin, as a dashed line that is red without a margin.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        shown: drawn obstacles, which hide the parts of links behind them.
    """
    links = [each for each in required_positions(plan.scenario) if each.is_link]
    labelled = sum(len(required.members) for required in links) <= _MAX_LABELLED
    lines = []
    for required in links:
        minima = required.minima(plan)
        begins = required.origins(plan, minima.times)
        ends = plan.motion().each_at("position", required.members, minima.times)
        parts = minima.values / required.plenty(plan)
        for begin, end, part, time in zip(begins, ends, parts, minima.times, strict=True):
            points = begin + np.linspace(0.0, 1.0, _PARTS + 1)[:, None] * (end - begin)
            style: dict[str, Any] = {"color": reddened(part), "linewidth": 1.0}
            lines += draw_line(ax, points, shown, linestyle=(0, (3, 2)), **style)
            if required.partner is None:
                mark: dict[str, Any] = {"marker": "x", "markersize": 4, "color": "black"}
                lines += ax.plot(*begin[:, None], **mark)
            if labelled:
                words = (
                    f"{as_text(required.label)}, {round(plan.scenario.grid.start + time, 2):g} s"
                )
                spots = around(ax, *points[_PARTS // 2])
                Labels.of(ax).add(words, spots, rank=2, color="#555555")
    return lines


def draw_margins(
    ax: Axes, plan: Drawn, required: Sequence[RequiredPositions], *, title: str | None = None
) -> list[Line2D]:
    """Draw each vehicle's margin in requirements of positions over time.

    The margin is the distance from the boundary of the set, positive inside, minus the largest
    deviation of a moving point from its track. Curves are drawn while the requirement is active.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        required: requirements; of several, each minimum is labelled with its name.
        title: title of the axes.

    Returns:
        The curves, and a ring at the overall minimum.
    """
    highest = _highest(plan, required)
    curves = [line for each in required for line in _draw_curves(ax, plan, each, highest)]
    number, minima = tightest(required, plan)
    where, least, scenario = required[number], minima.least, plan.scenario
    tolerance = where.requirement.tolerances(scenario.fleet, scenario.names)[least.row]
    words = f" in {as_text(where.label)}" if len(required) > 1 else ""
    ring = draw_minimum(ax, plan, least, words, tolerance=tolerance, title=title)
    bottom = bottom_of(np.concatenate([np.asarray(line.get_ydata()) for line in curves]))
    draw_limit(ax, 0.0, "boundary of the set", bottom)
    ax.set(ylabel="distance inside the set [m]", ylim=(bottom, highest))
    if len(required) == 1:
        draw_inactive(ax, plan, where.requirement.active)
    finish(ax, plan, curves if len(required) == 1 else [])
    return [*curves, ring]


def _highest(plan: Drawn, required: Sequence[RequiredPositions]) -> float | None:
    """Return the upper end of axes with several requirements [m]: above their smallest margin.

    None for one requirement, or if no margin is positive.
    """
    if len(required) == 1:
        return None
    times = dense_times(plan)
    least = np.min([each.margins(plan, times).min(axis=0) for each in required], axis=0)
    top = _ABOVE * float(least.max(where=np.isfinite(least), initial=0.0))
    return top if top > 0.0 else None


def _draw_curves(
    ax: Axes, plan: Drawn, required: RequiredPositions, highest: float | None
) -> list[Line2D]:
    """Draw the margins in a requirement, with marks at the minima.

    With a highest value [m], greater values are omitted, and the minima are labelled.
    """
    most = np.inf if highest is None else highest
    labels = [] if highest is None else [as_text(required.label)] * len(required.members)
    elapsed, minima = plan.scenario.grid.elapsed, required.minima(plan)
    times = np.union1d(required.times(plan), minima.times)
    knots = elapsed[required.is_active(plan, elapsed)]
    values, at_knots, least = (
        np.where(each <= most, each, np.nan)
        for each in (required.margins(plan, times), required.margins(plan, knots), minima.values)
    )
    minima = dataclasses.replace(minima, values=least)
    curves = Curves(times, values, minima, knots, at_knots, labels)
    lines = draw_curves(ax, plan, curves)
    for piece in plan.planned:
        times = dense_times(piece.shown)
        margins = np.full((len(plan.positions), len(times)), np.nan)
        values = required.margins(piece.shown, times)
        margins[required.members] = np.where(values <= most, values, np.nan)
        draw_planned(ax, piece, times, margins)
    return lines
