"""Moves of a lattice that run into something that moves: obstacles, and vehicles planned before.

Time goes in layers; in each a vehicle makes one move. What moves is taken to go straight within a
layer, an obstacle's deviation from that being added to what is kept from it.
"""

from __future__ import annotations

import numpy as np

from drake_rho.planning.clear_moves import kept_from, least_between
from drake_rho.planning.lattice import MOVES, Lattice
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Obstacle, Separation

_PARTS = np.array([0.0, 0.5, 1.0])
"""Parts of a layer at which the distance from an obstacle is looked at first."""

_FINE_PARTS = np.linspace(0.0, 1.0, 9)
"""Those where that leaves open whether a move keeps clear."""


class MovingObstacle:
    """An obstacle that moves, as it is met in the layers.

    Args:
        body: the obstacle, on a clock that is 0 at the first knot.
        radius: kept from it [m].
        times: between layers, since the first knot [s], shape (M + 1,).
    """

    blocks = True
    """whether nothing gets through"""

    def __init__(self, body: Obstacle, radius: float, times: FloatArray) -> None:
        self.centers = body.centers(times)
        middles = body.centers((times[:-1] + times[1:]) / 2.0)
        bends = np.linalg.norm(middles - (self.centers[:-1] + self.centers[1:]) / 2.0, axis=1)
        self.margins: FloatArray = kept_from(body, radius) + bends
        self.reach: FloatArray = body.shape.extent + self.margins.max()
        self._shape, self._outermost = body.shape, float(np.linalg.norm(body.shape.extent))

    def room(self, layers: IntArray, positions: FloatArray) -> FloatArray:
        """How far positions, (Q, 3), are from coming too close when layers, (Q,), begin."""
        x = positions - self.centers[layers]
        room: FloatArray = self._shape.signed_distance(x) - self.margins[layers]
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


def met_moves(lattice: Lattice, moving: Moving) -> list[IntArray]:
    """For each layer the moves that come too close, as u F + the number of the point they lead to.

    Only points near enough to be met within the layer are looked at and, of what blocks the way,
    none that is too close when the layer begins: moves that lead there are met before.
    """
    raster, count = lattice.raster, len(lattice.points)
    centers = moving.centers
    shifts = np.abs(np.diff(centers, axis=0)).max(axis=0, initial=0.0)
    reach = moving.reach + raster.spacing + shifts / 2.0
    layers, points = _near(lattice, (centers[:-1] + centers[1:]) / 2.0, reach)
    to = lattice.neighbors[:, points]
    start, ways = lattice.points[points], MOVES * raster.spacing
    room = moving.room(layers, start)
    if moving.blocks:
        asked = np.flatnonzero((room >= 0.0) | (layers == 0))
        layers, to, start, room = layers[asked], to[:, asked], start[asked], room[asked]
    within = room < moving.lengths(ways)[:, layers]
    u, q = np.nonzero(within & (to < count))
    to, start, layers = to[u, q], start[q], layers[q]
    met = moving.met(layers, start, start + ways[u])
    codes, layers = (u * count + to)[met], layers[met]
    order = np.argsort(layers, kind="stable")
    ends = np.searchsorted(layers[order], np.arange(1, len(centers) - 1))
    return np.split(codes[order], ends)


def _near(lattice: Lattice, centers: FloatArray, reach: FloatArray) -> tuple[IntArray, IntArray]:
    """Layers, and numbers of points that are within `reach` of the layer's center, each (Q,)."""
    raster = lattice.raster
    shape = np.array(raster.shape)
    reach = np.minimum(reach, raster.spacing * shape)
    low = np.ceil((centers - reach - raster.lower) / raster.spacing).astype(np.int64)
    width = np.floor(2.0 * reach / raster.spacing).astype(np.int64) + 1
    offsets = np.stack(np.meshgrid(*map(np.arange, width), indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.clip(low[:, None] + offsets, -1, shape) + 1
    numbers = lattice.numbers[index[..., 0], index[..., 1], index[..., 2]]
    layers, which = np.nonzero(numbers < len(lattice.points))
    return layers, numbers[layers, which]
