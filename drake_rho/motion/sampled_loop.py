"""Responses of a vehicle's tracking error to its causes, under sampled feedback.

The unit of time is the sample δ and that of acceleration is m/s², so positions are in units of δ²
and velocities in units of δ (m/s² times s² and s). With the gains α = k_p δ² and β = k_v δ, no
other units occur. The axes are decoupled, and one of them is considered.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

WIND_AT_END, WIND_AT_BEGIN, POSITION_ERROR, VELOCITY_ERROR, POSITION, VELOCITY = range(6)
"""Indices of the causes of an error: wind at the end and at the beginning of a sample, estimation
errors of position and velocity, initial errors of position and velocity."""

_A: Final = np.array([[1.0, 1.0], [0.0, 1.0]])
"""Transition matrix of position and velocity over one sample."""

_B: Final = np.array([0.5, 1.0])
"""Change of position and velocity by a unit acceleration during one sample."""

_NEGLIGIBLE = 1e-18
"""Part of its initial size at which a decayed error is below the rounding of any sum."""

_PER_CHUNK = 20_000
"""Number of values computed at a time: a few arrays of this size fit into the cache."""


def transition(gains: tuple[float, float], delay: int) -> FloatArray:
    """Return the transition matrix over one sample, shape (2 + d, 2 + d).

    The state consists of the errors (e_p, e_v) and, with a delay of d samples, of the d feedback
    values computed but not yet applied. The feedback of a sample is -α e_p - β e_v of d samples
    ago.
    """
    F = np.zeros((2 + delay, 2 + delay))
    F[:2, :2] = _A
    if delay == 0:
        F[:2] -= np.outer(_B, gains)
    else:
        F[:2, 2] = _B  # the oldest value is applied
        F[2:-1, 3:] = np.eye(delay - 1)  # the others move up in the queue
        F[-1, :2] = np.negative(gains)
    return F


def is_stable(gains: tuple[float, float], delay: int) -> bool:
    """Return whether every error decays under the feedback."""
    return bool(np.abs(np.linalg.eigvals(transition(gains, delay))).max() < 1.0 - 1e-9)


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Responses of position, velocity and feedback to each cause, at samples after it."""

    values: FloatArray
    """position and velocity at the beginning of the sample, and feedback in it, m samples after a
    cause of size 1, shape (3, 6, L); L samples after the cause they have decayed, or the flight has
    ended"""

    @classmethod
    def of(cls, gains: tuple[float, float], delay: int, samples: int) -> Responses:
        """Return the responses in a flight of a number of samples."""
        initial = _after_initial(gains, delay, samples)
        values = np.zeros((3, 6, initial.shape[2]))
        values[:, POSITION:] = initial
        # A wind impulse leaves (r, 1) at the end of its sample, a time r later; linear in r.
        values[:, WIND_AT_END, 1:] = initial[:, 1, :-1]
        values[:, WIND_AT_BEGIN, 1:] = initial[:, 0, :-1] + initial[:, 1, :-1]
        command = np.zeros((3, initial.shape[2]))  # response to a unit feedback in one sample
        command[2, 0], command[:, 1:] = 1.0, 0.5 * initial[:, 0, :-1] + initial[:, 1, :-1]
        command = command[:, : max(0, initial.shape[2] - delay)]
        values[:, POSITION_ERROR, delay:] = -gains[0] * command
        values[:, VELOCITY_ERROR, delay:] = -gains[1] * command
        return cls(values)

    def __len__(self) -> int:
        """Return the number L of samples until the responses have decayed or the flight ends."""
        return int(self.values.shape[2])

    def at(self, quantity: Quantity, parts: FloatArray) -> FloatArray:
        """Return responses of position, velocity or feedback (acceleration) inside samples.

        Args:
            quantity: one of the three.
            parts: elapsed parts of the samples, from 0 to 1, shape (M,).

        Returns:
            Responses of shape (M, 6, L).
        """
        return self._at(quantity, parts, np.arange(6))

    def _at(self, quantity: Quantity, parts: FloatArray, causes: IntArray) -> FloatArray:
        t, (p, v, u) = parts[:, None, None], self.values[:, causes]
        if quantity == "position":
            return np.asarray(p + t * v + t**2 / 2.0 * u)
        if quantity == "velocity":
            return np.asarray(v + t * u)
        return np.repeat(u[None], len(parts), axis=0)

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
        W, errors, initial = sizes[0], sizes[1:3], sizes[3:]
        radii = np.zeros((len(parts), len(self)))
        if W > 0.0:
            wind = self._at(quantity, parts, np.array([WIND_AT_END, WIND_AT_BEGIN]))
            radii += W * _integral(wind[:, 0], wind[:, 1])
        for cause, size in zip((POSITION_ERROR, VELOCITY_ERROR), errors, strict=True):
            if size > 0.0:
                radii += size * np.abs(self._at(quantity, parts, np.array([cause]))[:, 0])
        radii = np.cumsum(radii, axis=1)
        for cause, size in zip((POSITION, VELOCITY), initial, strict=True):
            if size > 0.0:
                radii += size * np.abs(self._at(quantity, parts, np.array([cause]))[:, 0])
        present = {"position": parts**2 / 2.0, "velocity": parts}  # wind of the sample itself
        if quantity in present:
            radii += W * present[quantity][:, None]
        return radii

    def radii_at(
        self, quantity: Quantity, samples: IntArray, parts: FloatArray, sizes: FloatArray
    ) -> FloatArray:
        """Return `radii` at one part of one sample each; arrays have the same, arbitrary shape."""
        different, which = np.unique(parts, return_inverse=True)
        order = np.argsort(which, axis=None)
        which, j = which.ravel()[order], samples.ravel()[order]
        found = np.empty(len(order))
        chunk = max(1, _PER_CHUNK // len(self))
        for first in range(0, len(different), chunk):
            table = self.radii(quantity, different[first : first + chunk], sizes)
            here = slice(*np.searchsorted(which, (first, first + chunk)))
            found[order[here]] = table[which[here] - first, j[here]]
        return found.reshape(parts.shape)


def _integral(first: FloatArray, last: FloatArray) -> FloatArray:
    """Return the integrals of |f| over a unit of time, where f is linear from `first` to `last`."""
    a, b = np.abs(first), np.abs(last)
    total = a + b
    crossing = (first > 0.0) & (last < 0.0) | (first < 0.0) & (last > 0.0)
    np.divide(a * a + b * b, total, out=total, where=crossing)  # the area of two triangles
    return np.asarray(total / 2.0)


def _after_initial(gains: tuple[float, float], delay: int, samples: int) -> FloatArray:
    """Return position, velocity and feedback m samples after an initial error, shape (3, 2, L).

    Powers of the transition matrix are computed by doubling, until they have decayed or the flight
    ends.
    """
    power = transition(gains, delay)
    states = np.eye(2 + delay)[None, :, :2]
    while len(states) < samples and np.abs(states[len(states) // 2 :]).max() > _NEGLIGIBLE:
        states, power = np.concatenate([states, power @ states]), power @ power
    lasting = np.abs(states[:samples]).max(axis=(1, 2)) > _NEGLIGIBLE
    known = int(np.flatnonzero(lasting)[-1]) + 1
    length = min(samples, known + 2 * delay + 2)  # until responses to delayed feedback have ended
    after = np.zeros((3, 2, length))
    after[:2, :, :known] = np.moveaxis(states[:known, :2], 0, 2)
    after[2, :, delay:] = -np.tensordot(gains, after[:2, :, : max(0, length - delay)], 1)
    return after
