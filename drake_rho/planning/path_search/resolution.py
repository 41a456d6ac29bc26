"""Grids in space and time on which ways are looked for: where they reach, and how fine they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from drake_rho.planning.path_search.reachable import Reach, reach_of
from drake_rho.planning.path_search.time_scaling import legs_of, usable_speeds
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario

_MOST_POINTS = 2e5
"""Points of the finest grid."""

_FINER, _COARSER = 1.5, 1.25
"""How much finer the next grid is, and how much coarser the first is made if it is too large."""

_FIRST_VALUES, _VALUES = 2e6, 5e7
"""Bounds on points times layers of the first grid, and of others, for the time they take."""

_FLATTEST = 8.0
"""How much longer moves may be along one axis than along another. What a slow axis then misses in
speeds, bounds on where a vehicle can be at a time tell."""

_FASTER = 2.5
"""How much faster than straight to its goal a vehicle may fly on its way where no limit binds."""

_AHEAD = 1.15
"""How much faster than straight to its goal along an axis a vehicle goes on its way at least, so
that no layer that is lost makes it late; a little faster than its limits, if need be."""

_ROUNDED = 1.06
"""How much faster than its limits a vehicle may climb for the sake of fewer levels."""


@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Where ways are looked for."""

    lower: FloatArray
    """corners of a box for each vehicle [m], shape (N, 3)"""
    upper: FloatArray
    """the opposite ones [m], shape (N, 3)"""
    reach: Reach
    """where the vehicles can be at a time"""


@dataclasses.dataclass(frozen=True, eq=False)
class Resolution:
    """How fine a grid is in space and time."""

    region: Region
    """what it fills"""
    length: float
    """the distance of neighbours where only space matters [m]"""
    spacing: FloatArray
    """along each axis where time matters too, for each vehicle [m], shape (N, 3)"""
    times: FloatArray
    """between layers, since the first knot [s], shape (M + 1,)"""


@dataclasses.dataclass(frozen=True)
class Size:
    """What a search on some grids takes."""

    bytes: float
    """of memory, at most at a time"""
    values: float = 0.0
    """to be computed, in the largest search"""


def resolutions(
    scenario: Scenario, points: float, size: Callable[[Resolution], Size], most: float
) -> Iterator[Resolution]:
    """From a coarse grid, on which a search is quick, to the finest that is looked at.

    The first is made coarser until it is small enough; there is none if none is.

    Args:
        scenario: what is asked.
        points: of the first grid, unless fewer resolve what there is.
        size: what a search would take, told before anything is made.
        most: bytes that it may take.
    """
    where, scale = region(scenario), _scale(scenario)
    sides = np.maximum((where.upper - where.lower).max(axis=0), scale)
    volume, faster = float(np.prod(sides)), _FASTER

    def at(length: float, values: float) -> tuple[Resolution, bool]:
        resolution = _resolution(scenario, where, length, _speeds(scenario, where.reach, faster))
        takes = size(resolution)
        return resolution, takes.bytes <= most and takes.values <= values

    length = max(scale, (volume / points) ** (1.0 / 3.0))
    resolution, fits = at(length, _FIRST_VALUES)
    while not fits and length < 2.0 * float(sides.max()):
        length *= _COARSER
        resolution, fits = at(length, _FIRST_VALUES)
    while fits:
        yield resolution
        length, faster = length / _FINER, faster * 1.2
        if volume / length**3 > _MOST_POINTS:
            break
        resolution, fits = at(length, _VALUES)


def _resolution(scenario: Scenario, where: Region, length: float, speeds: FloatArray) -> Resolution:
    """Layers in which one move of about `length` is made at given speeds, shape (N, 3)."""
    times = _layers(scenario.grid, length / float(speeds.max()))
    spacing = speeds * (times[1] - times[0])
    if scenario.separation is not None:
        above = scenario.separation.distance * scenario.separation.downwash
        heights = where.upper[:, 2] - where.lower[:, 2]
        spacing[:, 2] = _levels(spacing[:, 2], above, heights)
    return Resolution(where, length, spacing, times)


def _layers(grid: Grid, layer: float) -> FloatArray:
    """Times between layers about as long as `layer`, from the first knot on [s], shape (M + 1,).

    They begin at knots where they are longer than a step, else they divide the steps. What is
    left over of the flight is divided between start and end.
    """
    steps = grid.knots - 1
    if layer > grid.step:
        each = min(max(1, round(layer / grid.step)), steps)
        rest = steps % each
        return grid.step * np.arange(rest // 2, steps + 1 - rest + rest // 2, each, dtype=float)
    parts = max(1, int(grid.step / layer + 0.1))
    return grid.step / parts * np.arange(steps * parts + 1, dtype=float)


def _levels(spacing: FloatArray, above: float, heights: FloatArray) -> FloatArray:
    """Spacing along z [m], shape (N,), of which a multiple lets vehicles pass above each other.

    Args:
        spacing: about how much is wanted [m], shape (N,).
        above: how far apart vehicles are above each other [m].
        heights: of the boxes that are filled [m], shape (N,).
    """
    levels = above / np.ceil(above / (_ROUNDED * spacing))
    levels = np.maximum(heights / np.maximum(np.floor(heights / levels), 1.0), levels)
    levels = np.maximum(levels, spacing / _FLATTEST)
    return np.asarray(levels, dtype=np.float64)


def _speeds(scenario: Scenario, reach: Reach, faster: float) -> FloatArray:
    """Speeds along each axis at which ways are flown [m/s], shape (N, 3)."""
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
    usable = np.minimum(usable_speeds(scenario).max(axis=1), reach.speeds)
    usable = np.maximum(usable, _AHEAD * np.minimum(least, usable))
    speeds: FloatArray = np.minimum(wanted, usable)
    floor: FloatArray = np.maximum(speeds.max(), 1e-3 * wanted) / _FLATTEST
    return np.maximum(speeds, floor)


def _scale(scenario: Scenario) -> float:
    """The length that a grid should resolve [m]."""
    radius = float(scenario.fleet.radii.min())
    scales = [0.5 * (radius + float(body.shape.extent.min())) for _, body in scenario.known]
    if scenario.separation is not None:
        scales.append(scenario.separation.distance * 2.0 / 3.0)
    return max(min(scales, default=1.0), 1e-3 * float(scenario.fleet.lengths.max()))


def region(scenario: Scenario) -> Region:
    """Boxes in which ways are looked for.

    Each vehicle's position box, as far as starts, goals, waypoints and obstacles reach, what a way
    round them all takes, and no further than any vehicle gets.
    """
    fleet, grid = scenario.fleet, scenario.grid
    lows = [fleet.start_positions.min(axis=0), fleet.goal_positions.min(axis=0)]
    highs = [fleet.start_positions.max(axis=0), fleet.goal_positions.max(axis=0)]
    for waypoints in fleet.waypoints:
        lows.append(np.nanmin(waypoints.positions, axis=0))
        highs.append(np.nanmax(waypoints.positions, axis=0))
    for _, body in scenario.known:
        centers, extent = body.centers(grid.elapsed), body.shape.extent
        extent = np.where(np.isfinite(extent), extent, 0.0)
        lows.append((centers - extent).min(axis=0))
        highs.append((centers + extent).max(axis=0))
    around = 2.0 * float(fleet.radii.max()) + _scale(scenario) + np.zeros(3)
    if scenario.separation is not None:
        around += 2.0 * scenario.separation.shape.semi_axes
    reach = reach_of(scenario)
    lower = np.maximum(np.min(lows, axis=0) - around, reach.lower.min(axis=(0, 1)))
    upper = np.minimum(np.max(highs, axis=0) + around, reach.upper.max(axis=(0, 1)))
    count = len(scenario.vehicles)
    lower, upper = np.tile(lower, (count, 1)), np.tile(upper, (count, 1))
    if (bounds := fleet.bounds("position")) is not None:
        lower, upper = np.maximum(lower, bounds.lower), np.minimum(upper, bounds.upper)
    return Region(lower, np.maximum(lower, upper), reach)
