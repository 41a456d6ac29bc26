"""Distances of vehicles from obstacles over time, drawn on given axes.

Times are those of the scenario's clock. Every function takes the axes first and returns the
artists it has drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common.clearances import Clearances, least_clearances
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.obstacle_snapshots import short_label
from drake_rho.display.common.style import (
    EXTREMUM_STYLE,
    FORBIDDEN,
    MAX_NAMED,
    dense_times,
    vehicle_colours,
    vehicle_marker,
    with_gaps,
)
from drake_rho.display.plots.curves import draw_curve, draw_limit, draw_planned
from drake_rho.display.plots.labels import Labels, around, beside
from drake_rho.display.plots.legends import add_above
from drake_rho.display.plots.overlapping_curves import show_overlapping
from drake_rho.motion.obstacle_clearances import (
    ClosestApproaches,
    closest,
    distances,
    required_distances,
)
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.quadrics import Sphere

MAX_PANELS = 4
"""Largest number of obstacles with one panel each."""
BELOW = 0.08
"""Space below the lowest value, over the range of distances: enough for a line of text."""
MAX_ANNOTATED = 14
"""Largest number of vehicles whose closest approaches are marked."""
_MAX_DISCOVERIES = 6
"""Largest number of labelled times at which obstacles become known."""


def obstacle_panels(plan: Drawn, bodies: Sequence[Obstacle]) -> list[Callable[[Axes], object]]:
    """Return a drawing function for each panel of distances from obstacles."""
    if len(bodies) > MAX_PANELS:
        return [partial(draw_least_clearances, plan=plan, obstacles=bodies)]
    round_ones = all(isinstance(each.shape, Sphere) and not each.is_uncertain for each in bodies)
    panels: list[Callable[[Axes], object]] = []
    for number, body in enumerate(bodies, start=1):
        name = None if body.name is None else as_text(brief(body.name))
        name = short_label(number, body) if len(bodies) > 1 else name
        title = None if name is None else f"obstacle {name}"
        radius = body.shape.size if round_ones else 0.0
        panels.append(partial(draw_distances, plan=plan, obstacle=body, radius=radius, title=title))
    return panels


def draw_distances(
    ax: Axes, plan: Drawn, obstacle: Obstacle, *, radius: float = 0.0, title: str | None = None
) -> list[Line2D]:
    """Draw each vehicle's distance from an obstacle, less its uncertainty, and the limits.

    Args:
        ax: axes to draw in.
        plan: motion to draw.
        obstacle: obstacle to measure from.
        radius: radius of a sphere, for distances from its centre; if 0, from the surface.
        title: title of the axes.
    """

    def measured(each: Drawn, times: FloatArray) -> FloatArray:
        active = obstacle.since(each.scenario.grid).is_active(times)
        return np.where(active, distances(each, obstacle, times) + radius, np.nan)

    grid, times = plan.scenario.grid, dense_times(plan)
    exact, knots = measured(plan, times), measured(plan, grid.elapsed)
    low, high = np.nanmin(exact, initial=0.0), np.nanmax(exact, initial=0.0)
    bottom = 0.0 if radius > 0.0 else float(low - BELOW * max(high - low, 1e-9))
    for least in sorted(set(required_distances(plan.scenario, obstacle).tolist())):
        words = "surface" if least == 0.0 else f"required distance: {least:g} m"
        if radius > 0.0:
            more = f" + {least:g} m" if least > 0.0 else ""
            words = f"R{more} = {radius + least:g} m"
        draw_limit(ax, radius + least, words, bottom)
    times, exact = with_gaps(plan, times, exact)
    lines = [
        draw_curve(ax, plan, index, (grid.start + times, exact[index]), (plan.times, knots[index]))
        for index in range(len(exact))
    ]
    for piece in plan.planned:
        times = dense_times(piece.shown)
        draw_planned(ax, piece, times, measured(piece.shown, times))
    _draw_discoveries(ax, plan, {obstacle.known_from: "known"})
    draw_inactive(ax, plan, obstacle.active)
    where = "where it may be" if obstacle.is_uncertain else "the obstacle"
    where = "the centre" if radius > 0.0 else where
    ax.set(ylabel=f"distance from {where} [m]", ylim=(bottom, None))
    finish(ax, plan, lines)
    found = closest(plan, obstacle)
    _mark_least(ax, plan, obstacle, ClosestApproaches(found.times, found.distances + radius), title)
    return lines


def _mark_least(
    ax: Axes, plan: Drawn, obstacle: Obstacle, found: ClosestApproaches, title: str | None
) -> None:
    """Mark each vehicle's closest approach, and describe the smallest margin above the axes."""
    start, colours = plan.scenario.grid.start, vehicle_colours(len(plan.positions))
    if not np.isfinite(found.distances).any():  # the obstacle is not active in the flight
        add_above(ax, [], title)
        return
    for i, (time, value) in enumerate(zip(found.times, found.distances, strict=True)):
        if len(plan.positions) <= MAX_ANNOTATED:
            mark_minimum(ax, plan, i, (start + time, value), colours[i])
    i = int(np.argmin(found.distances - required_distances(plan.scenario, obstacle)))
    label = description(
        plan, i, float(found.distances[i]), float(found.times[i]), obstacle.shape.tolerance
    )
    time, value = start + found.times[i], found.distances[i]
    (ring,) = ax.plot(time, value, label=label, **EXTREMUM_STYLE)
    add_above(ax, [ring], title)


def mark_minimum(
    ax: Axes, plan: Drawn, index: int, place: tuple[float, float], colour: str
) -> None:
    """Draw a vehicle's marker, larger and open, at the minimum of its curve."""
    ax.plot(
        *place,
        color=colour,
        marker=vehicle_marker(index),
        markersize=4.5,
        markerfacecolor="white",
        linestyle="none",
        zorder=2.8,
        clip_on=False,
    )


def description(plan: Drawn, vehicle: int, value: float, time: float, tolerance: float) -> str:
    """Describe an instant by its distance, its time and the vehicle's name."""
    far = "0" if abs(value) <= tolerance else f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    name = as_text(brief(plan.scenario.vehicles[vehicle].name))
    return f"{far} m at {plan.scenario.grid.start + time:.4g} s: {name}"


def draw_least_clearances(ax: Axes, plan: Drawn, obstacles: Sequence[Obstacle]) -> list[Line2D]:
    """Draw each vehicle's least clearance from all obstacles over time.

    The minimum of each curve has a mark with the obstacle's number.

    A clearance is the distance from an obstacle, less its uncertainty, the vehicle's radius and the
    largest deviation of the obstacle from its track.

    Returns:
        The curves, and a ring at the overall minimum if there is one.
    """
    found, start = least_clearances(plan, obstacles), plan.scenario.grid.start
    colours = vehicle_colours(len(plan.positions))
    ever = bool(np.isfinite(found.clearances).any())  # else no obstacle is active in the flight
    shown = _with_gaps(found.clearances)
    lowest = np.argmin(found.clearances, axis=1)
    lines = []
    for i, vehicle in enumerate(plan.scenario.vehicles):
        name, times = as_text(vehicle.name), start + found.times[i]
        drawn, left = with_gaps(plan, found.times[i], shown[i])
        lines += ax.plot(start + drawn, left, color=colours[i], label=name)
        if len(plan.positions) <= MAX_ANNOTATED and ever:
            m = lowest[i]
            place = (float(times[m]), float(found.clearances[i, m]))
            number = int(found.nearest[i, m]) + 1
            mark_minimum(ax, plan, i, place, colours[i])
            words = short_label(number, obstacles[number - 1])
            Labels.of(ax).add(words, around(ax, *place), rank=1, color=colours[i])
    for piece in plan.planned:
        near = least_clearances(piece.shown, obstacles)
        draw_planned(ax, piece, near.times, _with_gaps(near.clearances))
    curves = list(lines)
    if ever:
        lines.append(_draw_closest(ax, plan, obstacles, found))
    else:
        Labels.of(ax).add("no obstacle is active in the flight", beside(ax, start))
    known = {
        each.known_from: f"{short_label(n, each)} known" for n, each in enumerate(obstacles, 1)
    }
    _draw_discoveries(ax, plan, known)
    values = shown[np.isfinite(shown)]  # while an obstacle is active
    bottom = float(values.min(initial=0.0))
    bottom -= BELOW * (float(values.max(initial=0.0)) - bottom)
    least = max(float(required_distances(plan.scenario, obstacle).max()) for obstacle in obstacles)
    draw_limit(ax, 0.0, "vehicle radius from the surface" if least > 0.0 else "surface", bottom)
    uncertain = any(obstacle.is_uncertain for obstacle in obstacles)
    where = "where obstacles may be" if uncertain else "the nearest obstacle"
    ax.set(ylabel=f"clearance from {where} [m]", ylim=(bottom, None))
    finish(ax, plan, curves)
    return lines


def _with_gaps(clearances: FloatArray) -> FloatArray:
    """Return clearances with NaN, which is not drawn, while no obstacle is active."""
    return np.where(np.isfinite(clearances), clearances, np.nan)


def _draw_closest(
    ax: Axes, plan: Drawn, obstacles: Sequence[Obstacle], found: Clearances
) -> Line2D:
    """Draw a ring at the least clearance of all, and describe it above the axes."""
    i, m = np.unravel_index(np.argmin(found.clearances), found.clearances.shape)
    time, least = float(found.times[i, m]), float(found.clearances[i, m])
    number = int(found.nearest[i, m]) + 1
    obstacle = obstacles[number - 1]
    label = description(plan, int(i), least, time, obstacle.shape.tolerance)
    label += f" and obstacle {short_label(number, obstacle)}"
    (ring,) = ax.plot(plan.scenario.grid.start + time, least, label=label, **EXTREMUM_STYLE)
    handles = [ring]
    if len(plan.positions) <= MAX_ANNOTATED:
        words = "minimum of each vehicle, with the obstacle's number"
        handles.append(Line2D([], [], **(EXTREMUM_STYLE | {"markersize": 4.5}), label=words))
    add_above(ax, handles)
    return ring


def _draw_discoveries(ax: Axes, plan: Drawn, known: dict[float, str]) -> None:
    """Draw lines at the times during the flight from which obstacles are known."""
    grid = plan.scenario.grid
    later = {
        time: words for time, words in known.items() if grid.clock.after(time, max(grid.start, 0.0))
    }
    for time, words in later.items():
        ax.axvline(time, color="black", linestyle=":", linewidth=0.9)
        if len(later) <= _MAX_DISCOVERIES:
            Labels.of(ax).add(f"{words} from {time:g} s", beside(ax, time))


def draw_inactive(ax: Axes, plan: Drawn, active: tuple[float, float] | None) -> None:
    """Shade the times of the flight outside the interval of a constraint."""
    if active is None:
        return
    grid, (first, last) = plan.scenario.grid, active
    for begin, end in ((grid.start, min(first, grid.end)), (max(last, grid.start), grid.end)):
        if grid.clock.before(begin, end):
            ax.axvspan(begin, end, color=FORBIDDEN, alpha=0.08, linewidth=0)
            Labels.of(ax).add("not active", beside(ax, begin))


def finish(ax: Axes, plan: Drawn, lines: Sequence[Line2D]) -> None:
    """Set the time axis and, if vehicles are named, make overlapping curves visible."""
    ax.set_xlabel("time [s]")
    ax.set_xlim(plan.scenario.grid.start, plan.scenario.grid.end)
    if lines and len(plan.positions) <= MAX_NAMED:
        show_overlapping(ax, lines)
