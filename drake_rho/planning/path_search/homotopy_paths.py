"""Paths in space in different homotopy classes: on different sides of obstacles at rest.

The shortest path through a point joins the shortest path from the start to the point and that from
the point to the goal. Two searches therefore give the shortest paths through all points. Further
paths are routed through points beside an obstacle close to a known path, on its other sides.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.keep_out import across
from drake_rho.planning.path_search.lattice import Lattice
from drake_rho.planning.path_search.swept_clearance import required_distance
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Obstacle
from drake_rho.scenario.shapes.base import Shape

_TURNS = np.radians([90.0, -90.0, 180.0, 45.0, -45.0, 135.0, -135.0])
"""Other sides of an obstacle, as rotations of a path's own side about its direction [rad]."""

_SAME_SIDE = 0.5
"""Least scalar product of two unit vectors that count as the same side."""

_LONGER = 2.0
"""Largest length of a path, as a multiple of the shortest."""

_SAMPLES = 33
"""Points along a shortcut between corners at which distances are computed."""


@dataclasses.dataclass(frozen=True, eq=False)
class SpacePath:
    """Polyline from start to goal."""

    positions: FloatArray
    """its corners [m], shape (P, 3)"""
    sides: FloatArray
    """unit vector from each obstacle towards the nearest point of the path, shape (B, 3)"""

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def resembles(self, other: SpacePath) -> bool:
        """Return whether both paths pass every obstacle on the same side."""
        return bool(np.all(np.sum(self.sides * other.sides, axis=1) > _SAME_SIDE))


class SpacePathSearch:
    """Search for paths of one vehicle on a lattice.

    Args:
        lattice: collision-free points and moves.
        obstacles: obstacles at rest.
        radius: of the vehicle [m].
        start: start position [m], shape (3,).
        goal: goal position [m], shape (3,).

    Attributes:
        found: whether there is a path.
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
        begin, end = lattice.visible_from(start), lattice.visible_from(goal)
        self.found = len(begin) > 0 and len(end) > 0
        if self.found:
            self._from = lattice.shortest_paths(begin)
            self._to = lattice.shortest_paths(end)
            self._lengths = self._from.lengths + self._to.lengths
            self.found = bool(np.isfinite(self._lengths).any())

    def paths(self, most: int) -> list[SpacePath]:
        """Return up to `most` paths that pass obstacles on different sides, the shortest first."""
        if not self.found:
            return []
        paths = [self._through(int(np.argmin(self._lengths)))]
        longest = _LONGER * paths[0].length
        for path in paths:  # the list grows during the loop
            check_time()
            points = self._beside(path)
            for point in points[np.argsort(self._lengths[points], kind="stable")]:
                if len(paths) >= most or self._lengths[point] > longest:
                    break
                other = self._through(int(point))
                if not any(other.resembles(known) for known in paths):
                    paths.append(other)
            if len(paths) >= most:
                break
        return sorted(map(self._shortcut, paths), key=lambda path: path.length)

    def _through(self, point: int) -> SpacePath:
        """Return the shortest path through a point of the lattice."""
        there, back = self._from.path(point), self._to.path(point)
        points = self._lattice.points[np.concatenate([there[::-1], back[1:]])]
        return self._path(np.concatenate([self._start[None], points, self._goal[None]]))

    def _shortcut(self, path: SpacePath) -> SpacePath:
        """Return a path shortened by collision-free shortcuts between corners."""
        corners, chosen = path.positions, [0]
        while (here := chosen[-1]) < len(corners) - 1:
            later = corners[here + 1 :]
            seen = self._lattice.are_clear(np.tile(corners[here], (len(later), 1)), later, _SAMPLES)
            chosen.append(here + 1 + int(np.max(np.flatnonzero(seen), initial=0)))
        return dataclasses.replace(path, positions=corners[chosen])

    def _path(self, positions: FloatArray) -> SpacePath:
        """Return the path through given corners, with the sides on which it passes obstacles."""
        sides = np.zeros((len(self._obstacles), 3))
        for number, obstacle in enumerate(self._obstacles):
            x = positions - obstacle.first_center
            nearest = x[np.argmin(obstacle.shape.local_distance(x))]
            sides[number] = obstacle.shape.local_outward(nearest)
        return SpacePath(positions, sides)

    def _beside(self, path: SpacePath) -> IntArray:
        """Return the numbers of free points on other sides of the obstacles near a path."""
        nearby = 2.0 * float(self._lattice.raster.spacing.max())
        points = []
        for obstacle, side in zip(self._obstacles, path.sides, strict=True):
            if not isinstance(obstacle.shape, Shape):  # other sides of a map are not searched
                continue
            x = path.positions - obstacle.first_center
            required = required_distance(obstacle, self._radius)
            clearances = obstacle.shape.local_distance(x) - required
            k = int(np.argmin(clearances))
            if clearances[k] > nearby:
                continue
            ahead = path.positions[min(k + 1, len(x) - 1)] - path.positions[max(k - 1, 0)]
            places = obstacle.first_center + self._around(obstacle, side, ahead)
            points += [int(self._lattice.nearest(place)) for place in places]
        numbers = np.unique(np.array(points, dtype=np.int64))
        known: IntArray = numbers[numbers < len(self._lattice.points)]
        return known

    def _around(self, obstacle: Obstacle, side: FloatArray, ahead: FloatArray) -> FloatArray:
        """Return positions just beside an obstacle on its other sides, shape (S, 3).

        Args:
            obstacle: a convex one.
            side: unit vector from the obstacle towards the path, shape (3,).
            ahead: direction of the path there, of any length, shape (3,).

        Returns:
            Positions relative to the centre of the obstacle [m].
        """
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-300)
        first = side - (side @ ahead) * ahead
        length = float(np.linalg.norm(first))
        first = first / length if length > 1e-6 else across(ahead)
        second = np.cross(ahead, first)
        sides = np.cos(_TURNS)[:, None] * first + np.sin(_TURNS)[:, None] * second
        shape = obstacle.shape
        assert isinstance(shape, Shape)  # noqa: S101  # callers leave out maps
        far = shape.local_support(sides) + obstacle.position_error
        sides, far = sides[np.isfinite(far)], far[np.isfinite(far)]
        far = far + self._radius + float(self._lattice.raster.spacing.max())
        places: FloatArray = far[:, None] * sides
        return places
