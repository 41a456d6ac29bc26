"""Drawing a plan in space on axes that are given: paths, windows, obstacles, starts and goals.

Curves are the exact motion between the knots, not lines from knot to knot; the knots are marked.
Every function takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.patheffects import withStroke
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.names import as_text, brief
from drake_rho.display.style import (
    FORBIDDEN,
    MOST_NAMED,
    dense_times,
    vehicle_colours,
    vehicle_marker,
    view,
    window_colours,
)
from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario, Sphere

MOST_LABELLED = 6
"""Most vehicles whose names are written beside their starts."""
_MOST_LARGE = 14
"""Most vehicles whose starts and goals are drawn large."""
_TOP = 1000
"""Layer above all obstacles."""


def draw_obstacles(ax: Axes3D, obstacles: Sequence[Sphere]) -> list[Poly3DCollection]:
    """Obstacles as translucent balls, the nearer over the farther; paths go between them."""
    u, v = np.mgrid[0 : 2 * np.pi : 40j, 0 : np.pi : 20j]
    directions = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    layers = _layers(np.array([sphere.center for sphere in obstacles]).reshape(-1, 3), obstacles)
    return [
        ax.plot_surface(
            *(sphere.center[:, None, None] + sphere.radius * directions),
            color=FORBIDDEN,
            alpha=0.25,
            linewidth=0,
            antialiased=True,
            zorder=2 * layer + 2,
        )
        for sphere, layer in zip(obstacles, layers, strict=True)
    ]


def draw_paths(ax: Axes3D, plan: Plan, obstacles: Sequence[Sphere] = ()) -> list[Line3D]:
    """Each vehicle's path, its knots, its start (ring) and its goal (star).

    With more than `MOST_NAMED` vehicles there are no knots, and starts and goals are smaller.

    Args:
        ax: where to draw.
        plan: what to draw.
        obstacles: those drawn by `draw_obstacles`; what is in front of them is drawn over them.

    Returns:
        The paths, in pieces that lie before or behind an obstacle; the first of each vehicle
        carries its name.
    """
    lines = []
    colours = vehicle_colours(len(plan.positions))
    paths = plan.motion().at("position", dense_times(plan))
    for index, vehicle in enumerate(plan.scenario.vehicles):
        style = {"color": colours[index]}
        pieces = _draw_path(ax, paths[index], obstacles, linewidth=1.4, **style)
        pieces[0].set_label(as_text(vehicle.name))
        if len(paths) <= MOST_NAMED:
            _draw_knots(ax, plan.positions[index], index, obstacles, markersize=2.6, **style)
        lines += pieces
    draw_ends(ax, plan.scenario)
    return lines


def draw_windows(
    ax: Axes3D, flight: Flight, obstacles: Sequence[Sphere] = ()
) -> list[list[Line3D]]:
    """What was flown of each window in the window's colour, and the rest of it as a thin line.

    Args:
        ax: where to draw.
        flight: what to draw.
        obstacles: those drawn by `draw_obstacles`; what is in front of them is drawn over them.

    Returns:
        For each window, the pieces of what was flown of it.
    """
    lines: list[list[Line3D]] = []
    colours = window_colours(len(flight.windows))
    for window, colour in zip(flight.windows, colours, strict=True):
        flown = _flown_steps(flight, window.first_knot)
        times = dense_times(window.plan)
        paths = window.plan.motion().at("position", times)
        part = times <= window.plan.scenario.grid.elapsed[flown] + 1e-9
        lines.append([])
        for index in range(len(paths)):
            _draw_path(ax, paths[index], obstacles, color=colour, linewidth=0.6, alpha=0.45)
            lines[-1] += _draw_path(ax, paths[index, part], obstacles, color=colour, linewidth=1.6)
            if len(paths) <= MOST_NAMED:
                knots = window.plan.positions[index, : flown + 1]
                _draw_knots(ax, knots, index, obstacles, color=colour, markersize=3.2)
    named = len(flight.plan.positions) <= MOST_LABELLED
    draw_ends(ax, flight.plan.scenario, ["black"] * len(flight.plan.positions) if named else None)
    return lines


def draw_ends(ax: Axes3D, scenario: Scenario, colours: Sequence[str] | None = None) -> list[Artist]:
    """Starts as rings, goals as stars; up to `MOST_LABELLED` vehicles have their names beside."""
    artists: list[Artist] = []
    colours = colours or vehicle_colours(len(scenario.vehicles))
    size = 6.0 if len(scenario.vehicles) <= _MOST_LARGE else 3.0
    for vehicle, colour in zip(scenario.vehicles, colours, strict=True):
        start, goal = vehicle.start.position, vehicle.goal.position
        artists += ax.plot(
            *start[:, None],
            marker="o",
            markersize=size,
            markerfacecolor="white",
            color=colour,
            zorder=_TOP,
        )
        artists += ax.plot(
            *goal[:, None], marker="*", markersize=1.5 * size, color="black", zorder=_TOP
        )
        if len(scenario.vehicles) <= MOST_LABELLED:
            artists.append(_draw_name(ax, start, as_text(brief(vehicle.name))))
    return artists


def _layers(points: FloatArray, obstacles: Sequence[Sphere]) -> IntArray:
    """How many obstacles' centres lie behind each point as one looks at the scene, shape (M,)."""
    _, _, towards = view()
    depths = np.array([sphere.center @ towards for sphere in obstacles])
    layers: IntArray = np.sum((points @ towards)[:, None] > depths, axis=1)
    return layers


def _draw_path(
    ax: Axes3D, path: FloatArray, obstacles: Sequence[Sphere], **style: Any
) -> list[Line3D]:
    """A line in pieces, each over the obstacles behind it and under those in front of it."""
    layers = _layers(path, obstacles)
    cuts = [0, *(np.flatnonzero(np.diff(layers)) + 1), len(path) - 1]
    return [
        ax.plot(*path[first : last + 1].T, zorder=2 * layers[first] + 1, **style)[0]
        for first, last in pairwise(cuts)
        if last > first
    ]


def _draw_knots(
    ax: Axes3D, knots: FloatArray, index: int, obstacles: Sequence[Sphere], **style: Any
) -> None:
    layers = _layers(knots, obstacles)
    for layer in np.unique(layers):
        ax.plot(
            *knots[layers == layer].T,
            linestyle="none",
            marker=vehicle_marker(index),
            zorder=2 * layer + 1,
            **style,
        )


def _draw_name(ax: Axes3D, position: FloatArray, name: str) -> Artist:
    text: Artist = ax.text(
        *position, f"{name}\n", fontsize=8, ha="center", va="bottom", linespacing=0.6, zorder=_TOP
    )
    text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    return text


def _flown_steps(flight: Flight, first_knot: int) -> int:
    later = [window.first_knot for window in flight.windows if window.first_knot > first_knot]
    return min(later, default=flight.plan.scenario.grid.knots - 1) - first_knot
