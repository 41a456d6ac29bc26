"""Responses of a vehicle's tracking error to its causes, under sampled feedback.

The unit of time is the sample δ and that of acceleration is m/s², so positions are in units of δ²
and velocities in units of δ (m/s² times s² and s). With the gains α = k_p δ² and β = k_v δ, no
other units occur. The axes are decoupled, and one of them is considered.
"""

from __future__ import annotations

import dataclasses
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from drake_rho.motion.dropouts import Effects
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

WIND_AT_END, WIND_AT_BEGIN, POSITION_ERROR, VELOCITY_ERROR, POSITION, VELOCITY = range(6)
"""Indices of the causes of an error: wind at the end and at the beginning of a sample, estimation
errors of position and velocity, initial errors of position and velocity."""

_A: Final = np.array([[1.0, 1.0], [0.0, 1.0]])
"""Transition matrix of position and velocity over one sample."""

_B: Final = np.array([0.5, 1.0])
"""Change of position and velocity by a unit acceleration during one sample."""

_CAUSES: Final = ([WIND_AT_END, WIND_AT_BEGIN], [2], [3], [4], [5])
"""Causes with given sizes: wind, estimation errors, and initial errors."""

_NEGLIGIBLE = 1e-18
"""Part of its initial size at which a decayed error vanishes in the rounding of any sum."""

_PER_CHUNK = 20_000
"""Number of values computed at a time: a few arrays of this size fit into the cache."""


class Measurements(NamedTuple):
    """Measurements that the feedback of a sample is computed from."""

    delay: int = 0
    """number of samples from a measurement to the feedback that answers it"""
    dropouts: int = 0
    """largest number of measurements in a row that are lost"""
    predicted: bool = True
    """whether the feedback predicts the present state from the newest measurement that has arrived
    and the feedback since; if not, it is linear in the measurement of `delay` samples ago"""

    @property
    def ahead(self) -> int:
        """Number of samples over which the feedback predicts the state if no measurement is lost.

        Since the prediction includes the feedback itself, errors then decay as without a delay.
        """
        return self.delay if self.predicted else 0

    @property
    def queued(self) -> int:
        """Number of feedback values that are computed and do not act yet."""
        return self.delay - self.ahead


def transition(gains: tuple[float, float], queued: int) -> FloatArray:
    """Return the transition matrix over one sample, shape (2 + d, 2 + d).

    The state consists of the errors (e_p, e_v) and of the d queued feedback values
    (`Measurements.queued`). The feedback of a sample is -α e_p - β e_v of d samples ago.
    """
    F = np.zeros((2 + queued, 2 + queued))
    F[:2, :2] = _A
    if queued == 0:
        F[:2] -= np.outer(_B, gains)
    else:
        F[:2, 2] = _B  # the oldest value is applied
        F[2:-1, 3:] = np.eye(queued - 1)  # the others move up in the queue
        F[-1, :2] = np.negative(gains)
    return F


def is_stable(gains: tuple[float, float], queued: int) -> bool:
    """Return whether every error decays under the feedback, with `Measurements.queued` values."""
    return bool(np.abs(np.linalg.eigvals(transition(gains, queued))).max() < 1.0 - 1e-9)


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Responses of position, velocity and feedback to each cause, at samples after it."""

    values: FloatArray
    """position and velocity at the beginning of the sample, and feedback in it, m samples after a
    cause of size 1, if the next q measurements are lost; shape (1 + dropouts, 3, 6, L). L samples
    after the cause they have decayed, or the flight has ended"""

    @classmethod
    def of(cls, gains: tuple[float, float], measurements: Measurements, samples: int) -> Responses:
        """Return the responses in a flight of a number of samples."""
        delay, dropouts, _ = measurements
        answered = _after_initial(gains, measurements.queued, samples)
        length = min(samples, answered.shape[2] + measurements.ahead + dropouts)
        command = np.zeros((3, length))  # response to a unit feedback in one sample
        known = answered[:, :, : length - 1]
        command[2, 0] = 1.0
        command[:, 1 : 1 + known.shape[2]] = 0.5 * known[:, 0] + known[:, 1]
        values = np.zeros((1 + dropouts, 3, 6, length))
        estimates = np.zeros((2, 3, length))  # responses to estimation errors
        for lost, response in enumerate(values):
            drift = measurements.ahead + lost  # samples before the feedback answers
            initial = _drifted(answered, drift, length)
            response[:, POSITION:] = initial
            # A wind impulse leaves (r, 1) at the end of its sample, a time r later; linear in r.
            response[:, WIND_AT_END, 1:] = initial[:, 1, :-1]
            response[:, WIND_AT_BEGIN, 1:] = initial[:, 0, :-1] + initial[:, 1, :-1]
            # An estimate is used until the next one arrives, each time propagated to the present.
            later, acting = delay + lost, command[:, : max(0, length - delay - lost)]
            estimates[0, :, later:] -= gains[0] * acting
            estimates[1, :, later:] -= (gains[1] + gains[0] * drift) * acting
            response[:, POSITION_ERROR], response[:, VELOCITY_ERROR] = estimates
        return cls(values)

    def __len__(self) -> int:
        """Return the number L of samples until the responses have decayed or the flight ends."""
        return int(self.values.shape[3])

    def radii(self, quantity: Quantity, parts: npt.ArrayLike, sizes: FloatArray) -> FloatArray:
        """Return the largest possible norm of the error of a quantity, at parts of every sample.

        Args:
            quantity: position, velocity or acceleration (of the feedback).
            parts: elapsed parts of a sample, from 0 to 1, shape (M,).
            sizes: of wind, position and velocity estimation errors, initial position and velocity
                errors, shape (5,).

        Returns:
            Radii in samples 0 to L - 1, shape (M, L). Those of sample L - 1 also hold for all later
            samples, if the flight has any.
        """
        parts = np.asarray(parts, dtype=np.float64)
        if len(self.values) > 1:
            radii = self._effects(quantity, parts, sizes).largest()
        else:
            radii = self._sum((0, 1, 2), quantity, parts, sizes)
            np.cumsum(radii, axis=1, out=radii)
            radii = self._sum((3, 4), quantity, parts, sizes, total=radii)
        present = {"position": parts**2 / 2.0, "velocity": parts}  # wind of the sample itself
        if quantity in present:
            radii += sizes[0] * present[quantity][:, None]
        return radii

    def worst(
        self, quantity: Quantity, part: float, sample: int, sizes: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return the responses that lead to a radius, and which measurements are lost.

        Args:
            quantity: position, velocity or acceleration (of the feedback).
            part: elapsed part of the sample, from 0 to 1.
            sample: sample j, counted from 0.
            sizes: as for `radii`.

        Returns:
            Responses to the causes of 0, 1, ... samples ago, shape (6, n), and whether the
            measurements of these samples are lost, shape (n,). No cause of n or more samples ago
            has an effect.
        """
        parts, every = np.array([part]), np.arange(6)
        lost = range(len(self.values))
        found = np.stack([self._at(quantity, parts, every, q)[0] for q in lost])
        ages = np.arange(min(len(self), sample + 1))
        after = self._effects(quantity, parts, sizes).lost_after(len(ages) - 1)
        x, is_lost = found[after[:-1], :, ages].T, after[1:] > 0
        x[POSITION_ERROR, is_lost] = x[VELOCITY_ERROR, is_lost] = 0.0
        x[POSITION:, -1] = found[after[-1], POSITION:, ages[-1]]
        return x, is_lost

    def _effects(self, quantity: Quantity, parts: FloatArray, sizes: FloatArray) -> Effects:
        """Return the largest effects of single causes for every number of lost measurements."""
        lost = range(len(self.values))
        effects = (
            np.stack([self._sum(numbers, quantity, parts, sizes, q) for q in lost])
            for numbers in ((0,), (1, 2), (3, 4))
        )
        return Effects(*effects)

    def _sum(
        self,
        numbers: tuple[int, ...],
        quantity: Quantity,
        parts: FloatArray,
        sizes: FloatArray,
        lost: int = 0,
        total: FloatArray | None = None,
    ) -> FloatArray:
        """Return the sum of the largest effects of causes, given by their numbers in `sizes`.

        It has the shape (M, L), and is added to a total if one is given.
        """
        if total is None:
            total = np.zeros((len(parts), len(self)))
        for number in numbers:
            if sizes[number] > 0.0:
                found = self._at(quantity, parts, np.array(_CAUSES[number]), lost)
                total += sizes[number] * _largest(*found.swapaxes(0, 1))
        return total

    def _at(self, quantity: Quantity, parts: FloatArray, causes: IntArray, lost: int) -> FloatArray:
        """Return the responses to causes, at parts of samples, shape (M, C, L)."""
        t, (p, v, u) = parts[:, None, None], self.values[lost][:, causes]
        if quantity == "position":
            return np.asarray(p + t * v + t**2 / 2.0 * u)
        if quantity == "velocity":
            return np.asarray(v + t * u)
        return np.repeat(u[None], len(parts), axis=0)

    def radii_at(
        self, quantity: Quantity, samples: IntArray, parts: FloatArray, sizes: FloatArray
    ) -> FloatArray:
        """Return `radii` at one part of one sample each; arrays have the same, arbitrary shape."""
        different, which = np.unique(parts, return_inverse=True)
        order = np.argsort(which, axis=None)
        which, j = which.ravel()[order], samples.ravel()[order]
        found = np.empty(len(order))
        chunk = max(1, _PER_CHUNK // (len(self) * len(self.values)))
        for first in range(0, len(different), chunk):
            table = self.radii(quantity, different[first : first + chunk], sizes)
            here = slice(*np.searchsorted(which, (first, first + chunk)))
            found[order[here]] = table[which[here] - first, j[here]]
        return found.reshape(parts.shape)


def _largest(first: FloatArray, last: FloatArray | None = None) -> FloatArray:
    """Return the largest effects of a cause with a given response, or with one linear in time.

    These are the absolute responses, or the integrals of |f| over a unit of time, where f is linear
    from `first` to `last`.
    """
    if last is None:
        return np.abs(first)
    a, b = np.abs(first), np.abs(last)
    total = a + b
    crossing = (first > 0.0) & (last < 0.0) | (first < 0.0) & (last > 0.0)
    np.divide(a * a + b * b, total, out=total, where=crossing)  # the area of two triangles
    return np.asarray(total / 2.0)


def _drifted(answered: FloatArray, drift: int, length: int) -> FloatArray:
    """Return the responses to an initial error that no feedback answers for some samples.

    Args:
        answered: responses without a drift, shape (3, 2, M).
        drift: number of samples before the feedback acts, as if it had known the error throughout.
        length: number L of samples.

    Returns:
        Responses of shape (3, 2, L).
    """
    if drift == 0 and answered.shape[2] == length:
        return answered
    after = np.zeros((3, 2, length))
    m = np.arange(min(drift, length))
    after[0, 0, m] = after[1, 1, m] = 1.0
    after[0, 1, m] = m
    known = answered[:, :, : length - len(m)]
    rest = after[:, :, len(m) : len(m) + known.shape[2]]
    rest[:, 0], rest[:, 1] = known[:, 0], known[:, 1] + drift * known[:, 0]
    return after


def _after_initial(gains: tuple[float, float], queued: int, samples: int) -> FloatArray:
    """Return position, velocity and feedback m samples after an initial error, shape (3, 2, L).

    Powers of the transition matrix are computed by doubling, until they have decayed or the flight
    ends.
    """
    power = transition(gains, queued)
    states = np.eye(2 + queued)[None, :, :2]
    while len(states) < samples and np.abs(states[len(states) // 2 :]).max() > _NEGLIGIBLE:
        states, power = np.concatenate([states, power @ states]), power @ power
    lasting = np.abs(states[:samples]).max(axis=(1, 2)) > _NEGLIGIBLE
    known = int(np.flatnonzero(lasting)[-1]) + 1
    length = min(samples, known + 2 * queued + 2)  # until responses to delayed feedback have ended
    after = np.zeros((3, 2, length))
    after[:2, :, :known] = np.moveaxis(states[:known, :2], 0, 2)
    after[2, :, queued:] = -np.tensordot(gains, after[:2, :, : max(0, length - queued)], 1)
    return after
