"""Obstacles (8) of every shape, at rest or moving, judged at the knots and at every instant.

A vehicle's clearance is the signed distance of its position from the shape, where that is at the
time, less what errors are around it then. Seen from an obstacle a vehicle's motion is quadratic
between two instants, and where a track has a corner between them, up to it and from it on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.course import Course
from drake_rho.verification.report import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.steps import Steps


def check_obstacles(course: Course) -> Iterator[Column]:
    """Judge the vehicles' distances from every obstacle."""
    for number in range(1, len(course.scenario.bodies) + 1):
        yield from check_obstacle(course, number)


def check_obstacle(course: Course, number: int) -> Iterator[Column]:
    """Judge distances from one obstacle: from when it is known and, apart from these, before.

    Args:
        course: what is judged.
        number: of the obstacle, from 1.
    """
    scenario, start = course.scenario, course.scenario.grid.start
    obstacle, name = scenario.bodies_in_flight[number - 1], scenario.obstacle_name(number)
    late = number not in {number for number, _ in scenario.known}
    since = obstacle.known_from if late else 0.0
    seen = seen_from(course, obstacle, since)
    kept = scenario.fleet.radii + obstacle.deviation
    for known in (True, False) if late else (True,):
        both = seen.closest(obstacle.shape, since, known=known)
        for part, found in zip((AT_KNOTS, AT_ALL_TIMES), both, strict=True):
            limits = np.where(found.errors > 0.0, kept + found.errors, kept)
            yield Column(
                kind="obstacles",
                constraint=name if known else f"{name} before it is known",
                parts=[part] * len(limits),
                times=start + found.times,
                values=found.clearances,
                limits=limits,
                excess=limits - found.clearances,
                tolerances=scenario.fleet.obstacle_tolerances(obstacle.shape),
                errors=found.errors,
                unit="m",
                asked=known and (part == AT_KNOTS or scenario.between_knots),
                always=part == AT_ALL_TIMES,
                due=~np.isposinf(found.clearances),  # else it is not avoided in this flight
            )


@dataclasses.dataclass(frozen=True, eq=False)
class _Closest:
    """When vehicles are closest to an obstacle, errors counted; arrays of shape (N,)."""

    times: FloatArray
    """since the first knot [s]"""
    clearances: FloatArray
    """signed distances without the errors [m]"""
    errors: FloatArray
    """radii then [m]"""


@dataclasses.dataclass(frozen=True)
class Seen:
    """Motions as an obstacle sees them: less its own, in pieces of time in which it is constant."""

    course: Course
    """with pieces that are cut where the obstacle's track has corners"""
    obstacle: Obstacle
    """on a clock that is 0 at the first knot"""
    tolerance: float
    """time by which a knot may be early, or late, and still count as one at which the obstacle is
    known, or avoided [s]"""
    positions: FloatArray
    """of the vehicles at the instants, from the middle of the obstacle [m], shape (N, J + 1, 3)"""
    pieces: Steps
    """vehicle by vehicle, J of each"""

    def lowest_at_least(self, shape: Shape, enough: FloatArray) -> FloatArray:
        """Return lower bounds of distances from the shape in the pieces [m], shape (N, J).

        Args:
            shape: of the obstacle.
            enough: where distances from its bounding box show as much, they do [m], as the answer.
        """
        outside = _outside_of_box(self.positions, shape.extent)
        lowest = self._between(outside)
        near = np.flatnonzero(~(lowest >= enough).all(axis=1))
        if len(near) > 0:
            outside[near] = shape.signed_distance(self.positions[near])
            lowest = self._between(outside)
        return lowest

    @property
    def active_pieces(self) -> BoolArray:
        """Whether the obstacle is avoided in each piece, shape (J,)."""
        elapsed = self.course.elapsed
        return self.obstacle.is_active((elapsed[:-1] + elapsed[1:]) / 2.0)

    def _between(self, distances: FloatArray) -> FloatArray:
        """Return where two slopes meet, from distances at the instants, shape (N, J)."""
        ways = self.pieces.speeds.reshape(len(distances), -1)
        lowest: FloatArray = (distances[:, :-1] + distances[:, 1:] - ways) / 2.0
        return lowest

    def closest(self, shape: Shape, since: float, *, known: bool) -> tuple[_Closest, _Closest]:
        """When each vehicle is closest to the shape: at knots, and at all times.

        Nothing is measured exactly where the distance from the bounding box shows that another
        instant is closer.

        Args:
            shape: of the obstacle.
            since: when it is known, since the first knot [s].
            known: whether the time from then on is looked at, or the time before.
        """
        course, instants = self.course, self.course.elapsed
        outside = _outside_of_box(self.positions, shape.extent)
        later = instants >= since - self.tolerance
        active = self.obstacle.is_active(instants, self.tolerance)
        judged = course.knots & (later if known else ~later) & active
        count = len(self.positions)
        times, values, off = np.zeros(count), np.full(count, np.inf), np.zeros(count)
        if judged.any():
            x, errors = self.positions[:, judged], course.errors(judged)
            k, values = _least_at(shape, x, outside[:, judged] - errors, errors)
            times, off = instants[judged][k], errors[k]
        at_knots = _Closest(times, values + off, off)

        during = (instants[:-1] >= since) == known
        during &= self.active_pieces
        lowest = self._between(outside) - course.errors_over
        owners, piece = np.nonzero(~(lowest >= values[:, None]) & during)  # what is no number too
        around = course.around(piece)
        least = least_over_time(
            self.pieces.select(owners * len(during) + piece),
            owners[:, None],
            shape.signed_distance,
            PRECISION * course.scenario.fleet.obstacle_tolerances(shape)[owners],
            Least.unknown(values),
            around,
        )
        found = np.flatnonzero(least.steps >= 0)
        always, off, at = np.array(times), np.array(off), least.steps[found]
        always[found] = course.moments(piece[at], least.moments[found])
        if around is not None:
            off[found] = around.radii(at, least.moments[found, None])[:, 0]
        return at_knots, _Closest(always, least.values + off, off)


def seen_from(course: Course, obstacle: Obstacle, since: float = 0.0) -> Seen:
    """Return the motions of a scenario's vehicles as an obstacle sees them.

    Args:
        course: what is judged.
        obstacle: on a clock that is 0 at the first knot.
        since: a time at which pieces end and begin too [s].
    """
    tolerance = course.scenario.grid.rounding
    course = course.cut(np.append(obstacle.corners, since))
    centers = obstacle.centers(course.elapsed)
    positions = course.positions - centers
    width = course.durations[:, None]
    ways = width * course.velocities[:, :-1] - np.diff(centers, axis=0)
    pieces = (positions[:, :-1], ways, width**2 * course.accelerations)
    steps = Steps(*(each.reshape(-1, 3) for each in pieces))
    return Seen(course, obstacle, tolerance, positions, steps)


def _least_at(
    shape: Shape, x: FloatArray, at_least: FloatArray, errors: FloatArray
) -> tuple[IntArray, FloatArray]:
    """At which of its positions each vehicle is closest to a shape, and the signed distance there.

    Args:
        shape: what it is close to.
        x: positions from its centre [m], shape (N, M, 3).
        at_least: a lower bound of the distance of each, less the errors [m], shape (N, M).
        errors: what is taken off distances [m], shape (M,).

    Returns:
        Indices, and distances less errors [m], each of shape (N,).
    """
    vehicles, likely = np.arange(len(x)), np.argmin(at_least, axis=1)
    distances = np.full(at_least.shape, np.inf)
    near = shape.signed_distance(x[vehicles, likely]) - errors[likely]
    distances[vehicles, likely] = near
    perhaps = ~(at_least >= near[:, None])  # what is no number too
    distances[perhaps] = shape.signed_distance(x[perhaps]) - errors[np.nonzero(perhaps)[1]]
    k = np.argmin(distances, axis=1)
    return k, distances[vehicles, k]


def _outside_of_box(x: FloatArray, extent: FloatArray) -> FloatArray:
    """Signed distances from a box around the origin, which those from what is in it exceed [m].

    Args:
        x: positions [m], shape (..., 3).
        extent: half its sides [m], shape (3,); may be infinite.
    """
    beyond = np.abs(x) - extent
    outside = np.sqrt(np.sum(np.maximum(beyond, 0.0) ** 2, axis=-1))
    distance: FloatArray = outside + np.minimum(beyond.max(axis=-1), 0.0)
    return distance
