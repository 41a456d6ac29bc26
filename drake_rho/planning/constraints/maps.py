"""Collision avoidance with maps: rows of the parts near a motion, found with a tree.

A map has thousands of parts, of which a motion meets few. Only the parts that a motion is too close
to have rows: a half-space excludes more than its part, and a motion clear of all parts need not
satisfy the half-spaces of distant ones. The number of a part is the side of its rows.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.planning.constraints.base import VIOLATED, HalfSpaces, with_neighbours
from drake_rho.planning.constraints.keep_out import EvaluationPoints, KeepOutOfObstacle
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts

_SOFT_SEARCHES = 3
"""Searches for worst instants among the parts of a map in one step of a restoration. Parts have
rows only where a motion enters them: a motion that avoids one part may enter another."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepOutOfMap(KeepOutOfObstacle):
    """Collision avoidance constraint of all parts of a map."""

    shape: Parts
    """convex parts that cover the map"""

    def encounters(self, rows: HalfSpaces) -> list[IntArray]:
        """Return the vehicles, since a motion meets several parts one after the other."""
        return [rows.vehicles]

    def softened_for(self, penalty: float, rounds: int) -> Self:
        """Return this constraint for one step of a restoration, with more searches."""
        soft = super().softened_for(penalty, rounds)
        return dataclasses.replace(soft, searches=_SOFT_SEARCHES)

    def distances_at(self, points: EvaluationPoints, offsets: FloatArray) -> FloatArray:
        """Return signed distances from the points' own parts [m], shape (R,)."""
        assert points.parts is not None  # noqa: S101  # points of maps have them
        return self.shape.distances_of(points.parts, self.shape.in_frame(offsets))

    def rows(self, points: EvaluationPoints) -> HalfSpaces:
        """Return the rows n · p >= n · c + h(n) + r of the parts at points.

        The normal n points from the nearest point of the part to the reference. Where the reference
        is inside the map, all parts have the normal towards the nearest point of the surface: with
        its own normal, each would push the motion into the next part.
        """
        assert points.parts is not None  # noqa: S101  # points of maps have them
        shape, parts, x = self.shape, points.parts, self.offsets(self.reference, points)
        inner = shape.measured(parts, shape.in_frame(x))[1]
        close = np.flatnonzero(self._comes_close[points.vehicles])
        if shape.solid is not None and len(close) > 0:
            distances, ways_out = shape.solid.local_measured(x[close])
            inside = distances < 0.0
            inner[close[inside]] = shape.in_frame(ways_out[inside])
        normals = shape.in_world(inner)
        centers = self.obstacle.centers(points.times)
        beyond = shape.supports(parts, inner) + self.radius(points)
        return HalfSpaces(
            self,
            points.vehicles,
            points.partners,
            sides=parts,
            times=points.times,
            normals=normals,
            bounds=beyond + np.vecdot(normals, centers),
            tolerances=self.tolerances[points.vehicles],
        )

    def penetrations(
        self, motion: Motion, vehicles: IntArray, *, beyond: float = -VIOLATED
    ) -> EvaluationPoints:
        """Return the deepest instant of each penetrating step, with its part.

        A mesh may have hundreds of triangles near one step. Violations of the others are found in
        later rounds, once the motion is clear of this one.
        """
        if not self.every_instant:
            return self._penetrating_knots(motion, vehicles)
        parts, whose, times = self.deepest_instants(motion, vehicles, beyond)
        points = _sorted(whose, parts, times)
        depths = self.distances(motion, points) - self.radius(points)
        steps = step_at(points.times, motion.step)
        return points.select(np.sort(_least_of_each(points.vehicles, steps, depths)))

    def _penetrating_knots(self, motion: Motion, vehicles: IntArray) -> EvaluationPoints:
        """Return the inner knots of vehicles that are too close to a part, with the part."""
        points = self.inner_knots.select(np.isin(self.inner_knots.vehicles, vehicles))
        points = points.select(self.holds_at(points.times))
        x = self.shape.in_frame(self.offsets(motion, points))
        below = self.radius(points) - VIOLATED * self.tolerances[points.vehicles]
        which, parts = self.shape.tree.pairs(x, x, np.maximum(below, 0.0))
        inside = self.shape.distances_of(parts, x[which]) < below[which]
        which, parts = which[inside], parts[inside]
        return _sorted(points.vehicles[which], parts, points.times[which])

    def violated_at_knots(self, motion: Motion, vehicles: IntArray, neighbours: int) -> HalfSpaces:
        """Return the most violated row of each inner knot, and rows at neighbouring knots.

        Rows at neighbouring knots are those of the part nearest to the reference there, because a
        motion through a wall meets too many parts.
        """
        points = self._penetrating_knots(motion, vehicles)
        if len(points) == 0:
            return self.none
        rows = self.rows(points)
        margins = rows.margins(motion)
        violated = margins < -VIOLATED * rows.tolerances
        rows = rows.select(violated)
        rows = rows.select(_least_of_each(rows.vehicles, rows.times, margins[violated]))
        if neighbours == 0 or len(rows) == 0:
            return rows
        inner = motion.accelerations.shape[1] - 1 + self.open_end
        marked = np.zeros(len(self._nearest_rows), dtype=bool)
        marked[rows.vehicles * inner + np.rint(rows.times / motion.step).astype(int) - 1] = True
        marked = with_neighbours(marked, self._nearest_rows.vehicles, neighbours)
        nearby = self._nearest_rows.select(marked & self.holds_at(self._nearest_rows.times))
        return rows.union(nearby)

    @cached_property
    def _comes_close(self) -> BoolArray:
        """Whether each vehicle's reference is closer than required at an inner knot, shape (N,)."""
        x = self.offsets(self.reference, self.inner_knots)
        required = self.radius(self.inner_knots)
        distances = self.shape.distance_up_to(x, float(required.max()))
        close = (distances < required).reshape(len(self.required), -1)
        return np.asarray(close.any(axis=1))

    @cached_property
    def _nearest_rows(self) -> HalfSpaces:
        """Rows of the part nearest to the reference at every inner knot."""
        x = self.offsets(self.reference, self.inner_knots)
        points = dataclasses.replace(self.inner_knots, parts=self.shape.nearest(x))
        return self.rows(points)


def _least_of_each(
    vehicles: IntArray, moments: FloatArray | IntArray, values: FloatArray
) -> IntArray:
    """Return the index of the least value of each vehicle at each moment, sorted by both."""
    order = np.lexsort((values, moments, vehicles))
    vehicles, moments = vehicles[order], moments[order]
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(vehicles) != 0) | (np.diff(moments) != 0.0)
    least: IntArray = order[first]
    return least


def _sorted(vehicles: IntArray, parts: IntArray, times: FloatArray) -> EvaluationPoints:
    """Return points sorted by vehicle, part and time, without duplicates."""
    order = np.lexsort((times, parts, vehicles))
    vehicles, parts, times = vehicles[order], parts[order], times[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(vehicles) != 0) | (np.diff(parts) != 0) | (np.diff(times) != 0.0)
    return EvaluationPoints(vehicles[new], vehicles[new], times[new], parts=parts[new])
