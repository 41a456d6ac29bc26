"""Plans drawn in space on given axes: paths, windows, obstacles, starts and goals.

Curves show the exact motion, not straight lines from knot to knot; the knots are marked. Every
function takes the axes first and returns the artists it has drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import to_rgba
from matplotlib.text import Text
from mpl_toolkits.mplot3d.art3d import Line3D, Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from drake_rho.display.common.drawable import Drawn, goal_point
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.obstacle_snapshots import Snapshot
from drake_rho.display.common.shape_faces import around as surface_around
from drake_rho.display.common.shape_faces import surface
from drake_rho.display.common.style import (
    CONFLICT,
    CONTINGENCY,
    FORBIDDEN,
    MAX_NAMED,
    MEASURED_STYLE,
    PLANNED_STYLE,
    dense_times,
    in_pieces,
    vehicle_colours,
    vehicle_marker,
    view,
    window_colours,
)
from drake_rho.display.plots.labels import Labels, around
from drake_rho.display.plots.legends import width_of
from drake_rho.display.plots.lines3d import draw_line
from drake_rho.display.plots.maps import draw_map
from drake_rho.display.plots.overlapping_curves import marks_every
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

MAX_LABELLED = 6
"""Largest number of vehicles with names beside their starts."""
_MAX_LARGE = 14
"""Largest number of vehicles with large starts and goals, and of obstacles with large labels."""
_MIN_NUMBERED = 0.02
"""Least size of a numbered obstacle over that of the axes, if there are many obstacles."""
_TOP = 3
"""Layer above all lines."""
_ON_WINDOWS = {"markersize": 3.6, "markeredgecolor": "black", "markeredgewidth": 0.3}
"""Style of marks at knots in the colours of windows."""


def within(ax: Axes3D, shown: Sequence[Snapshot]) -> list[Snapshot]:
    """Return obstacles with infinite shapes cut off at the limits of the axes."""
    lower, upper = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T
    return [each.truncated(lower, upper) for each in shown]


def draw_obstacles(ax: Axes3D, shown: Sequence[Snapshot]) -> list[Poly3DCollection]:
    """Draw maps, and other bounded obstacles as translucent bodies, from back to front.

    The uncertainty of an obstacle is a fainter body around it, except around maps.
    """
    bodies = []
    to_viewer = view()[2]
    for each in sorted(shown, key=lambda one: (one.faces is None, one.center @ to_viewer)):
        if each.faces is not None:
            bodies.append(draw_map(ax, each))
            continue
        skin = surface(each.shape).moved(each.center)
        body = Poly3DCollection(
            skin.faces,
            facecolors=to_rgba(FORBIDDEN),
            shade=True,
            alpha=0.1 if each.faint else 0.25,
            linewidth=0,
            antialiased=True,
        )
        ax.add_collection3d(body)
        bodies.append(body)
        if each.halo > 0.0:
            halo = surface_around(each.shape, each.halo).moved(each.center).faces
            style = {"alpha": 0.04 if each.faint else 0.1, "linewidth": 0}
            ax.add_collection3d(Poly3DCollection(halo, facecolors=FORBIDDEN, **style))
        if skin.edges:
            alpha = 0.3 if each.faint else 0.7
            lines = Line3DCollection(skin.edges, colors=FORBIDDEN, linewidths=0.6, alpha=alpha)
            ax.add_collection3d(lines)
    return bodies


def draw_obstacle_labels(ax: Axes3D, shown: Sequence[Snapshot]) -> list[Text]:
    """Draw the obstacles' numbers in their centres, and names and times above them.

    If there are many obstacles, small ones have no numbers.
    """
    lower, upper = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T
    artists: list[Text] = []
    many = len(shown) > _MAX_LARGE
    for each in shown:
        number = each.label.isdecimal()
        middle = number and each.faces is None
        narrow = each.shape.extent.max() < _MIN_NUMBERED * np.max(upper - lower)
        if not each.label or (many and number and narrow):
            continue
        above = 0.0 if middle else each.shape.extent[2]
        top = each.center + above * np.eye(3)[2]
        style: dict[str, Any] = {
            "fontsize": 6 if many else 7,
            "color": "#555555" if each.faint else "#222222",
        }
        if middle:
            style["bbox"] = None
        spots = around(ax, *top, middle=middle, rows=1 if many else 4)
        artists.append(Labels.of(ax).add(each.label, spots, rank=2 if number else 1, **style))
    return artists


def draw_approaches(ax: Axes3D, found: Sequence[FloatArray]) -> list[Line3D]:
    """Draw lines from vehicles to the nearest points of obstacles [m], shape (2, 3), in black."""
    style: dict[str, Any] = {"color": "black", "linewidth": 1.0, "marker": ".", "markersize": 3}
    return [ax.plot(*ends.T, zorder=_TOP, **style)[0] for ends in found]


def draw_obstacle_paths(
    ax: Axes3D, paths: Sequence[FloatArray], shown: Sequence[Snapshot] = ()
) -> list[Line3D]:
    """Draw the paths of moving obstacles [m], each of shape (M, 3), as dashed lines."""
    style: dict[str, Any] = {"color": FORBIDDEN, "linewidth": 0.9, "linestyle": (0, (4, 3))}
    return [line for path in paths for line in draw_line(ax, path, shown, **style)]


def draw_paths(ax: Axes3D, plan: Drawn, shown: Sequence[Snapshot] = ()) -> list[Line3D]:
    """Draw each vehicle's path, knots, start (ring) and goal (star).

    Straight lines of a scenario are dashed, without knots. For more than `MAX_NAMED` vehicles,
    knots are not marked, and starts and goals are smaller.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        shown: obstacles drawn by `draw_obstacles`, behind which paths are faint.

    Returns:
        The paths, with their hidden parts; the first line of each vehicle is labelled with its
        name.
    """
    lines = []
    flown = plan.kind != "scenario"
    shape: dict[str, Any] = {"linewidth": 1.2}
    if not flown:
        shape = {"linewidth": 0.9, "linestyle": (0, (5, 3))}
    times = dense_times(plan)
    paths, pieces = plan.motion().at("position", times), in_pieces(plan, times)
    for index, colour in enumerate(vehicle_colours(len(paths))):
        parts = [draw_line(ax, paths[index, each], shown, color=colour, **shape) for each in pieces]
        parts[0][0].set_label(as_text(plan.scenario.vehicles[index].name))
        if flown:
            _draw_knots(ax, plan, index, shown, (0, len(plan.times) - 1), color=colour)
        lines += [line for part in parts for line in part]
    draw_ends(ax, plan.scenario)
    return lines


def draw_conflicts(
    ax: Axes3D, scenario: Scenario, error: InfeasibleError, shown: Sequence[Snapshot]
) -> list[Artist]:
    """Mark the vehicles and obstacles of an error in red: starts, goals and outlines."""
    artists: list[Artist] = []
    style: dict[str, Any] = {"color": CONFLICT, "zorder": _TOP, "linestyle": "none"}
    for vehicle in scenario.vehicles:
        if vehicle.name in error.conflicts:
            ends = np.array([vehicle.start.position, *goal_point(vehicle)])
            artists += ax.plot(*ends.T, marker="o", markersize=11, fillstyle="none", **style)
    numbers = frozenset[int]().union(*error.obstacles.values())
    for each in shown:
        if each.number in numbers:
            skin = surface(each.shape).faces if each.faces is None else each.faces.corners
            faces = [each.center + face for face in skin]
            body = Poly3DCollection(faces, facecolors=CONFLICT, alpha=0.25, linewidth=0)
            artists.append(ax.add_collection3d(body))
    return artists


def draw_planned_paths(ax: Axes3D, plan: Drawn, shown: Sequence[Snapshot] = ()) -> list[Line3D]:
    """Draw planned paths as dotted lines, if the flown paths differ from them."""
    colours = vehicle_colours(len(plan.positions))
    lines = []
    for piece in plan.planned:
        times = dense_times(piece.shown)
        paths = piece.shown.motion().at("position", times[piece.in_force(times)])
        for path, colour in zip(paths, colours, strict=True):
            lines += draw_line(ax, path, shown, color=colour, **PLANNED_STYLE)
    return lines


def draw_measured_paths(ax: Axes3D, plan: Drawn, shown: Sequence[Snapshot] = ()) -> list[Line3D]:
    """Draw the measured positions of a flight, with gaps where a vehicle was not seen."""
    paths = [] if plan.measured is None else list(plan.measured.positions)
    return [line for path in paths for line in draw_line(ax, path, shown, **MEASURED_STYLE)]


def draw_windows(ax: Axes3D, plan: Drawn, shown: Sequence[Snapshot] = ()) -> list[list[Line3D]]:
    """Draw the flown part of each window in its colour, and its whole prediction as a thin line.

    Up to `MAX_NAMED` vehicles have marks of their own at knots, in the colour of the window.

    Args:
        ax: axes to draw in.
        plan: motion of a flight or simulation to draw.
        shown: obstacles drawn by `draw_obstacles`, behind which paths are faint.

    Returns:
        For each window, the pieces of its flown part.
    """
    lines: list[list[Line3D]] = []
    grid, times = plan.scenario.grid, dense_times(plan)
    true = plan.motion().at("position", times)
    for window, colour in zip(plan.windows, window_colours(len(plan.windows)), strict=True):
        first, last = window.first, window.last
        paths = window.shown.motion().at("position", dense_times(window.shown))
        part = grid.clock.within(times, tuple(grid.elapsed[[first, last]].tolist()))
        if last in plan.jumps:  # the state there is the next window's
            part &= grid.clock.before(times, grid.elapsed[last])
        lines.append([])
        for index in range(len(paths)):
            draw_line(ax, paths[index], shown, color=colour, linewidth=0.6, alpha=0.45)
            lines[-1] += draw_line(ax, true[index, part], shown, color=colour, linewidth=1.6)
            _draw_knots(ax, plan, index, shown, (first, last), color=colour, **_ON_WINDOWS)
        if (braking := window.braking) is not None:
            draw_braking(ax, braking, shown)
    named = len(true) <= MAX_LABELLED
    draw_ends(ax, plan.scenario, ["black"] * len(true) if named else None)
    return lines


def draw_braking(ax: Axes3D, braking: Drawn, shown: Sequence[Snapshot] = ()) -> None:
    """Draw the braking of a contingency as dotted lines that end in crosses at rest."""
    style: dict[str, Any] = {"color": CONTINGENCY, "linewidth": 1.0}
    for path in braking.motion().at("position", dense_times(braking)):
        draw_line(ax, path, shown, linestyle=":", **style)
        ax.plot(*path[-1:].T, marker="x", markersize=6.0, zorder=2 * _TOP, **style)


def draw_ends(ax: Axes3D, scenario: Scenario, colours: Sequence[str] | None = None) -> list[Artist]:
    """Draw starts as rings, waypoints as diamonds and goals as stars.

    Up to `MAX_LABELLED` vehicles have their names beside their starts.
    """
    artists: list[Artist] = []
    colours = colours or vehicle_colours(len(scenario.vehicles))
    size = 5.5 if len(scenario.vehicles) <= _MAX_LARGE else 3.0
    # open marks, so that the ends of paths remain visible
    style: dict[str, Any] = {"fillstyle": "none", "linestyle": "none", "zorder": _TOP}
    for vehicle, colour in zip(scenario.vehicles, colours, strict=True):
        start = vehicle.start.position
        own = style | {"color": colour, "markersize": size}
        artists += ax.plot(*start[:, None], marker="o", **own)
        star = own | {"color": "black", "markersize": 1.5 * size}
        for goal in goal_point(vehicle):
            artists += ax.plot(*goal[:, None], marker="*", **star)
        for waypoint in vehicle.waypoints:
            artists += ax.plot(*waypoint.position[:, None], marker="D", **own)
        if len(scenario.vehicles) <= MAX_LABELLED:
            name = as_text(brief(vehicle.name))
            artists.append(Labels.of(ax).add(name, around(ax, *start)))
    return artists


def _draw_knots(
    ax: Axes3D,
    plan: Drawn,
    index: int,
    shown: Sequence[Snapshot],
    knots: tuple[int, int],
    **style: Any,
) -> None:
    """Mark a vehicle's positions at knots, or at some of them, if vehicles are named.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        index: index of the vehicle.
        shown: obstacles behind which marks are faint.
        knots: first and last knot to mark, both included.
        **style: colour and style of the marks.
    """
    if len(plan.positions) > MAX_NAMED:
        return
    first, last = knots
    every = marks_every(len(plan.times), width_of(ax))
    marked = plan.positions[index, first + -first % every : last + 1 : every]
    style = {"linestyle": "none", "marker": vehicle_marker(index), "markersize": 2.4} | style
    draw_line(ax, marked, shown, **style)
