"""Verification of sampled motions: the tube in which the motion is, and what stays undecided.

Where the norm of the acceleration is at most a, the motion between two samples a time w apart is
within a s (w - s) / 2 of the straight line between them, s after the first one, and its velocity
within a (s² + (w - s)²) / (2 w) of the line's. So the line is verified with these error radii, as
a plan is with its tube.

A check with errors e that does not hold is decided only if the constraint is violated everywhere
within e of the line. The mean velocity between two samples is that of the line, and a mean of
values in a convex set is in the set. So boxes and norms of velocities that the line violates are
violated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import UNITS, Quantity
from drake_rho.scenario.records import TOLERANCE
from drake_rho.verification.check import Column
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii, Tubes

_GROWTH = {UNITS["position"]: 2.0, UNITS["velocity"]: 1.0}
"""Power of the time between samples with which errors grow, by unit; others do not depend on it."""

_OF_MEANS = ("velocity", "max_speed")
"""Kinds whose values between samples have the line's value as their mean, at all times."""


@dataclasses.dataclass(frozen=True, eq=False)
class SampleTubes(Tubes):
    """Error radii around straight lines between samples, the largest of all vehicles."""

    bound: float
    """bound on the norm of the acceleration [m/s²]"""
    samples: tuple[FloatArray, ...]
    """times of the samples on the scenario's clock [s], those of several vehicles once"""

    @classmethod
    def of_samples(cls, times: Sequence[FloatArray], bound: float) -> SampleTubes:
        """Return the error radii of sampled motions.

        Args:
            times: times of each vehicle's samples on the scenario's clock [s].
            bound: bound on accelerations [m/s²].
        """
        distinct = {each.tobytes(): each for each in times}
        return cls((), np.zeros(0), np.zeros(0, dtype=bool), bound, tuple(distinct.values()))

    def widths(self, times: FloatArray) -> FloatArray:
        """Return the longest time between samples around each time [s], of the same shape."""
        before, after = (self._largest(times, side) for side in ("left", "right"))
        return np.maximum(before, after)

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return radii at times on the scenario's clock, in the quantity's unit."""
        if quantity == "position":
            return self._largest(times, "right", products=True) * self.bound / 2.0
        if quantity == "velocity":
            return self.widths(times) * self.bound / 2.0
        return np.full(times.shape, self.bound)

    def before(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Return the same radii: that of the velocity is the greater one of both sides."""
        return self.at(quantity, times)

    def position_in(self, times: FloatArray, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return position radii [m] at times."""
        return self.at("position", times)

    def over(self, quantity: Quantity, begins: FloatArray, ends: FloatArray) -> FloatArray:
        """Return upper bounds of the radii in intervals without a sample inside, shape (M,)."""
        widths = self._largest((begins + ends) / 2.0, "right")
        if quantity == "position":
            return self.bound * widths**2 / 8.0
        return self.bound * (widths / 2.0 if quantity == "velocity" else np.ones_like(widths))

    def around(
        self, begins: FloatArray, durations: FloatArray, pieces: IntArray, vehicles: float
    ) -> ErrorRadii:
        """Return the radii of position errors in pieces of time; arguments are those of `Tubes`."""

        def radii(steps: IntArray, u: FloatArray) -> FloatArray:
            first, lasting = begins[pieces[steps], None], durations[pieces[steps], None]
            return vehicles * self.at("position", first + np.clip(u, 0.0, 1.0) * lasting)

        return ErrorRadii(radii, vehicles * self.bound * durations[pieces] ** 2)

    def _largest(self, times: FloatArray, side: str, *, products: bool = False) -> FloatArray:
        """Return the largest width of the intervals between samples that contain times.

        Args:
            times: times on the scenario's clock [s].
            side: "right" for the interval that begins at a sample, "left" for that which ends.
            products: whether to return s (w - s) in place of w.
        """
        largest = np.zeros(times.shape)
        for samples in self.samples:
            k = np.searchsorted(samples, times, side="right" if side == "right" else "left") - 1
            inside = (k >= 0) & (k < len(samples) - 1)  # vehicles are at rest outside
            k = np.clip(k, 0, len(samples) - 2)
            width = samples[k + 1] - samples[k]
            s = np.clip(times - samples[k], 0.0, width)
            found = s * (width - s) if products else width
            largest = np.maximum(largest, np.where(inside, found, 0.0))
        return largest


def check_samples(
    trajectory: PiecewiseTrajectory, trajectories: Trajectories, bound: float
) -> Column:
    """Verify that samples are possible with the bound on accelerations.

    The change of the mean velocity from one interval to the next, over the time between their
    middles, is a mean of the acceleration.
    """
    scenario = trajectory.scenario
    found = [_largest_mean(trajectories.motions[name]) for name in scenario.names]
    times, values = (np.array(each) for each in zip(*found, strict=True))
    count = len(values)
    return Column(
        kind="dynamics",
        constraint="dynamics",
        parts=["mean acceleration of samples"] * count,
        times=times,
        values=values,
        limits=np.full(count, bound),
        excess=values - bound,
        tolerances=TOLERANCE * np.maximum(scenario.fleet.scale("acceleration"), bound),
        errors=np.zeros(count),
        unit=UNITS["acceleration"],
        concerned=np.ones(count, dtype=bool),
    )


def _largest_mean(motion: Polynomials) -> tuple[float, float]:
    """Return when the mean acceleration of samples is largest [s], and its norm [m/s²]."""
    widths, slopes = np.diff(motion.instants), motion.coefficients[0, :, :, 1]
    means = np.diff(slopes, axis=0) / ((widths[1:] + widths[:-1]) / 2.0)[:, None]
    norms = np.append(np.linalg.norm(means, axis=1), 0.0)  # of two samples there is no mean
    k = int(np.argmax(norms))
    return float(motion.instants[min(k + 1, len(widths))]), float(norms[k])


_MORE = 1.2
"""Factor on a rate that would decide if the straight lines stayed where they are."""


def with_rates(column: Column, tubes: Tubes) -> Column:
    """Return a column with the rates that would decide its undecided checks.

    The errors have to shrink below the line's own distance from the limit. Lines between more
    samples lie elsewhere, so the rates are larger by `_MORE`.
    """
    if not isinstance(tubes, SampleTubes):
        return column
    excess, errors = column.excess, column.errors
    certain = errors if column.kind in _OF_MEANS else 2.0 * errors
    undecided = ~(excess <= column.tolerances) & ~(excess - certain > column.tolerances)
    if (growth := _GROWTH.get(column.unit)) is None:
        rates = np.full(len(excess), np.inf)
    else:
        apart = np.maximum(np.abs(excess - errors), column.tolerances)
        shrunk = _MORE * np.maximum(errors / apart, 1.0) ** (1.0 / growth)
        rates = shrunk / np.maximum(tubes.widths(column.times), np.finfo(float).tiny)
    return dataclasses.replace(column, rates=np.where(undecided, rates, np.nan))
