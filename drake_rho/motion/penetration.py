"""Where motions are deepest inside a convex shape, at rest or moving, without sampling.

On a piece of time in which the relative motion x(s) is quadratic, with acceleration a, the signed
distance d from a convex shape makes d(x(s)) - norm(a)/2 (s - s0) (s1 - s) convex in s. It equals d
at the ends s0 and s1, is below it between, and above its own tangents there: where these meet is a
lower bound of d, short of its least value in proportion to the square of the time between. Pieces
whose bound is too high are dropped, the others are split. (A step by the distance alone,
conservative advancement, stalls where a motion touches a shape.)

A ball has a closed form (`drake_rho.motion.clearance`).
"""

from __future__ import annotations

import dataclasses
from functools import singledispatch

import numpy as np

from drake_rho.motion.clearance import nearest_moments
from drake_rho.motion.dynamics import Motion, step_at
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.shapes.base import Shape
from drake_rho.scenario.shapes.quadrics import Sphere

_PARTS = 8
"""Parts that a piece is split into."""

_SPLITS = 18
"""Bound on the splits of a piece: past the last digit of a double."""

_PRECISION = 1e-3
"""Depth in tolerances to which the deepest instant is found."""


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Pieces of relative motions: p + s v + s²/2 a for s from 0 to a piece's duration."""

    owners: IntArray
    """index of the vehicle, shape (M,)"""
    times: FloatArray
    """when a piece begins, since the first knot [s], shape (M,)"""
    durations: FloatArray
    """[s], shape (M,)"""
    p: FloatArray
    """from the shape's centre [m], shape (M, 3)"""
    v: FloatArray
    """[m/s], shape (M, 3)"""
    a: FloatArray
    """[m/s²], shape (M, 3)"""

    def at(self, s: FloatArray) -> FloatArray:
        """Positions at s, shape (M,), after the beginning of each piece [m], shape (M, 3)."""
        positions: FloatArray = self.p + s[:, None] * (self.v + s[:, None] / 2 * self.a)
        return positions

    def select(self, which: BoolArray | IntArray) -> Pieces:
        """Some of the pieces."""
        fields = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Pieces(*(field[which] for field in fields))


def pieces_near(motion: Motion, obstacle: Obstacle, within: FloatArray) -> Pieces:
    """Return the pieces of motions relative to an obstacle that may come close to it.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        obstacle: on a clock that is 0 at the first knot; its corners cut steps into pieces.
        within: of how close, for each vehicle [m], shape (N,).
    """
    h, count = motion.step, motion.accelerations.shape[1]
    times: FloatArray = np.float64(h) * np.arange(count)
    corners = obstacle.corners
    corners = corners[(corners > 0.0) & (corners < h * count)]
    p, v, a = motion.positions[:, :-1], motion.velocities[:, :-1], motion.accelerations
    if len(corners) > 0:
        times = np.union1d(times, corners)
        p, v = motion.at("position", times), motion.at("velocity", times)
        k = np.minimum(step_at(times, h), count - 1)
        a = motion.accelerations[:, k]
    durations: FloatArray = np.diff(times, append=h * count)
    middles = times + durations / 2.0  # where no rounding tells one side of a corner for the other
    p, v = p - obstacle.centers(times), v - obstacle.velocities(middles)
    w = durations[:, None]  # an axis that turns round gets no further than v/2 would in all of w
    ways = w * np.maximum(np.abs(v + w / 2 * a), np.abs(v) / 2)
    reach = obstacle.shape.extent + within[:, None, None] + ways
    near = np.all(np.abs(p) < reach, axis=2)
    if obstacle.active is not None:
        near &= obstacle.is_active(middles)
    owners, k = np.nonzero(near)
    return Pieces(owners, times[k], durations[k], p[owners, k], v[owners, k], a[owners, k])


def deepest(
    shape: Shape, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Where pieces come below a signed distance from a shape, and when each is lowest.

    Args:
        shape: the shape.
        pieces: M pieces.
        below: the signed distance for each [m], shape (M,).
        tolerances: by which a shape may be entered; the deepest instant is found to a thousandth
            of them [m], shape (M,).

    Returns:
        Indices of pieces that do, shape (D,), and times since the first knot [s], shape (D,).
    """
    if len(pieces.owners) == 0:
        return np.zeros(0, dtype=int), np.zeros(0)
    which, s = _deepest(shape, pieces, below, tolerances)
    return which, pieces.times[which] + s


@singledispatch
def _deepest(
    shape: Shape, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Pieces, and times after their beginnings, by bounds and splits."""
    search = _Search(shape, pieces, below, _PRECISION * tolerances)
    return search.run()


@_deepest.register
def _(
    shape: Sphere, pieces: Pieces, below: FloatArray, tolerances: FloatArray
) -> tuple[IntArray, FloatArray]:
    """In closed form."""
    s = nearest_moments(pieces.p, pieces.v, pieces.a, pieces.durations)
    inside = np.flatnonzero(shape.signed_distance(pieces.at(s)) < below)
    return inside, s[inside]


class _Search:
    """The lowest instant of each piece, by bounds from tangents.

    Args:
        shape: the shape.
        pieces: M pieces.
        below: only what is lower is looked for [m], shape (M,).
        precision: by how much the lowest may be missed [m], shape (M,).
    """

    def __init__(
        self, shape: Shape, pieces: Pieces, below: FloatArray, precision: FloatArray
    ) -> None:
        self._shape, self._pieces = shape, pieces
        self._below, self._precision = below, precision
        self._bends = np.linalg.norm(pieces.a, axis=1)
        self.lowest = np.full(len(below), np.inf)
        self.moments = np.zeros(len(below))

    def run(self) -> tuple[IntArray, FloatArray]:
        """Pieces that come below, and when they are lowest."""
        which = np.arange(len(self._below))
        low, high = np.zeros(len(which)), np.array(self._pieces.durations)
        at_low, at_high = self._sample(which, low), self._sample(which, high)
        for _ in range(_SPLITS):
            least = _bounds(high - low, at_low, at_high, self._bends[which])
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
        """Signed distances and their slopes at times in pieces, shape (2, P)."""
        pieces = self._pieces.select(which)
        d, n = self._shape.measured(pieces.at(s))
        slope = np.einsum("pi,pi->p", n, pieces.v + s[:, None] * pieces.a)
        order = np.argsort(-d, kind="stable")  # of several in a piece the lowest comes last
        order = order[d[order] < self.lowest[which[order]]]
        self.lowest[which[order]], self.moments[which[order]] = d[order], s[order]
        return np.stack([d, slope])


def _bounds(
    width: FloatArray, at_low: FloatArray, at_high: FloatArray, bends: FloatArray
) -> FloatArray:
    """Lower bounds between two instants: where the tangents from both meet; arrays (P,)."""
    falls = np.minimum(at_low[1] - bends / 2 * width, 0.0)
    climbs = np.maximum(at_high[1] + bends / 2 * width, 0.0)
    steep = climbs - falls
    meet = (climbs * width - at_high[0] + at_low[0]) / np.where(steep > 0.0, steep, 1.0)
    meet = np.clip(np.where(steep > 0.0, meet, 0.0), 0.0, width)
    bounds: FloatArray = np.minimum(at_low[0] + falls * meet, at_high[0])
    return bounds
