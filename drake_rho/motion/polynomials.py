"""Piecewise polynomial motions, and their form in Drake."""

from __future__ import annotations

import dataclasses
from math import comb
from typing import TYPE_CHECKING, Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.times import Clock

if TYPE_CHECKING:
    from pydrake.trajectories import PiecewisePolynomial

_LARGEST_JUMPS = 1e-3, 1e-2
"""Largest jumps of positions [m] and velocities [m/s] that count as rounding."""


@dataclasses.dataclass(frozen=True, eq=False)
class Polynomials:
    """Motions of N vehicles as polynomials in J pieces of time, the same for all."""

    instants: FloatArray
    """times at which pieces begin and end, of a plan since the first knot [s], shape (J + 1,)"""
    coefficients: FloatArray
    """coefficients of the powers of the time since a piece began, from the lowest up: [m], [m/s],
    [m/s²], …, shape (N, J, 3, D + 1)"""
    resolution: float = 0.0
    """largest error of coefficients by the digits of a file, in their units; 0 if it has all"""

    @classmethod
    def through(cls, times: FloatArray, positions: FloatArray) -> Self:
        """Return the motion of one vehicle along straight lines between samples.

        Args:
            times: increasing times [s], shape (M,).
            positions: positions at these times [m], shape (M, 3).
        """
        slopes = np.diff(positions, axis=0) / np.diff(times)[:, None]
        return cls(times, np.stack([positions[:-1], slopes], axis=-1)[None])

    @classmethod
    def lasting(
        cls, durations: FloatArray, coefficients: FloatArray, resolution: float = 0.0
    ) -> Self:
        """Return the motion of one vehicle from time 0 on, by the durations of its pieces.

        Args:
            durations: durations [s], shape (J,).
            coefficients: coefficients as in the field, shape (J, 3, D + 1).
            resolution: as in the field.
        """
        return cls(np.append(0.0, np.cumsum(durations)), coefficients[None], resolution)

    @classmethod
    def of_trajectory(cls, trajectory: PiecewisePolynomial) -> Self:
        """Return the motion of one vehicle from Drake's type, whose values are of shape (3, 1)."""
        pieces = range(trajectory.get_number_of_segments())
        axes = [
            [trajectory.getPolynomial(piece, axis, 0).GetCoefficients() for axis in range(3)]
            for piece in pieces
        ]
        most = max(len(each) for piece in axes for each in piece)
        padded = [[np.pad(each, (0, most - len(each))) for each in piece] for piece in axes]
        return cls(np.array(trajectory.get_segment_times()), np.array(padded)[None])

    def trajectory(self, vehicle: int, start: float) -> PiecewisePolynomial:
        """Return a vehicle's motion as Drake's type, on a clock with the first knot at `start`."""
        from pydrake.polynomial import Polynomial
        from pydrake.trajectories import PiecewisePolynomial

        pieces = [
            np.array([[Polynomial(axis)] for axis in piece]) for piece in self.coefficients[vehicle]
        ]
        return PiecewisePolynomial(pieces, start + self.instants)

    def delayed(self, seconds: float) -> Polynomials:
        """Return the motions that begin later by a time [s]."""
        return dataclasses.replace(self, instants=self.instants + seconds)

    @property
    def jumps(self) -> tuple[float, float]:
        """Largest jumps of positions [m] and velocities [m/s] that the resolution can explain.

        A coefficient of s^k is multiplied by the k-th power of the duration of its piece, and that
        of the next piece by 1. Jumps beyond `_LARGEST_JUMPS` are no rounding of use to anyone.
        """
        if self.resolution == 0.0:
            return 0.0, 0.0
        s, powers = float(np.diff(self.instants).max()), np.arange(self.coefficients.shape[-1])
        each = self.resolution * np.sqrt(3.0)
        slopes = powers[1:] * s ** (powers[1:] - 1.0)
        sums = each * (1.0 + np.sum(s**powers)), each * (1.0 + np.sum(slopes))
        position, velocity = np.minimum(sums, _LARGEST_JUMPS).tolist()
        return position, velocity

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions [m], velocities [m/s] and accelerations [m/s²] at times, (N, M, 3) each.

        Vehicles are at rest before the motion begins and after its end.
        """
        clock = Clock.of(np.diff(self.instants).min(), *self.instants[[0, -1]])
        at_end = clock.same(times, self.instants[-1])  # where the last piece still counts
        begun = clock.last_begun(self.instants, times)
        c = self._expanded(times, np.where(at_end, len(self.instants) - 2, begun))
        c = np.pad(c, ((0, 0), (0, 0), (0, 0), (0, max(0, 3 - c.shape[-1]))))
        return c[..., 0], c[..., 1], 2.0 * c[..., 2]

    def cut(self, instants: FloatArray) -> Polynomials:
        """Return the motions in pieces between other instants, among which are all of their own.

        Vehicles are at rest before the motion begins and from its end on.
        """
        middles = (instants[:-1] + instants[1:]) / 2.0
        pieces = np.searchsorted(self.instants, middles, side="right") - 1
        return Polynomials(instants, self._expanded(instants[:-1], pieces))

    def _expanded(self, times: FloatArray, pieces: IntArray) -> FloatArray:
        """Return the coefficients of powers of the time since some times, shape (N, M, 3, D + 1).

        Args:
            times: these times [s], shape (M,).
            pieces: number of the piece of each, counted from 0, shape (M,): less before the motion
                begins, more after its end.
        """
        durations = np.diff(self.instants)
        begun, ended = pieces >= 0, pieces >= len(durations)
        k = np.clip(pieces, 0, len(durations) - 1)
        s = np.where(ended, durations[-1], np.where(begun, times - self.instants[k], 0.0))
        powers = np.arange(self.coefficients.shape[-1])
        degrees = powers[:, None] - powers  # of a power in another's share
        shares = np.array([[comb(m, i) for i in powers] for m in powers])
        shift = shares * s[:, None, None] ** np.maximum(degrees, 0)
        found = np.einsum("njxm,jmi->njxi", self.coefficients[:, k], shift)
        found[:, ~begun | ended, :, 1:] = 0.0
        return np.asarray(found)
