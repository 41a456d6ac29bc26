"""Steps of motions in normalised time, for the verification between the knots."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class Steps:
    """Steps of motions: in step m the position is p[m] + u v[m] + u²/2 a[m], with u from 0 to 1."""

    p: FloatArray
    """positions at the beginning [m], shape (M, D)"""
    v: FloatArray
    """velocities at the beginning [m per step], shape (M, D)"""
    a: FloatArray
    """accelerations [m per step²], shape (M, D)"""

    @classmethod
    def of(cls, step: float | FloatArray, p: FloatArray, v: FloatArray, a: FloatArray) -> Self:
        """Return the steps of motions, one motion after another.

        Args:
            step: h, or the duration of each step, shape (K-1, 1) [s].
            p: positions at the knots [m], shape (..., K, D).
            v: velocities at the knots [m/s], shape (..., K, D).
            a: accelerations in the steps [m/s²], shape (..., K-1, D).
        """
        each = (p[..., :-1, :], step * v[..., :-1, :], step**2 * a)
        return cls(*(array.reshape(-1, array.shape[-1]) for array in each))

    def select(self, which: IntArray) -> Steps:
        """Return the steps with the given indices."""
        return Steps(self.p[which], self.v[which], self.a[which])

    def at(self, which: IntArray, u: FloatArray) -> FloatArray:
        """Return positions (P, S, D) in the steps `which`, shape (P,), at moments u, (P, S)."""
        p, v, a = (array[which, None] for array in (self.p, self.v, self.a))
        u = u[..., None]
        positions: FloatArray = p + u * (v + u / 2 * a)
        return positions

    @cached_property
    def speeds(self) -> FloatArray:
        """Maximum speed in each step, attained at one of its ends [m per step], shape (M,)."""
        ends = np.linalg.norm(np.stack([self.v, self.v + self.a]), axis=2)
        speeds: FloatArray = ends.max(axis=0)
        return speeds

    @cached_property
    def acceleration_norms(self) -> FloatArray:
        """Norm of the acceleration in each step [m per step²], shape (M,)."""
        acceleration_norms: FloatArray = np.linalg.norm(self.a, axis=1)
        return acceleration_norms

    @cached_property
    def coordinate_bounds(self) -> FloatArray:
        """Upper bound of the coordinates' absolute values in each step [m], shape (M,)."""
        coordinate_bounds: FloatArray = np.abs(self.p).max(axis=1, initial=0.0) + self.speeds
        return coordinate_bounds
