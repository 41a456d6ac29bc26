"""Greatest value over time of a convex measure plus an error radius, by branch and bound.

Within a time w, a curve with the second derivative a deviates from the chord between its ends by
norm(a) w²/8 at most. A convex, 1-Lipschitz measure is at most the greater of its values at the ends
of the chord, and the error radius exceeds its own chord by κ w²/8 at most
(`drake_rho.verification.tubes`). So between two instants, the measure plus the radius is at most
the greater of its two end values plus (norm(a) + κ) w²/8. Intervals in which this bound exceeds the
greatest value found are halved until the difference is negligible.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import ErrorRadii

Measure = Callable[[IntArray, FloatArray, FloatArray], FloatArray]
"""Convex and 1-Lipschitz function of the indices of vehicles (R,), values of a quantity (R, 3) and
times since the first knot (R,), with one or more values for each, shape (R, ...)."""

_LEVELS = 30
"""Largest number of successive halvings: an interval is then 1e-9 of a piece of time."""


@dataclasses.dataclass(eq=False)
class Highest:
    """Greatest measure plus error radius of each vehicle, and its time; arrays of one shape."""

    times: FloatArray
    """times since the first knot [s]"""
    values: FloatArray
    """measures at these times without the error radii, in the quantity's unit"""
    errors: FloatArray
    """error radii at these times, in the quantity's unit"""

    @classmethod
    def of(cls, times: FloatArray, values: FloatArray, errors: FloatArray) -> Highest:
        """Return the greatest of measures (M, T, ...) at times (T,), with error radii (T,)."""
        count, shape = len(values), (len(values), *values.shape[2:])
        values = values.reshape(count, len(times), -1)
        k = (values + errors[:, None]).argmax(axis=1)  # the first NaN, if there is one
        picked = values[np.arange(count)[:, None], k, np.arange(values.shape[2])]
        return cls(times[k].reshape(shape), picked.reshape(shape), errors[k].reshape(shape))

    def or_greater(self, other: Highest) -> Highest:
        """Return the greater of two, element by element; NaN is above all."""
        greater = ~(other.values + other.errors <= self.values + self.errors)
        greater &= ~np.isnan(self.values)
        pairs = zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
        return Highest(*(np.where(greater, b, a) for a, b in pairs))

    def offer(
        self, motions: IntArray, times: FloatArray, values: FloatArray, errors: FloatArray
    ) -> None:
        """Keep the greatest value of each motion, NaN above all; arrays (P, S)."""
        totals = np.where(np.isnan(values), np.inf, values + errors)
        every, best = np.arange(len(motions)), np.argmax(totals, axis=1)
        top = totals[every, best]
        order = np.argsort(top, kind="stable")  # the greatest of a motion is last, stays
        order = order[top[order] > self.values[motions[order]] + self.errors[motions[order]]]
        who, at = motions[order], (order, best[order])
        self.times[who], self.values[who], self.errors[who] = times[at], values[at], errors[at]


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """Curves of a quantity in pieces of time, equally many for each vehicle, one after another."""

    steps: Steps
    """curves in normalised time, M of them"""
    owners: IntArray
    """number of the vehicle of each curve, from 0, shape (M,)"""
    vehicles: IntArray
    """index of that vehicle in the scenario, shape (M,)"""
    begins: FloatArray
    """beginnings of the pieces since the first knot [s], shape (M,)"""
    durations: FloatArray
    """durations of the pieces [s], shape (M,)"""
    errors: ErrorRadii
    """error radii in the pieces"""

    def times(self, which: IntArray, u: FloatArray) -> FloatArray:
        """Return times since the first knot [s] of moments u of curves, of one common shape."""
        return np.asarray(self.begins[which] + u * self.durations[which])


def highest_over_time(curves: Curves, measure: Measure, precision: FloatArray) -> Highest:
    """Return when the measure of each vehicle's curves, plus the error radius, is greatest.

    Args:
        curves: the curves.
        measure: the measure.
        precision: amount by which a greater value may be missed, for each vehicle, shape (V,).

    Returns:
        Arrays of shape (V,), with minus infinity for a vehicle without a curve.
    """
    steps, owners, count = curves.steps, curves.owners, len(precision)
    known = Highest(np.zeros(count), np.full(count, -np.inf), np.zeros(count))
    bend = steps.acceleration_norms + curves.errors.curvatures
    which, low, width = np.arange(len(owners)), np.zeros(len(owners)), 1.0
    for _ in range(_LEVELS):
        if len(which) == 0:
            break
        u = low[:, None] + width * np.array([0.0, 0.5, 1.0])
        x, times = steps.at(which, u).reshape(-1, 3), curves.times(which[:, None], u)
        who = np.repeat(curves.vehicles[which], u.shape[1])
        values = measure(who, x, times.reshape(-1)).reshape(u.shape)
        errors = curves.errors.radii(which, u)
        known.offer(owners[which], times, values, errors)
        width /= 2.0
        at, rise = values + errors, bend[which] * width**2 / 8.0
        overflow = owners[which[~np.isfinite(rise)]]
        known.values[overflow] = np.maximum(known.values[overflow], np.inf)  # never holds
        least = (known.values + known.errors + precision)[owners[which]]
        first, second = (np.maximum(at[:, i], at[:, i + 1]) + rise > least for i in range(2))
        which = np.concatenate([which[first], which[second]])
        low = np.concatenate([low[first], low[second] + width])
    return known
