"""Ways in space and time: points of a lattice, layers of time, in each of which one move is made.

Dynamic programming: the least cost of being at a point after a layer is the least over the 27
moves that lead there. A move costs its length; being ahead or late costs a little, so that speeds
are even. Vehicles whose ways are known are avoided at almost any cost, obstacles at any.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from copy import copy

import numpy as np

from drake_rho.planning.path_search.lattice import MOVES, Lattice, TooLargeError
from drake_rho.planning.path_search.moving_obstacles import ANYWHERE, Bounds, Moving, met_moves
from drake_rho.planning.time_limit import check_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_CONFLICT = 1e4
"""Cost of a move that comes too close to another vehicle, in steps of the lattice."""

_PACE = 8.0
"""Cost of being late all along, for each squared part of the way by which, in ways."""

_AS_FAST = np.ones((2, 3))
"""How many times less fast vehicles are in some directions: in none."""


@dataclasses.dataclass(frozen=True, eq=False)
class TimedWay:
    """A way through all layers."""

    positions: FloatArray
    """between layers [m], shape (M + 1, 3)"""
    conflicts: int
    """moves that come too close to other vehicles"""


class Layers:
    """Moves of a lattice that are blocked in each layer by what moves.

    Args:
        lattice: points and moves that are clear of what stands still.
        count: how many layers there are, M.
        moving: what to keep clear of.
        reach: lower and upper bounds on positions between layers [m], shape (M + 1, 3) each;
            moves out of there are not looked at.
        most: bytes that the numbers of blocked moves may take.

    Attributes:
        blocked: for each layer the moves that come too close, as u F + number of the point that
            move u leads to, rising.

    Raises:
        TooLargeError: they take more.
    """

    def __init__(
        self,
        lattice: Lattice,
        count: int,
        moving: Sequence[Moving] = (),
        reach: Bounds = ANYWHERE,
        most: float = np.inf,
    ) -> None:
        self.count, self._lattice, self._first, self._most = count, lattice, 0, most
        self._reach = reach
        self._moving: list[Moving] = []
        self.blocked: list[IntArray] = [np.zeros(0, dtype=np.int64)] * count
        for each in moving:
            self.add(each)

    def add(self, moving: Moving) -> None:
        """Keep clear of one more.

        Raises:
            TooLargeError: the moves that are blocked take too much memory.
        """
        self._moving.append(moving)
        met = met_moves(self._lattice, moving, self._reach)
        if sum(each.nbytes for each in (*self.blocked, *met)) > self._most:
            raise TooLargeError
        self.blocked = [
            np.sort(np.concatenate(each)) for each in zip(self.blocked, met, strict=True)
        ]

    def part(self, first: int, last: int) -> Layers:
        """The layers from one to before another."""
        part = copy(self)
        part.count, part._first = last - first, self._first + first
        part.blocked = self.blocked[first:last]
        return part

    def met(self, start: FloatArray, end: FloatArray) -> BoolArray:
        """Whether something is met on the ways from and to positions, (E, 3): shape (M, E)."""
        layers = np.repeat(self._first + np.arange(self.count), len(start))
        start, end = np.tile(start, (self.count, 1)), np.tile(end, (self.count, 1))
        met = np.zeros(len(layers), dtype=bool)
        for moving in self._moving:
            met |= moving.met(layers, start, end)
        return met.reshape(self.count, -1)


class Search:
    """The search for one vehicle's way. Start and goal are points F and F + 1.

    Args:
        lattice: points and moves that are clear of what stands still.
        start: [m], shape (3,).
        goal: [m], shape (3,).
        slower: how many times less fast than along its axes a vehicle can go against them, and
            along them, at least 1, shape (2, 3).

    Attributes:
        length: of the shortest way, whatever moves [m]; infinite if there is none.
    """

    def __init__(
        self,
        lattice: Lattice,
        start: FloatArray,
        goal: FloatArray,
        slower: FloatArray = _AS_FAST,
    ) -> None:
        F = self._count = len(lattice.points)
        self._lattice, self._ends = lattice, np.array([start, goal])
        scale = 1.0 / float(lattice.raster.spacing.max())
        times = np.select([MOVES < 0, MOVES > 0], [slower[0], slower[1]], 1.0).max(axis=1)
        self._scale, self._costs = scale, scale * lattice.lengths
        self._costs[times > 1.0] *= times[times > 1.0]
        self._begin, self._end = lattice.next_to(start), lattice.next_to(goal)
        self._to_go = np.full(F + 2, np.inf, dtype=np.float32)
        self._to_go[F + 1] = 0.0
        if len(self._begin) and len(self._end):
            self._to_go[:F] = lattice.shortest(self._end).lengths
            first = np.linalg.norm(lattice.points[self._begin] - start, axis=1)
            self._to_go[F] = np.min(self._to_go[self._begin] + first)
        self.length = float(self._to_go[F])

    def way(
        self,
        obstacles: Layers,
        vehicles: Layers,
        progress: FloatArray,
        reach: Bounds = ANYWHERE,
    ) -> TimedWay | None:
        """The way of least cost; None if there is none.

        Args:
            obstacles: never met.
            vehicles: met only if there is no other way.
            progress: part of the way that should be done between layers, shape (M + 1,).
            reach: lower and upper bounds on positions between layers [m], shape (M + 1, 3) each.
        """
        if not np.isfinite(self.length):
            return None
        self._obstacles, self._vehicles = obstacles, vehicles
        self._out, self._home, self._rests = self._links()
        lower, upper = (np.broadcast_to(side, (len(progress), 3)) for side in reach)
        values = self._filled(progress, lower, upper)
        return self._backtracked(values)

    def _at(self, numbers: IntArray) -> FloatArray:
        """Positions of points, start and goal being the last two, (Q, 3)."""
        F = self._count
        there = np.minimum(numbers, F - 1)
        ends = self._ends[np.maximum(numbers - F, 0)]
        positions: FloatArray = np.where((numbers < F)[:, None], self._lattice.points[there], ends)
        return positions

    def _links(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Costs of moves from the start, to the goal, and of staying there, (M, ...) each."""
        begin, end = self._at(self._begin), self._at(self._end)
        start, goal = ends = self._ends
        links = [(start + 0.0 * begin, begin), (end, goal + 0.0 * end), (ends, ends)]
        costs = []
        for one, other in links:
            cost = self._scale * np.linalg.norm(other - one, axis=1)
            cost = cost + _CONFLICT * self._vehicles.met(one, other)
            cost[self._obstacles.met(one, other)] = np.inf
            costs.append(cost.astype(np.float32))
        return costs[0], costs[1], costs[2]

    def _filled(self, progress: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """The values of all points between layers, shape (M + 1, F + 2)."""
        F, M = self._count, self._obstacles.count
        values: FloatArray = np.full((M + 1, F + 2), np.inf, dtype=np.float32)
        values[0, F] = 0.0
        origins = self._lattice.neighbors[::-1]  # of the moves that lead here
        costs = self._costs.astype(np.float32)[:, None]
        arrivals = np.empty(origins.shape, dtype=np.float32)
        left = (self._to_go / max(self.length, 1e-300)).astype(np.float32)
        pace = _PACE * self._scale * self.length / M
        before = np.full(F + 1, np.inf, dtype=np.float32)
        for t in range(M):
            check_time()
            before[:F], after = values[t, :F], values[t + 1]
            np.take(before, origins, out=arrivals, mode="clip")
            arrivals += costs
            arrivals.ravel()[self._vehicles.blocked[t]] += _CONFLICT
            arrivals.ravel()[self._obstacles.blocked[t]] = np.inf
            np.min(arrivals, axis=0, out=after[:F])
            after[self._begin] = np.minimum(after[self._begin], values[t, F] + self._out[t])
            after[F:] = values[t, F:] + self._rests[t]
            after[F + 1] = min(after[F + 1], np.min(values[t, self._end] + self._home[t]))
            after += pace * (left - (1.0 - progress[t + 1])) ** 2
            self._bound(after, lower[t + 1], upper[t + 1])
        return values

    def _bound(self, after: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Set the values of what is out of bounds, (3,) each."""
        raster = self._lattice.raster
        axes = [raster.lower[i] + raster.spacing[i] * np.arange(raster.shape[i]) for i in range(3)]
        x, y, z = ((a >= lower[i]) & (a <= upper[i]) for i, a in enumerate(axes))
        if not (x.all() and y.all() and z.all()):
            inside = x[:, None, None] & y[:, None] & z
            after[:-2][~inside[self._lattice.free]] = np.inf
        after[-2:][np.any((self._ends < lower) | (self._ends > upper), axis=1)] = np.inf

    def _backtracked(self, values: FloatArray) -> TimedWay | None:
        """The way that leads to the goal after the last layer, from the values."""
        F, M = self._count, self._obstacles.count
        if not np.isfinite(values[M, F + 1]):
            return None
        path, conflicts = [F + 1], 0
        for t in range(M - 1, -1, -1):
            origins, costs = self._arrivals(path[-1], t)
            best = int(np.argmin(values[t, origins] + costs))
            conflicts += bool(costs[best] >= _CONFLICT)
            path.append(int(origins[best]))
        return TimedWay(self._at(np.array(path[::-1])), conflicts)

    def _arrivals(self, number: int, t: int) -> tuple[IntArray, FloatArray]:
        """Points from which a point can be reached in a layer, and at which costs."""
        F = self._count
        if number == F:
            return np.array([F]), self._rests[t, :1]
        if number == F + 1:
            return np.append(self._end, F + 1), np.append(self._home[t], self._rests[t, 1])
        moves = np.arange(len(MOVES)) * F + number
        costs = self._costs.copy()
        costs[_among(moves, self._vehicles.blocked[t])] += _CONFLICT
        costs[_among(moves, self._obstacles.blocked[t])] = np.inf
        origins = self._lattice.neighbors[::-1, number]
        origins, costs = origins[origins < F], costs[origins < F]
        first = self._begin == number
        return np.append(origins, np.full(first.sum(), F)), np.append(costs, self._out[t, first])


def _among(numbers: IntArray, known: IntArray) -> BoolArray:
    """Which numbers are among known ones, which are sorted."""
    if len(known) == 0:
        return np.zeros(len(numbers), dtype=bool)
    places = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    among: BoolArray = known[places] == numbers
    return among
