"""Plan as a vehicle shares it: a motion that ends at rest, and the radius of its error tube."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import roll_out
from drake_rho.scenario.fields import BoolArray, FloatArray, unchecked
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.times import steps_begun
from drake_rho.scenario.tracks import Track
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.separation import ellipsoid_distance
from drake_rho.verification.steps import Steps
from drake_rho.verification.tubes import ErrorRadii

_PRECISION = 0.01
"""Precision of least distances, in tolerances of the separation."""

_HARDLY = 1e-7
"""Distance that counts as no motion [m]."""


_RESTING = Track([0.0], np.zeros((1, 3)), after="rests")
"""Track of which that of a plan is a copy, as validating each one takes longer than making it."""


@dataclasses.dataclass(frozen=True, eq=False)
class SharedPlan:
    """Motion of one vehicle from a time on: accelerations constant in each step, then at rest."""

    announced: float
    """time of its announcement, on the scenario's clock [s]"""
    start: float
    """time at which it begins, not after the announcement [s]"""
    step: float
    """duration of a step [s]"""
    state: FloatArray
    """position [m] and velocity [m/s] at its beginning, shape (6,)"""
    accelerations: FloatArray
    """in the steps [m/s²], shape (M, 3)"""
    radius: float = 0.0
    """largest distance of the vehicle from it, at any time [m]"""

    @classmethod
    def at_rest(cls, position: FloatArray, start: float, step: float, radius: float) -> Self:
        """Return the plan of a vehicle that stays at a position (3,) [m] from a time on [s]."""
        state = np.append(position, np.zeros(3))
        return cls(start, start, step, state, np.zeros((1, 3)), radius)

    @cached_property
    def knots(self) -> tuple[FloatArray, FloatArray]:
        """Positions [m] and velocities [m/s] at its knots, shape (M+1, 3) each."""
        return roll_out(self.state[:3], self.state[3:], self.accelerations, self.step)

    @cached_property
    def times(self) -> FloatArray:
        """Times of its knots [s], shape (M+1,)."""
        times: FloatArray = self.start + self.step * np.arange(len(self.accelerations) + 1.0)
        return times

    @cached_property
    def speed(self) -> float:
        """Greatest speed [m/s]."""
        return float(np.linalg.norm(self.knots[1], axis=1).max())

    @cached_property
    def deviation(self) -> float:
        """Largest distance of the motion from the polyline through its knots [m]."""
        return float(np.linalg.norm(self.accelerations, axis=1).max()) * self.step**2 / 8.0

    @cached_property
    def box(self) -> FloatArray:
        """Lower and upper corner of a box that the motion does not leave [m], shape (2, 3)."""
        p = self.knots[0]
        return np.array([p.min(axis=0) - self.deviation, p.max(axis=0) + self.deviation])

    def ending_at_rest(self, place: FloatArray, steps: int) -> Self:
        """Return the plan with accelerations that differ so that it ends at rest at a place.

        Args:
            place: place (3,) near its end [m].
            steps: number of its last steps, n, over which the change is linear: with c_k from
                (n - 1) / 2 down to -(n - 1) / 2 and a_k + α + β c_k, velocities change by n h α and
                positions by h² (α n² / 2 + β n (n² - 1) / 12).
        """
        (p, v), h, n = self.knots, self.step, steps
        alpha = -v[-1] / (n * h)
        beta = (place - p[-1]) / h**2 - alpha * n**2 / 2.0
        beta *= 12.0 / max(n * (n**2 - 1.0), 1.0) * (n > 1)
        accelerations = np.array(self.accelerations)
        accelerations[-n:] += alpha + beta * ((n - 1) / 2.0 - np.arange(n))[:, None]
        return dataclasses.replace(self, accelerations=accelerations)

    def track(self, begin: float) -> Track:
        """Return the polyline through its knots, from the last one before a time on [s].

        It never quite rests: a vehicle may move on, and is no wall to a search for paths.
        """
        first = int(np.clip(steps_begun(begin - self.start, self.step), 0, len(self.times) - 1))
        times = np.append(self.times[first:], self.times[-1] + self.step)
        end = self.knots[0][-1:] + _HARDLY
        positions = np.concatenate([self.knots[0][first:], end])
        times.setflags(write=False)
        positions.setflags(write=False)
        deviation = self.deviation + 2.0 * _HARDLY
        return unchecked(_RESTING, times=times, positions=positions, deviation=deviation)

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions [m], velocities [m/s] and accelerations [m/s²] at times, (T, 3) each.

        Args:
            times: from its beginning on [s], shape (T,).
        """
        (p, v), count = self.knots, len(self.accelerations)
        k = np.clip(steps_begun(times - self.start, self.step), 0, count)
        a = np.append(self.accelerations, np.zeros((1, 3)), axis=0)[k]
        moving = (k < count)[:, None]
        s = np.maximum(times - self.times[k], 0.0)[:, None] * moving
        return p[k] + s * (v[k] + s / 2.0 * a), (v[k] + s * a) * moving, a

    def then(self, knot: int, accelerations: FloatArray) -> FloatArray:
        """Return its accelerations until one of its knots, and then others, (knot + M', 3)."""
        before = np.zeros((knot, 3))
        flown = self.accelerations[:knot]
        before[: len(flown)] = flown
        return np.concatenate([before, accelerations])


def conflicting(
    own: SharedPlan, others: Sequence[SharedPlan], separation: Separation, clock_error: float
) -> BoolArray:
    """Return which other plans come closer than the separation, at any instant, shape (P,).

    The relative motion of two plans is quadratic between the knots of both, and zero after both
    have ended. It counts from the time at which both have begun.

    Args:
        own: the vehicle's own plan.
        others: plans of other vehicles.
        separation: that they have to keep, beside both radii.
        clock_error: largest difference of two vehicles' clocks [s].
    """
    errors = np.array([own.radius + each.radius + clock_error * each.speed for each in others])
    found, size = np.zeros(len(others), dtype=bool), float(separation.shape.semi_axes.max())
    # plans whose boxes are apart by the separation in its longest direction do not conflict
    apart = np.array([_apart(own, each) for each in others])
    near = np.flatnonzero(~(apart >= size + errors))  # true for NaN as well
    if len(near) == 0:
        return found
    pieces, errors = [_relative(own, others[i]) for i in near.tolist()], errors[near]
    owners = np.repeat(np.arange(len(pieces)), [len(each.p) for each in pieces])
    least = Least.unknown(np.full(len(pieces), separation.distance - separation.tolerance))
    precision = np.full(len(owners), _PRECISION * separation.tolerance)
    least_over_time(
        Steps.joined(pieces),
        owners[:, None],
        lambda x: ellipsoid_distance(separation, x),
        precision,
        least,
        ErrorRadii.constant(errors[owners]),
    )
    found[near] = (least.steps >= 0) | np.isnan(least.values)
    return found


def _apart(own: SharedPlan, other: SharedPlan) -> float:
    """Return the distance of the boxes around two plans [m]; NaN where numbers overflow."""
    gaps = np.maximum(np.maximum(own.box[0] - other.box[1], other.box[0] - own.box[1]), 0.0)
    return float(np.linalg.norm(gaps))


def _relative(own: SharedPlan, other: SharedPlan) -> Steps:
    """Return the steps of a motion relative to another, while both go on and a moment after."""
    begin = max(own.start, other.start)
    end = max(own.times[-1], other.times[-1], begin) + own.step
    knots = np.union1d(own.times, other.times)
    knots = np.concatenate([[begin], knots[(knots > begin) & (knots < end)], [end]])
    durations, middles = np.diff(knots)[:, None], (knots[:-1] + knots[1:]) / 2.0
    (p, v, _), (q, w, _) = own.states(knots), other.states(knots)
    a, b = own.states(middles)[2], other.states(middles)[2]
    return Steps.of(durations, p - q, v - w, a - b)
