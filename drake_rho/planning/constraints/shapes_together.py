"""Searches for the deepest instants of motions inside several obstacles at once.

Motions of a few vehicles are short arrays, whose searches cost calls rather than work. The
constraint of each obstacle asks for its own part of one search, which the first to ask makes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.penetration import (
    Courses,
    Pieces,
    corners_within,
    deepest,
    deepest_in_balls,
    pieces_near_courses,
)
from drake_rho.planning.constraints.margins import Margins
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.quadrics import Sphere

_MOST = 2**18
"""Largest number of obstacles, times vehicles, times steps, in one search: more take as long in
several searches, and less memory."""


class ShapesTogether:
    """Convex shapes, at rest or moving, whose motions have no corners within steps.

    Args:
        obstacles: on a clock that is 0 at the first knot.
        required: distances that vehicles keep from them without a disturbance [m], shape (M, N).
        tolerances: depths in them that count as outside [m], shape (M, N).
        margins: margins of the vehicles' positions.
        reference: a motion with the same steps as all motions that are searched.
    """

    def __init__(
        self,
        obstacles: Sequence[Obstacle],
        required: Sequence[FloatArray],
        tolerances: Sequence[FloatArray],
        margins: Margins,
        reference: Motion,
    ) -> None:
        self._obstacles, self._margins, self._reference = obstacles, margins, reference
        self._required, self._tolerances = np.array(required), np.array(tolerances)
        self._shapes = [each.shape for each in obstacles]
        self._radii = np.array([getattr(each, "radius", 0.0) for each in self._shapes])
        self._asked: tuple[Motion, IntArray, float] | None = None
        self._found = list[tuple[IntArray, FloatArray]]()

    @cached_property
    def _courses(self) -> Courses:
        """Motions of the obstacles in the steps of all motions that are searched."""
        reference = self._reference
        return Courses.of(self._obstacles, reference.step, reference.accelerations.shape[1])

    @cached_property
    def _are_balls(self) -> BoolArray:
        """Whether each obstacle is a ball that does not grow, shape (M,)."""
        return np.array([isinstance(each, Sphere) for each in self._shapes]) & ~self._courses.grow

    @staticmethod
    def groups(obstacles: Sequence[Obstacle], reference: Motion) -> Iterator[list[int]]:
        """Yield the indices of obstacles in groups that can be searched together.

        Args:
            obstacles: on a clock that is 0 at the first knot.
            reference: a motion with the steps of all motions that are searched.
        """
        vehicles, steps = reference.accelerations.shape[:2]
        whole = [
            number
            for number, each in enumerate(obstacles)
            if isinstance(each.shape, Shape)
            and len(corners_within(each, reference.step, steps)) == 0
        ]
        most = max(1, _MOST // (vehicles * steps))
        yield from (whole[first : first + most] for first in range(0, len(whole), most))

    def deepest_instants(
        self, number: int, motion: Motion, vehicles: IntArray, beyond: float
    ) -> tuple[IntArray, FloatArray]:
        """Return the vehicles and times [s] of the deepest instants inside an obstacle, (R,) each.

        Args:
            number: index of the obstacle.
            motion: the motion of all vehicles.
            vehicles: the vehicles to check, as increasing indices.
            beyond: distance beyond the required one that counts as inside, in tolerances.
        """
        if not self._is_asked_again(motion, vehicles, beyond):
            self._found = self._search(motion, vehicles, beyond)
            self._asked = motion, vehicles, beyond
        return self._found[number]

    def _is_asked_again(self, motion: Motion, vehicles: IntArray, beyond: float) -> bool:
        if self._asked is None or motion is not self._asked[0] or beyond != self._asked[2]:
            return False
        return vehicles is self._asked[1] or np.array_equal(vehicles, self._asked[1])

    def _search(
        self, motion: Motion, vehicles: IntArray, beyond: float
    ) -> list[tuple[IntArray, FloatArray]]:
        """Return the vehicles and times of the deepest instants inside each obstacle."""
        tolerances = self._tolerances[:, vehicles]
        below = self._required[:, vehicles] + beyond * tolerances
        within = np.maximum(below + self._margins.largest, 0.0)
        pieces = pieces_near_courses(motion.of(vehicles), self._courses, within)
        if len(pieces) == 0:
            return [_NOWHERE] * len(self._shapes)
        margins = self._margins.steps["position"][step_at(pieces.times, motion.step)]
        below = below[pieces.parts, pieces.owners] + margins
        tolerances = tolerances[pieces.parts, pieces.owners]
        ends = pieces.parts.searchsorted(np.arange(len(self._shapes) + 1)).tolist()
        found = self._in_balls(pieces, below)
        for number, shape in enumerate(self._shapes):
            own = slice(ends[number], ends[number + 1])
            if own.start < own.stop and not self._are_balls[number]:
                near = pieces.select(own)
                which, times = deepest(shape, near, below[own], tolerances[own])
                found[number] = near.owners[which], times
        return [(vehicles[owners], times) for owners, times in found]

    def _in_balls(self, pieces: Pieces, below: FloatArray) -> list[tuple[IntArray, FloatArray]]:
        """Return the owners of pieces and the times inside each ball; none inside other shapes."""
        of_balls = self._are_balls[pieces.parts].nonzero()[0]
        if len(of_balls) < len(pieces):
            pieces, below = pieces.select(of_balls), below[of_balls]
        which, times = deepest_in_balls(pieces, below + self._radii[pieces.parts])
        parts, owners = pieces.parts[which], pieces.owners[which]
        ends = parts.searchsorted(np.arange(len(self._shapes) + 1)).tolist()
        return [(owners[first:last], times[first:last]) for first, last in pairwise(ends)]


_NOWHERE = np.zeros(0, dtype=int), np.zeros(0)
