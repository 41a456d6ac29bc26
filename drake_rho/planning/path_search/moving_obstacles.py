"""Moves of a lattice that collide with moving obstacles or previously planned vehicles.

Time is divided into layers, and a vehicle makes one move in each. Within a layer, obstacles and
other vehicles are assumed to move along straight lines. The deviation of an obstacle's motion from
its line is added to the distance required from it. If its position is uncertain, the distance grows
linearly within a layer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.work_limit import MOVE, MOVE_IN_MAP, count_work
from drake_rho.planning.path_search.lattice import BATCH_SIZE, MOVES, Lattice
from drake_rho.planning.path_search.swept_clearance import lower_bound, required_distance
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.records import Obstacle, Separation

_PARTS = np.array([0.0, 0.5, 1.0])
"""Fractions of a layer at which distances from an obstacle are computed first."""

_ROUNDING = 1e-6
"""Rounding tolerance, as a fraction of the spacing of the lattice."""

_FINE_PARTS = np.linspace(0.0, 1.0, 9)
"""Fractions of a layer for distances if the first ones leave the check undecided."""


class MovingObstacle:
    """Obstacle that moves, grows or is active for a time, in the layers of a time-expanded graph.

    Args:
        body: the obstacle, on a clock that is 0 at the first knot.
        radius: of the vehicle [m].
        times: layer boundaries since the first knot [s], shape (M + 1,).

    Attributes:
        begins: first layer in which the obstacle is active.
        layers: layers in which it is active; if nothing changes, only the first two.
        alike: layers with the same blocked moves as the last of `layers`.
        work: of checking one move [rounds].
    """

    blocks = True
    """colliding moves are impossible"""

    def __init__(self, body: Obstacle, radius: float, times: FloatArray) -> None:
        self.centers = body.centers(times)
        first, last = body.active or (-np.inf, np.inf)
        self._active: BoolArray = (times[1:] > first) & (times[:-1] < last)
        self.begins = int(np.argmax(self._active))
        active = np.flatnonzero(self._active)
        different = len(active) if body.changes else 2
        self.layers, self.alike = active[:different], active[different:]
        middles = body.centers((times[:-1] + times[1:]) / 2.0)
        deviations = np.linalg.norm(middles - (self.centers[:-1] + self.centers[1:]) / 2.0, axis=1)
        self.margins: FloatArray = required_distance(body, radius) + deviations
        errors = body.uncertainty(times) - body.position_error
        self._before, self._growth = errors[:-1], np.diff(errors)
        self.extent: FloatArray = body.shape.extent + (self.margins + errors[1:]).max()
        self.work = MOVE_IN_MAP if isinstance(body.shape, Parts) else MOVE
        self._shape, self._outermost = body.shape, float(np.linalg.norm(body.shape.extent))

    def clearance(self, layers: IntArray, positions: FloatArray) -> FloatArray:
        """Return the clearance of positions, (Q, 3), at the beginning of layers, (Q,)."""
        x = positions - self.centers[layers]
        required = self.margins[layers] + self._before[layers]
        clearance: FloatArray = self._shape.local_distance(x) - required
        return clearance

    def lengths(self, steps: FloatArray) -> FloatArray:
        """Return bounds on the change of the clearance in a layer during moves, (U, 3): (U, M)."""
        lengths: FloatArray = np.linalg.norm(
            steps[:, None] - np.diff(self.centers, axis=0), axis=-1
        )
        return lengths + self._growth

    def collide(self, layers: IntArray, start: FloatArray, end: FloatArray) -> BoolArray:
        """Return which moves in given layers, (Q,), between positions, (Q, 3), collide: (Q,)."""
        x0, margins = start - self.centers[layers], self.margins[layers] + self._before[layers]
        step, growth = end - self.centers[layers + 1] - x0, self._growth[layers]
        lengths = np.sqrt(np.einsum("qi,qi->q", step, step)) + growth
        reached = _least_squared_distances(x0, step) < (self._outermost + margins + growth) ** 2
        near = np.flatnonzero(reached & self._active[layers])
        collides = np.zeros(len(layers), dtype=bool)
        for parts in (_PARTS, _FINE_PARTS):
            x = x0[near] + parts[:, None, None] * step[near]
            d = self._shape.local_distance(x) - margins[near] - parts[:, None] * growth[near]
            collides[near] = lower_bound(self._shape, d, lengths[near]) < 0.0
            near = near[collides[near] & (d.min(axis=0) >= 0.0)]  # a point inside decides the check
        return collides


class MovingVehicle:
    """Vehicle with a known path, in the layers of a time-expanded graph.

    Args:
        positions: of the vehicle at the layer boundaries [m], shape (M + 1, 3).
        separation: required of the two vehicles.
    """

    blocks = False
    """colliding moves are possible at a cost"""
    begins = 0
    """first layer with the vehicle as an obstacle"""
    work = MOVE
    """work of checking one move [rounds]"""

    def __init__(self, positions: FloatArray, separation: Separation) -> None:
        self.centers = positions
        self.layers, self.alike = np.arange(len(positions) - 1), np.zeros(0, dtype=np.int64)
        self.extent: FloatArray = separation.shape.semi_axes
        self._separation = separation

    def clearance(self, layers: IntArray, positions: FloatArray) -> FloatArray:
        """Return the clearance of positions, (Q, 3), at the beginning of layers, (Q,)."""
        x = self._separation.scaled(positions - self.centers[layers])
        clearance: FloatArray = np.linalg.norm(x, axis=1) - self._separation.distance
        return clearance

    def lengths(self, steps: FloatArray) -> FloatArray:
        """Return bounds on the change of the clearance in a layer during moves, (U, 3): (U, M)."""
        steps = self._separation.scaled(steps[:, None] - np.diff(self.centers, axis=0))
        lengths: FloatArray = np.linalg.norm(steps, axis=-1)
        return lengths

    def collide(self, layers: IntArray, start: FloatArray, end: FloatArray) -> BoolArray:
        """Return which moves in given layers, (Q,), between positions, (Q, 3), collide: (Q,)."""
        x0 = self._separation.scaled(start - self.centers[layers])
        step = self._separation.scaled(end - self.centers[layers + 1]) - x0
        collides: BoolArray = _least_squared_distances(x0, step) < self._separation.distance**2
        return collides


def _least_squared_distances(x0: FloatArray, step: FloatArray) -> FloatArray:
    """Return the least squared distances from the origin of segments x0 to x0 + step, (Q,)."""
    squares = np.einsum("qi,qi->q", step, step)
    part = -np.einsum("qi,qi->q", x0, step) / np.maximum(squares, 1e-300)
    nearest = x0 + np.clip(part, 0.0, 1.0)[:, None] * step
    least: FloatArray = np.einsum("qi,qi->q", nearest, nearest)
    return least


Moving = MovingObstacle | MovingVehicle

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper bounds on positions at the layer boundaries [m], (M + 1, 3) or (1, 3) each."""

UNBOUNDED: Bounds = np.full((1, 3), -np.inf), np.full((1, 3), np.inf)
"""Infinite bounds."""


def blocked_moves(lattice: Lattice, moving: Moving, bounds: Bounds = UNBOUNDED) -> list[IntArray]:
    """Return the codes of each layer's moves that are too close to an obstacle or vehicle.

    Move u to the point with number i has the code u F + i. Only points near enough for a collision
    within the layer are checked. For an obstacle, moves from points that are too close when the
    layer begins are left out, since the moves to these points are blocked already.

    Args:
        lattice: with the moves.
        moving: obstacle or vehicle to keep clear of.
        bounds: on the positions at which moves begin; moves from outside may be left out.
    """
    if len(moving.alike) > 0:  # for all of these layers, so within the bounds of any
        bounds = bounds[0].min(axis=0, keepdims=True), bounds[1].max(axis=0, keepdims=True)
    none = np.zeros(0, dtype=np.int64)
    found = [
        (none, none),
        *(_blocked_among(lattice, moving, *near) for near in _near(lattice, moving, bounds)),
    ]
    layers, codes = map(np.concatenate, zip(*found, strict=True))
    order = np.argsort(layers, kind="stable")
    ends = np.searchsorted(layers[order], np.arange(1, len(moving.centers) - 1))
    blocked = np.split(codes[order], ends)
    for layer in moving.alike:
        blocked[layer] = blocked[moving.layers[-1]]
    return blocked


def _blocked_among(
    lattice: Lattice, moving: Moving, layers: IntArray, points: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the layers and codes of the blocked moves among those from given points.

    Args:
        lattice: with the moves.
        moving: obstacle or vehicle to keep clear of.
        layers: in which moves begin, shape (Q,).
        points: at which they begin, by number, shape (Q,).
    """
    count = len(lattice.points)
    start, steps = lattice.points[points], MOVES * lattice.raster.spacing
    clearance, lengths = moving.clearance(layers, start), moving.lengths(steps)
    near = clearance < lengths.max(axis=0)[layers]
    if moving.blocks:
        near &= (clearance >= 0.0) | (layers == moving.begins)
    layers, points, start, clearance = (
        layers[near],
        points[near],
        start[near],
        clearance[near],
    )
    to = lattice.neighbors[:, points]
    u, q = np.nonzero((clearance < lengths[:, layers]) & (to < count))
    collides = np.zeros(len(u), dtype=bool)
    for some in np.array_split(np.arange(len(u)), 1 + len(u) // BATCH_SIZE):
        check_time()
        count_work(len(some) * moving.work)
        begin = start[q[some]]
        collides[some] = moving.collide(layers[q[some]], begin, begin + steps[u[some]])
    u, q = u[collides], q[collides]
    return layers[q], u * count + to[u, q]


def _near(lattice: Lattice, moving: Moving, bounds: Bounds) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield layers and numbers of the points that may collide in them, (Q,) each, in batches."""
    raster, ends = lattice.raster, moving.centers
    shape = np.array(raster.shape)
    shifts = np.abs(np.diff(ends, axis=0)).max(axis=0, initial=0.0)
    extent = moving.extent + raster.spacing + shifts / 2.0
    middles = ((ends[:-1] + ends[1:]) / 2.0 - raster.lower) / raster.spacing
    wide = extent / raster.spacing  # infinite along the axis of an unbounded shape
    width = np.minimum(np.floor(2.0 * wide) + 1.0, shape).astype(np.int64)
    meets = np.all((middles + wide >= 0.0) & (middles - wide <= shape - 1.0), axis=1)
    low = np.clip(np.ceil(middles - wide), 0, shape - width).astype(np.int64)
    some, every = moving.layers[meets[moving.layers]], np.arange(np.prod(width))
    for window in np.array_split(every, max(1, len(every) // BATCH_SIZE)):
        offsets = np.stack(np.unravel_index(window, width), axis=-1) + 1
        for layers in np.array_split(some, max(1, len(some) * len(offsets) // BATCH_SIZE)):
            index = low[layers][:, None] + offsets
            numbers = lattice.numbers[index[..., 0], index[..., 1], index[..., 2]]
            relevant = numbers < len(lattice.points)
            for side, sign in zip(bounds, (1.0, -1.0), strict=True):
                ends = np.broadcast_to(side, (len(moving.centers), 3))[layers]
                last = sign * (ends - (raster.lower - raster.spacing)) / raster.spacing - _ROUNDING
                relevant &= np.all(sign * index >= last[:, None], axis=-1)
            which, points = np.nonzero(relevant)
            yield layers[which], numbers[which, points]
