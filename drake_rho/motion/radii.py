"""Radii of the error's balls, in samples and over pieces of time, in the units of the loop.

See `drake_rho.motion.sampled_loop` for the units; a time is a sample, counted from 0, and the part
of it that has passed.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.motion.sampled_loop import Responses
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

_ABOVE = 0.01
"""By what part of it a bound over a piece of time may be above the largest radius there."""

_MOST_PARTS = 20
"""Parts of a piece for which that holds in any case: 1/8 / 20² <= 1 % of 1/32."""


@dataclasses.dataclass(frozen=True)
class Pieces:
    """Pieces of time, each from a part of one sample to a part of the same or of a later one."""

    first: IntArray
    """samples that they begin in, shape (M,)"""
    begin: FloatArray
    """parts of the first sample at which they begin, from 0 to 1, shape (M,)"""
    last: IntArray
    """samples that they end in, shape (M,)"""
    end: FloatArray
    """parts of the last sample at which they end, from 0 to 1, shape (M,)"""


@dataclasses.dataclass(frozen=True, eq=False)
class Radii:
    """Radii of position, velocity and feedback (acceleration) at any time of a flight."""

    responses: Responses
    """what each cause of an error does to it later"""
    sizes: FloatArray
    """of wind, errors of the estimate, and errors at first, shape (5,)"""

    def at(self, quantity: Quantity, samples: IntArray, parts: FloatArray) -> FloatArray:
        """Radii at parts of samples, two arrays of one shape."""
        samples = np.minimum(samples, self._settled)
        return self.responses.radii_at(quantity, samples, parts, self.sizes)

    def position_over(self, pieces: Pieces) -> FloatArray:
        """Bounds of the position's radius over pieces: never too small, at most 1 % too large."""
        same = pieces.first == pieces.last
        begun, ended = same | (pieces.begin > 0.0), ~same & (pieces.end < 1.0)
        top = _range_max(self._whole, pieces.first + begun, pieces.last - ended)
        for cut, j, a, b in (
            (begun, pieces.first, pieces.begin, np.where(same, pieces.end, 1.0)),
            (ended, pieces.last, np.zeros(len(same)), pieces.end),
        ):
            top[cut] = np.maximum(top[cut], self._part_of_sample(j[cut], a[cut], b[cut]))
        return top

    def velocity_over(self, pieces: Pieces) -> FloatArray:
        """The greatest radii of the velocity over pieces.

        Responses of the velocity are linear in a sample, so its radius is convex there.
        """
        begin = self.at("velocity", pieces.first, pieces.begin)
        end = self.at("velocity", pieces.last, pieces.end)
        between = _range_max(self._at_samples("velocity"), pieces.first + 1, pieces.last)
        return np.asarray(np.maximum(np.maximum(begin, end), between))

    def acceleration_over(self, pieces: Pieces) -> FloatArray:
        """The greatest radii of the feedback over pieces."""
        return _range_max(self._at_samples("acceleration"), pieces.first, pieces.last)

    @property
    def _settled(self) -> int:
        """The sample from which on radii are the same in every one."""
        return len(self.responses) - 1

    def _at_samples(self, quantity: Quantity) -> FloatArray:
        """Radii where samples begin, up to the one from which on they are the same."""
        radii: FloatArray = self.responses.radii(quantity, [0.0], self.sizes)[0]
        return radii

    @cached_property
    def _whole(self) -> FloatArray:
        """Bounds of the position's radius over whole samples, up to the one as all later ones."""
        j = np.arange(self._settled + 1)
        return self._part_of_sample(j, np.zeros(len(j)), np.ones(len(j)))

    def _part_of_sample(self, j: IntArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """Bounds of the position over pieces of samples, in the units of the loop.

        The second derivative of every response is that of the feedback, so ρ_p + κ t²/2 is convex
        in a sample with κ = ρ_u there: below the parabola that `_top` takes the greatest value of,
        which is too large by no more than κ w²/8 over a width w. The largest of the two ends tells
        how many parts make that 1 %. Twenty are always enough, as the mean of ρ_p over the piece is
        at least κ w²/32 (a parabola cannot be closer to zero all along).
        """
        left, right = self.at("position", j, a), self.at("position", j, b)
        kappa = self._at_samples("acceleration")[np.minimum(j, self._settled)]
        top, seen = _top(left, right, kappa, b - a), np.maximum(left, right)
        (coarse,) = np.nonzero(top > (1.0 + _ABOVE) * seen)
        if len(coarse) == 0:
            return top
        short = kappa[coarse] * (b - a)[coarse] ** 2 / 8.0
        most = np.full(len(coarse), float(_MOST_PARTS))
        parts = np.divide(short, _ABOVE * seen[coarse], out=most**2, where=seen[coarse] > 0.0)
        count = np.minimum(np.ceil(np.sqrt(parts)), most).astype(np.int64)
        owner = np.repeat(coarse, count + 1)
        begins = np.cumsum(count + 1) - (count + 1)
        number = np.arange(len(owner)) - np.repeat(begins, count + 1)
        width = (b - a)[owner] / np.repeat(count, count + 1)
        values = self.at("position", j[owner], np.minimum(a[owner] + number * width, 1.0))
        tops = _top(values[:-1], values[1:], kappa[owner[1:]], width[1:])
        tops[begins[1:] - 1] = -np.inf  # from one piece to the next
        top[coarse] = np.maximum.reduceat(tops, begins)
        return top


def _top(left: FloatArray, right: FloatArray, kappa: FloatArray, width: FloatArray) -> FloatArray:
    """Greatest values of left + (right - left) x / w + κ x (w - x) / 2 for x from 0 to w."""
    rise, bend = right - left, kappa * width**2 / 2.0
    at = np.divide(rise, 2.0 * bend, out=np.copysign(np.inf, rise), where=bend > 0.0) + 0.5
    at = np.clip(at, 0.0, 1.0)
    return np.asarray(left + rise * at + bend * at * (1.0 - at))


def _range_max(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Greatest values from places to places, both included; the last value goes on for ever."""
    some, end = first <= last, len(values) - 1
    places = np.stack([np.minimum(first, end), np.minimum(np.maximum(last, first), end) + 1], -1)
    greatest = np.maximum.reduceat(np.append(values, -np.inf), places.ravel())[::2]
    return np.asarray(np.where(some, greatest, -np.inf))
