"""Smooth motions of plans: moving averages of positions, in closed form (`rho.Smoothing`).

A plan is at rest before its first knot and after its last; that of a window continues the flown
motion. Its acceleration is then a sum of steps, one at each knot, and averaging changes a step only
within n w/2 of it. So the smooth motion is the plan's own, displaced by n w²/24 a with the
acceleration a of the step at a time t, plus one term for each knot nearer than n w/2. With the
truncated powers

    F_m(s) = w^(m - n) / m! Σ_j (-1)^j binom(n, j) (s/w + n/2 - j)+^m,    s <= 0,

F_n is the averaged step before the knot at s = 0, F_(n+1) its integral and F_(n+2) that of the
latter; F_(n-1) and so on are its derivatives. After the knot they are the same by symmetry.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property
from math import comb, factorial

import numpy as np

from drake_rho.motion.dynamics import Motion, response, step_at
from drake_rho.motion.polynomials import Polynomials
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import REACHED, Grid, Quantity
from drake_rho.scenario.smoothing import Smoothing
from drake_rho.scenario.times import Clock

_KNOTS = -1, 0, 1, 2
"""Knots that may affect averages at a time, relative to the one at which its step begins."""

_AROUND = np.arange(-2, 3)
"""Steps beside these knots, relative to the step that contains the time."""


@dataclasses.dataclass(frozen=True, eq=False)
class SmoothMotion:
    """Moving averages of motions that end at rest, and begin at rest or in a flight."""

    motion: Motion
    """motions of N vehicles with piecewise constant accelerations"""
    smoothing: Smoothing

    def states(self, elapsed: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions [m], velocities [m/s] and accelerations [m/s²], (N, M, 3) each.

        Args:
            elapsed: times since the first knot [s], shape (M,).
        """
        n, w = self.smoothing.times, self.smoothing.width
        k = self._steps_of(elapsed)
        whole = self._extended
        s = (elapsed - whole.step * k)[:, None]
        p, v, a = (
            each[:, k + REACHED]
            for each in (whole.positions, whole.velocities, whole.accelerations)
        )
        return (
            p + s * (v + s / 2.0 * a) + n * w**2 / 24.0 * a + self._beside(-2, elapsed, k),
            v + s * a + self._beside(-1, elapsed, k),
            a + self._beside(0, elapsed, k),
        )

    def each_at(self, quantity: Quantity, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Return the position of one vehicle at each time since the first knot [s], (M, 3).

        Raises:
            ValueError: the quantity is not the position.
        """
        if quantity != "position":
            raise ValueError(f"quantity: got {quantity!r}, expected position")
        added = corrections(self.smoothing, self.motion.step, times)
        k = self._steps_of(times)[:, None] + _AROUND + REACHED
        near = self._extended.accelerations[vehicles[:, None], k]
        own = self.motion.each_at("position", vehicles, times)
        if (early := times < 0.0).any():
            later = times[early] + REACHED * self.motion.step
            own[early] = self._extended.each_at("position", vehicles[early], later)
        return np.asarray(own + np.einsum("mo,mox->mx", added, near))

    def polynomials(self) -> Polynomials:
        """Return the motions as polynomials of degree n + 2, which differ from piece to piece."""
        n, w, h = self.smoothing.times, self.smoothing.width, self.motion.step
        first = 0 if self.motion.flown is None else -REACHED
        knots = h * np.arange(first, self.motion.positions.shape[1])
        instants = np.unique(knots[:, None] + w * (np.arange(n + 1) - n / 2.0))
        clock = Clock.of(h)
        instants = clock.distinct(instants[~clock.before(instants, -n * w / 2.0)])
        half = np.diff(instants) / 2.0
        middles = instants[:-1] + half  # where each derivative has one value
        k = self._steps_of(middles)
        derivatives = [*self.states(middles)]
        derivatives += [self._beside(order, middles, k) for order in range(1, n + 1)]
        taylor = [each / factorial(m) for m, each in enumerate(derivatives)]
        moved = [
            sum(comb(m, i) * (-half[:, None]) ** (m - i) * taylor[m] for m in range(i, len(taylor)))
            for i in range(len(taylor))
        ]
        return Polynomials(instants, np.stack(moved, axis=-1))

    @cached_property
    def _extended(self) -> Motion:
        """The motions, with the flown motion or rest before and with rest after."""
        own, after = self.motion, ((0, 0), (0, REACHED), (0, 0))
        h, a = own.step, own.earlier
        v = own.velocities[:, :1] - h * np.cumsum(a[:, ::-1], axis=1)[:, ::-1]
        moves = h * (v + h / 2.0 * a)
        p = own.positions[:, :1] - np.cumsum(moves[:, ::-1], axis=1)[:, ::-1]
        return Motion(
            h,
            np.concatenate([p, np.pad(own.positions, after, mode="edge")], axis=1),
            np.concatenate([v, np.pad(own.velocities, after)], axis=1),
            np.concatenate([a, np.pad(own.accelerations, after)], axis=1),
            own.before,
            own.after,
        )

    def _steps_of(self, elapsed: FloatArray) -> IntArray:
        """Return the numbers of the steps at times, negative before the first knot."""
        return step_at(elapsed, self.motion.step)

    def _beside(self, order: int, elapsed: FloatArray, k: IntArray) -> FloatArray:
        """Return contributions of nearby knots to a derivative of the accelerations, (N, M, 3).

        Args:
            order: of the derivative; negative for integrals, of which -2 are the positions.
            elapsed: times since the first knot [s], shape (M,).
            k: numbers of the steps at these times, shape (M,).
        """
        a, h = self._extended.accelerations, self.motion.step
        added = np.zeros((len(a), len(elapsed), 3))
        for knot in _KNOTS:
            at = k + knot
            jumps = a[:, at + REACHED] - a[:, at + REACHED - 1]
            weights = _of_knot(self.smoothing, order, elapsed - h * at, knot <= 0)
            added += weights[:, None] * jumps
        return added


def averaged(motion: Motion, smoothing: Smoothing | None) -> Motion | SmoothMotion:
    """Return the moving averages of motions; without a smoothing, the motions themselves."""
    return SmoothMotion(motion, smoothing) if smoothing else motion


def corrections(smoothing: Smoothing, step: float, times: FloatArray) -> FloatArray:
    """Return the change of positions by averaging, as weights of accelerations [s²], shape (M, 5).

    The weights are those of the step that contains a time, of the two before and of the two after.

    Args:
        smoothing: the averages.
        step: h [s].
        times: since the first knot [s], shape (M,).
    """
    k = step_at(times, step)
    weights = np.zeros((len(times), len(_AROUND)))
    weights[:, 2] = smoothing.times * smoothing.width**2 / 24.0
    for knot in _KNOTS:
        of_jump = _of_knot(smoothing, -2, times - step * (k + knot), knot <= 0)
        weights[:, 2 + knot] += of_jump
        weights[:, 1 + knot] -= of_jump
    return weights


def response_of(
    quantity: Quantity, averaged: Smoothing | None, grid: Grid, times: FloatArray
) -> FloatArray:
    """Return the response of a quantity, or of averaged positions, to unit accelerations, (M, K-1).

    Args:
        quantity: position, velocity, acceleration or jerk.
        averaged: moving averages of the position; None for the quantity itself.
        grid: the grid.
        times: since the first knot [s], shape (M,).
    """
    responses = response(quantity, grid.step, grid.knots, times)
    if averaged is not None:
        steps, added = steps_around(averaged, grid, times)
        rows = np.nonzero(steps >= 0)
        responses[rows[0], steps[rows]] += added[rows]
    return responses


def steps_around(
    smoothing: Smoothing, grid: Grid, times: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return steps near times, -1 for none, and weights of their accelerations, (M, 5) each.

    The weights are those of `corrections`.
    """
    steps = step_at(times, grid.step)[:, None] + _AROUND
    within = (steps >= 0) & (steps < grid.knots - 1)  # accelerations are zero elsewhere
    return np.where(within, steps, -1), corrections(smoothing, grid.step, times)


def _of_knot(smoothing: Smoothing, order: int, s: FloatArray, passed: bool) -> FloatArray:
    """Return the contribution of a knot's jump to a derivative of the accelerations, (M,).

    Args:
        smoothing: the averages.
        order: of the derivative; negative for integrals, of which -2 are the positions.
        s: times since the knot [s], shape (M,).
        passed: whether the knot is passed at these times.
    """
    before = np.minimum(-s if passed else s, 0.0)
    # averaged steps less the step itself, and their integrals: odd and even by turns
    sign = -1.0 if passed and order % 2 == 0 else 1.0
    return sign * _power(smoothing, order, before)


def _power(smoothing: Smoothing, order: int, s: FloatArray) -> FloatArray:
    """Return F_(n - order) at times s before a knot, none above 0 [s]."""
    n, w = smoothing.times, smoothing.width
    m, u = n - order, s / w + n / 2.0
    terms = [
        (-1.0) ** j * comb(n, j) * np.where(u > j, np.abs(u - j) ** m, 0.0) for j in range(n + 1)
    ]
    return np.asarray(sum(terms) * w ** (m - n) / factorial(m))
