"""Drawing a plan on axes that are given: paths in space, distances, components over time.

Curves are the exact motion between the knots, not lines from knot to knot; the knots are marked.
Every function takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle, islice, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3D, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.motion.plan import Flight, Plan
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario, Sphere

IntArray = npt.NDArray[np.int64]

# Okabe and Ito's palette, which the colour-blind can tell apart, without its yellow (too pale on
# white) and black (kept for limits).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_MARKERS = ("o", "s", "^", "D", "v", "P")
_SPHERE = "#888888"
LIMIT_STYLE: dict[str, Any] = {"color": "black", "linestyle": "--", "linewidth": 0.9}
VIEW_ELEVATION, VIEW_AZIMUTH = 22.0, -58.0
"""Where a scene is seen from, above the horizon and around the vertical axis [deg]."""
_TOP = 1000
_PER_STEP = 12
"""Points drawn of the exact motion in each step."""


def vehicle_colours(count: int) -> list[str]:
    """A colour for each vehicle, from the first again after six."""
    return list(islice(cycle(_COLOURS), count))


def window_colours(count: int) -> list[str]:
    """A colour for each window of a receding horizon, in their order from dark to light."""
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.0, 0.95, count))]


def draw_obstacles(ax: Axes3D, obstacles: Sequence[Sphere]) -> list[Poly3DCollection]:
    """Obstacles as translucent balls, the nearer over the farther; paths go between them."""
    u, v = np.mgrid[0 : 2 * np.pi : 40j, 0 : np.pi : 20j]
    directions = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    layers = _layers(np.array([sphere.center for sphere in obstacles]).reshape(-1, 3), obstacles)
    return [
        ax.plot_surface(
            *(sphere.center[:, None, None] + sphere.radius * directions),
            color=_SPHERE,
            alpha=0.25,
            linewidth=0,
            antialiased=True,
            zorder=2 * layer + 2,
        )
        for sphere, layer in zip(obstacles, layers, strict=True)
    ]


def draw_paths(ax: Axes3D, plan: Plan, obstacles: Sequence[Sphere] = ()) -> list[Line3D]:
    """Each vehicle's path, its knots, its start (ring) and its goal (star).

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
    paths = plan.motion().at("position", _dense_times(plan))
    for index, vehicle in enumerate(plan.scenario.vehicles):
        style = {"color": colours[index]}
        pieces = _draw_path(ax, paths[index], obstacles, linewidth=1.4, **style)
        pieces[0].set_label(vehicle.name)
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
        times = _dense_times(window.plan)
        paths = window.plan.motion().at("position", times)
        part = times <= window.plan.times[flown] + 1e-9
        lines.append([])
        for index in range(len(paths)):
            _draw_path(ax, paths[index], obstacles, color=colour, linewidth=0.6, alpha=0.45)
            lines[-1] += _draw_path(ax, paths[index, part], obstacles, color=colour, linewidth=1.6)
            knots = window.plan.positions[index, : flown + 1]
            _draw_knots(ax, knots, index, obstacles, color=colour, markersize=3.2)
    draw_ends(ax, flight.plan.scenario, colours=["black"] * len(flight.plan.positions))
    return lines


def _layers(points: FloatArray, obstacles: Sequence[Sphere]) -> IntArray:
    """How many obstacles' centres lie behind each point as one looks at the scene, shape (M,)."""
    azimuth, elevation = np.radians(VIEW_AZIMUTH), np.radians(VIEW_ELEVATION)
    level = np.cos(elevation)
    towards = np.array([np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)])
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
            marker=_MARKERS[index % len(_MARKERS)],
            zorder=2 * layer + 1,
            **style,
        )


def draw_ends(ax: Axes3D, scenario: Scenario, colours: Sequence[str] | None = None) -> list[Artist]:
    """Starts as rings with the vehicles' names, goals as stars."""
    artists: list[Artist] = []
    colours = colours or vehicle_colours(len(scenario.vehicles))
    for vehicle, colour in zip(scenario.vehicles, colours, strict=True):
        start, goal = vehicle.start.position, vehicle.goal.position
        artists += ax.plot(
            *start[:, None],
            marker="o",
            markersize=6,
            markerfacecolor="white",
            color=colour,
            zorder=_TOP,
        )
        artists += ax.plot(*goal[:, None], marker="*", markersize=9, color="black", zorder=_TOP)
        if len(scenario.vehicles) <= len(_COLOURS):
            artists.append(_draw_name(ax, start, vehicle.name))
    return artists


def _draw_name(ax: Axes3D, position: FloatArray, name: str) -> Artist:
    text: Artist = ax.text(
        *position, f"{name}\n", fontsize=8, ha="center", va="bottom", linespacing=0.6, zorder=_TOP
    )
    text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
    return text


def frame_scene(ax: Axes3D, positions: FloatArray, obstacles: Sequence[Sphere]) -> None:
    """Equal axes around the positions [m] and the obstacles, named with their unit."""
    points = [positions.reshape(-1, 3)]
    for sphere in obstacles:
        points.append(sphere.center + sphere.radius * np.concatenate([np.eye(3), -np.eye(3)]))
    every = np.concatenate(points)
    lower, upper = every.min(axis=0), every.max(axis=0)
    margin = 0.04 * float(np.max(upper - lower)) or 1.0
    lower, upper = lower - margin, upper + margin
    ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
    ax.set_box_aspect(upper - lower, zoom=1.0)
    ax.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    for each in (ax.xaxis, ax.yaxis, ax.zaxis):
        each.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    ax.tick_params(labelsize=8, pad=1)
    # Lines and surfaces are drawn in the order of their layers, which parallel lines of sight make
    # exact; matplotlib's own order goes by the middle of each and hides what is in front.
    ax.computed_zorder = False
    ax.set_proj_type("ortho")
    ax.view_init(elev=VIEW_ELEVATION, azim=VIEW_AZIMUTH)


def draw_distances(ax: Axes, plan: Plan, sphere: Sphere) -> list[Line2D]:
    """Distance of each vehicle from the centre of a sphere over time, with the radius."""
    times = _dense_times(plan)
    exact = np.linalg.norm(plan.motion().at("position", times) - sphere.center, axis=2)
    knots = np.linalg.norm(plan.positions - sphere.center, axis=2)
    ax.axhspan(0.0, sphere.radius, color=_SPHERE, alpha=0.18, linewidth=0)
    ax.axhline(sphere.radius, **LIMIT_STYLE)
    ax.annotate(
        f"R = {sphere.radius:g} m",
        (0.01, sphere.radius),
        xycoords=("axes fraction", "data"),
        xytext=(0, -4),
        textcoords="offset points",
        fontsize=8,
        va="top",
    )
    lines = [
        _draw_curve(ax, plan, index, (times, exact[index]), (plan.times, knots[index]))
        for index in range(len(exact))
    ]
    ax.set(xlabel="time [s]", ylabel="distance from the obstacle's centre [m]", ylim=(0, None))
    ax.grid(alpha=0.25, linewidth=0.5)
    ax.set_xlim(0.0, plan.scenario.grid.duration)
    return lines


def draw_velocities(axes: Sequence[Axes], plan: Plan) -> list[Line2D]:
    """Velocity components over time with their bounds; one axes for each of x, y and z."""
    times = _dense_times(plan)
    exact = plan.motion().at("velocity", times)
    lines = []
    for axis, ax in enumerate(axes):
        lines += [
            _draw_curve(
                ax, plan, i, (times, exact[i, :, axis]), (plan.times, plan.velocities[i, :, axis])
            )
            for i in range(len(exact))
        ]
        _finish_component(ax, plan, "velocity", "v", "m/s", axis)
    axes[-1].set_xlabel("time [s]")
    return lines


def draw_accelerations(axes: Sequence[Axes], plan: Plan) -> list[Line2D]:
    """Acceleration components, constant in each step, with their bounds; one axes an axis."""
    lines = []
    for axis, ax in enumerate(axes):
        for i in range(len(plan.accelerations)):
            a = plan.accelerations[i, :, axis]
            steps = (np.repeat(plan.times, 2)[1:-1], np.repeat(a, 2))
            lines.append(_draw_curve(ax, plan, i, steps, (plan.times[:-1], a)))
        _finish_component(ax, plan, "acceleration", "a", "m/s²", axis)
    axes[-1].set_xlabel("time [s]")
    return lines


def _draw_curve(
    ax: Axes,
    plan: Plan,
    index: int,
    exact: tuple[FloatArray, FloatArray],
    knots: tuple[FloatArray, FloatArray],
) -> Line2D:
    colour = vehicle_colours(len(plan.positions))[index]
    name = plan.scenario.vehicles[index].name
    (line,) = ax.plot(*exact, color=colour, linewidth=1.2, label=name)
    marker = _MARKERS[index % len(_MARKERS)]
    ax.plot(*knots, color=colour, linestyle="none", marker=marker, markersize=2.6)
    return line


def vehicle_handles(scenario: Scenario, most: int = 14) -> list[Line2D]:
    """Legend entries of the first `most` vehicles: line and knots as they are drawn."""
    colours = vehicle_colours(len(scenario.vehicles))
    return [
        Line2D(
            [],
            [],
            color=colours[index],
            marker=_MARKERS[index % len(_MARKERS)],
            markersize=4,
            linewidth=1.2,
            label=vehicle.name,
        )
        for index, vehicle in enumerate(scenario.vehicles[:most])
    ]


def _finish_component(
    ax: Axes, plan: Plan, quantity: str, letter: str, unit: str, axis: int
) -> None:
    for vehicle in plan.scenario.vehicles:
        box = getattr(plan.scenario.limits_of(vehicle), quantity)
        if box is not None:
            ax.axhline(box.lower[axis], **LIMIT_STYLE)
            ax.axhline(box.upper[axis], **LIMIT_STYLE)
    ax.set_ylabel(f"${letter}_{'xyz'[axis]}$ [{unit}]")
    ax.set_xlim(0.0, plan.scenario.grid.duration)
    ax.grid(alpha=0.25, linewidth=0.5)


def _dense_times(plan: Plan) -> FloatArray:
    grid = plan.scenario.grid
    return np.linspace(0.0, grid.duration, _PER_STEP * (grid.knots - 1) + 1)


def _flown_steps(flight: Flight, first_knot: int) -> int:
    later = [window.first_knot for window in flight.windows if window.first_knot > first_knot]
    return min(later, default=flight.plan.scenario.grid.knots - 1) - first_knot
