"""Space-time paths by dynamic programming on a time-expanded graph.

The graph has the points of a lattice at M + 1 times. The interval between two of these times is a
layer, in which a vehicle makes one move. The least cost of being at a point after a layer is the
least over the 27 moves that lead there. A move costs its length; a small cost of being early or
late keeps the speed even. Collisions with vehicles of known paths have a very high cost, collisions
with obstacles an infinite one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from copy import copy

import numpy as np

from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.path_search.lattice import MOVES, Lattice, TooLargeError
from drake_rho.planning.path_search.moving_obstacles import UNBOUNDED, Bounds, Moving, blocked_moves
from drake_rho.planning.path_search.required_sets import RequiredOfVehicle
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_CONFLICT = 1e4
"""Cost of a move that comes too close to another vehicle, in spacings of the lattice."""

_OUTSIDE = 30.0
"""Penalty for being outside a required set at a layer boundary, in path lengths per distance."""

_TIMING_COST = 8.0
"""Cost of a delay that lasts the whole flight, in path lengths per squared delay. The delay is a
fraction of the path."""

_EQUALLY_FAST = np.ones((2, 3))
"""Ratios of speeds for a vehicle that is equally fast in all directions."""


@dataclasses.dataclass(frozen=True, eq=False)
class SpaceTimePath:
    """Path with a position at each layer boundary."""

    positions: FloatArray
    """positions at the layer boundaries [m], shape (M + 1, 3)"""
    conflicts: int
    """number of moves that come too close to other vehicles"""


class TimeExpandedGraph:
    """Lattice repeated over time, with the moves blocked by moving obstacles or vehicles.

    Args:
        lattice: points and moves that are clear of the obstacles at rest.
        count: number M of layers.
        moving: obstacles and vehicles to keep clear of.
        bounds: lower and upper bounds on positions at the layer boundaries [m], shape (M + 1, 3)
            each. Moves that begin outside are not checked.
        most: bound on the memory of the numbers of blocked moves [bytes].

    Attributes:
        blocked: for each layer the sorted codes of the blocked moves. Move u to the point with
            number i has the code u F + i.

    Raises:
        TooLargeError: the numbers of blocked moves exceed that memory.
    """

    def __init__(
        self,
        lattice: Lattice,
        count: int,
        moving: Sequence[Moving] = (),
        bounds: Bounds = UNBOUNDED,
        most: float = np.inf,
    ) -> None:
        self.count, self._lattice, self._first, self._most = count, lattice, 0, most
        self._bounds = bounds
        self._moving: list[Moving] = []
        self.blocked: list[IntArray] = [np.zeros(0, dtype=np.int64)] * count
        for each in moving:
            self.add(each)

    def add(self, moving: Moving) -> None:
        """Block the moves that come too close to one more obstacle or vehicle.

        Raises:
            TooLargeError: the numbers of blocked moves exceed the memory allowed.
        """
        self._moving.append(moving)
        blocked = blocked_moves(self._lattice, moving, self._bounds)
        if sum(each.nbytes for each in (*self.blocked, *blocked)) > self._most:
            raise TooLargeError
        self.blocked = [
            np.sort(np.concatenate(each)) for each in zip(self.blocked, blocked, strict=True)
        ]

    def part(self, first: int, last: int) -> TimeExpandedGraph:
        """Return the graph of the layers from `first` to before `last`."""
        part = copy(self)
        part.count, part._first = last - first, self._first + first
        part.blocked = self.blocked[first:last]
        return part

    def collisions(self, start: FloatArray, end: FloatArray) -> BoolArray:
        """Return flags of the segments that collide in each layer, shape (M, E).

        Args:
            start: starting positions of the segments [m], shape (E, 3).
            end: end positions of the segments [m], shape (E, 3).
        """
        layers = np.repeat(self._first + np.arange(self.count), len(start))
        start, end = np.tile(start, (self.count, 1)), np.tile(end, (self.count, 1))
        collisions = np.zeros(len(layers), dtype=bool)
        for moving in self._moving:
            collisions |= moving.collide(layers, start, end)
        return collisions.reshape(self.count, -1)


class SpaceTimeSearch:
    """Search for the space-time path of one vehicle. Start and goal are the points F and F + 1.

    Args:
        lattice: points and moves that are clear of the obstacles at rest.
        start: start position [m], shape (3,).
        goal: goal position [m], shape (3,).
        slower: speed of the lattice's moves divided by that of the vehicle, at least 1, in the
            negative and the positive direction of each axis, shape (2, 3).

    Attributes:
        length: of the shortest path, moving obstacles ignored [m]; infinite if there is none.
    """

    def __init__(
        self,
        lattice: Lattice,
        start: FloatArray,
        goal: FloatArray,
        slower: FloatArray = _EQUALLY_FAST,
    ) -> None:
        F = self._count = len(lattice.points)
        self._lattice, self._ends = lattice, np.array([start, goal])
        scale = 1.0 / float(lattice.raster.spacing.max())
        times = np.select([MOVES < 0, MOVES > 0], [slower[0], slower[1]], 1.0).max(axis=1)
        self._scale, self._costs = scale, scale * lattice.lengths
        self._costs[times > 1.0] *= times[times > 1.0]
        self._begin, self._end = lattice.visible_from(start), lattice.visible_from(goal)
        self._to_go = np.full(F + 2, np.inf, dtype=np.float32)
        self._to_go[F + 1] = 0.0
        if len(self._begin) and len(self._end):
            self._to_go[:F] = lattice.shortest_paths(self._end).lengths
            first = np.linalg.norm(lattice.points[self._begin] - start, axis=1)
            self._to_go[F] = np.min(self._to_go[self._begin] + first)
        self.length = float(self._to_go[F])

    def path(
        self,
        obstacles: TimeExpandedGraph,
        vehicles: TimeExpandedGraph,
        progress: FloatArray,
        bounds: Bounds = UNBOUNDED,
        required: RequiredOfVehicle | None = None,
    ) -> SpaceTimePath | None:
        """Return the path of least cost; None if there is none.

        Args:
            obstacles: moves blocked by moving obstacles, which are never taken.
            vehicles: moves blocked by other vehicles, taken only if there is no other path.
            progress: scheduled fraction of the path at the layer boundaries, shape (M + 1,).
            bounds: lower and upper bounds on positions at the layer boundaries [m], shape
                (M + 1, 3) each.
            required: sets that should contain the positions, with a penalty per metre outside.
        """
        if not np.isfinite(self.length):
            return None
        self._obstacles, self._vehicles = obstacles, vehicles
        self._exit_costs, self._entry_costs, self._wait_costs = self._links()
        lower, upper = (np.broadcast_to(side, (len(progress), 3)) for side in bounds)
        values = self._filled(progress, lower, upper, required)
        return self._backtracked(values)

    def _at(self, numbers: IntArray) -> FloatArray:
        """Return the positions of points by number, F and F + 1 being start and goal, (Q, 3)."""
        F = self._count
        there = np.minimum(numbers, F - 1)
        ends = self._ends[np.maximum(numbers - F, 0)]
        positions: FloatArray = np.where((numbers < F)[:, None], self._lattice.points[there], ends)
        return positions

    def _links(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the costs of leaving the start, entering the goal, and waiting at either.

        Returns:
            Costs in each layer: from the start to its neighbours, to the goal from its neighbours,
            and of waiting at start and goal, shape (M, ...) each.
        """
        begin, end = self._at(self._begin), self._at(self._end)
        start, goal = ends = self._ends
        links = [(start + 0.0 * begin, begin), (end, goal + 0.0 * end), (ends, ends)]
        costs = []
        for one, other in links:
            cost = self._scale * np.linalg.norm(other - one, axis=1)
            cost = cost + _CONFLICT * self._vehicles.collisions(one, other)
            cost[self._obstacles.collisions(one, other)] = np.inf
            costs.append(cost.astype(np.float32))
        return costs[0], costs[1], costs[2]

    def _filled(
        self,
        progress: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        required: RequiredOfVehicle | None,
    ) -> FloatArray:
        """Return the value function at all points and layer boundaries, shape (M + 1, F + 2)."""
        F, M = self._count, self._obstacles.count
        values: FloatArray = np.full((M + 1, F + 2), np.inf, dtype=np.float32)
        values[0, F] = 0.0
        origins = self._lattice.neighbors[::-1]  # of the moves that lead to each point
        costs = self._costs.astype(np.float32)[:, None]
        arrivals = np.empty(origins.shape, dtype=np.float32)
        remaining = (self._to_go / max(self.length, 1e-300)).astype(np.float32)
        timing_cost = _TIMING_COST * self._scale * self.length / M
        before = np.full(F + 1, np.inf, dtype=np.float32)
        every = self._at(np.arange(F + 2)) if required is not None else self._ends
        for t in range(M):
            check_time()
            before[:F], after = values[t, :F], values[t + 1]
            np.take(before, origins, out=arrivals, mode="clip")
            arrivals += costs
            arrivals.ravel()[self._vehicles.blocked[t]] += _CONFLICT
            arrivals.ravel()[self._obstacles.blocked[t]] = np.inf
            np.min(arrivals, axis=0, out=after[:F])
            after[self._begin] = np.minimum(after[self._begin], values[t, F] + self._exit_costs[t])
            after[F:] = values[t, F:] + self._wait_costs[t]
            after[F + 1] = min(after[F + 1], np.min(values[t, self._end] + self._entry_costs[t]))
            after += timing_cost * (remaining - (1.0 - progress[t + 1])) ** 2
            self._bound(after, lower[t + 1], upper[t + 1])
            if required is not None:
                outside = required.outside(t + 1, every)
                after += _OUTSIDE * self._scale * outside
        return values

    def _bound(self, after: FloatArray, lower: FloatArray, upper: FloatArray) -> None:
        """Set the values of points outside the bounds, (3,) each, to infinity."""
        raster = self._lattice.raster
        axes = [raster.lower[i] + raster.spacing[i] * np.arange(raster.shape[i]) for i in range(3)]
        x, y, z = ((a >= lower[i]) & (a <= upper[i]) for i, a in enumerate(axes))
        if not (x.all() and y.all() and z.all()):
            inside = x[:, None, None] & y[:, None] & z
            after[:-2][~inside[self._lattice.free]] = np.inf
        after[-2:][np.any((self._ends < lower) | (self._ends > upper), axis=1)] = np.inf

    def _backtracked(self, values: FloatArray) -> SpaceTimePath | None:
        """Return the path that reaches the goal after the last layer, from the value function."""
        F, M = self._count, self._obstacles.count
        if not np.isfinite(values[M, F + 1]):
            return None
        path, conflicts = [F + 1], 0
        for t in range(M - 1, -1, -1):
            origins, costs = self._predecessors(path[-1], t)
            best = int(np.argmin(values[t, origins] + costs))
            conflicts += bool(costs[best] >= _CONFLICT)
            path.append(int(origins[best]))
        return SpaceTimePath(self._at(np.array(path[::-1])), conflicts)

    def _predecessors(self, number: int, t: int) -> tuple[IntArray, FloatArray]:
        """Return the points from which a point can be reached in a layer, with the move costs."""
        F = self._count
        if number == F:
            return np.array([F]), self._wait_costs[t, :1]
        if number == F + 1:
            return np.append(self._end, F + 1), np.append(
                self._entry_costs[t], self._wait_costs[t, 1]
            )
        moves = np.arange(len(MOVES)) * F + number
        costs = self._costs.copy()
        costs[_among(moves, self._vehicles.blocked[t])] += _CONFLICT
        costs[_among(moves, self._obstacles.blocked[t])] = np.inf
        origins = self._lattice.neighbors[::-1, number]
        origins, costs = origins[origins < F], costs[origins < F]
        first = self._begin == number
        origins = np.append(origins, np.full(first.sum(), F))
        return origins, np.append(costs, self._exit_costs[t, first])


def _among(numbers: IntArray, known: IntArray) -> BoolArray:
    """Return flags of the numbers that are among sorted known ones."""
    if len(known) == 0:
        return np.zeros(len(numbers), dtype=bool)
    places = np.minimum(np.searchsorted(known, numbers), len(known) - 1)
    among: BoolArray = known[places] == numbers
    return among
