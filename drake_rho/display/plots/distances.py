"""Distances of vehicles from obstacles over time, drawn on given axes.

Times are those of the scenario's clock. Every function takes the axes first and returns the
artists it has drawn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from drake_rho.display.common import measured
from drake_rho.display.common.clearances import least_clearances, minima_from
from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_text, brief
from drake_rho.display.common.obstacle_snapshots import short_label
from drake_rho.display.common.style import EXTREMUM_STYLE, dense_times
from drake_rho.display.plots.labels import Labels, beside
from drake_rho.display.plots.legends import add_above
from drake_rho.display.plots.panels import (
    MAX_ANNOTATED,
    Curves,
    bottom_of,
    draw_curves,
    draw_inactive,
    draw_limit,
    draw_measured,
    draw_minimum,
    draw_planned,
    finish,
)
from drake_rho.motion.obstacle_clearances import closest, distances, required_distances
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.quadrics import Sphere

MAX_PANELS = 4
"""Largest number of obstacles with one panel each."""
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

    def sampled(each: Drawn, times: FloatArray) -> FloatArray:
        active = obstacle.since(each.scenario.grid).is_active(times)
        return np.where(active, distances(each, obstacle, times) + radius, np.nan)

    grid, times = plan.scenario.grid, dense_times(plan)
    exact, clear = sampled(plan, times), minima_from(plan, obstacle)
    required = required_distances(plan.scenario, obstacle)
    bottom = 0.0 if radius > 0.0 else bottom_of(exact)
    if plan.measured is not None:
        values = measured.distances(plan.scenario, obstacle, plan.measured) + radius
        draw_measured(ax, plan, values)
        bottom = min(bottom, 0.0 if radius > 0.0 else bottom_of(values))
    for least in sorted(set(required.tolist())):
        words = "surface" if least == 0.0 else f"required distance: {least:g} m"
        if radius > 0.0:
            more = f" + {least:g} m" if least > 0.0 else ""
            words = f"R{more} = {radius + least:g} m"
        draw_limit(ax, radius + least, words, bottom)
    minima = dataclasses.replace(clear, values=closest(plan, obstacle).distances + radius)
    at_knots = sampled(plan, grid.elapsed)
    lines = draw_curves(ax, plan, Curves(times, exact, minima, grid.elapsed, at_knots))
    for piece in plan.planned:
        times = dense_times(piece.shown)
        draw_planned(ax, piece, times, sampled(piece.shown, times))
    _draw_discoveries(ax, plan, {obstacle.known_from: "known"})
    draw_inactive(ax, plan, obstacle.active)
    where = "where it may be" if obstacle.is_uncertain else "the obstacle"
    where = "the centre" if radius > 0.0 else where
    ax.set(ylabel=f"distance from {where} [m]", ylim=(bottom, None))
    finish(ax, plan, lines)
    least = dataclasses.replace(clear.least, value=float(minima.values[clear.least.row]))
    if np.isfinite(least.value):
        draw_minimum(ax, plan, least, "", tolerance=obstacle.shape.tolerance, title=title)
    else:  # the obstacle is not active in the flight
        add_above(ax, [], title)
    return lines


def draw_least_clearances(ax: Axes, plan: Drawn, obstacles: Sequence[Obstacle]) -> list[Line2D]:
    """Draw each vehicle's least clearance from all obstacles over time.

    The minimum of each curve has a mark with the obstacle's number.

    A clearance is the distance from an obstacle, less its uncertainty, the vehicle's radius and the
    largest deviation of the obstacle from its track.

    Returns:
        The curves, and a ring at the overall minimum if there is one.
    """
    found = least_clearances(plan, obstacles)
    minima, bodies = found.minima, found.nearest_at_minima
    names = [short_label(number, each) for number, each in enumerate(obstacles, start=1)]
    nearest = [names[number] for number in bodies]
    curves = Curves(found.times, found.clearances, minima, labels=nearest)
    lines = draw_curves(ax, plan, curves)
    for piece in plan.planned:
        near = least_clearances(piece.shown, obstacles)
        draw_planned(ax, piece, near.times, near.clearances)
    least, rings = minima.least, list[Line2D]()
    if np.isfinite(least.value):
        marks = "minimum of each vehicle, with the obstacle's number"
        handle = Line2D([], [], **(EXTREMUM_STYLE | {"markersize": 4.5}), label=marks)
        handles = [handle] if len(nearest) <= MAX_ANNOTATED else []
        words = f" and obstacle {nearest[least.vehicle]}"
        tolerance = obstacles[bodies[least.vehicle]].shape.tolerance
        rings = [draw_minimum(ax, plan, least, words, *handles, tolerance=tolerance)]
    else:
        Labels.of(ax).add(
            "no obstacle is active in the flight", beside(ax, plan.scenario.grid.start)
        )
    known = [each.known_from for each in obstacles]
    _draw_discoveries(ax, plan, {t: f"{name} known" for t, name in zip(known, names, strict=True)})
    bottom = bottom_of(found.clearances)
    if plan.measured is not None:
        values = measured.least_clearances(plan.scenario, obstacles, plan.measured)
        draw_measured(ax, plan, values)
        bottom = min(bottom, bottom_of(values))
    padded = any(np.any(required_distances(plan.scenario, each) > 0.0) for each in obstacles)
    draw_limit(ax, 0.0, "vehicle radius from the surface" if padded else "surface", bottom)
    uncertain = any(obstacle.is_uncertain for obstacle in obstacles)
    where = "where obstacles may be" if uncertain else "the nearest obstacle"
    ax.set(ylabel=f"clearance from {where} [m]", ylim=(bottom, None))
    finish(ax, plan, lines)
    return lines + rings


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
