"""Deepest instants of motions inside a convex shape, at rest or moving, by branch and bound.

On a piece of time from s0 to s1 the relative motion x(s) is quadratic with acceleration a. With the
signed distance d from a convex shape, the function d(x(s)) - norm(a)/2 (s - s0) (s1 - s) is convex
in s. It equals d at the ends, is below d between them, and lies above its own tangents at the ends,
which therefore meet at a lower bound of d. The gap of this bound is proportional to the square of
the piece's duration. Pieces whose bound is too high are dropped, the others are split. (A step by
the distance alone, conservative advancement, stalls where a motion touches a shape.)

The result is not sampled, but exact to a precision. A ball has a closed form
(`drake_rho.motion.extremes`).

The position error of an uncertain shape grows linearly in a piece. The signed distance from the
space that it may occupy is d less an affine function of s, so that all of this holds for it too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import singledispatch

import numpy as np

from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.motion.extremes import lengths_of, nearest_moments
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.quadrics import Sphere
from drake_rho.scenario.times import Clock
from drake_rho.system.table import Table

_PARTS = 8
"""Number of parts into which a piece is split."""

_SPLITS = 18
"""Bound on the successive splits of a piece, beyond the last digit of a double."""

_ROUNDED_DOWN = 1.0 - 1e-9
"""Factor by which a distance is at most rounded up."""

_PRECISION = 1e-3
"""Precision of the greatest depth, as a part of the tolerance."""


@dataclasses.dataclass(frozen=True)
class Pieces(Table):
    """Pieces of relative motions: p + s v + s²/2 a for s from 0 to a piece's duration."""

    owners: IntArray
    """index of the vehicle, shape (M,)"""
    times: FloatArray
    """beginning of each piece since the first knot [s], shape (M,)"""
    durations: FloatArray
    """durations [s], shape (M,)"""
    p: FloatArray
    """positions relative to the shape's centre [m], shape (M, 3)"""
    v: FloatArray
    """relative velocities [m/s], shape (M, 3)"""
    a: FloatArray
    """relative accelerations [m/s²], shape (M, 3)"""
    parts: IntArray
    """number of the nearby part of a map, in whose frame the piece is; 0 for a shape, (M,)"""
    errors: FloatArray
    """position error of the shape when the piece begins [m], shape (M,)"""
    growths: FloatArray
    """growth rates of the position error [m/s], shape (M,)"""

    def at(self, s: FloatArray) -> FloatArray:
        """Return positions [m], shape (M, 3), at times s [s] since each piece's beginning, (M,)."""
        positions: FloatArray = self.p + s[:, None] * (self.v + s[:, None] / 2 * self.a)
        return positions


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """An obstacle's motion in pieces of time: steps, split at its corners."""

    obstacle: Obstacle
    """obstacle on a clock that is 0 at the first knot"""
    times: FloatArray
    """beginning of each piece since the first knot [s], shape (M,)"""
    durations: FloatArray
    """durations of the pieces [s], shape (M,)"""
    steps: IntArray | None
    """step of each piece, shape (M,); None if no step is split"""
    centers: FloatArray
    """centres at the beginnings [m], shape (M, 3)"""
    velocities: FloatArray
    """velocities in the pieces [m/s], shape (M, 3)"""
    errors: FloatArray
    """position errors at the beginnings [m], shape (M,)"""
    grown: FloatArray
    """position errors at the ends [m], shape (M,)"""
    active: BoolArray
    """whether the obstacle is avoided in each piece, shape (M,)"""

    @classmethod
    def of(cls, obstacle: Obstacle, h: float, count: int) -> Course:
        """Return the motion of an obstacle in a number of steps h [s].

        Args:
            obstacle: on a clock that is 0 at the first knot.
            h: duration of a step [s].
            count: number of steps.
        """
        times: FloatArray = np.float64(h) * np.arange(count)
        corners, steps = corners_within(obstacle, h, count), None
        if len(corners) > 0:
            times = np.union1d(times, corners)
            steps = np.minimum(step_at(times, h), count - 1)
        durations: FloatArray = np.diff(times, append=h * count)
        middles = times + durations / 2.0  # away from corners, which rounding could shift
        return cls(
            obstacle,
            times,
            durations,
            steps,
            obstacle.centers(times),
            obstacle.velocities(middles),
            obstacle.uncertainty(times),
            obstacle.uncertainty(times + durations),
            obstacle.is_active(middles),
        )


def corners_within(obstacle: Obstacle, h: float, count: int) -> FloatArray:
    """Return the corners of an obstacle's motion between the ends of so many steps [s], (C,)."""
    corners = obstacle.corners
    if len(corners) == 0:
        return corners
    clock = Clock.of(h)  # at the ends, none splits a step
    return corners[clock.after(corners, 0.0) & clock.before(corners, h * count)]


@dataclasses.dataclass(frozen=True, eq=False)
class Courses:
    """Motions of several convex obstacles in the same steps, without corners within them."""

    times: FloatArray
    """beginning of each step since the first knot [s], shape (K-1,)"""
    durations: FloatArray
    """durations of the steps [s], shape (K-1,)"""
    extents: FloatArray
    """half the side lengths of the obstacles' bounding boxes [m], shape (M, 3)"""
    centers: FloatArray
    """centres at the beginnings [m], shape (M, K-1, 3)"""
    velocities: FloatArray
    """velocities in the steps [m/s], shape (M, K-1, 3)"""
    errors: FloatArray
    """position errors at the beginnings [m], shape (M, K-1)"""
    growths: FloatArray
    """growth rates of the position errors [m/s], shape (M, K-1)"""
    grown: FloatArray
    """position errors at the ends [m], shape (M, K-1)"""
    active: BoolArray
    """whether each obstacle is avoided in each step, shape (M, K-1)"""

    @classmethod
    def of(cls, obstacles: Sequence[Obstacle], h: float, count: int) -> Courses:
        """Return the motions of obstacles in a number of steps h [s].

        Args:
            obstacles: on a clock that is 0 at the first knot, without corners within these steps.
            h: duration of a step [s].
            count: number of steps.
        """
        times: FloatArray = np.float64(h) * np.arange(count)
        durations: FloatArray = np.diff(times, append=h * count)
        middles, ends = times + durations / 2.0, times + durations
        errors = np.array([each.uncertainty(times) for each in obstacles])
        grown = np.array([each.uncertainty(ends) for each in obstacles])
        return cls(
            times,
            durations,
            np.array([each.shape.extent for each in obstacles]),
            np.array([each.centers(times) for each in obstacles]),
            np.array([each.velocities(middles) for each in obstacles]),
            errors,
            (grown - errors) / durations,
            grown,
            np.array([each.is_active(middles) for each in obstacles]),
        )

    @property
    def grow(self) -> BoolArray:
        """Whether the space that each may occupy grows, shape (M,)."""
        return np.asarray(self.growths.any(axis=1))


def pieces_near_courses(motion: Motion, courses: Courses, within: FloatArray) -> Pieces:
    """Return the steps of motions relative to obstacles that may come close to them.

    The parts of the pieces are the obstacles' indices, in ascending order.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        courses: motions of M obstacles in its steps.
        within: the distance that counts as close, of each obstacle and vehicle [m], shape (M, N).
    """
    p = motion.positions[:, :-1] - courses.centers[:, None]
    v = motion.velocities[:, :-1] - courses.velocities[:, None]
    a, distances = motion.accelerations, within[..., None] + courses.grown[:, None]
    near = _near_box(courses.extents[:, None, None], p, v, a, courses.durations, distances)
    near &= courses.active[:, None]
    parts, owners, k = near.nonzero()
    errors, growths = courses.errors[parts, k], courses.growths[parts, k]
    of = p[near], v[near], a[owners, k]
    return Pieces(owners, courses.times[k], courses.durations[k], *of, parts, errors, growths)


def pieces_near(motion: Motion, obstacle: Obstacle, within: FloatArray) -> Pieces:
    """Return the pieces of motions relative to an obstacle that may come close to it.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        obstacle: on a clock that is 0 at the first knot; its corners split steps into pieces.
        within: the distance that counts as close, for each vehicle [m], shape (N,).
    """
    course = Course.of(obstacle, motion.step, motion.accelerations.shape[1])
    return pieces_near_course(motion, course, within)


def pieces_near_course(motion: Motion, course: Course, within: FloatArray) -> Pieces:
    """Return the same for an obstacle whose motion in the same steps is known."""
    obstacle, times, durations = course.obstacle, course.times, course.durations
    p, v, a = motion.positions[:, :-1], motion.velocities[:, :-1], motion.accelerations
    if course.steps is not None:
        p, v = motion.at("position", times), motion.at("velocity", times)
        a = motion.accelerations[:, course.steps]
    errors, grown = course.errors, course.grown
    p, v = p - course.centers, v - course.velocities
    distances = within[:, None] + grown
    if (parts := _parts_of(obstacle.shape)) is not None:
        p, v, a = (parts.in_frame(each) for each in (p, v, a))
        owners, k, numbers = _near_parts(parts, p, v, a, durations, distances)
    else:
        near = _near_box(obstacle.shape.extent, p, v, a, durations, distances)
        owners, k = np.nonzero(near)
        numbers = np.zeros(len(k), dtype=np.int64)
    if obstacle.active is not None:
        active = course.active[k]
        owners, k, numbers = owners[active], k[active], numbers[active]
    of = (p[owners, k], v[owners, k], a[owners, k])
    growths = (grown - errors) / durations
    return Pieces(owners, times[k], durations[k], *of, numbers, errors[k], growths[k])


def _near_box(
    extent: FloatArray,
    p: FloatArray,
    v: FloatArray,
    a: FloatArray,
    durations: FloatArray,
    within: FloatArray,
) -> BoolArray:
    """Return which pieces (..., K) may come within distances (..., K) of boxes around zero."""
    w = durations[:, None]  # a coordinate that reverses moves at most as far as v/2 does in w
    moved = w * np.maximum(np.abs(v + w / 2 * a), np.abs(v) / 2)
    return np.asarray((np.abs(p) < extent + within[..., None] + moved).all(axis=-1))


def _near_parts(
    parts: Parts,
    p: FloatArray,
    v: FloatArray,
    a: FloatArray,
    durations: FloatArray,
    within: FloatArray,
) -> tuple[IntArray, IntArray, IntArray]:
    """Return the vehicle, the piece and the part of every piece that may come near a part.

    The distances that count as near are those `within`, shape (N, K). A piece is within
    norm(a) w²/8 of the straight line between its ends.
    """
    w = durations[:, None]
    ends = p + w * (v + w / 2 * a)
    near = within + np.linalg.norm(a, axis=2) * durations**2 / 8.0
    lower, upper = np.minimum(p, ends).reshape(-1, 3), np.maximum(p, ends).reshape(-1, 3)
    pieces, numbers = parts.tree.pairs(lower, upper, near.reshape(-1))
    owners, k = np.divmod(pieces, len(durations))
    return owners, k, numbers


def _parts_of(solid: Solid) -> Parts | None:
    """Return the parts of a map, or of its cover; None for a shape."""
    return solid.parts if isinstance(solid, Map) else solid if isinstance(solid, Parts) else None


def deepest(
    shape: Solid, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the pieces that come below a signed distance from a shape, with their lowest instants.

    Distances are those from the space that the shape may occupy.

    Args:
        shape: the shape; for a map, each piece is compared with its own part alone.
        pieces: M pieces.
        below: signed distance of each piece [m], shape (M,).
        tolerances: accepted depth in the shape [m], shape (M,); the depth of the instants returned
            is exact to a thousandth of it.

    Returns:
        Indices of these pieces, shape (D,), and times since the first knot [s], shape (D,).
    """
    if len(pieces.owners) == 0:
        return np.zeros(0, dtype=int), np.zeros(0)
    which, s = _deepest(shape, pieces, below, tolerances)
    return which, pieces.times[which] + s


@singledispatch
def _deepest(
    shape: Solid, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return pieces, and times since their beginnings, by branch and bound."""
    search = _Search(shape, pieces, below, _PRECISION * tolerances)
    return search.run()


@_deepest.register
def _(
    shape: Sphere, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return pieces, and times since their beginnings, in closed form if nothing grows."""
    if np.any(pieces.growths):
        return _Search(shape, pieces, below, _PRECISION * tolerances).run()
    return _nearest_within(pieces, shape.radius + below)


def deepest_in_balls(pieces: Pieces, below: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the pieces that come below a distance from the centre of a ball that does not grow.

    Args:
        pieces: M pieces, which may be near several balls.
        below: distance from the centre of each piece's ball [m], shape (M,).

    Returns:
        Indices of these pieces, shape (D,), and times since the first knot [s], shape (D,).
    """
    which, s = _nearest_within(pieces, below)
    return which, pieces.times[which] + s


def _nearest_within(pieces: Pieces, below: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return pieces and times since their beginnings, in closed form."""
    near = (_least_lengths(pieces) < below + pieces.errors).nonzero()[0]
    if len(near) == 0:
        return near, np.zeros(0)
    pieces, below = pieces.select(near), below[near]
    s = nearest_moments(pieces.p, pieces.v, pieces.a, pieces.durations)
    inside = (lengths_of(pieces.at(s)) - pieces.errors < below).nonzero()[0]
    return near[inside], s[inside]


def _least_lengths(pieces: Pieces) -> FloatArray:
    """Return lower bounds of the lengths of relative positions in pieces [m], shape (M,).

    A piece is within norm(a) w²/8 of the straight line between its ends.
    """
    w, p = pieces.durations, pieces.p
    chords = w[:, None] * (pieces.v + w[:, None] / 2.0 * pieces.a)
    squares = np.maximum(np.vecdot(chords, chords), np.finfo(float).tiny)
    part = np.clip(-np.vecdot(p, chords) / squares, 0.0, 1.0)
    nearest = lengths_of(p + part[:, None] * chords)
    return np.asarray(_ROUNDED_DOWN * nearest - lengths_of(pieces.a) * w**2 / 8.0)


class _Search:
    """Branch-and-bound search for the lowest instant of each piece, with bounds from tangents.

    Args:
        shape: the shape.
        pieces: M pieces.
        below: signed distances below which instants are searched [m], shape (M,).
        precision: accepted error of the least distances [m], shape (M,).
    """

    def __init__(
        self, shape: Solid, pieces: Pieces, below: FloatArray, precision: FloatArray
    ) -> None:
        self._shape, self._parts, self._pieces = shape, _parts_of(shape), pieces
        self._below, self._precision = below, precision
        self._curvatures = np.linalg.norm(pieces.a, axis=1)
        self.lowest = np.full(len(below), np.inf)
        self.moments = np.zeros(len(below))

    def run(self) -> tuple[IntArray, FloatArray]:
        """Return the pieces that come below the given distance, and their lowest instants."""
        which = np.arange(len(self._below))
        low, high = np.zeros(len(which)), np.array(self._pieces.durations)
        at_low, at_high = self._sample(which, low), self._sample(which, high)
        for _ in range(_SPLITS):
            least = _bounds(high - low, at_low, at_high, self._curvatures[which])
            sought = np.minimum(self._below[which], self.lowest[which] - self._precision[which])
            open_ = np.flatnonzero(least < sought)
            if len(open_) == 0:
                break
            which = np.repeat(which[open_], _PARTS)
            nodes = np.linspace(low[open_], high[open_], _PARTS + 1, axis=1)
            between = nodes[:, 1:-1].reshape(-1)
            inner = self._sample(np.repeat(which[::_PARTS], _PARTS - 1), between)
            inner = inner.reshape(2, len(open_), _PARTS - 1)
            at_nodes = np.concatenate(
                [at_low[:, open_, None], inner, at_high[:, open_, None]], axis=2
            )
            low, high = nodes[:, :-1].reshape(-1), nodes[:, 1:].reshape(-1)
            at_low, at_high = at_nodes[..., :-1].reshape(2, -1), at_nodes[..., 1:].reshape(2, -1)
        found = np.flatnonzero(self.lowest < self._below)
        return found, self.moments[found]

    def _sample(self, which: IntArray, s: FloatArray) -> FloatArray:
        """Return signed distances and their slopes at times in pieces, shape (2, P)."""
        pieces = self._pieces.select(which)
        if self._parts is None:
            d, n = self._shape.local_measured(pieces.at(s))
        else:
            d, n = self._parts.measured(pieces.parts, pieces.at(s))
        d = d - (pieces.errors + s * pieces.growths)
        slope = np.einsum("pi,pi->p", n, pieces.v + s[:, None] * pieces.a) - pieces.growths
        order = np.argsort(-d, kind="stable")  # the lowest instant of a piece is assigned last
        order = order[d[order] < self.lowest[which[order]]]
        self.lowest[which[order]], self.moments[which[order]] = d[order], s[order]
        return np.stack([d, slope])


def _bounds(
    width: FloatArray, at_low: FloatArray, at_high: FloatArray, curvatures: FloatArray
) -> FloatArray:
    """Return lower bounds of the distance between two instants, where the tangents meet, (P,).

    Args:
        width: time between the instants [s], shape (P,).
        at_low: signed distances and their slopes at the first instants, shape (2, P).
        at_high: those at the second instants, shape (2, P).
        curvatures: norms of the accelerations [m/s²], shape (P,).
    """
    falls = np.minimum(at_low[1] - curvatures / 2 * width, 0.0)
    climbs = np.maximum(at_high[1] + curvatures / 2 * width, 0.0)
    steep = climbs - falls
    meet = (climbs * width - at_high[0] + at_low[0]) / np.where(steep > 0.0, steep, 1.0)
    meet = np.clip(np.where(steep > 0.0, meet, 0.0), 0.0, width)
    bounds: FloatArray = np.minimum(at_low[0] + falls * meet, at_high[0])
    return bounds
