"""Radii of the error tube at instants and over pieces of time.

`drake_rho.motion.sampled_loop` defines the units. A time is given by a sample, counted from 0, and
the elapsed part of this sample.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.sampled_loop import Responses
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

_ABOVE = 0.01
"""Largest relative error of an upper bound of the radii over a piece of time."""

_MOST_PARTS = 20
"""Number of parts of a piece that always suffices for this error: 1/8 / 20² <= 1 % of 1/32."""


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Pieces of time, each from a part of one sample to a part of the same or of a later one."""

    first: IntArray
    """samples in which they begin, shape (M,)"""
    begin: FloatArray
    """parts of the first sample at which they begin, from 0 to 1, shape (M,)"""
    last: IntArray
    """samples in which they end, shape (M,)"""
    end: FloatArray
    """parts of the last sample at which they end, from 0 to 1, shape (M,)"""


@dataclasses.dataclass(frozen=True, eq=False)
class Radii:
    """Radii of position, velocity and feedback (acceleration) at any time of a flight."""

    responses: Responses
    """responses of the error to each of its causes"""
    sizes: FloatArray
    """sizes of wind, estimation errors and initial errors, shape (5,)"""

    def at(self, quantity: Quantity, samples: IntArray, parts: FloatArray) -> FloatArray:
        """Return the radii at parts of samples, two arrays of one shape."""
        samples = np.minimum(samples, self._steady)
        return self.responses.radii_at(quantity, samples, parts, self.sizes)

    def position_over(self, pieces: Pieces) -> FloatArray:
        """Return upper bounds of the position's radius over pieces, at most 1 % too large."""
        same = pieces.first == pieces.last
        cut_first, cut_last = same | (pieces.begin > 0.0), ~same & (pieces.end < 1.0)
        top = _range_max(self._whole, pieces.first + cut_first, pieces.last - cut_last)
        for cut, j, a, b in (
            (cut_first, pieces.first, pieces.begin, np.where(same, pieces.end, 1.0)),
            (cut_last, pieces.last, np.zeros(len(same)), pieces.end),
        ):
            top[cut] = np.maximum(top[cut], self._part_of_sample(j[cut], a[cut], b[cut]))
        return top

    def velocity_over(self, pieces: Pieces) -> FloatArray:
        """Return the greatest radii of the velocity over pieces.

        Responses of the velocity are linear in a sample, so its radius is convex there.
        """
        begin = self.at("velocity", pieces.first, pieces.begin)
        end = self.at("velocity", pieces.last, pieces.end)
        between = _range_max(self._at_samples("velocity"), pieces.first + 1, pieces.last)
        return np.asarray(np.maximum(np.maximum(begin, end), between))

    def acceleration_over(self, pieces: Pieces) -> FloatArray:
        """Return the greatest radii of the feedback over pieces."""
        return _range_max(self._at_samples("acceleration"), pieces.first, pieces.last)

    @property
    def _steady(self) -> int:
        """Sample from which on the radii of all samples are equal."""
        return len(self.responses) - 1

    def _at_samples(self, quantity: Quantity) -> FloatArray:
        """Return the radii at the beginnings of samples, up to the first steady one."""
        radii: FloatArray = self.responses.radii(quantity, [0.0], self.sizes)[0]
        return radii

    @cached_property
    def _whole(self) -> FloatArray:
        """Bounds of the position's radius over whole samples, up to the first steady one."""
        j = np.arange(self._steady + 1)
        return self._part_of_sample(j, np.zeros(len(j)), np.ones(len(j)))

    def _part_of_sample(self, j: IntArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return upper bounds of the position's radius over pieces, each within one sample.

        The second derivative of every response is that of the feedback. In a sample with κ = ρ_u,
        ρ_p + κ t²/2 is therefore convex, and ρ_p lies below a parabola through its values at the
        ends. The greatest value of this parabola (`_top`) exceeds that of ρ_p by at most κ w²/8
        over a width w. The larger of the two end values determines the number of parts that reduce
        this error to 1 %. Twenty parts always suffice, since the mean of ρ_p over the piece is at
        least κ w²/32 (no parabola with this curvature is closer to zero throughout).

        Args:
            j: samples, shape (M,).
            a: parts of the samples at which the pieces begin, shape (M,).
            b: parts of the samples at which they end, shape (M,).
        """
        left, right = self.at("position", j, a), self.at("position", j, b)
        kappa = self._at_samples("acceleration")[np.minimum(j, self._steady)]
        top, at_ends = _top(left, right, kappa, b - a), np.maximum(left, right)
        (coarse,) = np.nonzero(top > (1.0 + _ABOVE) * at_ends)
        if len(coarse) == 0:
            return top
        gap = kappa[coarse] * (b - a)[coarse] ** 2 / 8.0
        most = np.full(len(coarse), float(_MOST_PARTS))
        known = at_ends[coarse]
        parts = np.divide(gap, _ABOVE * known, out=most**2, where=known > 0.0)
        count = np.minimum(np.ceil(np.sqrt(parts)), most).astype(np.int64)
        owner = np.repeat(coarse, count + 1)
        begins = np.cumsum(count + 1) - (count + 1)
        number = np.arange(len(owner)) - np.repeat(begins, count + 1)
        width = (b - a)[owner] / np.repeat(count, count + 1)
        values = self.at("position", j[owner], np.minimum(a[owner] + number * width, 1.0))
        tops = _top(values[:-1], values[1:], kappa[owner[1:]], width[1:])
        tops[begins[1:] - 1] = -np.inf  # these intervals lie between two pieces
        top[coarse] = np.maximum.reduceat(tops, begins)
        return top


def _top(left: FloatArray, right: FloatArray, kappa: FloatArray, width: FloatArray) -> FloatArray:
    """Return the maxima of left + (right - left) x / w + κ x (w - x) / 2 for x in [0, w]."""
    rise, curvature = right - left, kappa * width**2 / 2.0
    at = np.divide(rise, 2.0 * curvature, out=np.copysign(np.inf, rise), where=curvature > 0.0)
    at = np.clip(at + 0.5, 0.0, 1.0)
    return np.asarray(left + rise * at + curvature * at * (1.0 - at))


def _range_max(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return the greatest values in ranges of indices, both ends included.

    The last value is repeated for all larger indices. The maximum of an empty range is -inf.
    """
    nonempty, end = first <= last, len(values) - 1
    ranges = np.stack([np.minimum(first, end), np.minimum(np.maximum(last, first), end) + 1], -1)
    greatest = np.maximum.reduceat(np.append(values, -np.inf), ranges.ravel())[::2]
    return np.asarray(np.where(nonempty, greatest, -np.inf))
