"""Moves of a lattice that run into something that moves: obstacles, and vehicles planned before.

Time goes in layers; in each a vehicle makes one move. What moves is taken to go straight within a
layer, an obstacle's deviation from that being added to what is kept from it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.planning.path_search.lattice import AT_ONCE, MOVES, Lattice
from drake_rho.planning.path_search.swept_clearance import kept_from, least_between
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Obstacle, Separation

_PARTS = np.array([0.0, 0.5, 1.0])
"""Parts of a layer at which the distance from an obstacle is looked at first."""

_ROUNDING = 1e-6
"""Part of a step of the lattice that is as good as none."""

_FINE_PARTS = np.linspace(0.0, 1.0, 9)
"""Those where that leaves open whether a move keeps clear."""


class MovingObstacle:
    """An obstacle that moves, as it is met in the layers.

    Args:
        body: the obstacle, on a clock that is 0 at the first knot.
        radius: kept from it [m].
        times: between layers, since the first knot [s], shape (M + 1,).

    Attributes:
        begins: first layer in which it is avoided.
    """

    blocks = True
    """whether nothing gets through"""

    def __init__(self, body: Obstacle, radius: float, times: FloatArray) -> None:
        self.centers = body.centers(times)
        first, last = body.active or (-np.inf, np.inf)
        self._active: BoolArray = (times[1:] >= first) & (times[:-1] <= last)
        self.begins = int(np.argmax(self._active))
        middles = body.centers((times[:-1] + times[1:]) / 2.0)
        bends = np.linalg.norm(middles - (self.centers[:-1] + self.centers[1:]) / 2.0, axis=1)
        self.margins: FloatArray = kept_from(body, radius) + bends
        self.reach: FloatArray = body.shape.extent + self.margins.max()
        self._shape, self._outermost = body.shape, float(np.linalg.norm(body.shape.extent))

    def room(self, layers: IntArray, positions: FloatArray) -> FloatArray:
        """How far positions, (Q, 3), are from coming too close when layers, (Q,), begin."""
        x = positions - self.centers[layers]
        room: FloatArray = self._shape.signed_distance(x) - self.margins[layers]
        room[~self._active[layers]] = np.inf
        return room

    def lengths(self, ways: FloatArray) -> FloatArray:
        """By how much the room can change when ways, (U, 3), are gone in a layer: shape (U, M)."""
        lengths: FloatArray = np.linalg.norm(ways[:, None] - np.diff(self.centers, axis=0), axis=-1)
        return lengths

    def met(self, layers: IntArray, start: FloatArray, end: FloatArray) -> BoolArray:
        """Whether moves in some layers, (Q,), from and to positions, (Q, 3), come too close."""
        x0, margins = start - self.centers[layers], self.margins[layers]
        way = end - self.centers[layers + 1] - x0
        lengths = np.sqrt(np.einsum("qi,qi->q", way, way))
        near = np.flatnonzero(_least_squares(x0, way) < (self._outermost + margins) ** 2)
        met = np.zeros(len(layers), dtype=bool)
        for parts in (_PARTS, _FINE_PARTS):
            x = x0[near] + parts[:, None, None] * way[near]
            d = self._shape.signed_distance(x) - margins[near]
            met[near] = least_between(d, lengths[near]) < 0.0
            near = near[met[near] & (d.min(axis=0) >= 0.0)]  # what is inside needs no closer look
        return met


class MovingVehicle:
    """A vehicle whose way is known, as it is met in the layers.

    Args:
        positions: between layers [m], shape (M + 1, 3).
        separation: kept from it.
    """

    blocks = False
    """whether nothing gets through: at a cost, a way may lead too close to it"""
    begins = 0
    """first layer in which it is avoided"""

    def __init__(self, positions: FloatArray, separation: Separation) -> None:
        self.centers = positions
        self.reach: FloatArray = separation.shape.semi_axes
        self._separation = separation

    def room(self, layers: IntArray, positions: FloatArray) -> FloatArray:
        """How far positions, (Q, 3), are from coming too close when layers, (Q,), begin."""
        x = self._separation.scaled(positions - self.centers[layers])
        room: FloatArray = np.linalg.norm(x, axis=1) - self._separation.distance
        return room

    def lengths(self, ways: FloatArray) -> FloatArray:
        """By how much the room can change when ways, (U, 3), are gone in a layer: shape (U, M)."""
        ways = self._separation.scaled(ways[:, None] - np.diff(self.centers, axis=0))
        lengths: FloatArray = np.linalg.norm(ways, axis=-1)
        return lengths

    def met(self, layers: IntArray, start: FloatArray, end: FloatArray) -> BoolArray:
        """Whether moves in some layers, (Q,), from and to positions, (Q, 3), come too close."""
        x0 = self._separation.scaled(start - self.centers[layers])
        way = self._separation.scaled(end - self.centers[layers + 1]) - x0
        met: BoolArray = _least_squares(x0, way) < self._separation.distance**2
        return met


def _least_squares(x0: FloatArray, way: FloatArray) -> FloatArray:
    """Least squared distances from the origin of what goes `way` from x0, both (Q, 3)."""
    squares = np.einsum("qi,qi->q", way, way)
    part = -np.einsum("qi,qi->q", x0, way) / np.maximum(squares, 1e-300)
    nearest = x0 + np.clip(part, 0.0, 1.0)[:, None] * way
    least: FloatArray = np.einsum("qi,qi->q", nearest, nearest)
    return least


Moving = MovingObstacle | MovingVehicle

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper bounds on positions between layers [m], shape (M + 1, 3) each, or (1, 3)."""

ANYWHERE: Bounds = np.full((1, 3), -np.inf), np.full((1, 3), np.inf)
"""Bounds that are none."""


def met_moves(lattice: Lattice, moving: Moving, reach: Bounds = ANYWHERE) -> list[IntArray]:
    """For each layer the moves that come too close, as u F + the number of the point they lead to.

    Only points near enough to be met within the layer are looked at and, of what blocks the way,
    none that is too close when the layer begins: moves that lead there are met before.

    Args:
        lattice: with the moves.
        moving: what comes too close.
        reach: where moves begin that are asked for; of others some may be left out.
    """
    none = np.zeros(0, dtype=np.int64)
    found = [
        (none, none),
        *(_met_among(lattice, moving, *near) for near in _near(lattice, moving, reach)),
    ]
    layers, codes = map(np.concatenate, zip(*found, strict=True))
    order = np.argsort(layers, kind="stable")
    ends = np.searchsorted(layers[order], np.arange(1, len(moving.centers) - 1))
    return np.split(codes[order], ends)


def _met_among(
    lattice: Lattice, moving: Moving, layers: IntArray, points: IntArray
) -> tuple[IntArray, IntArray]:
    """Layers, and moves as above, of those that begin at some points in some layers, (Q,) each."""
    count = len(lattice.points)
    start, ways = lattice.points[points], MOVES * lattice.raster.spacing
    room, lengths = moving.room(layers, start), moving.lengths(ways)
    asked = room < lengths.max(axis=0)[layers]
    if moving.blocks:
        asked &= (room >= 0.0) | (layers == moving.begins)
    layers, points, start, room = layers[asked], points[asked], start[asked], room[asked]
    to = lattice.neighbors[:, points]
    u, q = np.nonzero((room < lengths[:, layers]) & (to < count))
    met = np.zeros(len(u), dtype=bool)
    for some in np.array_split(np.arange(len(u)), 1 + len(u) // AT_ONCE):
        begin = start[q[some]]
        met[some] = moving.met(layers[q[some]], begin, begin + ways[u[some]])
    u, q = u[met], q[met]
    return layers[q], u * count + to[u, q]


def _near(lattice: Lattice, moving: Moving, bounds: Bounds) -> Iterator[tuple[IntArray, IntArray]]:
    """Layers, and numbers of points that may be met in them, each (Q,), not too many at once."""
    raster, ends = lattice.raster, moving.centers
    shape = np.array(raster.shape)
    shifts = np.abs(np.diff(ends, axis=0)).max(axis=0, initial=0.0)
    reach = moving.reach + raster.spacing + shifts / 2.0
    middles = ((ends[:-1] + ends[1:]) / 2.0 - raster.lower) / raster.spacing
    wide = reach / raster.spacing  # infinite where it is endless
    width = np.minimum(np.floor(2.0 * wide) + 1.0, shape).astype(np.int64)
    meets = np.all((middles + wide >= 0.0) & (middles - wide <= shape - 1.0), axis=1)
    low = np.clip(np.ceil(middles - wide), 0, shape - width).astype(np.int64)
    some, every = np.flatnonzero(meets), np.arange(np.prod(width))
    for window in np.array_split(every, max(1, len(every) // AT_ONCE)):
        offsets = np.stack(np.unravel_index(window, width), axis=-1) + 1
        for layers in np.array_split(some, max(1, len(some) * len(offsets) // AT_ONCE)):
            index = low[layers][:, None] + offsets
            numbers = lattice.numbers[index[..., 0], index[..., 1], index[..., 2]]
            asked = numbers < len(lattice.points)
            for side, sign in zip(bounds, (1.0, -1.0), strict=True):
                ends = np.broadcast_to(side, (len(moving.centers), 3))[layers]
                last = sign * (ends - (raster.lower - raster.spacing)) / raster.spacing - _ROUNDING
                asked &= np.all(sign * index >= last[:, None], axis=-1)
            which, points = np.nonzero(asked)
            yield layers[which], numbers[which, points]
