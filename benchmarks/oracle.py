"""Search for a path of one vehicle among shapes at rest: a grid, a path, and its timing.

It shares nothing with the package's planner, and does not minimise cost: any path will do. A yes is
a motion within the limits that is clear at samples every two centimetres; a no proves nothing,
since the grid is coarse and few paths are timed.
"""

from __future__ import annotations

import dataclasses
from itertools import product
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

import drake_rho as rho
from benchmarks.clearance import distances, nearest
from benchmarks.field import Field, field_of
from benchmarks.timing import least_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

TRIES = ((0.2, 0.4), (0.2, 0.2), (0.2, 0.1), (0.2, 0.0), (0.1, 0.1), (0.1, 0.0))
"""Spacings of the grid and distances beyond the radius [m], tried in order: a large distance has
rounder corners, which are faster; a small one passes gaps that the large one does not."""

SPACING, SPARE = 0.1, 0.003
"""Spacing of the points of a tightened path, and their additional distance from shapes, so that the
segments between them are clear as well [m]."""

SAMPLES = 0.02
"""Spacing of the samples of a path [m]."""

HALF_STENCIL = [step for step in product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]
"""Half of the 26 neighbours of a node: those that come after it."""

Verdict = Literal["way", "too slow", "none"]


@dataclasses.dataclass(frozen=True)
class Answer:
    """Result of the oracle."""

    verdict: Verdict
    """a path, only paths that take longer than the duration, or no path"""
    seconds: float = np.inf
    """least time found along a path [s]"""
    metres: float = np.inf
    """length of that path [m]"""


def ask(scenario: rho.Scenario) -> Answer:
    """Search a path in a scenario of one vehicle, from rest to rest, among shapes at rest.

    Raises:
        TypeError: the scenario has other features.
    """
    field, best = field_of(scenario), Answer("none")
    for spacing, berth in TRIES:
        path = shortest_path(field, spacing, berth)
        band = None if path is None else tightened(field, path, berth)
        if band is None or not _is_clear(field, band):
            continue
        seconds = least_time(band, field.velocity.upper, field.acceleration.upper)
        if seconds < best.seconds:
            metres = float(np.sum(np.linalg.norm(np.diff(band, axis=0), axis=1)))
            best = Answer("too slow" if seconds > field.duration else "way", seconds, metres)
        if best.verdict == "way":
            break
    return best


def shortest_path(field: Field, spacing: float, berth: float) -> FloatArray | None:
    """Return the shortest path on a grid over the room, shape (P, 3), from start to goal [m].

    Nodes and middles of edges are clear. The ends are joined to the free nodes around them.

    Args:
        field: the scenario.
        spacing: of the grid [m].
        berth: distance from the shapes beyond the radius, as far as the ends allow [m].
    """
    # every second point of a grid twice as fine is a node, the others are middles of edges
    room = field.room
    counts = 2 * np.maximum(1, np.round((room.upper - room.lower) / spacing).astype(int)) + 1
    axes = [np.linspace(*ends) for ends in zip(room.lower, room.upper, counts, strict=True)]
    free = _free(field, axes, berth)
    points = np.stack(np.meshgrid(*[axis[::2] for axis in axes], indexing="ij"), axis=-1)
    points, nodes = points.reshape(-1, 3), free[::2, ::2, ::2].reshape(-1)
    edges = [_edges(free, step) for step in HALF_STENCIL]
    start, goal = len(points), len(points) + 1
    for number, end in ((start, field.start), (goal, field.goal)):
        near = np.flatnonzero(nodes & (np.linalg.norm(points - end, axis=1) <= 1.8 * spacing))
        edges.append((np.full(len(near), number), near))
    tails, heads = (np.concatenate(some) for some in zip(*edges, strict=True))
    points = np.vstack([points, field.start, field.goal])
    lengths = np.linalg.norm(points[tails] - points[heads], axis=1)
    graph = csr_array((lengths, (tails, heads)), shape=(len(points), len(points)))
    reached, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    if not np.isfinite(reached[goal]):
        return None
    way = [goal]
    while way[-1] != start:
        way.append(int(before[way[-1]]))
    found: FloatArray = points[way[::-1]]
    return found


def _kept(field: Field, berth: float) -> FloatArray:
    """Return the distance to keep from each shape [m], shape (M,): at most that of both ends."""
    ends = np.array([field.start, field.goal])
    clear = np.array([distances(shape, ends).min() for shape in field.shapes])
    kept: FloatArray = np.clip(clear, field.radius, field.radius + berth)
    return kept


def _free(field: Field, axes: list[FloatArray], berth: float) -> BoolArray:
    """Return which points of a grid are far enough from all shapes."""
    free = np.ones([len(axis) for axis in axes], dtype=bool)
    for shape, kept in zip(field.shapes, _kept(field, berth), strict=True):
        reach = shape.extent + kept
        parts = [
            slice(*np.searchsorted(axis, (middle - far, middle + far)))
            for axis, middle, far in zip(axes, shape.center, reach, strict=True)
        ]
        around = [axis[part] for axis, part in zip(axes, parts, strict=True)]
        positions = np.stack(np.meshgrid(*around, indexing="ij"), axis=-1)
        free[tuple(parts)] &= distances(shape, positions) >= kept
    return free


def _edges(free: BoolArray, step: tuple[int, ...]) -> tuple[IntArray, IntArray]:
    """Return the nodes joined by free edges in one direction, both of shape (E,)."""
    sizes = [(size + 1) // 2 for size in free.shape]
    numbers = np.arange(np.prod(sizes)).reshape(sizes)
    spans = [np.arange(max(0, -s), size - max(0, s)) for s, size in zip(step, sizes, strict=True)]
    tails, heads = (np.ix_(*[s + i * d for s, d in zip(spans, step, strict=True)]) for i in (0, 1))
    fine = (np.ix_(*[2 * s + i * d for s, d in zip(spans, step, strict=True)]) for i in range(3))
    good = np.logical_and.reduce([free[at] for at in fine])
    return numbers[tails][good], numbers[heads][good]


def tightened(field: Field, path: FloatArray, berth: float) -> FloatArray:
    """Return the path tightened like a rubber band that slides around the shapes, shape (P, 3)."""
    kept, band = _kept(field, berth) + SPARE, _resampled(path, SPACING)
    for _ in range(3):
        for _ in range(150):
            band[1:-1] += 0.5 * (band[:-2] + band[2:] - 2.0 * band[1:-1])
            for shape, distance in zip(field.shapes, kept, strict=True):
                _push_out(band[1:-1], shape, distance)
            band[1:-1] = np.clip(band[1:-1], field.room.lower, field.room.upper)
        band = _resampled(band, SPACING)
    return band


def _push_out(points: FloatArray, shape: rho.Sphere | rho.Box, distance: float) -> None:
    """Move points that are too close to a shape away from it, in place."""
    close = distances(shape, points) < distance
    if np.any(close):
        touched = nearest(shape, points[close])
        away = points[close] - touched
        lengths = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        points[close] = touched + distance * away / lengths


def _resampled(path: FloatArray, spacing: float) -> FloatArray:
    """Return points at equal distances of at most `spacing` along a polyline [m], shape (P, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / spacing)) + 1)
    return np.stack([np.interp(at, along, axis) for axis in path.T], axis=1)


def _is_clear(field: Field, path: FloatArray) -> bool:
    """Return whether a polyline keeps the radius from all shapes, by samples."""
    points = _resampled(path, SAMPLES)
    return all(np.all(distances(shape, points) >= field.radius) for shape in field.shapes)
