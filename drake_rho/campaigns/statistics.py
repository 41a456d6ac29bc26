"""Statistics of runs: intervals of proportions, quantiles, and comparisons of methods."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.special import bdtr

from drake_rho.scenario.fields import BoolArray, FloatArray

SAME = 1e-6
"""Relative difference up to which two costs, or two final times, count as equal."""


@dataclasses.dataclass(frozen=True)
class Proportion:
    """Proportion of runs that succeeded, with Wilson's 95 % interval."""

    successes: int
    """number of verified plans"""
    runs: int
    """number of runs"""

    @property
    def rate(self) -> float:
        """Fraction of runs that succeeded; NaN without runs."""
        return self.successes / self.runs if self.runs else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval of the success rate; (0, 1) without runs."""
        if not self.runs:
            return 0.0, 1.0
        from scipy.stats import binomtest  # imported here because it takes half a second to load

        found = binomtest(self.successes, self.runs).proportion_ci(method="wilson")
        return float(found.low), float(found.high)


@dataclasses.dataclass(frozen=True)
class Quantiles:
    """Quantiles of a set of numbers; NaN if it is empty."""

    least: float
    """smallest number"""
    lower: float
    """lower decile: a tenth of the numbers is below"""
    median: float
    """median: half of the numbers is below"""
    upper: float
    """upper decile: a tenth of the numbers is above"""
    greatest: float
    """largest number"""

    @classmethod
    def of(cls, values: FloatArray) -> Quantiles:
        """Return the quantiles of the finite numbers among `values`, shape (M,)."""
        known = values[np.isfinite(values)]
        if not len(known):
            return cls(*[math.nan] * 5)
        return cls(*np.quantile(known, [0.0, 0.1, 0.5, 0.9, 1.0]).tolist())


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Comparison of two methods on the same scenarios and seeds."""

    scenario: str
    """name of the source; empty for all sources"""
    method: str
    """name of the method"""
    base: str
    """name of the method to compare with"""
    both: int
    """number of runs in which both succeed"""
    only_method: int
    """number of runs in which only the method succeeds"""
    only_base: int
    """number of runs in which only the base succeeds"""
    neither: int
    """number of runs in which neither succeeds"""
    cost_ratio: Quantiles
    """cost of the method over that of the base, where both succeed"""
    cheaper: int
    """number of these runs in which the method costs less, by more than a millionth"""
    costlier: int
    """number of these runs in which the method costs more, by more than a millionth"""
    duration_ratio: Quantiles
    """final time of the method over that of the base, counted from the first knot, where both
    succeed"""
    shorter: int
    """number of these runs in which the method's flight is shorter, by more than a millionth"""
    longer: int
    """number of these runs in which the method's flight is longer, by more than a millionth"""
    time_ratio: Quantiles
    """planning time of the method over that of the base, where both succeed"""

    @property
    def p_success(self) -> float:
        """P-value of the difference in success (McNemar's exact test)."""
        return sign_test(self.only_method, self.only_base)

    @property
    def p_cost(self) -> float:
        """P-value of the difference in cost (sign test)."""
        return sign_test(self.cheaper, self.costlier)

    @property
    def p_duration(self) -> float:
        """P-value of the difference in final time (sign test)."""
        return sign_test(self.shorter, self.longer)


@dataclasses.dataclass(frozen=True)
class Group:
    """Summary of the runs of one method on one source of scenarios."""

    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    success: Proportion
    """proportion of runs with a verified plan"""
    cost: Quantiles
    """costs of these runs [m²/s⁴]"""
    duration: Quantiles
    """times from the first knot to the last, of these runs [s]"""
    seconds: Quantiles
    """planning times of all runs, including failures [s]"""


@dataclasses.dataclass(frozen=True)
class Failure:
    """Group of failed runs of one method with the same status."""

    method: str
    """name of the method"""
    status: str
    """status of the runs; solved, if a constraint is violated"""
    reason: str
    """most frequent reason"""
    runs: int
    """number of runs"""


def sign_test(one: int, other: int) -> float:
    """Return the two-sided p-value of a split of counts between two equally likely sides."""
    if one + other == 0:
        return 1.0
    return min(1.0, 2.0 * float(bdtr(min(one, other), one + other, 0.5)))


def compare(
    names: tuple[str, str, str],
    succeeded: tuple[BoolArray, BoolArray],
    costs: tuple[FloatArray, FloatArray],
    durations: tuple[FloatArray, FloatArray],
    seconds: tuple[FloatArray, FloatArray],
) -> Comparison:
    """Compare a method with a base on the same runs.

    Args:
        names: names of the source, the method and the base.
        succeeded: whether the method and the base succeeded, shape (M,) each, run by run.
        costs: costs of the method and the base [m²/s⁴], shape (M,) each.
        durations: times from first to last knot of the method and the base [s], shape (M,) each.
        seconds: planning times of the method and the base [s], shape (M,) each.
    """
    one, other = succeeded
    both = one & other
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(costs[0] == costs[1], 1.0, costs[0] / costs[1])[both]
        longer = (durations[0] / durations[1])[both]
        slower = (seconds[0] / seconds[1])[both]
    return Comparison(
        *names,
        both=int(np.sum(both)),
        only_method=int(np.sum(one & ~other)),
        only_base=int(np.sum(other & ~one)),
        neither=int(np.sum(~one & ~other)),
        cost_ratio=Quantiles.of(ratios),
        cheaper=int(np.sum(ratios < 1.0 - SAME)),
        costlier=int(np.sum(ratios > 1.0 + SAME)),
        duration_ratio=Quantiles.of(longer),
        shorter=int(np.sum(longer < 1.0 - SAME)),
        longer=int(np.sum(longer > 1.0 + SAME)),
        time_ratio=Quantiles.of(slower),
    )
