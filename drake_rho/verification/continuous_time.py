"""The least value over time of a convex distance, by branch and bound.

`verify` judges with this between the knots. It shares nothing with the planner, which solves for
the closest approach: here a distance is only sampled, what may lie between the samples is bounded
from below, and pieces of time that may hide a smaller value are split and sampled again.

The bound. In a step the position x(u) is quadratic in time u, with a constant second derivative a.
Let d be a distance that is convex and changes by no more than the way moved, as the signed distance
of any convex shape does. Then d(x(u)) + norm(a) u²/2 is convex in u, and a convex function is
above the line through two of its samples, outside the two. So between samples a time w apart, d
is above two lines:

- from the left sample, falling by norm(a) w² more than d does in the piece of time before, and
- from the right sample, falling, backwards in time, by norm(a) w² more than d does in the piece
  after; but neither by more than the way that can be made in w at the greatest speed.

The bound is where they meet. It is short of the least value in proportion to w², so that a few
splits reach any precision, also where a motion touches a shape.

Where a ball of errors is around the position (`drake_rho.verification.tubes`), what is looked for
is the least value of the distance less its radius r(t). Between two samples r is above the line
through its values by κ w²/8 at most. So that line is taken off the two lines of d, and κ w²/8 off
the bound.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Self

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import Around

Distance = Callable[[FloatArray], FloatArray]
"""A function of positions, shape (..., D), with values of shape (...) [m]: convex, and changing by
no more than the way from one position to another."""

_PARTS = 4
"""Parts that a piece of time is split into."""

_LEVELS = 20
"""Bound on the splits: a part is then 1e-12 of a step, which is where rounding begins."""

_BLOCK = 1 << 15
"""Pieces of time sampled at once, so that what they take of memory is bounded."""

_ROUNDING = 1e-14
"""Relative to the numbers in it, an upper bound of the rounding error of a distance."""


@dataclasses.dataclass
class Least:
    """The least values found, one for each owner of steps; NaN where they cannot be computed."""

    values: FloatArray
    """[m], shape (N,)"""
    steps: IntArray
    """in which step, shape (N,); -1 where none was as low as the value it began with"""
    moments: FloatArray
    """when in this step, from 0 to 1, shape (N,)"""
    widths: FloatArray
    """part of a step between the samples there, shape (N,)"""

    @classmethod
    def unknown(cls, values: FloatArray) -> Self:
        """Nothing is found yet; only what is below `values`, shape (N,), is looked for."""
        count = len(values)
        return cls(np.array(values), np.full(count, -1), np.zeros(count), np.ones(count))

    def offer(
        self, owners: IntArray, values: FloatArray, steps: IntArray, u: FloatArray, width: float
    ) -> None:
        """Keep of each owner's values the least, and of equal ones the first; arrays (P,)."""
        better = np.flatnonzero(values < self.values[owners])
        order = better[np.argsort(values[better], kind="stable")[::-1]]  # the last one stays
        who = owners[order]
        self.values[who], self.steps[who] = values[order], steps[order]
        self.moments[who], self.widths[who] = u[order], width


@dataclasses.dataclass
class AnyLower(Least):
    """Whether there is a lower value, for each owner: the first that is found ends its search."""

    def offer(
        self, owners: IntArray, values: FloatArray, steps: IntArray, u: FloatArray, width: float
    ) -> None:
        """Keep where a lower value is, and look for none that is lower still."""
        super().offer(owners, values, steps, u, width)
        self.values[self.steps >= 0] = -np.inf


def least_over_time(
    steps: Steps,
    owners: IntArray,
    distance: Distance,
    precision: FloatArray,
    least: Least,
    around: Around | None = None,
) -> Least:
    """Each owner's least distance in all of its steps, less the radii of errors if there are some.

    Args:
        steps: M steps.
        owners: whose a step is, shape (M, 1), or (M, 2) where it belongs to two.
        distance: of positions.
        precision: by how much a smaller value may be missed [m], shape (M,), where rounding does
            not hide more.
        least: values that smaller ones are looked for; changed into the answer.
        around: the errors around positions, whose radii are taken off distances; none if not given.

    Returns:
        `least`: values that are attained, below which there is nothing but by the precision.
    """
    search = _Search(steps, owners, distance, precision, least, around)
    which, start, width = np.arange(len(steps.p)), np.zeros(len(steps.p)), 1.0
    for parts in (1, *[_PARTS] * _LEVELS):
        if len(which) == 0:
            break
        width /= parts
        blocks = [slice(first, first + _BLOCK) for first in range(0, len(which), _BLOCK)]
        left = [search.split(which[block], start[block], width, parts) for block in blocks]
        which, start = (np.concatenate(each) for each in zip(*left, strict=True))
    search.interpolate()
    return least


@dataclasses.dataclass(frozen=True)
class _Search:
    """What is searched, as in `least_over_time`."""

    steps: Steps
    owners: IntArray
    distance: Distance
    precision: FloatArray
    least: Least
    around: Around | None

    def split(
        self, which: IntArray, start: FloatArray, width: float, parts: int
    ) -> tuple[IntArray, FloatArray]:
        """Sample pieces of the steps `which` at equal times, and tell which parts stay open.

        Args:
            which: steps, shape (P,).
            start: when in its step each piece begins, shape (P,).
            width: of the parts.
            parts: of each piece.

        Returns:
            Steps and beginnings of the parts that may hide a smaller value.
        """
        steps, owners, values = self.steps, self.owners[which], self.least.values
        u = start[:, None] + width * np.arange(parts + 1)
        d = self.distance(steps.at(which, u))
        reach, bend = width * steps.speeds[which], width**2 * steps.bends[which]
        if self.around is None:
            bounds = _lower_bounds(d, reach, bend)
        else:
            radii = self.around.radii(which, u)
            bounds = _lower_bounds(d, reach, bend, radii)
            bounds -= width**2 * self.around.bends[which, None] / 8.0
            d = d - radii
        _offer_samples(self.least, owners, d, which, u, width)
        overflow = ~(np.isfinite(d).all(axis=1) & np.isfinite(bounds).all(axis=1))
        values[owners[overflow]] = np.nan  # below which nothing is looked for
        slack = self.precision[which] + _ROUNDING * (steps.sizes[which] + np.abs(d).max(axis=1))
        sought = np.fmax.reduce(values[owners], axis=1) - slack
        piece, part = np.nonzero(bounds < sought[:, None])
        return which[piece], u[piece, part]

    def interpolate(self) -> None:
        """Offer the lowest point of the parabola through each least sample and its neighbours."""
        least = self.least
        found = np.flatnonzero(least.steps >= 0)
        if len(found) == 0:
            return
        which, w = least.steps[found], least.widths[found][:, None]
        middle = least.moments[found][:, None]
        middle = np.clip(middle, np.minimum(w, 0.5), np.maximum(1.0 - w, 0.5))
        before, at, after = self._values(which, middle + w * [-1.0, 0.0, 1.0]).T
        bend = before - 2.0 * at + after
        shift = np.where(bend > 0.0, (before - after) / np.where(bend > 0.0, 2.0 * bend, 1.0), 0.0)
        u = np.clip(middle + w * np.clip(shift, -1.0, 1.0)[:, None], 0.0, 1.0)
        least.offer(found, self._values(which, u)[:, 0], which, u[:, 0], 0.0)

    def _values(self, which: IntArray, u: FloatArray) -> FloatArray:
        """What is to be least, in the steps `which` at moments u, shape (P, S)."""
        values = self.distance(self.steps.at(which, u))
        if self.around is None:
            return values
        return values - self.around.radii(which, np.clip(u, 0.0, 1.0))


def _offer_samples(
    least: Least, owners: IntArray, d: FloatArray, which: IntArray, u: FloatArray, width: float
) -> None:
    """The least of each piece's samples d, shape (P, S), is offered to its owners."""
    each, best = np.arange(len(d)), np.argmin(d, axis=1)
    for owner in owners.T:
        least.offer(owner, d[each, best], which, u[each, best], width)


def _lower_bounds(
    d: FloatArray, reach: FloatArray, bend: FloatArray, radii: FloatArray | None = None
) -> FloatArray:
    """Lower bounds of a distance between neighbouring samples; see the top of this module.

    Args:
        d: samples at equal distances in time [m], shape (P, S + 1).
        reach: the way that can be made between two [m], shape (P,).
        bend: norm of the acceleration times their distance in time squared [m], shape (P,).
        radii: what is taken off the samples, and between them on straight lines [m], as d.

    Returns:
        Bounds [m], shape (P, S).
    """
    reach, rises = reach[:, None], np.diff(d, axis=1)
    falls = np.concatenate([-reach, np.maximum(rises[:, :-1] - bend[:, None], -reach)], axis=1)
    climbs = np.concatenate([np.minimum(rises[:, 1:] + bend[:, None], reach), reach], axis=1)
    if radii is not None:
        grows = np.diff(radii, axis=1)
        d, rises, falls, climbs = d - radii, rises - grows, falls - grows, climbs - grows
    falls, climbs = np.minimum(falls, 0.0), np.maximum(climbs, 0.0)
    meet = (climbs - rises) / np.maximum(climbs - falls, np.finfo(float).tiny)
    bounds: FloatArray = d[:, :-1] + falls * np.clip(meet, 0.0, 1.0)
    return bounds


@dataclasses.dataclass(frozen=True, eq=False)
class Lowest:
    """When each of several motions is closest to something, all that errors take being taken off.

    Arrays of any one shape.
    """

    steps: IntArray
    """in which step"""
    moments: FloatArray
    """when in this step, from 0 to 1"""
    values: FloatArray
    """the distance then, less the radius [m]"""
    radii: FloatArray
    """of the errors then [m]"""


def lowest_over_time(
    steps: Steps,
    shape: tuple[int, ...],
    distance: Distance,
    precision: npt.ArrayLike,
    around: Around | None = None,
) -> Lowest:
    """The least distance of each of several motions, and when.

    Args:
        steps: of the motions, one motion after another, as many of each.
        shape: of the motions.
        distance: of positions.
        precision: see `least_over_time` [m]; broadcasts to `shape`.
        around: errors around the positions.

    Returns:
        Arrays of this shape.
    """
    motions = math.prod(shape)
    count = len(steps.p) // motions
    owners = np.repeat(np.arange(motions), count)
    each = np.repeat(np.broadcast_to(precision, shape).ravel(), count)
    unknown = Least.unknown(np.full(motions, np.inf))
    least = least_over_time(steps, owners[:, None], distance, each, unknown, around)
    which, radii = np.maximum(least.steps, 0), np.zeros(motions)
    if around is not None:
        radii = around.radii(which, least.moments[:, None])[:, 0]
    values = (each.reshape(shape) for each in (least.moments, least.values, radii))
    return Lowest((which % count).reshape(shape), *values)
