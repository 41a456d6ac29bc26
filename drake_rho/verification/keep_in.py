"""Check that quantities stay in convex sets, at every instant: boxes, norms and `KeepIn`.

All are judged by one number: the greatest value, over all required times, of a convex measure of
the quantity plus the radius of its errors. Each quantity has its own times:

- positions are verified at the knots and, by branch and bound, at every instant;
- velocities are linear in a piece of time, so that its ends suffice. With errors, their radius is
  convex in a sample of the feedback, so that the ends of samples suffice;
- accelerations are constant in a piece of time, and limits apply to commands;
- jerks are changes of the acceleration where it jumps, as at a plan's knots, without errors.

All quantities of smooth motions are verified at every instant.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import TypeVar

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.times import Clock
from drake_rho.verification.highest_over_time import (
    Curves,
    Highest,
    Measure,
    highest_over_time,
)
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import ErrorRadii

EVER = (-np.inf, np.inf)
"""Interval of a requirement at all times."""

_ORDERS: dict[Quantity, int] = {"position": 0, "velocity": 1, "acceleration": 2, "jerk": 3}
"""Orders of the derivatives of positions."""

_AT_ONCE = 1 << 20
"""Largest number of array entries computed at once, which bounds the memory."""

Search = Callable[[Curves, Measure, FloatArray], Highest]
"""Function that finds the greatest measure of curves over time, as `highest_over_time` does."""


@dataclasses.dataclass(frozen=True, eq=False)
class Constrained:
    """Quantity of some vehicles, at the times at which it has to stay in a set."""

    trajectory: PiecewiseTrajectory
    """trajectory of all vehicles, cut where the interval begins or ends and where the set turns"""
    quantity: Quantity
    measure: Measure
    """measure of the quantity, less that of any partner"""
    precision: FloatArray
    """amount by which a greater measure between instants may be missed, as `search` takes it"""
    members: IntArray
    """indices of the vehicles, shape (M,)"""
    interval: tuple[float, float] = EVER
    """first and last required time since the first knot [s]"""
    partner: int | None = None
    """index of the vehicle from which the difference is taken, if any"""
    deviation: float = 0.0
    """largest distance of the set from its place, which adds to the errors [m]"""
    between_knots: bool = True
    """whether velocities are required at other instants than the knots"""
    search: Search = highest_over_time
    """search for the greatest measure over time"""

    @classmethod
    def by_all(
        cls,
        trajectory: PiecewiseTrajectory,
        quantity: Quantity,
        measure: Measure,
        precision: FloatArray,
        search: Search = highest_over_time,
    ) -> Constrained:
        """Return a quantity of all vehicles, at all times."""
        everyone = np.arange(len(trajectory.positions))
        return cls(trajectory, quantity, measure, precision, everyone, search=search)

    def greatest(self) -> Highest:
        """Return the greatest measure over all required times."""
        if self.quantity == "position":
            if self.is_instant or len(self._during) == 0:
                return self._at(self._active(self.trajectory.elapsed))
            return self._at_every_instant()
        if self.trajectory.is_smooth and not self.is_instant:
            found = self._at_every_instant()
            if self.quantity == "jerk" and len(self.trajectory.jerks.elapsed) > 0:
                found = found.or_greater(self._greatest_jerks())
            return found
        if self.quantity == "velocity":
            return self._greatest_velocities()
        if self.trajectory.is_smooth:
            return self._beside_instant()
        if self.quantity == "acceleration":
            return self._greatest_accelerations()
        return self._greatest_jerks()

    def at_samples(self, times: FloatArray, values: FloatArray, unseen: BoolArray) -> Highest:
        """Return the greatest measure of other values, at those of their times that are required.

        Args:
            times: since the first knot [s], shape (T,).
            values: of the quantity of all vehicles, in its unit, shape (N, T, 3).
            unseen: flags of values that do not count, shape (N, T).
        """
        here = self._active(times)
        times, values, unseen = times[here], values[:, here], unseen[:, here]
        return self._greatest_of(times, values, np.zeros(len(times)), unseen)

    def at_knots(self) -> Highest:
        """Return the greatest measure of positions at the knots, or at the one instant."""
        instants = self._active(self.trajectory.elapsed)
        return self._at(instants if self.is_instant else instants & self.trajectory.knots)

    @property
    def is_instant(self) -> bool:
        """Whether it is required at one instant only."""
        return self.interval[0] == self.interval[1]

    @property
    def _vehicles(self) -> float:
        """Number of vehicles whose errors add up."""
        return 1.0 if self.partner is None else 2.0

    @property
    def _clock(self) -> Clock:
        """Clock for comparing times."""
        return self.trajectory.scenario.grid.clock

    def _active(self, times: FloatArray) -> BoolArray:
        return self._clock.within(times, self.interval)

    def _nothing(self) -> Highest:
        """Return values that hold, for an interval without any instant."""
        count = len(self.members)
        return Highest(np.full(count, self.interval[0]), np.full(count, -np.inf), np.zeros(count))

    def _greatest_of(
        self,
        times: FloatArray,
        values: FloatArray,
        errors: FloatArray,
        free: BoolArray | None = None,
    ) -> Highest:
        """Return the greatest measure of values (N, T, 3) of all vehicles at times (T,).

        Args:
            times: since the first knot [s].
            values: of the quantity, in its unit.
            errors: error radii of one vehicle, in its unit, shape (T,).
            free: flags of values without a limit, shape (N, T).
        """
        if len(times) == 0:
            return self._nothing()
        measured = self._measured(times, values)
        if free is not None:
            measured[free[self.members]] = -np.inf
            if self.partner is not None:
                measured[:, free[self.partner]] = -np.inf
        return Highest.of(times, measured, self._vehicles * errors + self.deviation)

    def _measured(self, times: FloatArray, values: FloatArray) -> FloatArray:
        """Return the measures (M, T, ...) of values (N, T, 3) of all vehicles at times (T,)."""
        own = values[self.members]
        if self.partner is not None:
            own = own - values[self.partner]
        who, at = self.members.repeat(len(times)), _repeated(times, len(own))
        measured = self.measure(who, own.reshape(-1, 3), at)
        return np.asarray(measured.reshape(*own.shape[:2], *measured.shape[1:]))

    def _at(self, instants: BoolArray) -> Highest:
        """Return the greatest measure of positions at selected instants of the trajectory."""
        trajectory = self.trajectory
        values, errors = trajectory.positions[:, instants], trajectory.errors(instants)
        return self._greatest_of(trajectory.elapsed[instants], values, errors)

    def _greatest_velocities(self) -> Highest:
        """Return the greatest measure of velocities: at ends of pieces and of samples."""
        trajectory, tubes = self.trajectory, self.trajectory.tubes
        instants = self._active(trajectory.elapsed)
        if not (self.is_instant or self.between_knots):
            instants &= trajectory.knots
        errors = tubes.at("velocity", trajectory.times[instants])
        values = trajectory.velocities[:, instants]
        found = self._greatest_of(trajectory.elapsed[instants], values, errors)
        if not self.between_knots:
            return found
        if len(k := self._before_jumps()) > 0:
            errors = tubes.before("velocity", trajectory.times[k + 1])
            before = self._greatest_of(trajectory.elapsed[k + 1], trajectory.ends[1][:, k], errors)
            found = found.or_greater(before)
        return self._between_samples(found) if trajectory.has_errors else found

    def _before_jumps(self) -> IntArray:
        """Return the pieces that end in a jump while it is active."""
        k = self.trajectory.last_before_jumps
        ends = self.trajectory.elapsed[k + 1]
        return k[self._clock.after(ends, self.interval[0]) & self._active(ends)]

    def _between_samples(self, found: Highest) -> Highest:
        """Return the greatest measure also at the samples of the feedback inside pieces of time.

        A piece is skipped if the greatest measure at its ends plus the greatest radius in it is not
        greater than what was found.
        """
        trajectory, elapsed = self.trajectory, self.trajectory.elapsed
        begun, ended = trajectory.velocities[:, :-1], trajectory.ends[1]
        both = self._measured(elapsed[:-1], begun), self._measured(elapsed[1:], ended)
        over = trajectory.tubes.over("velocity", trajectory.times[:-1], trajectory.times[1:])
        most = np.moveaxis(np.maximum(*both), 1, -1) + self._vehicles * over
        greater = ~(most <= (found.values + found.errors)[..., None])  # true for NaN as well
        possible = np.any(greater.reshape(-1, len(over)), axis=0)

        samples = _samples_inside(trajectory)
        pieces = np.searchsorted(elapsed, samples, side="right") - 1
        samples = samples[self._active(samples) & possible[pieces]]
        at_once = max(1, _AT_ONCE // found.values.size)
        for first in range(0, len(samples), at_once):
            at = samples[first : first + at_once]
            k = np.searchsorted(elapsed, at, side="right") - 1
            values = begun[:, k] + (at - elapsed[k])[:, None] * trajectory.accelerations[:, k]
            radii = trajectory.tubes.at("velocity", trajectory.scenario.grid.start + at)
            found = found.or_greater(self._greatest_of(at, values, radii))
        return found

    def _greatest_accelerations(self) -> Highest:
        """Return the greatest measure of the commands in the pieces that the interval meets."""
        trajectory, begins = self.trajectory, self.trajectory.elapsed[:-1]
        chosen = self._clock.meets(begins, trajectory.elapsed[1:], self.interval)
        values, errors = trajectory.commands[:, chosen], trajectory.feedback[chosen]
        return self._greatest_of(begins[chosen], values, errors)

    def _greatest_jerks(self) -> Highest:
        """Return the greatest measure of jerks where accelerations jump, as at a plan's knots."""
        grid, jerks = self.trajectory.scenario.grid, self.trajectory.jerks
        chosen = self._clock.meets(jerks.elapsed, jerks.elapsed + grid.step, self.interval)
        times, values = jerks.elapsed[chosen], jerks.values[:, chosen]
        errors = np.full(len(times), jerks.error)
        return self._greatest_of(times, values, errors, jerks.free[:, chosen])

    @cached_property
    def _during(self) -> IntArray:
        """Indices of the pieces of time inside the interval."""
        elapsed = self.trajectory.elapsed
        return self._active((elapsed[:-1] + elapsed[1:]) / 2.0).nonzero()[0]

    def _at_every_instant(self) -> Highest:
        """Return the greatest measure of curves over the interval."""
        return self.search(self._curves(self._during), self.measure, self.precision)

    def _beside_instant(self) -> Highest:
        """Return the greatest measure of smooth curves on both sides of a single instant."""
        found, elapsed = self._nothing(), self.trajectory.elapsed
        for instants, u in ((elapsed[:-1], 0.0), (elapsed[1:], 1.0)):
            pieces = np.flatnonzero(self._active(instants))
            curves = self._curves(pieces)
            every = np.arange(len(curves.owners))
            moments = np.full((len(every), 1), u)
            at, x = curves.times(every, moments[:, 0]), curves.steps.at(every, moments)[:, 0]
            values = self.measure(curves.vehicles, x, at).reshape(len(self.members), len(pieces))
            if len(pieces) > 0:
                errors = curves.errors.radii(np.arange(len(pieces)), moments[: len(pieces)])[:, 0]
                found = found.or_greater(Highest.of(instants[pieces], values, errors))
        return found

    def _curves(self, pieces: IntArray) -> Curves:
        """Return the quantity, less that of any partner, in pieces of time (P,)."""
        trajectory, order = self.trajectory, _ORDERS[self.quantity]
        count, each = len(trajectory.durations), _repeated(pieces, len(self.members))
        owners = np.arange(len(self.members)).repeat(len(pieces))
        every = trajectory.derivatives(order) if order > 0 else trajectory.steps
        steps = every.select(count * self.members[owners] + each)
        if self.partner is not None:
            steps = steps.less(every.select(count * self.partner + each))
        errors = ErrorRadii.constant(self._vehicles * trajectory.errors_of(order)[each])
        if order == 0:
            errors = trajectory.error_radii(each, self._vehicles)
        if self.deviation > 0.0:
            errors = errors.plus_linear(*2 * [np.full(len(each), self.deviation)])
        begins, durations = trajectory.elapsed[each], trajectory.durations[each]
        return Curves(steps, owners, self.members[owners], begins, durations, errors)


_Array = TypeVar("_Array", FloatArray, IntArray)


def _repeated(values: _Array, times: int) -> _Array:
    """Return values (M,) a number of times one after another."""
    return values[None].repeat(times, axis=0).reshape(-1)


def _samples_inside(trajectory: PiecewiseTrajectory) -> FloatArray:
    """Return the samples of the feedback inside pieces of time, since the first knot [s]."""
    disturbance, step = trajectory.scenario.disturbance, trajectory.scenario.grid.step
    if disturbance is None:
        return np.zeros(0)
    count = disturbance.samples_per_step(step)
    samples = np.arange(1, round(trajectory.elapsed[-1] / step * count)) * (step / count)
    return Clock.of(step).apart(samples, trajectory.elapsed)
