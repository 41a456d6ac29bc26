"""Drawing how far vehicles are from obstacles over time, on axes that are given.

Times are those of the scenario's clock. Every function takes the axes first and returns the
artists it has drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from drake_rho.display.clearances import Clearances, distances, kept, least_clearances
from drake_rho.display.curves import draw_curve, draw_limit, draw_planned
from drake_rho.display.flown import Drawn, planned
from drake_rho.display.names import as_text, brief
from drake_rho.display.snapshots import called
from drake_rho.display.style import dense_times, vehicle_colours, vehicle_marker
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.quadrics import Sphere
from drake_rho.scenario.shapes import TOLERANCE

_BELOW = 0.08
"""Room below the lowest that is drawn, in parts of the range of distances: that of a word."""
_MOST_ANNOTATED = 14
"""Most vehicles at whose closest approach the obstacle is named."""
_MOST_DISCOVERIES = 6
"""Most times at which an obstacle becomes known that are named."""


def draw_distances(ax: Axes, plan: Drawn, obstacle: Obstacle) -> list[Line2D]:
    """Distance of each vehicle from an obstacle's surface over time, with what is kept."""
    lines = _draw_distances(ax, plan, obstacle, lambda each, at: distances(each, obstacle, at))
    least = sorted(set(kept(plan, obstacle).tolist()))
    values = [np.asarray(line.get_ydata()) for line in lines]
    bottom = min(0.0, *(float(each.min()) for each in values))
    top = max(float(each.max()) for each in values)
    bottom -= _BELOW * max(top - bottom, 1e-9)
    for most in least:
        words = "surface" if most == 0.0 else f"least distance: {most:g} m"
        draw_limit(ax, most, words, bottom)
    ax.set(ylabel="distance from the obstacle [m]", ylim=(bottom, None))
    return lines


def draw_distances_from_centre(
    ax: Axes, plan: Drawn, obstacle: Obstacle, sphere: Sphere
) -> list[Line2D]:
    """Distance of each vehicle from the centre of a sphere over time, with the radius.

    Args:
        ax: where to draw.
        plan: what to draw.
        obstacle: where the sphere is.
        sphere: its shape.
    """

    def from_centre(each: Drawn, times: FloatArray) -> FloatArray:
        centers = obstacle.centers(each.scenario.grid.start + times)
        offsets: FloatArray = np.linalg.norm(each.motion().at("position", times) - centers, axis=2)
        return offsets

    for least in sorted(set(kept(plan, obstacle).tolist())):
        more = f" + {least:g} m" if least > 0.0 else ""
        draw_limit(ax, sphere.radius + least, f"R{more} = {sphere.radius + least:g} m")
    lines = _draw_distances(ax, plan, obstacle, from_centre)
    ax.set(ylabel="distance from the obstacle's centre [m]", ylim=(0, None))
    return lines


def _draw_distances(
    ax: Axes,
    plan: Drawn,
    obstacle: Obstacle,
    measured: Callable[[Drawn, FloatArray], FloatArray],
) -> list[Line2D]:
    grid, times = plan.scenario.grid, dense_times(plan)
    exact, knots = measured(plan, times), measured(plan, grid.elapsed)
    lines = [
        draw_curve(ax, plan, index, (grid.start + times, exact[index]), (plan.times, knots[index]))
        for index in range(len(exact))
    ]
    for piece in planned(plan):
        times = dense_times(piece.plan)
        draw_planned(ax, piece, times, measured(piece.plan, times))
    _finish(ax, plan)
    _draw_discoveries(ax, plan, {obstacle.known_from: "known"})
    return lines


def draw_least_clearances(ax: Axes, plan: Drawn, obstacles: Sequence[Obstacle]) -> list[Line2D]:
    """Each vehicle's least clearance from all obstacles over time.

    Where it is least of all, the number of the obstacle stands beside a mark.

    A clearance is the distance from an obstacle's surface less the vehicle's radius, and less how
    far the obstacle may be from its track.

    Returns:
        The curves, and a ring at the least of all.
    """
    found, start = least_clearances(plan, obstacles), plan.scenario.grid.start
    colours = vehicle_colours(len(plan.positions))
    lowest = np.argmin(found.clearances, axis=1)
    lines = []
    for i, vehicle in enumerate(plan.scenario.vehicles):
        name, times = as_text(vehicle.name), start + found.times[i]
        lines += ax.plot(times, found.clearances[i], color=colours[i], linewidth=1.2, label=name)
        if len(plan.positions) <= _MOST_ANNOTATED:
            m = lowest[i]
            place = (times[m], found.clearances[i, m])
            number = int(found.nearest[i, m]) + 1
            ax.plot(*place, color=colours[i], marker=vehicle_marker(i), markersize=4)
            text = ax.annotate(
                called(number, obstacles[number - 1]),
                place,
                xytext=(0, -4),
                textcoords="offset points",
                fontsize=7,
                color=colours[i],
                ha="center",
                va="top",
            )
            text.set_path_effects([withStroke(linewidth=2, foreground="white")])
    for piece in planned(plan):
        near = least_clearances(piece.plan, obstacles)
        draw_planned(ax, piece, near.times, near.clearances)
    lines.append(_draw_closest(ax, plan, obstacles, found))
    _finish(ax, plan)
    known = {each.known_from: f"{called(n, each)} known" for n, each in enumerate(obstacles, 1)}
    _draw_discoveries(ax, plan, known)
    bottom = min(0.0, float(found.clearances.min()))
    bottom -= _BELOW * (float(found.clearances.max()) - bottom)
    least = max(float(kept(plan, obstacle).max()) for obstacle in obstacles)
    draw_limit(ax, 0.0, "the radius from the surface" if least > 0.0 else "surface", bottom)
    ax.set(ylabel="clearance from the nearest obstacle [m]", ylim=(bottom, None))
    return lines


def _draw_closest(
    ax: Axes, plan: Drawn, obstacles: Sequence[Obstacle], found: Clearances
) -> Line2D:
    """A ring at the least clearance of all, and above the axes what it is of whom."""
    i, m = np.unravel_index(np.argmin(found.clearances), found.clearances.shape)
    time, least = plan.scenario.grid.start + found.times[i, m], found.clearances[i, m]
    number = int(found.nearest[i, m]) + 1
    who = as_text(brief(plan.scenario.vehicles[int(i)].name))
    what = called(number, obstacles[number - 1])
    touches = abs(least) <= TOLERANCE * obstacles[number - 1].shape.size
    far = "0" if touches else f"{least:.4g}".replace("-", "\N{MINUS SIGN}")
    label = f"{far} m at {time:.4g} s: {who} and obstacle {what}"
    (ring,) = ax.plot(
        time, least, marker="o", linestyle="none", fillstyle="none", color="black", label=label
    )
    handles = [ring]
    if len(plan.positions) <= _MOST_ANNOTATED:
        words = "least of each vehicle, and the obstacle's number"
        handles.append(Line2D([], [], label=words, linestyle="none", color="black", marker="."))
    ax.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False
    )
    return ring


def _draw_discoveries(ax: Axes, plan: Drawn, known: dict[float, str]) -> None:
    """Lines at the times from which obstacles are known, where these are in the flight."""
    grid = plan.scenario.grid
    later = {time: words for time, words in known.items() if time > max(grid.start, 0.0)}
    for time, words in later.items():
        ax.axvline(time, color="black", linestyle=":", linewidth=0.9)
        if len(later) <= _MOST_DISCOVERIES:
            ax.annotate(
                f"{words} from {time:g} s",
                (time, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(3, -3),
                textcoords="offset points",
                fontsize=8,
                va="top",
            )


def _finish(ax: Axes, plan: Drawn) -> None:
    ax.set_xlabel("time [s]")
    ax.grid(alpha=0.25, linewidth=0.5)
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
