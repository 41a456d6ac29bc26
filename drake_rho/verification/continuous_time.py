"""Least value over time of a convex distance, by branch and bound.

`verify` uses this between the knots. It shares nothing with the planner, which solves for the
closest approach: here a distance is only sampled, its values between the samples are bounded from
below, and intervals of time that may hide a smaller value are split and sampled again.

The bound. In a step the position x(u) is quadratic in time u, with a constant second derivative a.
Let d be a distance that is convex and 1-Lipschitz, as the signed distance from any convex shape is.
Then d(x(u)) + norm(a) u²/2 is convex in u, and outside two of its samples a convex function is
above the line through them. So between samples a time w apart, d is above two lines:

- a line from the left sample that falls by norm(a) w² more than d does in the interval before, and
- a line from the right sample that falls, backwards in time, by norm(a) w² more than d does in the
  interval after. Neither falls by more than the distance covered in w at the greatest speed.

The bound is where the lines meet. It falls short of the least value in proportion to w², so a few
splits reach any precision, also where a motion touches a shape.

Where a ball of errors surrounds the position (`drake_rho.verification.tubes`), the least value of
the distance less the ball's radius r(t) is sought. Between two samples r is above the line through
its values by κ w²/8 at most. So that line is subtracted from the two lines of d, and κ w²/8 from
the bound.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import ErrorRadii

Distance = Callable[[FloatArray], FloatArray]
"""Convex and 1-Lipschitz function of positions, shape (..., D), with values of shape (...) [m]."""

_PARTS = 4
"""Number of parts that an interval of time is split into."""

_LEVELS = 20
"""Largest number of successive splits: a part is then 1e-12 of a step, near rounding."""

_BLOCK = 1 << 15
"""Number of intervals of time sampled at once, which bounds the memory."""

_ROUNDING = 1e-14
"""Upper bound of a distance's rounding error, relative to the numbers it is computed from."""


@dataclasses.dataclass
class Least:
    """Least value found for each owner of steps; NaN where it cannot be computed."""

    values: FloatArray
    """distances [m], shape (N,)"""
    steps: IntArray
    """index of the step of the least value, shape (N,); -1 where none is below the initial value"""
    moments: FloatArray
    """time within this step, from 0 to 1, shape (N,)"""
    widths: FloatArray
    """time between the samples there, as a fraction of the step, shape (N,)"""

    @classmethod
    def unknown(cls, values: FloatArray) -> Self:
        """Return the initial state of a search for values below `values`, shape (N,)."""
        count = len(values)
        return cls(np.array(values), np.full(count, -1), np.zeros(count), np.ones(count))

    def offer(
        self, owners: IntArray, values: FloatArray, steps: IntArray, u: FloatArray, width: float
    ) -> None:
        """Keep each owner's least value, the first of equal ones; arrays of shape (P,)."""
        better = (values < self.values[owners]).nonzero()[0]
        if len(better) == 0:
            return
        order = better[values[better].argsort(kind="stable")[::-1]]  # the least is last, stays
        who = owners[order]
        self.values[who], self.steps[who] = values[order], steps[order]
        self.moments[who], self.widths[who] = u[order], width


@dataclasses.dataclass
class AnyLower(Least):
    """Search for any lower value: the first one found ends an owner's search."""

    def offer(
        self, owners: IntArray, values: FloatArray, steps: IntArray, u: FloatArray, width: float
    ) -> None:
        """Keep a lower value of each owner and stop its search."""
        super().offer(owners, values, steps, u, width)
        self.values[self.steps >= 0] = -np.inf


def least_over_time(
    steps: Steps,
    owners: IntArray,
    distance: Distance,
    precision: FloatArray,
    least: Least,
    error_radii: ErrorRadii,
) -> Least:
    """Return each owner's least distance over all of its steps, less the error radii.

    Args:
        steps: M steps.
        owners: index of the owner of each step, shape (M, 1), or (M, 2) if it belongs to two.
        distance: distance as a function of positions.
        precision: amount by which a smaller value may be missed [m], shape (M,), unless rounding
            hides more.
        least: initial values; only smaller ones are sought. Changed in place into the answer.
        error_radii: radii of the errors around positions, which are subtracted from distances.

    Returns:
        `least`, with values that are attained and exceed the true minimum by `precision` at most.
    """
    search = _Search(steps, owners, distance, precision, least, error_radii)
    which, start, width = np.arange(len(steps.p)), np.zeros(len(steps.p)), 1.0
    for parts in (1, *[_PARTS] * _LEVELS):
        if len(which) == 0:
            break
        width /= parts
        parted = [
            search.split(which[first : first + _BLOCK], start[first : first + _BLOCK], width, parts)
            for first in range(0, len(which), _BLOCK)
        ]
        which, start = map(np.concatenate, zip(*parted, strict=True))
    search.interpolate()
    return least


@dataclasses.dataclass(frozen=True)
class _Search:
    """Arguments of `least_over_time`, with the steps of the branch and bound as methods."""

    steps: Steps
    owners: IntArray
    distance: Distance
    precision: FloatArray
    least: Least
    error_radii: ErrorRadii

    def split(
        self, which: IntArray, start: FloatArray, width: float, parts: int
    ) -> tuple[IntArray, FloatArray]:
        """Sample intervals at equal times; return the parts that may contain a smaller value.

        Args:
            which: index of the step of each interval, shape (P,).
            start: time within the step at which each interval begins, shape (P,).
            width: length of a part, as a fraction of a step.
            parts: number of parts of each interval.

        Returns:
            Step and beginning of each part that stays open.
        """
        steps, owners, values = self.steps, self.owners[which], self.least.values
        u = start[:, None] + width * np.arange(parts + 1)
        d = self.distance(steps.at(which, u))
        travel, bend = width * steps.speeds[which], width**2 * steps.acceleration_norms[which]
        radii = self.error_radii.radii(which, u)
        bounds = _lower_bounds(d, travel, bend, radii)
        bounds -= width**2 * self.error_radii.curvatures[which, None] / 8.0
        d = d - radii
        _offer_samples(self.least, owners, d, which, u, width)
        largest = np.abs(d).max(axis=1)
        finite = np.isfinite(largest + bounds.sum(axis=1))
        if not finite.all():
            values[owners[~finite]] = np.nan  # ends the search of these owners
        slack = self.precision[which] + _ROUNDING * (steps.coordinate_bounds[which] + largest)
        sought = np.fmax.reduce(values[owners], axis=1) - slack
        piece, part = (bounds < sought[:, None]).nonzero()
        return which[piece], u[piece, part]

    def interpolate(self) -> None:
        """Refine each least sample by the minimum of a parabola through it and its neighbours."""
        least = self.least
        found = (least.steps >= 0).nonzero()[0]
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
        """Return distances less error radii at moments u of the steps `which`, shape (P, S)."""
        values = self.distance(self.steps.at(which, u))
        return np.asarray(values - self.error_radii.radii(which, u))


def _offer_samples(
    least: Least, owners: IntArray, d: FloatArray, which: IntArray, u: FloatArray, width: float
) -> None:
    """Offer the least sample d of each interval, shape (P, S), to the interval's owners."""
    each, best = np.arange(len(d)), d.argmin(axis=1)
    found, at = d[each, best], u[each, best]
    for owner in owners.T:
        least.offer(owner, found, which, at, width)


_TINY = float(np.finfo(float).tiny)
"""Smallest normal number, in place of differences of zero."""


def _lower_bounds(
    d: FloatArray, travel: FloatArray, bend: FloatArray, radii: FloatArray
) -> FloatArray:
    """Return lower bounds of a distance between neighbouring samples; see the module's docstring.

    Args:
        d: samples of the distance at equal time intervals w [m], shape (P, S + 1).
        travel: greatest distance covered in w [m], shape (P,).
        bend: norm of the acceleration times w² [m], shape (P,).
        radii: radii subtracted from the samples and, linearly interpolated, between them [m], of
            the shape of d.

    Returns:
        Bounds [m], shape (P, S).
    """
    travel, bend = travel[:, None], bend[:, None]
    rises, grows = d[:, 1:] - d[:, :-1], radii[:, 1:] - radii[:, :-1]
    falls = np.concatenate([-travel, np.maximum(rises[:, :-1] - bend, -travel)], axis=1)
    climbs = np.concatenate([np.minimum(rises[:, 1:] + bend, travel), travel], axis=1)
    falls, climbs = np.minimum(falls - grows, 0.0), np.maximum(climbs - grows, 0.0)
    d, rises = d - radii, rises - grows
    meet = (climbs - rises) / np.maximum(climbs - falls, _TINY)
    bounds: FloatArray = d[:, :-1] + falls * np.minimum(np.maximum(meet, 0.0), 1.0)
    return bounds
