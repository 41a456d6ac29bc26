"""A regular grid of points in space, and the moves between neighbours that keep clear.

A move leads from a point to one of its 26 neighbours, or stays.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.planning.path_search.swept_clearance import (
    SAMPLES,
    are_clear,
    kept_from,
    least_between,
)
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Obstacle

if TYPE_CHECKING:
    from scipy.sparse import csr_array


MOVES = np.array(list(product((-1, 0, 1), repeat=3)))
"""Moves in steps of the grid, shape (27, 3); move 26 - u is the reverse of move u."""

STAY = 13
"""The move that stays."""

_ROUNDING = 1e-6
"""Part of a step of the grid that is as good as none."""

POINT_BYTES = 1100.0
"""Memory that a lattice takes for each point of its raster while its shortest ways are found."""

KEPT_BYTES = 600.0
"""What it goes on taking."""

AT_ONCE = 16_000
"""Places whose distances from something are computed at once, for the memory that this takes."""


class TooLargeError(MemoryError):
    """A search would take more memory than it may."""


@dataclasses.dataclass(frozen=True, eq=False)
class Raster:
    """Where the points of a grid are."""

    lower: FloatArray
    """first point [m], shape (3,)"""
    spacing: FloatArray
    """from one point to the next along each axis [m], shape (3,)"""
    shape: tuple[int, ...]
    """how many there are along each axis"""

    @classmethod
    def filling(cls, lower: FloatArray, upper: FloatArray, spacing: FloatArray) -> Raster:
        """Points at most `spacing` apart that fill a box, along each axis from face to face."""
        steps = np.maximum(np.ceil((upper - lower) / spacing - _ROUNDING), 0.0)
        apart = np.where(steps > 0, (upper - lower) / np.maximum(steps, 1.0), spacing)
        return cls(lower, apart, tuple(int(count) + 1 for count in steps))

    @property
    def count(self) -> int:
        """How many points there are."""
        return math.prod(map(int, self.shape))

    def at(self, index: FloatArray | IntArray) -> FloatArray:
        """Positions [m] by numbers along the axes, which may lie between points, (..., 3)."""
        positions: FloatArray = self.lower + self.spacing * index
        return positions

    def window(self, center: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
        """First numbers, and numbers past the last, of the points within `reach` of a place."""
        last = np.array(self.shape) - 1  # in steps of the grid, so that rounding loses no point
        low = np.ceil((center - reach - self.lower) / self.spacing - _ROUNDING)
        high = np.floor((center + reach - self.lower) / self.spacing + _ROUNDING) + 1
        low, high = np.maximum(low, 0), np.minimum(high, last + 1)
        return low.astype(np.int64), np.maximum(low, high).astype(np.int64)


class Lattice:
    """The points of a raster that are clear of what stands still, and the clear moves between them.

    Args:
        raster: where points are.
        still: obstacles that do not move.
        radius: kept from them [m].

    Attributes:
        raster: as given.
        free: which points of the raster are clear, of its shape.
        points: the clear ones [m], shape (F, 3).
        numbers: which of them each point of the raster is, F if it is not clear; with one more
            layer around, shape (X + 2, Y + 2, Z + 2).
        neighbors: where each move leads, F if it is not clear, shape (27, F).
    """

    def __init__(self, raster: Raster, still: Sequence[Obstacle], radius: float) -> None:
        free = np.ones(raster.shape, dtype=bool)
        clear = np.ones((len(MOVES), *raster.shape), dtype=bool)
        for body in still:
            _block(raster, body, radius, free, clear)
        self.raster, self.free, self._still, self._radius = raster, free, still, radius
        count = int(free.sum())
        self.numbers: IntArray = np.full(np.array(raster.shape) + 2, count, dtype=np.int64)
        self.numbers[1:-1, 1:-1, 1:-1][free] = np.arange(count)
        self.index = np.argwhere(free)
        self.points = raster.at(self.index)
        self.neighbors = self._neighbors(free, clear)

    def _neighbors(self, free: BoolArray, clear: BoolArray) -> IntArray:
        count, shape = len(self.points), self.raster.shape
        neighbors: IntArray = np.full((len(MOVES), count), count, dtype=np.int64)
        neighbors[STAY] = own = np.arange(count)
        for u in range(STAY + 1, len(MOVES)):
            there = self.numbers[
                tuple(slice(1 + m, 1 + m + n) for m, n in zip(MOVES[u], shape, strict=True))
            ]
            to = np.where(clear[u], there, count)[free]
            neighbors[u] = to
            known = to < count
            neighbors[len(MOVES) - 1 - u, to[known]] = own[known]
        return neighbors

    @cached_property
    def lengths(self) -> FloatArray:
        """Of the moves [m], shape (27,)."""
        lengths: FloatArray = np.linalg.norm(MOVES * self.raster.spacing, axis=1)
        return lengths

    @cached_property
    def graph(self) -> csr_array:
        """Lengths of the moves between neighbours [m], shape (F, F)."""
        from scipy.sparse import csr_array  # slow to load, so only where needed

        count = len(self.points)
        others = np.delete(np.arange(len(MOVES)), STAY)
        to = self.neighbors[others].T
        known = to < count
        lengths = np.broadcast_to(self.lengths[others], to.shape)[known]
        starts = np.concatenate([[0], np.cumsum(known.sum(axis=1))]).astype(np.int32)
        return csr_array((lengths, to[known].astype(np.int32), starts), shape=(count, count))

    def near(self, position: FloatArray, steps: int) -> IntArray:
        """Numbers of the points within so many steps of a position along each axis."""
        low, high = self.raster.window(position, steps * self.raster.spacing)
        inside = tuple(slice(1 + a, 1 + b) for a, b in zip(low, high, strict=True))
        numbers = self.numbers[inside].ravel()
        near: IntArray = numbers[numbers < len(self.points)]
        return near

    def clear(self, one: FloatArray, other: FloatArray, samples: int = SAMPLES) -> BoolArray:
        """Whether straight ways between positions, (E, 3), are clear of what stands still: (E,)."""
        parts = np.linspace(0.0, 1.0, samples)[:, None, None]
        x, lengths = one + parts * (other - one), np.linalg.norm(other - one, axis=1)
        clear = np.ones(len(lengths), dtype=bool)
        for body in self._still:
            at = x[:, clear] - body.first_center
            d = body.shape.signed_distance(at) - kept_from(body, self._radius)
            clear[clear] = least_between(d, lengths[clear]) >= 0.0
        return clear

    def next_to(self, position: FloatArray) -> IntArray:
        """Numbers of the points next to a position to which a straight way is clear."""
        for steps in (1, 2):
            near = self.near(position, steps)
            near = near[self.clear(np.tile(position, (len(near), 1)), self.points[near])]
            if len(near) > 0:
                break
        return near

    def nearest(self, position: FloatArray) -> int:
        """The clear point among those around a position that is nearest to it; F if none is."""
        near = self.near(position, 2)
        if len(near) == 0:
            return len(self.points)
        return int(near[np.argmin(np.linalg.norm(self.points[near] - position, axis=1))])

    def shortest(self, sources: IntArray) -> ShortestPaths:
        """The shortest ways from the nearest of some points to all others."""
        from scipy.sparse.csgraph import dijkstra  # slow to load, so only where needed

        lengths, before, _ = dijkstra(
            self.graph, indices=sources, min_only=True, return_predecessors=True
        )
        return ShortestPaths(lengths, before)


@dataclasses.dataclass(frozen=True, eq=False)
class ShortestPaths:
    """Shortest ways from some points of a lattice to all."""

    lengths: FloatArray
    """[m], infinite where no way leads, shape (F,)"""
    before: IntArray
    """the point before each on its way, negative at the beginning, shape (F,)"""

    def path(self, point: int) -> IntArray:
        """The way back from a point, itself first, to where it begins."""
        path = [point]
        while self.before[path[-1]] >= 0:
            path.append(int(self.before[path[-1]]))
        return np.array(path)


def _block(
    raster: Raster, body: Obstacle, radius: float, free: BoolArray, clear: BoolArray
) -> None:
    """Mark what an obstacle at rest blocks: points, and moves by where they begin."""
    kept, center = kept_from(body, radius), body.first_center
    low, high = raster.window(center, body.shape.extent + kept + 1.001 * raster.spacing)
    if np.any(low >= high):
        return
    for first, past in _parts(low, high):
        _block_part(raster, body, kept, (first, past), free, clear)


def _parts(low: IntArray, high: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Parts of a window that are small enough; neighbours share a layer, so none splits a move."""
    wide = high - low
    axis = int(np.argmax(wide))
    if np.prod(2.0 * wide - 1.0) <= AT_ONCE or wide[axis] < 3:
        yield low, high
        return
    middle, unit = low[axis] + wide[axis] // 2, np.arange(3) == axis
    yield from _parts(low, np.where(unit, middle + 1, high))
    yield from _parts(np.where(unit, middle, low), high)


def _block_part(
    raster: Raster,
    body: Obstacle,
    kept: float,
    window: tuple[IntArray, IntArray],
    free: BoolArray,
    clear: BoolArray,
) -> None:
    """Mark what an obstacle blocks in a part of the raster."""
    low, high = window
    halves = [np.arange(2 * a, 2 * b - 1) / 2.0 for a, b in zip(low, high, strict=True)]
    x = raster.at(np.stack(np.meshgrid(*halves, indexing="ij"), axis=-1)) - body.first_center
    room = body.shape.signed_distance(x) - kept
    every, none = high - low, np.zeros(3, dtype=np.int64)
    free[_block_of(low, every)] &= room[_halves(none, every)] >= 0.0
    for u in range(STAY + 1, len(MOVES)):
        move = MOVES[u]
        first, count = np.maximum(0, -move), every - np.abs(move)
        if np.all(count > 0):
            rooms = np.stack([room[_halves(2 * first + k * move, count)] for k in range(3)])
            starts, way = x[_halves(2 * first, count)], move * raster.spacing
            clear[u][_block_of(low + first, count)] &= are_clear(
                body.shape, kept, starts, way, rooms
            )


def _block_of(first: IntArray, count: IntArray) -> tuple[slice, ...]:
    """So many points along each axis from the first on."""
    return tuple(slice(f, f + n) for f, n in zip(first, count, strict=True))


def _halves(first: IntArray, count: IntArray) -> tuple[slice, ...]:
    """The same on a grid of half the spacing, of which every second is taken."""
    return tuple(slice(f, f + 2 * n - 1, 2) for f, n in zip(first, count, strict=True))
