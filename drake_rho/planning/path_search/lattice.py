"""Lattice: a regular grid of points in space, with collision-free moves between neighbours.

A move leads from a point to one of its 26 neighbours, or stays at the point.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.planning.path_search.map_raster import colliding, segments_collide
from drake_rho.planning.path_search.swept_clearance import (
    SAMPLES,
    convex_lower_bound,
    moves_are_clear,
    required_distance,
)
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.records import Obstacle
from drake_rho.scenario.shapes.base import Shape, Solid

if TYPE_CHECKING:
    from scipy.sparse import csr_array


MOVES = np.array(list(product((-1, 0, 1), repeat=3)))
"""Moves in units of the grid spacing, shape (27, 3). Move 26 - u is the reverse of move u."""

STAY = 13
"""Index of the move that stays at its point."""

_FORTH = 13
"""Number of moves after it, of which the others are the reverse."""

_FAR = 1e9
"""Clearance of moves that leave a part of the raster, which another part contains [m]."""

_ROUNDING = 1e-6
"""Rounding tolerance, as a fraction of the grid spacing."""

PEAK_BYTES = 1100.0
"""Peak memory [bytes] per point of the raster, reached while shortest paths are computed."""

STEADY_BYTES = 600.0
"""Memory [bytes] per point of the raster that a lattice occupies after that."""

BATCH_SIZE = 16_000
"""Number of points whose distances are computed in one batch, to bound the memory needed."""


class TooLargeError(MemoryError):
    """Error of a search that would exceed its memory limit."""


@dataclasses.dataclass(frozen=True, eq=False)
class Raster:
    """Positions of the points of a regular grid."""

    lower: FloatArray
    """first point [m], shape (3,)"""
    spacing: FloatArray
    """distance between neighbouring points along each axis [m], shape (3,)"""
    shape: tuple[int, ...]
    """number of points along each axis"""

    @classmethod
    def filling(cls, lower: FloatArray, upper: FloatArray, spacing: FloatArray) -> Raster:
        """Return a raster that fills a box up to its faces, with points at most `spacing` apart."""
        steps = np.maximum(np.ceil((upper - lower) / spacing - _ROUNDING), 0.0)
        apart = np.where(steps > 0, (upper - lower) / np.maximum(steps, 1.0), spacing)
        return cls(lower, apart, tuple(int(count) + 1 for count in steps))

    @property
    def count(self) -> int:
        """Number of points."""
        return math.prod(map(int, self.shape))

    def at(self, index: FloatArray | IntArray) -> FloatArray:
        """Return the positions [m] of indices along the axes, (..., 3); they may be fractional."""
        positions: FloatArray = self.lower + self.spacing * index
        return positions

    def window(self, center: FloatArray, extent: FloatArray) -> tuple[IntArray, IntArray]:
        """Return the index range of the points within an extent of a position: first, last + 1.

        Args:
            center: position [m], shape (3,).
            extent: largest distance along each axis [m], shape (3,).
        """
        last = np.array(self.shape) - 1  # in units of the spacing, so that rounding loses no point
        low = np.ceil((center - extent - self.lower) / self.spacing - _ROUNDING)
        high = np.floor((center + extent - self.lower) / self.spacing + _ROUNDING) + 1
        low, high = np.maximum(low, 0), np.minimum(high, last + 1)
        return low.astype(np.int64), np.maximum(low, high).astype(np.int64)


class Lattice:
    """Collision-free points of a raster and collision-free moves between them, obstacles at rest.

    Args:
        raster: grid of candidate points.
        still: obstacles at rest.
        radius: of the vehicle [m].

    Attributes:
        raster: as given.
        free: mask of the collision-free points, with the shape of the raster.
        points: the F collision-free points [m], shape (F, 3).
        numbers: number of each point of the raster among the F points, or F if it collides. Padded
            by one on every side, shape (X + 2, Y + 2, Z + 2).
        neighbors: number of the point to which each move leads, or F if the move collides, shape
            (27, F).
    """

    def __init__(self, raster: Raster, still: Sequence[Obstacle], radius: float) -> None:
        self.raster, self._still, self._radius = raster, tuple(still), radius
        self.free: BoolArray = np.ones(raster.shape, dtype=bool)
        self._clear: BoolArray = np.ones((_FORTH, *raster.shape), dtype=bool)
        self._block(self._still)

    def with_more(self, more: Sequence[Obstacle]) -> Lattice:
        """Return the lattice among more obstacles at rest."""
        lattice = Lattice(self.raster, (), self._radius)
        lattice.free, lattice._clear = self.free.copy(), self._clear.copy()
        lattice._still = *self._still, *more
        lattice._block(more)
        return lattice

    def _block(self, still: Sequence[Obstacle]) -> None:
        """Remove the points and moves that collide with obstacles at rest."""
        for body in still:
            _block(self.raster, body, self._radius, self.free, self._clear)
        count = int(self.free.sum())
        self.numbers: IntArray = np.full(np.array(self.raster.shape) + 2, count, dtype=np.int64)
        self.numbers[1:-1, 1:-1, 1:-1][self.free] = np.arange(count)
        self.index = np.argwhere(self.free)
        self.points = self.raster.at(self.index)
        self.neighbors = self._neighbors()

    def _neighbors(self) -> IntArray:
        count, shape, free = len(self.points), self.raster.shape, self.free
        neighbors: IntArray = np.full((len(MOVES), count), count, dtype=np.int64)
        neighbors[STAY] = own = np.arange(count)
        for u in range(STAY + 1, len(MOVES)):
            there = self.numbers[
                tuple(slice(1 + m, 1 + m + n) for m, n in zip(MOVES[u], shape, strict=True))
            ]
            to = np.where(self._clear[u - STAY - 1], there, count)[free]
            neighbors[u] = to
            known = to < count
            neighbors[len(MOVES) - 1 - u, to[known]] = own[known]
        return neighbors

    @cached_property
    def lengths(self) -> FloatArray:
        """Lengths of the moves [m], shape (27,)."""
        lengths: FloatArray = np.linalg.norm(MOVES * self.raster.spacing, axis=1)
        return lengths

    @cached_property
    def graph(self) -> csr_array:
        """Sparse adjacency matrix with the lengths of the moves [m], shape (F, F)."""
        from scipy.sparse import csr_array  # slow to load, so only where needed

        count = len(self.points)
        others = np.delete(np.arange(len(MOVES)), STAY)
        to = self.neighbors[others].T
        known = to < count
        lengths = np.broadcast_to(self.lengths[others], to.shape)[known]
        starts = np.concatenate([[0], np.cumsum(known.sum(axis=1))]).astype(np.int32)
        return csr_array((lengths, to[known].astype(np.int32), starts), shape=(count, count))

    def near(self, position: FloatArray, steps: int) -> IntArray:
        """Return the numbers of the points within `steps` spacings of a position on every axis."""
        low, high = self.raster.window(position, steps * self.raster.spacing)
        inside = tuple(slice(1 + a, 1 + b) for a, b in zip(low, high, strict=True))
        numbers = self.numbers[inside].ravel()
        near: IntArray = numbers[numbers < len(self.points)]
        return near

    def are_clear(self, one: FloatArray, other: FloatArray, samples: int = SAMPLES) -> BoolArray:
        """Return flags of segments between positions (E, 3) clear of obstacles at rest, (E,)."""
        return are_clear(self._still, self._radius, one, other, samples)

    def visible_from(self, position: FloatArray) -> IntArray:
        """Return the numbers of nearby points joined to a position by a collision-free segment."""
        for steps in (1, 2):
            near = self.near(position, steps)
            near = near[self.are_clear(np.tile(position, (len(near), 1)), self.points[near])]
            if len(near) > 0:
                break
        return near

    def nearest(self, position: FloatArray) -> int:
        """Return the number of the nearest collision-free point; F if none is nearby."""
        near = self.near(position, 2)
        if len(near) == 0:
            return len(self.points)
        return int(near[np.argmin(np.linalg.norm(self.points[near] - position, axis=1))])

    def shortest_paths(self, sources: IntArray) -> ShortestPaths:
        """Return the shortest paths to all points, each from the nearest of several sources."""
        from scipy.sparse.csgraph import dijkstra  # slow to load, so only where needed

        lengths, before, _ = dijkstra(
            self.graph, indices=sources, min_only=True, return_predecessors=True
        )
        return ShortestPaths(lengths, before)


@dataclasses.dataclass(frozen=True, eq=False)
class ShortestPaths:
    """Shortest paths from several sources of a lattice to all of its points."""

    lengths: FloatArray
    """lengths of the paths [m], infinite for points that cannot be reached, shape (F,)"""
    before: IntArray
    """predecessor of each point on its path, negative at a source, shape (F,)"""

    def path(self, point: int) -> IntArray:
        """Return the points of the path from a point back to its source, the point first."""
        path = [point]
        while self.before[path[-1]] >= 0:
            path.append(int(self.before[path[-1]]))
        return np.array(path)


def are_clear(
    still: Sequence[Obstacle],
    radius: float,
    one: FloatArray,
    other: FloatArray,
    samples: int = SAMPLES,
) -> BoolArray:
    """Return flags of segments between positions (E, 3) clear of obstacles at rest, (E,).

    Args:
        still: obstacles at rest.
        radius: of the vehicle [m].
        one: ends of the segments [m].
        other: their other ends [m].
        samples: number of points along a segment.
    """
    parts, steps = np.linspace(0.0, 1.0, samples)[:, None, None], other - one
    lengths = np.linalg.norm(steps, axis=1)
    clear = np.ones(len(lengths), dtype=bool)
    for body in still:
        required = required_distance(body, radius)
        extent = float(np.linalg.norm(body.shape.extent)) + required
        near = np.flatnonzero(clear & _come_within(one, steps, body.first_center, extent))
        if len(near) == 0:
            continue
        if isinstance(body.shape, Parts):
            ends = one[near] - body.first_center, other[near] - body.first_center
            clear[near] = ~segments_collide(body.shape, required, *ends, samples)
            continue
        at = one[near] + parts * steps[near] - body.first_center
        d = body.shape.local_distance(at) - required
        clear[near] = convex_lower_bound(d, lengths[near]) >= 0.0
    return clear


def _come_within(
    one: FloatArray, steps: FloatArray, place: FloatArray, distance: float
) -> BoolArray:
    """Return which segments from positions (E, 3) come within a distance of a place, (E,)."""
    away, squares = place - one, np.vecdot(steps, steps)
    parts = np.clip(np.vecdot(away, steps) / np.where(squares > 0.0, squares, 1.0), 0.0, 1.0)
    nearest = parts[:, None] * steps - away
    return np.asarray(np.vecdot(nearest, nearest) <= distance**2)


def _block(
    raster: Raster, body: Obstacle, radius: float, free: BoolArray, clear: BoolArray
) -> None:
    """Mark the points and moves that collide with an obstacle at rest.

    Args:
        raster: grid of points.
        body: the obstacle.
        radius: of the vehicle [m].
        free: mask of the collision-free points, changed in place.
        clear: mask of the collision-free moves after `STAY` by their starting point, shape
            (13, X, Y, Z), changed in place.
    """
    required, center = required_distance(body, radius), body.first_center
    low, high = raster.window(center, body.shape.extent + required + 1.001 * raster.spacing)
    if np.any(low >= high):
        return
    if isinstance(body.shape, Parts):
        _block_map(raster, body, required, (low, high), free, clear)
        return
    for first, past in _parts(low, high):
        _block_part(raster, body, required, (first, past), free, clear)


def _block_map(
    raster: Raster,
    body: Obstacle,
    required: float,
    window: tuple[IntArray, IntArray],
    free: BoolArray,
    clear: BoolArray,
) -> None:
    """Mark the points and moves of a window of the raster that collide with a map."""
    low, high = window
    block = _block_of(low, high - low)
    axes = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    x = raster.at(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)) - body.first_center
    assert isinstance(body.shape, Parts)  # noqa: S101  # callers check this
    inside, blocked = colliding(body.shape, required, x, MOVES[STAY + 1 :], raster.spacing)
    free[block] &= ~inside
    clear[:, *block] &= ~blocked


def _parts(low: IntArray, high: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield parts of a window that are small enough for one batch.

    Neighbouring parts share one plane of points, so that every move lies in a part.
    """
    wide = high - low
    axis = int(np.argmax(wide))
    if np.prod(2.0 * wide - 1.0) <= BATCH_SIZE or wide[axis] < 3:
        yield low, high
        return
    middle, unit = low[axis] + wide[axis] // 2, np.arange(3) == axis
    yield from _parts(low, np.where(unit, middle + 1, high))
    yield from _parts(np.where(unit, middle, low), high)


def _block_part(
    raster: Raster,
    body: Obstacle,
    required: float,
    window: tuple[IntArray, IntArray],
    free: BoolArray,
    clear: BoolArray,
) -> None:
    """Mark the points and moves of a part of the raster that collide with an obstacle."""
    low, high = window
    halves = [np.arange(2 * a, 2 * b - 1) / 2.0 for a, b in zip(low, high, strict=True)]
    x = raster.at(np.stack(np.meshgrid(*halves, indexing="ij"), axis=-1)) - body.first_center
    shape: Solid = body.shape
    assert isinstance(shape, Shape)  # noqa: S101  # callers treat maps by themselves
    clearance = shape.local_distance(x) - required
    every, none = high - low, np.zeros(3, dtype=np.int64)
    free[_block_of(low, every)] &= clearance[_halves(none, every)] >= 0.0
    clearances = np.full((3, _FORTH, *every), _FAR)
    for u, move in enumerate(MOVES[STAY + 1 :]):
        first, count = np.maximum(0, -move), every - np.abs(move)
        if np.all(count > 0):
            for k in range(3):
                along = clearance[_halves(2 * first + k * move, count)]
                clearances[k, u][_block_of(first, count)] = along
    steps = MOVES[STAY + 1 :] * raster.spacing
    clear[:, *_block_of(low, every)] &= moves_are_clear(
        shape, required, x[_halves(none, every)], steps, clearances
    )


def _block_of(first: IntArray, count: IntArray) -> tuple[slice, ...]:
    """Return the slices of a block of points, from its first point and its size."""
    return tuple(slice(f, f + n) for f, n in zip(first, count, strict=True))


def _halves(first: IntArray, count: IntArray) -> tuple[slice, ...]:
    """Return the slices of a block on a grid of half the spacing, with every second point taken."""
    return tuple(slice(f, f + 2 * n - 1, 2) for f, n in zip(first, count, strict=True))
