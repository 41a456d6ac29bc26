"""Ways in space past obstacles at rest, and several that pass them on different sides.

The shortest way through a point is the shortest from the start to it and on to the goal, so two
searches give the ways through all points. Another way than those known goes through a point beside
an obstacle that one of them passes, on a side on which none passes it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.planning.constraints.obstacles import across
from drake_rho.planning.path_search.lattice import Lattice
from drake_rho.planning.path_search.swept_clearance import kept_from
from drake_rho.planning.time_limit import check_time
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Obstacle

_TURNS = np.radians([90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0])
"""Sides of an obstacle, as turns around the way past it from the side on which it is passed."""

_SAME_SIDE = 0.5
"""Least product of two unit vectors that count as the same side."""

_LONGER = 2.0
"""How many times the shortest way another may be."""

_SAMPLES = 33
"""Places along a straight way past corners at which distances are looked at."""


@dataclasses.dataclass(frozen=True, eq=False)
class SpaceWay:
    """A polyline from start to goal."""

    positions: FloatArray
    """its corners [m], shape (P, 3)"""
    sides: FloatArray
    """from each obstacle towards where the way comes nearest to it, unit vectors, shape (B, 3)"""

    @property
    def length(self) -> float:
        """Its length [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def resembles(self, other: SpaceWay) -> bool:
        """Whether it passes every obstacle on the same side."""
        return bool(np.all(np.sum(self.sides * other.sides, axis=1) > _SAME_SIDE))


class SpaceWays:
    """The ways of one vehicle on a lattice.

    Args:
        lattice: points and moves that keep clear.
        obstacles: the ones that stand still.
        radius: kept from them [m].
        start: [m], shape (3,).
        goal: [m], shape (3,).
    """

    def __init__(
        self,
        lattice: Lattice,
        obstacles: Sequence[Obstacle],
        radius: float,
        start: FloatArray,
        goal: FloatArray,
    ) -> None:
        self._lattice, self._obstacles, self._radius = lattice, obstacles, radius
        self._start, self._goal = start, goal
        begin, end = lattice.next_to(start), lattice.next_to(goal)
        self.found = len(begin) > 0 and len(end) > 0
        if self.found:
            self._from = lattice.shortest(begin)
            self._to = lattice.shortest(end)
            self._lengths = self._from.lengths + self._to.lengths
            self.found = bool(np.isfinite(self._lengths).any())

    def ways(self, most: int) -> list[SpaceWay]:
        """At most so many ways that pass obstacles on different sides, the shortest first."""
        if not self.found:
            return []
        ways = [self._through(int(np.argmin(self._lengths)))]
        longest = _LONGER * ways[0].length
        for way in ways:  # which grows meanwhile
            check_time()
            points = self._beside(way)
            for point in points[np.argsort(self._lengths[points], kind="stable")]:
                if len(ways) >= most or self._lengths[point] > longest:
                    break
                other = self._through(int(point))
                if not any(other.resembles(known) for known in ways):
                    ways.append(other)
            if len(ways) >= most:
                break
        return sorted(map(self._taut, ways), key=lambda way: way.length)

    def _through(self, point: int) -> SpaceWay:
        there, back = self._from.path(point), self._to.path(point)
        points = self._lattice.points[np.concatenate([there[::-1], back[1:]])]
        return self._way(np.concatenate([self._start[None], points, self._goal[None]]))

    def _taut(self, way: SpaceWay) -> SpaceWay:
        """A way without the corners past which the next ones are seen."""
        corners, kept = way.positions, [0]
        while (here := kept[-1]) < len(corners) - 1:
            later = corners[here + 1 :]
            seen = self._lattice.clear(np.tile(corners[here], (len(later), 1)), later, _SAMPLES)
            kept.append(here + 1 + int(np.max(np.flatnonzero(seen), initial=0)))
        return dataclasses.replace(way, positions=corners[kept])

    def _way(self, positions: FloatArray) -> SpaceWay:
        """The way through given corners, with the sides on which it passes obstacles."""
        sides = np.zeros((len(self._obstacles), 3))
        for number, obstacle in enumerate(self._obstacles):
            x = positions - obstacle.first_center
            nearest = x[np.argmin(obstacle.shape.signed_distance(x))]
            sides[number] = obstacle.shape.outward(nearest)
        return SpaceWay(positions, sides)

    def _beside(self, way: SpaceWay) -> IntArray:
        """Numbers of clear points on other sides of the obstacles that a way passes closely."""
        reach = 2.0 * float(self._lattice.raster.spacing.max())
        points = []
        for obstacle, side in zip(self._obstacles, way.sides, strict=True):
            x = way.positions - obstacle.first_center
            distances = obstacle.shape.signed_distance(x) - kept_from(obstacle, self._radius)
            k = int(np.argmin(distances))
            if distances[k] > reach:
                continue
            ahead = way.positions[min(k + 1, len(x) - 1)] - way.positions[max(k - 1, 0)]
            places = obstacle.first_center + self._around(obstacle, side, ahead)
            points += [int(self._lattice.nearest(place)) for place in places]
        numbers = np.unique(np.array(points, dtype=np.int64))
        known: IntArray = numbers[numbers < len(self._lattice.points)]
        return known

    def _around(self, obstacle: Obstacle, side: FloatArray, ahead: FloatArray) -> FloatArray:
        """Places just beside an obstacle, from its centre, on other sides of it, shape (S, 3)."""
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-300)
        first = side - (side @ ahead) * ahead
        length = float(np.linalg.norm(first))
        first = first / length if length > 1e-6 else across(ahead)
        second = np.cross(ahead, first)
        sides = np.cos(_TURNS)[:, None] * first + np.sin(_TURNS)[:, None] * second
        far = obstacle.shape.support(sides)
        sides, far = sides[np.isfinite(far)], far[np.isfinite(far)]
        far = far + self._radius + float(self._lattice.raster.spacing.max())
        places: FloatArray = far[:, None] * sides
        return places
