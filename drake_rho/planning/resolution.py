"""Grids in space and time on which ways are looked for: where they reach, and how fine they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.planning.pace import legs_of, usable_speeds
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Grid, Scenario

_MOST_POINTS = 2e5
"""Points of the finest grid."""

_FINER = 1.5
"""How much finer the next grid is."""

_VALUES = 5e7
"""Bound on points times layers, for the memory they take."""

_FASTER = 2.5
"""How much faster than straight to its goal a vehicle may fly on its way where no limit binds."""

_ROUNDED = 1.06
"""How much faster than its limits a vehicle may climb for the sake of fewer levels."""


@dataclasses.dataclass(frozen=True, eq=False)
class Resolution:
    """How fine a grid is in space and time."""

    length: float
    """the distance of neighbours where only space matters [m]"""
    spacing: FloatArray
    """along each axis where time matters too, for each vehicle [m], shape (N, 3)"""
    times: FloatArray
    """between layers, since the first knot [s], shape (M + 1,)"""


def resolutions(scenario: Scenario, points: float) -> Iterator[Resolution]:
    """From a coarse grid, on which a search is quick, to the finest that is looked at.

    Args:
        scenario: what is asked.
        points: of the first grid, unless fewer resolve what there is.
    """
    (lower, upper), scale = region(scenario), _scale(scenario)
    sides = np.maximum((upper - lower).max(axis=0), scale)
    volume, first = float(np.prod(sides)), True
    length = max(scale, (volume / points) ** (1.0 / 3.0))
    faster = _FASTER
    while first or volume / length**3 <= _MOST_POINTS:
        resolution = _resolution(scenario, length, _speeds(scenario, faster))
        count = np.prod(sides / resolution.spacing.min(axis=0) + 1.0) * len(resolution.times)
        if not first and count > _VALUES:
            break
        yield resolution
        first = False
        length, faster = length / _FINER, faster * 1.2


def _resolution(scenario: Scenario, length: float, speeds: FloatArray) -> Resolution:
    """Layers in which one move of about `length` is made at given speeds, shape (N, 3)."""
    times = _layers(scenario.grid, length / float(speeds.max()))
    spacing = speeds * (times[1] - times[0])
    if scenario.separation is not None:
        lower, upper = region(scenario)
        above = scenario.separation.distance * scenario.separation.downwash
        spacing[:, 2] = _levels(spacing[:, 2], above, upper[:, 2] - lower[:, 2])
    return Resolution(length, spacing, times)


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
    return np.asarray(levels, dtype=np.float64)


def _speeds(scenario: Scenario, faster: float) -> FloatArray:
    """Speeds along each axis at which ways are flown [m/s], shape (N, 3)."""
    legs = [leg for n in range(len(scenario.vehicles)) for leg in legs_of(scenario, n)]
    straight = max(
        float(np.linalg.norm(leg.goal - leg.start)) / (leg.end - leg.begin) for leg in legs
    )
    wanted = faster * max(straight, _scale(scenario) / scenario.grid.duration)
    speeds = np.minimum(wanted, usable_speeds(scenario))
    return np.maximum(speeds, 1e-3 * wanted)


def _scale(scenario: Scenario) -> float:
    """The length that a grid should resolve [m]."""
    radius = float(scenario.fleet.radii.min())
    scales = [0.5 * (radius + float(body.shape.extent.min())) for _, body in scenario.known]
    if scenario.separation is not None:
        scales.append(scenario.separation.distance * 2.0 / 3.0)
    return max(min(scales, default=1.0), 1e-3 * float(scenario.fleet.lengths.max()))


def region(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Boxes in which ways are looked for, as lower and upper corners [m], each (N, 3).

    Each vehicle's position box, as far as starts, goals, waypoints and obstacles reach, and what a
    way round them all takes.
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
    lower, upper = np.min(lows, axis=0) - around, np.max(highs, axis=0) + around
    count = len(scenario.vehicles)
    lower, upper = np.tile(lower, (count, 1)), np.tile(upper, (count, 1))
    if (bounds := fleet.bounds("position")) is not None:
        lower, upper = np.maximum(lower, bounds.lower), np.minimum(upper, bounds.upper)
    return lower, upper
