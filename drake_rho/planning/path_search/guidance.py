"""Points to aim at on the way to a goal: as far as a vehicle sees along its shortest path.

A straight line to such a point is clear of the obstacles at rest, so a vehicle that is drawn
towards it is not drawn into an obstacle, and the next point is further along the path.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.planning.path_search.lattice import Lattice, Raster, ShortestPaths, are_clear
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle

_POINTS = 5e3, 2e5
"""Bounds on the numbers of points of the first and of the finest lattice."""

_FINER = 1.5
"""Refinement factor from one lattice to the next."""

_AROUND = 0.3, 1.0, np.inf
"""Margins of the regions searched around start and goal, in their distance."""

_SEEN = 24
"""Largest number of points of a path to which straight lines are checked."""


@dataclasses.dataclass(frozen=True, eq=False)
class Aim:
    """Point to which a vehicle can move in a straight line."""

    point: FloatArray
    """the point [m], shape (3,)"""
    is_goal: bool
    """whether it is the goal"""
    reachable: bool = True
    """whether a path to the goal was found; otherwise the point is on the way to the nearest place
    that has one"""


@dataclasses.dataclass(frozen=True, eq=False)
class Surroundings:
    """Obstacles at rest and flyable volume of a vehicle."""

    bodies: tuple[Obstacle, ...]
    """obstacles at rest"""
    told: tuple[Obstacle, ...]
    """the same as told, by which changes are noticed"""
    radius: float
    """distance to keep from them [m]"""
    lower: FloatArray
    """lower corner of the flyable volume [m], shape (3,); infinite without one"""
    upper: FloatArray
    """upper corner [m], shape (3,)"""

    def more_than(self, other: Surroundings) -> tuple[Obstacle, ...] | None:
        """Return the obstacles that others lack; None if they have more, or another volume."""
        before, now = ({id(each) for each in one.told} for one in (other, self))
        if not (
            before <= now
            and self.radius == other.radius
            and np.array_equal(self.lower, other.lower)
            and np.array_equal(self.upper, other.upper)
        ):
            return None
        both = zip(self.bodies, self.told, strict=True)
        return tuple(body for body, told in both if id(told) not in before)

    def see(self, position: FloatArray, points: FloatArray) -> BoolArray:
        """Return flags of points (M, 3) to which the straight line is clear, (M,)."""
        return are_clear(self.bodies, self.radius, np.tile(position, (len(points), 1)), points)

    @property
    def scale(self) -> float:
        """Length that a lattice should resolve [m]."""
        return min(
            (0.5 * (self.radius + each.shape.thickness) for each in self.bodies), default=1.0
        )

    def region(self, ends: FloatArray, around: float) -> tuple[FloatArray, FloatArray]:
        """Return corners of the box in which a path between two ends (2, 3) is searched [m].

        Args:
            ends: start and goal.
            around: margin, in the distance of the ends; infinite for a box around all obstacles.
        """
        margin = 2.0 * self.radius + self.scale
        lower, upper = ends.min(axis=0), ends.max(axis=0)
        if around < np.inf:
            margin += around * float(np.linalg.norm(ends[1] - ends[0]))
        else:
            for each in self.bodies:
                extent = np.where(np.isfinite(each.shape.extent), each.shape.extent, 0.0)
                extent = extent + each.position_error
                lower = np.minimum(lower, each.first_center - extent)
                upper = np.maximum(upper, each.first_center + extent)
        return np.maximum(lower - margin, self.lower), np.minimum(upper + margin, self.upper)


class Guide:
    """Shortest paths of one vehicle, kept as long as its goal stays and its path is clear.

    A path that is clear of obstacles told since it was found is still a shortest one.
    """

    def __init__(self) -> None:
        self._paths: _Paths | None = None

    def aim(
        self, around: Surroundings, position: FloatArray, goal: FloatArray, farthest: float
    ) -> Aim:
        """Return the point on the shortest path to a goal that is as far as a vehicle sees.

        Args:
            around: obstacles and volume.
            position: from which it looks [m], shape (3,).
            goal: shape (3,) [m].
            farthest: largest distance of the point [m].
        """
        aim = self._seen(around, position, goal)
        away = float(np.linalg.norm(aim.point - position))
        if away <= farthest:
            return aim
        nearer = position + farthest / away * (aim.point - position)
        return Aim(nearer, is_goal=False, reachable=aim.reachable)

    def _seen(self, around: Surroundings, position: FloatArray, goal: FloatArray) -> Aim:
        """Return the point that is as far as a vehicle sees, at any distance."""
        if around.see(position, goal[None])[0]:
            return Aim(goal, is_goal=True)
        known = self._paths
        if known is not None and not known.serves(around, position, goal):
            known = known.among_more(around, position, goal)
        if known is None:
            known = _searched(around, position, goal)
        self._paths = known
        if known is None:
            return Aim(position, is_goal=False, reachable=False)
        return known.aim(around, position)


@dataclasses.dataclass(frozen=True, eq=False)
class _Paths:
    """Shortest paths on a lattice from everywhere to one point."""

    around: Surroundings
    """obstacles and volume as they were when the paths were found"""
    lattice: Lattice
    """collision-free points and moves"""
    goal: FloatArray
    """goal as given [m], shape (3,)"""
    end: FloatArray
    """where the paths end [m], shape (3,): the goal, or the reachable place nearest to it"""
    shortest: ShortestPaths
    """paths from the end to all points"""

    def serves(self, around: Surroundings, position: FloatArray, goal: FloatArray) -> bool:
        """Return whether there is a path from a position to a goal, clear of what is there now."""
        more = around.more_than(self.around)
        if more is None or not np.array_equal(goal, self.goal):
            return False
        path = self.path(position)
        if path is None:
            return False
        points = np.concatenate([position[None], path])
        return bool(are_clear(more, around.radius, points[:-1], points[1:]).all())

    def among_more(
        self, around: Surroundings, position: FloatArray, goal: FloatArray
    ) -> _Paths | None:
        """Return the paths to a goal on the same lattice among more obstacles; None without one."""
        more = around.more_than(self.around)
        if not (more and np.array_equal(goal, self.goal) and np.array_equal(goal, self.end)):
            return None
        return _paths_to(goal, position, around, self.lattice.with_more(more))

    def path(self, position: FloatArray) -> FloatArray | None:
        """Return the points of the shortest path from a position, (P, 3); None without one."""
        near = _joined(self.lattice, position)
        if len(near) == 0:
            return None
        away = np.linalg.norm(self.lattice.points[near] - position, axis=1)
        lengths = away + self.shortest.lengths[near]
        best = int(np.argmin(lengths))
        if not np.isfinite(lengths[best]):
            return None
        on_lattice = self.lattice.points[self.shortest.path(int(near[best]))]
        return np.concatenate([on_lattice, self.end[None]])

    def aim(self, around: Surroundings, position: FloatArray) -> Aim:
        """Return the point of the path from a position that is as far as a vehicle sees now."""
        path = self.path(position)
        assert path is not None  # noqa: S101  # only paths that serve are used
        last, step = 0, max(len(path) // _SEEN, 1)
        for each in (np.arange(0, len(path), step), None):
            points = np.arange(last, min(last + step, len(path))) if each is None else each
            seen = points[around.see(position, path[points])]
            last = int(seen[-1]) if len(seen) else last
        reachable = np.array_equal(self.end, self.goal)
        return Aim(path[last], reachable and last == len(path) - 1, reachable)


def _joined(lattice: Lattice, position: FloatArray) -> IntArray:
    """Return the numbers of points joined to a position by a clear segment, or the nearest one."""
    near = lattice.visible_from(position)
    if len(near) > 0:
        return near
    nearest = lattice.nearest(position)
    return np.array([nearest] if nearest < len(lattice.points) else [], dtype=np.int64)


def _paths_to(
    goal: FloatArray, position: FloatArray, around: Surroundings, lattice: Lattice
) -> _Paths | None:
    """Return the paths to a goal on a lattice; None if none begins at a position."""
    ends = lattice.visible_from(goal)
    if len(ends) == 0:
        return None
    found = _Paths(around, lattice, goal, goal, lattice.shortest_paths(ends))
    return None if found.path(position) is None else found


def _searched(around: Surroundings, position: FloatArray, goal: FloatArray) -> _Paths | None:
    """Return the paths to a goal or, if none begins at the position, to the place nearest to it.

    Of places that are equally near on the lattice, it is the one with the shortest path.
    """
    last: Lattice | None = None
    for lattice in _lattices(around, np.array([position, goal])):
        if (found := _paths_to(goal, position, around, lattice)) is not None:
            return found
        last = lattice
    if last is None or len(starts := _joined(last, position)) == 0:
        return None
    lengths = last.shortest_paths(starts).lengths
    there = np.flatnonzero(np.isfinite(lengths))
    away = np.linalg.norm(last.points[there] - goal, axis=1)
    near = there[away <= away.min() + last.raster.spacing.max()]  # as near as the lattice can tell
    end = int(near[np.argmin(lengths[near])])
    paths = last.shortest_paths(np.array([end]))
    return _Paths(around, last, goal, last.points[end], paths)


def _lattices(around: Surroundings, ends: FloatArray) -> Iterator[Lattice]:
    """Yield lattices of larger and larger regions around two ends (2, 3), then finer ones."""
    for margin in _AROUND:
        lower, upper = around.region(ends, margin)
        volume = float(np.prod(np.maximum(upper - lower, around.scale)))
        spacing = max(around.scale, (volume / _POINTS[0]) ** (1.0 / 3.0))
        yield _lattice(around, lower, upper, spacing)
    while volume / (spacing / _FINER) ** 3 <= _POINTS[1]:
        spacing /= _FINER
        yield _lattice(around, lower, upper, spacing)


def _lattice(around: Surroundings, lower: FloatArray, upper: FloatArray, spacing: float) -> Lattice:
    raster = Raster.filling(lower, np.maximum(lower, upper), np.full(3, spacing))
    return Lattice(raster, around.bodies, around.radius)
