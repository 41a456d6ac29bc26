"""Largest errors over all patterns of measurement loss, with at most m lost in a row.

Let q(k) be the number of measurements lost directly after sample k. Then q(k - 1) is 0 if the
measurement of sample k arrives, and q(k) + 1 if it is lost. The effect of wind in sample k, and
that of the estimation error of sample k if its measurement arrives, depend on q(k) alone. So the
sum of all effects is largest along a longest path through the states q = 0, ..., m of all samples,
which dynamic programming over the samples finds exactly (`docs/flight.md`).
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray


@dataclasses.dataclass(frozen=True, eq=False)
class Effects:
    """Largest effects of single past causes on a quantity, if q measurements are lost.

    The arrays have the shape (1 + m, M, L), for q, M parts of a sample, and the number n of samples
    since the cause. A cause in the present sample has n = 0.
    """

    wind: FloatArray
    """effects of wind in a sample, with q measurements lost directly after it"""
    estimates: FloatArray
    """effects of the errors of an estimate that arrives, with q measurements lost after it"""
    initial: FloatArray
    """effects of the initial errors, with the first q measurements lost"""

    def largest(self) -> FloatArray:
        """Return the largest sums of effects in samples 0 to L - 1, shape (M, L)."""
        return np.asarray(self._totals.max(axis=0))

    def lost_after(self, sample: int) -> IntArray:
        """Return the numbers of lost measurements that lead to the largest sum in a sample j.

        M is 1.

        Returns:
            The numbers lost directly after each sample, from the present sample j to sample 0, and
            that of the first measurements, shape (j + 2,).
        """
        numbers = np.zeros(sample + 2, dtype=np.int64)
        n, most = sample + 1, int(np.argmax(self._totals[:, 0, sample]))
        while n >= 0:
            run = np.arange(most + 1)[: n + 1]
            numbers[n - run] = most - run
            n -= most + 1
            if n >= 0:  # the measurement of n samples ago arrives
                most = int(np.argmax(self._runs[n, :, 0] + self._before(n)[:, 0]))
        return numbers

    @cached_property
    def _winds(self) -> FloatArray:
        """Effects of wind in a sample and in the q samples after it, whose measurements are lost.

        With the first of these samples there are q + 1.
        """
        sums = self.wind.copy()
        for q in range(1, len(sums)):
            sums[q, :, 1:] += sums[q - 1, :, :-1]
        return sums

    @cached_property
    def _runs(self) -> FloatArray:
        """Effects of an estimate and of all winds until the next one, shape (L, 1 + m, M)."""
        return np.ascontiguousarray(np.moveaxis(self._winds + self.estimates, 2, 0))

    @cached_property
    def _arrived(self) -> FloatArray:
        """Largest sums of the effects of a sample and all later ones, shape (1 + m + L, M).

        The measurement of that sample, n samples ago, arrives. They are at index 1 + m + n; the
        first 1 + m are 0, as nothing later than the present has an effect.
        """
        count = len(self.wind)
        sums = np.zeros((count + len(self._runs), self.wind.shape[1]))
        for n, run in enumerate(self._runs):
            sums[count + n] = (run + sums[n : n + count][::-1]).max(axis=0)
        return sums

    def _before(self, n: int) -> FloatArray:
        """Return `_arrived` of 1, ..., 1 + m samples after that of n samples ago, (1 + m, M)."""
        return self._arrived[n : n + len(self.wind)][::-1]

    @cached_property
    def _totals(self) -> FloatArray:
        """Largest sums in every sample with the first q measurements lost, shape (1 + m, M, L)."""
        arrived, count = self._arrived.T, len(self.wind)
        length = self.wind.shape[2]
        totals = self.initial.copy()
        for q in range(count):
            totals[q] += arrived[:, count - q : count - q + length]
            if q > 0:
                totals[q] += self._winds[q - 1]
        return totals
