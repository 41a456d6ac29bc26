"""The error of a vehicle under a sampled feedback: what each of its causes does to it later.

The unit of time is the sample δ and that of acceleration m/s², so positions are in units of δ² and
velocities in units of δ (m/s² times s² and s). With the gains α = k_p δ² and β = k_v δ nothing
here has another unit. The axes do not mix, and one is looked at.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

WIND_AT_END, WIND_AT_BEGIN, POSITION_ERROR, VELOCITY_ERROR, POSITION, VELOCITY = range(6)
"""Causes of an error: wind at the end and at the beginning of a sample, errors of the estimate,
error at the beginning of the flight."""

_A: Final = np.array([[1.0, 1.0], [0.0, 1.0]])
"""What a sample makes of position and velocity."""

_B: Final = np.array([0.5, 1.0])
"""What an acceleration of 1 adds to them in a sample."""

_NEGLIGIBLE = 1e-18
"""An error that has decayed to this part of what it was is beyond the rounding of any sum."""

_PER_CHUNK = 20_000
"""How many numbers to have in hand at once: a few arrays of them stay in the cache."""


def transition(gains: tuple[float, float], delay: int) -> FloatArray:
    """What a sample makes of (e_p, e_v) and the feedback decided on, shape (2 + d, 2 + d).

    The feedback of a sample is -α e_p - β e_v of d samples ago; in between it is on its way.
    """
    F = np.zeros((2 + delay, 2 + delay))
    F[:2, :2] = _A
    if delay == 0:
        F[:2] -= np.outer(_B, gains)
    else:
        F[:2, 2] = _B  # the oldest acts
        F[2:-1, 3:] = np.eye(delay - 1)  # the others move up
        F[-1, :2] = np.negative(gains)
    return F


def is_stable(gains: tuple[float, float], delay: int) -> bool:
    """Whether every error decays under the feedback."""
    return bool(np.abs(np.linalg.eigvals(transition(gains, delay))).max() < 1.0 - 1e-9)


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """What each cause adds to position, velocity and feedback at samples after it."""

    values: FloatArray
    """position and velocity at the beginning of the sample, and the feedback in it, m samples after
    a cause of size 1, shape (3, 6, L); beyond L they have decayed, or the flight is over"""

    @classmethod
    def of(cls, gains: tuple[float, float], delay: int, samples: int) -> Responses:
        """The responses in a flight of so many samples."""
        own = _after_initial(gains, delay, samples)
        values = np.zeros((3, 6, own.shape[2]))
        values[:, POSITION:] = own
        # Wind in a sample leaves (r, 1) at its end, r before which it blew; one for each end.
        values[:, WIND_AT_END, 1:] = own[:, 1, :-1]
        values[:, WIND_AT_BEGIN, 1:] = own[:, 0, :-1] + own[:, 1, :-1]
        command = np.zeros((3, own.shape[2]))  # the feedback of one sample, 1
        command[2, 0], command[:, 1:] = 1.0, 0.5 * own[:, 0, :-1] + own[:, 1, :-1]
        command = command[:, : max(0, own.shape[2] - delay)]
        values[:, POSITION_ERROR, delay:] = -gains[0] * command
        values[:, VELOCITY_ERROR, delay:] = -gains[1] * command
        return cls(values)

    def __len__(self) -> int:
        """L, after how many samples they have decayed, or the flight is over."""
        return int(self.values.shape[2])

    def at(self, quantity: Quantity, parts: FloatArray) -> FloatArray:
        """Responses inside samples: of position, velocity or feedback (acceleration).

        Args:
            quantity: which of the three.
            parts: how much of the sample has passed, from 0 to 1, shape (M,).

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
        """The largest norm that a quantity of the error can have, at parts of every sample.

        Args:
            quantity: position, velocity or acceleration (of the feedback).
            parts: how much of a sample has passed, from 0 to 1, shape (M,).
            sizes: of wind, position errors, velocity errors, and position and velocity at first.

        Returns:
            Radii in samples 0 to L - 1, shape (M, L). That of sample L - 1 is also that of all
            later ones, where the flight has more.
        """
        parts = np.asarray(parts, dtype=np.float64)
        W, errors, firsts = sizes[0], sizes[1:3], sizes[3:]
        radii = np.zeros((len(parts), len(self)))
        if W > 0.0:
            wind = self._at(quantity, parts, np.array([WIND_AT_END, WIND_AT_BEGIN]))
            radii += W * _integral(wind[:, 0], wind[:, 1])
        for cause, size in zip((POSITION_ERROR, VELOCITY_ERROR), errors, strict=True):
            if size > 0.0:
                radii += size * np.abs(self._at(quantity, parts, np.array([cause]))[:, 0])
        radii = np.cumsum(radii, axis=1)
        for cause, size in zip((POSITION, VELOCITY), firsts, strict=True):
            if size > 0.0:
                radii += size * np.abs(self._at(quantity, parts, np.array([cause]))[:, 0])
        now = {"position": parts**2 / 2.0, "velocity": parts}  # wind of the sample itself
        if quantity in now:
            radii += W * now[quantity][:, None]
        return radii

    def radii_at(
        self, quantity: Quantity, samples: IntArray, parts: FloatArray, sizes: FloatArray
    ) -> FloatArray:
        """`radii` at one part of one sample each, arrays of any one shape."""
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
    """The integral over a unit of time of the absolute value of what is linear between its ends."""
    a, b = np.abs(first), np.abs(last)
    total = a + b
    crossing = (first > 0.0) & (last < 0.0) | (first < 0.0) & (last > 0.0)
    np.divide(a * a + b * b, total, out=total, where=crossing)  # two triangles
    return np.asarray(total / 2.0)


def _after_initial(gains: tuple[float, float], delay: int, samples: int) -> FloatArray:
    """Position, velocity and feedback at samples m after a first error, shape (3, 2, L).

    Powers of the transition by doubling, until they have decayed or the flight is over.
    """
    power = transition(gains, delay)
    states = np.eye(2 + delay)[None, :, :2]
    while len(states) < samples and np.abs(states[len(states) // 2 :]).max() > _NEGLIGIBLE:
        states, power = np.concatenate([states, power @ states]), power @ power
    lasting = np.abs(states[:samples]).max(axis=(1, 2)) > _NEGLIGIBLE
    known = int(np.flatnonzero(lasting)[-1]) + 1
    length = min(samples, known + 2 * delay + 2)  # until feedback on feedback has come to rest
    after = np.zeros((3, 2, length))
    after[:2, :, :known] = np.moveaxis(states[:known, :2], 0, 2)
    after[2, :, delay:] = -np.tensordot(gains, after[:2, :, : max(0, length - delay)], 1)
    return after
