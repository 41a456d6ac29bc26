"""Jerks of averages: changes of a plan's acceleration over the width of one average.

The jerk of one average over w is (a(t + w/2) - a(t - w/2)) / w, and that of several an average of
it. As w is at most a step, it is 0 or the difference of two accelerations, of neighbouring steps or
of rest and the first or last step, over w. So in a convex set with 0 it stays if these differences
over w are in it. With one or two averages each of them is reached; with three less of it is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.sets import ConvexSet


@dataclasses.dataclass(frozen=True, eq=False)
class SmoothJerks:
    """Values of a plan that are a multiple of jerks of its averages."""

    part: str
    """start, inner or end of the plan"""
    quantity: Quantity
    """quantity of the plan: its jerk, or at both ends its acceleration, to which rest leads"""
    factor: float
    """value of this quantity for a jerk of the average of 1 m/s³"""
    times: FloatArray
    """times since the first knot [s], shape (T,)"""
    first: int
    """index of the first of `times` among the quantity's values"""

    def key(self, of: Hashable) -> Hashable:
        """Return the key of a constraint on these values."""
        return (of, self.part)


def smooth_jerks(scenario: Scenario) -> list[SmoothJerks]:
    """Return the values that jerks of averages follow from: inside, at the start, at the end."""
    grid, smoothing = scenario.grid, scenario.smoothing
    assert smoothing is not None  # noqa: S101  # callers check this
    w, steps = smoothing.width, grid.knots - 1
    elapsed = grid.elapsed
    end = SmoothJerks("end", "acceleration", -w, elapsed[-2:-1], steps - 1)
    fleet = scenario.fleet
    if fleet.flown is not None and not np.isnan(fleet.accelerations_before).any():
        # the first change is from the step before, not from rest
        return [SmoothJerks("inner", "jerk", w / grid.step, elapsed[:-1], 0), end]
    return [
        SmoothJerks("inner", "jerk", w / grid.step, elapsed[1:-1], 1),
        SmoothJerks("start", "acceleration", w, elapsed[:1], 0),
        end,
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class Scaled:
    """Convex set times a factor, which may be negative."""

    own: ConvexSet
    """the set"""
    factor: float
    """factor of its values"""

    def support(self, n: FloatArray, /) -> FloatArray:
        """Return the largest n · x of all x in the set, shape (...)."""
        return np.asarray(abs(self.factor) * self.own.support(np.sign(self.factor) * n))

    def signed_distance(self, x: FloatArray, /) -> FloatArray:
        """Return distances from the boundary, at most 0 for x in the set, shape (...)."""
        return np.asarray(abs(self.factor) * self.own.signed_distance(x / self.factor))

    def outward(self, x: FloatArray, /) -> FloatArray:
        """Return unit vectors that point away from the set, shape (..., 3)."""
        return np.asarray(np.sign(self.factor) * self.own.outward(x / self.factor))
