"""What many runs say: intervals for proportions, quantiles, and two methods on the same runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.special import bdtr

from drake_rho.scenario.fields import BoolArray, FloatArray

SAME = 1e-6
"""Relative difference up to which two costs are the same."""


@dataclasses.dataclass(frozen=True)
class Proportion:
    """How many of some runs succeeded, with Wilson's 95 % interval."""

    successes: int
    """verified plans"""
    runs: int
    """all"""

    @property
    def rate(self) -> float:
        """Part of the runs that succeeded; NaN without runs."""
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
    """The middle and the spread of some numbers; NaN where there are none."""

    least: float
    """the smallest"""
    lower: float
    """a tenth is below"""
    median: float
    """half is below"""
    upper: float
    """a tenth is above"""
    greatest: float
    """the largest"""

    @classmethod
    def of(cls, values: FloatArray) -> Quantiles:
        """The quantiles of some numbers, shape (M,), those that are NaN left out."""
        known = values[np.isfinite(values)]
        if not len(known):
            return cls(*[math.nan] * 5)
        return cls(*np.quantile(known, [0.0, 0.1, 0.5, 0.9, 1.0]).tolist())


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two methods on the same scenarios and seeds."""

    scenario: str
    """name of the source; empty for all of them"""
    method: str
    """that is compared"""
    base: str
    """with which"""
    both: int
    """runs in which both succeed"""
    only_method: int
    """in which only the method does"""
    only_base: int
    """in which only the base does"""
    neither: int
    """in which none does"""
    cost_ratio: Quantiles
    """cost of the method over that of the base, where both succeed"""
    cheaper: int
    """runs of these in which the method costs less, by more than a millionth"""
    dearer: int
    """in which it costs more"""
    time_ratio: Quantiles
    """planning time of the method over that of the base, where both succeed"""

    @property
    def p_success(self) -> float:
        """How likely such a difference in success is by chance alone (McNemar's exact test)."""
        return sign_test(self.only_method, self.only_base)

    @property
    def p_cost(self) -> float:
        """How likely such a difference in cost is by chance alone (sign test)."""
        return sign_test(self.cheaper, self.dearer)


@dataclasses.dataclass(frozen=True)
class Group:
    """The runs of one method on one source of scenarios."""

    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    success: Proportion
    """runs whose plan holds"""
    cost: Quantiles
    """of these runs [m²/s⁴]"""
    seconds: Quantiles
    """to plan or to fail, of all runs [s]"""


@dataclasses.dataclass(frozen=True)
class Failure:
    """Runs that ended in the same way."""

    method: str
    """name"""
    status: str
    """what became of them; solved, where a constraint is broken"""
    reason: str
    """the one given most often"""
    runs: int
    """how many"""


def sign_test(one: int, other: int) -> float:
    """Two-sided probability of a split at least as uneven, if both sides are as likely."""
    if one + other == 0:
        return 1.0
    return min(1.0, 2.0 * float(bdtr(min(one, other), one + other, 0.5)))


def compare(
    names: tuple[str, str, str],
    succeeded: tuple[BoolArray, BoolArray],
    costs: tuple[FloatArray, FloatArray],
    seconds: tuple[FloatArray, FloatArray],
) -> Comparison:
    """Compare a method with a base on the same runs.

    Args:
        names: of the source, the method and the base.
        succeeded: of the method and the base, shape (M,) each, run by run.
        costs: the same [m²/s⁴].
        seconds: the same [s].
    """
    one, other = succeeded
    both = one & other
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(costs[0] == costs[1], 1.0, costs[0] / costs[1])[both]
        slower = (seconds[0] / seconds[1])[both]
    return Comparison(
        *names,
        both=int(np.sum(both)),
        only_method=int(np.sum(one & ~other)),
        only_base=int(np.sum(other & ~one)),
        neither=int(np.sum(~one & ~other)),
        cost_ratio=Quantiles.of(ratios),
        cheaper=int(np.sum(ratios < 1.0 - SAME)),
        dearer=int(np.sum(ratios > 1.0 + SAME)),
        time_ratio=Quantiles.of(slower),
    )
