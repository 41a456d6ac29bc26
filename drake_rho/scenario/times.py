"""Comparison of times: two times are equal where only rounding makes them differ.

Times of a flight are sums that begin at its first knot, and users compute theirs in other ways, so
that equal times differ in their last digits. On a clock far from 0 these are coarse: today's Unix
time is rounded to 2.4e-7 s. No other module decides which times are equal.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Self

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

SAME_TIME = 1e-9
"""Part of a step, or of a sample of the feedback, by which two times may differ and still count as
equal."""

END_MARGIN = 1e-6
"""Part of a step after the start and before the end in which states count as given."""

_ROUNDINGS = 8.0
"""Multiple of the clock's rounding by which two times may differ and still count as equal: it
covers sums of a few times and a user's own arithmetic."""


@dataclasses.dataclass(frozen=True)
class Clock:
    """Clock for comparing times [s], alone or in arrays that broadcast.

    Examples:
        >>> bool(rho.Grid(0.1, 5, start=1.7e9).clock.same(0.3, 0.1 + 0.2))
        True
    """

    rounding: float
    """largest difference of two times that count as equal [s]"""

    @classmethod
    def of(cls, step: float, *times: float) -> Self:
        """Return the clock of steps [s] at some times on it [s]."""
        largest = max(map(abs, times), default=0.0)
        return cls(max(SAME_TIME * step, _ROUNDINGS * sys.float_info.epsilon * largest))

    @property
    def tick(self) -> float:
        """Shortest time distinguishable from zero [s]."""
        return 2.0 * self.rounding

    def same(self, one: npt.ArrayLike, other: npt.ArrayLike) -> BoolArray:
        """Return whether times are equal."""
        return np.asarray(np.abs(np.subtract(one, other)) <= self.rounding)

    def before(self, one: npt.ArrayLike, other: npt.ArrayLike) -> BoolArray:
        """Return whether times are before others, and not equal to them."""
        return np.asarray(np.subtract(other, one) > self.rounding)

    def after(self, one: npt.ArrayLike, other: npt.ArrayLike) -> BoolArray:
        """Return whether times are after others, and not equal to them."""
        return np.asarray(np.subtract(one, other) > self.rounding)

    def within(self, times: npt.ArrayLike, interval: tuple[float, float]) -> BoolArray:
        """Return whether times are in an interval that includes both its ends; not for NaN."""
        early, late = np.subtract(interval[0], times), np.subtract(times, interval[1])
        return np.asarray((early <= self.rounding) & (late <= self.rounding))

    def meets(
        self, begins: FloatArray, ends: FloatArray, interval: tuple[float, float]
    ) -> BoolArray:
        """Return which consecutive steps overlap an interval, which includes its ends.

        Each step includes the time at which it begins, and the last one also that at which it ends.
        """
        passed = ~self.after(ends, interval[0])
        passed[-1:] = self.before(ends[-1:], interval[0])
        return np.asarray(~self.after(begins, interval[1]) & ~passed)

    def overlap(self, one: tuple[float, float], other: tuple[float, float]) -> bool:
        """Return whether two intervals that include their ends have a time in common."""
        return not (self.before(one[1], other[0]) or self.after(one[0], other[1]))

    def apart(self, times: FloatArray, others: FloatArray) -> FloatArray:
        """Return the times (M,) that equal none of the increasing times `others`."""
        if len(others) == 0:
            return times
        later = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
        near = [
            self.same(times, others[np.minimum(k, len(others) - 1)]) for k in (later - 1, later)
        ]
        return np.asarray(times[~(near[0] | near[1])])

    def distinct(self, times: FloatArray) -> FloatArray:
        """Return times in increasing order, without any that equals the one before."""
        ordered = np.unique(times)
        return np.asarray(ordered[np.diff(ordered, prepend=-np.inf) > self.rounding])

    def whole(self, times: FloatArray) -> IntArray:
        """Return the number of whole units of time that have passed at times in this unit."""
        return np.asarray(np.floor(times + self.rounding).astype(np.int64))

    def whole_before(self, times: FloatArray) -> IntArray:
        """Return the greatest whole number of units of time that is before times in this unit."""
        return np.asarray(np.ceil(times - self.rounding).astype(np.int64) - 1)

    def last_begun(self, begins: FloatArray, times: npt.ArrayLike) -> IntArray:
        """Return the index of the last of increasing times that is not after each time; or -1."""
        return np.searchsorted(begins, np.add(times, self.rounding), side="right") - 1

    def last_before(self, begins: FloatArray, times: npt.ArrayLike) -> IntArray:
        """Return the index of the last of increasing times that is before each time; or -1."""
        return np.searchsorted(begins, np.subtract(times, self.rounding), side="right") - 1


EXACT = Clock(0.0)
"""Clock on which equal times are equal numbers."""


def steps_begun(times: npt.ArrayLike, step: float) -> IntArray:
    """Return the number of whole steps in times [s], of which each has begun at its multiple."""
    return np.floor(np.asarray(times) / step + SAME_TIME).astype(np.int64)


def steps_within(time: float, step: float) -> int:
    """Return the largest number of steps that do not last longer than a time [s]."""
    return int(time / step * (1.0 + SAME_TIME))


def steps_lasting(time: float, step: float) -> int:
    """Return the least number of steps that last as long as a time, or longer [s]."""
    return math.ceil(time / step * (1.0 - SAME_TIME))


def divides(step: float, time: float) -> bool:
    """Return whether a time is a whole number of steps, one or more [s]."""
    steps = time / step
    return round(steps) >= 1 and abs(steps - round(steps)) <= SAME_TIME * steps
