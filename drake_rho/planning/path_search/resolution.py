"""Extent and resolution of the path search's grids in space and time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from drake_rho.planning.path_search.reachable import ReachableBounds, reachable_bounds
from drake_rho.planning.path_search.speed_profiles import legs_of, usable_speeds
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.times import Clock

_MOST_POINTS = 2e5
"""Bound on the number of points of the finest grid."""

_FINER, _COARSER = 1.5, 1.25
"""Refinement factor from one grid to the next, and coarsening factor if the first is too large."""

_FIRST_VALUES, _VALUES = 2e6, 5e7
"""Bounds on the number of points times layers, for the first grid and the next ones. They bound the
computing time."""

_FLATTEST = 8.0
"""Largest ratio of the lengths of moves along two axes. On a slower axis the grid then allows too
high a speed; the bounds on reachable positions (`Reach`) make up for it."""

_FASTER = 2.5
"""Speed on a path where no limit binds, as a multiple of that of the straight flight."""

_FASTER_STILL, _IN_A_HURRY = 1.2, 1.6
"""Factor on a path's speed from one grid to the next: in general, and if an obstacle is active for
a part of the flight, since most of the path may have to be flown before or after it."""

_AHEAD = 1.15
"""Least speed on a path along an axis, as a multiple of that of the straight flight, so that the
loss of a layer does not make the vehicle late. It may exceed the vehicle's limits slightly."""

_ROUNDED = 1.06
"""Factor by which climbs on the grid may exceed a vehicle's limits, to need fewer levels."""


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Space in which paths are searched."""

    lower: FloatArray
    """lower corner of a box for each vehicle [m], shape (N, 3)"""
    upper: FloatArray
    """upper corner of a box for each vehicle [m], shape (N, 3)"""
    reachable: ReachableBounds
    """bounds on the positions that vehicles can reach over time"""


@dataclasses.dataclass(frozen=True, eq=False)
class Resolution:
    """Resolution of a grid in space and time."""

    region: Region
    """space that the grid fills"""
    length: float
    """distance of neighbouring points in searches in space alone [m]"""
    spacing: FloatArray
    """distance along each axis in space-time searches, for each vehicle [m], shape (N, 3)"""
    times: FloatArray
    """layer boundaries, as times since the first knot [s], shape (M + 1,)"""


@dataclasses.dataclass(frozen=True)
class Size:
    """Memory and work that a search needs."""

    bytes: float
    """peak memory [bytes]"""
    values: float = 0.0
    """number of values computed in the largest search"""


def resolutions(
    scenario: Scenario, points: float, size: Callable[[Resolution], Size], most: float
) -> Iterator[Resolution]:
    """Yield resolutions from a coarse grid with a quick search to the finest one tried.

    The first grid is made coarser until it is small enough. If that fails, nothing is yielded.

    Args:
        scenario: to be planned.
        points: of the first grid; fewer if they resolve the obstacles and the separation.
        size: predicts the size of a search before any grid is made.
        most: bound on its memory [bytes].
    """
    where, scale = region(scenario), _scale(scenario)
    sides = np.maximum((where.upper - where.lower).max(axis=0), scale)
    volume, faster = float(np.prod(sides)), _FASTER
    timed = any(body.active is not None for _, body in scenario.avoided)

    def at(length: float, values: float) -> tuple[Resolution, bool]:
        resolution = _resolution(
            scenario, where, length, _speeds(scenario, where.reachable, faster)
        )
        takes = size(resolution)
        return resolution, takes.bytes <= most and takes.values <= values

    length = max(scale, (volume / points) ** (1.0 / 3.0))
    resolution, fits = at(length, _FIRST_VALUES)
    while not fits and length < 2.0 * float(sides.max()):
        length *= _COARSER
        resolution, fits = at(length, _FIRST_VALUES)
    while fits:
        yield resolution
        length, faster = length / _FINER, faster * (_IN_A_HURRY if timed else _FASTER_STILL)
        if volume / length**3 > _MOST_POINTS:
            break
        resolution, fits = at(length, _VALUES)


def _resolution(scenario: Scenario, where: Region, length: float, speeds: FloatArray) -> Resolution:
    """Return the resolution at which a move of about `length` fits the speeds of one layer.

    Args:
        scenario: to be planned.
        where: space to fill.
        length: of a move along the fastest axis [m].
        speeds: of each vehicle along each axis [m/s], shape (N, 3).
    """
    times = _layers(scenario.grid, length / float(speeds.max()))
    spacing = speeds * (times[1] - times[0])
    if scenario.separation is not None:
        above = scenario.separation.distance * scenario.separation.downwash
        heights = where.upper[:, 2] - where.lower[:, 2]
        spacing[:, 2] = _levels(spacing[:, 2], above, heights)
    return Resolution(where, length, spacing, times)


def _layers(grid: Grid, layer: float) -> FloatArray:
    """Return the boundaries of layers of about the duration `layer` [s], shape (M + 1,).

    Layers longer than a step begin at knots; shorter ones divide the steps evenly. Remaining steps
    at the start and the end of the flight have no layer.
    """
    steps = grid.knots - 1
    if layer > grid.step:
        each = min(max(1, round(layer / grid.step)), steps)
        rest = steps % each
        return grid.step * np.arange(rest // 2, steps + 1 - rest + rest // 2, each, dtype=float)
    parts = max(1, int(grid.step / layer + 0.1))
    return grid.step / parts * np.arange(steps * parts + 1, dtype=float)


def _levels(spacing: FloatArray, above: float, heights: FloatArray) -> FloatArray:
    """Return a spacing along z that divides the vertical separation [m], shape (N,).

    Args:
        spacing: approximate spacing [m], shape (N,).
        above: vertical separation of vehicles above each other [m].
        heights: of the boxes to fill [m], shape (N,).
    """
    levels = above / np.ceil(above / (_ROUNDED * spacing))
    levels = np.maximum(heights / np.maximum(np.floor(heights / levels), 1.0), levels)
    levels = np.maximum(levels, spacing / _FLATTEST)
    return np.asarray(levels, dtype=np.float64)


def _speeds(scenario: Scenario, reachable: ReachableBounds, faster: float) -> FloatArray:
    """Return the speeds along each axis at which paths are flown [m/s], shape (N, 3).

    Args:
        scenario: to be planned.
        reachable: bounds on the speeds that vehicles can reach.
        faster: speed where no limit binds, as a multiple of that of the straight flight.
    """
    legs = [legs_of(scenario, number) for number in range(len(scenario.vehicles))]
    least = np.array(
        [
            np.max([abs(leg.goal - leg.start) / (leg.end - leg.begin) for leg in each], axis=0)
            for each in legs
        ]
    )
    straight = max(
        float(np.linalg.norm(leg.goal - leg.start)) / (leg.end - leg.begin)
        for each in legs
        for leg in each
    )
    wanted = faster * max(straight, _scale(scenario) / scenario.grid.duration)
    usable = np.minimum(usable_speeds(scenario).max(axis=1), reachable.speeds)
    usable = np.maximum(usable, _AHEAD * np.minimum(least, usable))
    speeds: FloatArray = np.minimum(wanted, usable)
    floor: FloatArray = np.maximum(speeds.max(), 1e-3 * wanted) / _FLATTEST
    return np.maximum(speeds, floor)


def _scale(scenario: Scenario) -> float:
    """Return the length that a grid should resolve [m]."""
    radius = float(scenario.fleet.radii.min())
    scales = [0.5 * (radius + body.shape.thickness) for _, body in scenario.avoided]
    if scenario.separation is not None:
        scales.append(scenario.separation.distance * 2.0 / 3.0)
    return max(min(scales, default=1.0), 1e-3 * float(scenario.fleet.lengths.max()))


def region(scenario: Scenario) -> Region:
    """Return the boxes in which paths are searched.

    They enclose starts, goals, waypoints and obstacles, with a margin for paths around all of
    them. They are cut to the positions that any vehicle can reach, to each vehicle's position box
    and to the sets in which its position is required at all times.
    """
    fleet, elapsed = scenario.fleet, scenario.grid.elapsed
    lows = [fleet.start_positions.min(axis=0), fleet.goal_positions.min(axis=0)]
    highs = [fleet.start_positions.max(axis=0), fleet.goal_positions.max(axis=0)]
    for waypoints in fleet.waypoints:
        lows.append(np.nanmin(waypoints.positions, axis=0))
        highs.append(np.nanmax(waypoints.positions, axis=0))
    for _, body in scenario.avoided:
        active = body.is_active(elapsed, Clock(scenario.grid.step))
        centers, extent = body.centers(elapsed[active]), body.shape.extent
        extent = np.where(np.isfinite(extent), extent, 0.0)
        extent = extent + body.uncertainty(elapsed[active])[:, None]
        lows.append((centers - extent).min(axis=0))
        highs.append((centers + extent).max(axis=0))
    margin = 2.0 * float(fleet.radii.max()) + _scale(scenario) + np.zeros(3)
    if scenario.separation is not None:
        margin += 2.0 * scenario.separation.shape.semi_axes
    reachable = reachable_bounds(scenario)
    lower = np.maximum(np.min(lows, axis=0) - margin, reachable.lower.min(axis=(0, 1)))
    upper = np.minimum(np.max(highs, axis=0) + margin, reachable.upper.max(axis=(0, 1)))
    count = len(scenario.vehicles)
    lower, upper = np.tile(lower, (count, 1)), np.tile(upper, (count, 1))
    if (bounds := fleet.bounds("position")) is not None:
        lower, upper = np.maximum(lower, bounds.lower), np.minimum(upper, bounds.upper)
    axes = np.eye(3)
    for each in scenario.required:
        always = each.active is None and each.between is None and each.penalty is None
        if each.of == "position" and each.relative_to is None and always:
            who = each.members(scenario.names)
            lower[who] = np.maximum(lower[who], -np.asarray(each.set.support(-axes)))
            upper[who] = np.minimum(upper[who], np.asarray(each.set.support(axes)))
    return Region(lower, np.maximum(lower, upper), reachable)
