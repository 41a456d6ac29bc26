"""Steps of motions in normalised time, for the verification between the knots."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from math import comb, perm
from typing import Self

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.system.table import Table


@dataclasses.dataclass(frozen=True)
class Steps(Table):
    """Steps of motions: in step m the position is p[m] + u v[m] + u²/2 a[m], with u from 0 to 1.

    Smooth motions have n higher powers of u too; n is 0 where accelerations are constant.
    """

    p: FloatArray
    """positions at the beginning [m], shape (M, D)"""
    v: FloatArray
    """velocities at the beginning [m per step], shape (M, D)"""
    a: FloatArray
    """accelerations, at the beginning for smooth motions [m per step²], shape (M, D)"""
    higher: FloatArray
    """coefficients of the powers of u from the third up [m], shape (M, n, D)"""

    @classmethod
    def of(
        cls,
        step: float | FloatArray,
        p: FloatArray,
        v: FloatArray,
        a: FloatArray,
        higher: FloatArray | None = None,
    ) -> Self:
        """Return the steps of motions, one motion after another.

        Args:
            step: h, or the duration of each step, shape (K-1, 1) [s].
            p: positions at the knots [m], shape (..., K, D).
            v: velocities at the knots [m/s], shape (..., K, D).
            a: accelerations in the steps [m/s²], shape (..., K-1, D).
            higher: coefficients of the time from the third power up, shape (..., K-1, n, D); no
                higher powers if not given.
        """
        if higher is None:
            higher = without_higher(a)
        scaled = powers_of(np.asarray(step)[..., None], higher)
        each = (p[..., :-1, :], step * v[..., :-1, :], step**2 * a)
        p, v, a = (array.reshape(-1, array.shape[-1]) for array in each)
        return cls(p, v, a, scaled.reshape(len(p), *higher.shape[-2:]))

    def less(self, other: Steps) -> Steps:
        """Return the steps relative to others."""
        higher = self.higher - other.higher
        return Steps(self.p - other.p, self.v - other.v, self.a - other.a, higher)

    def derivative(self, order: int, durations: FloatArray) -> Steps:
        """Return derivatives of smooth motions by time, as curves of u in the same steps.

        Args:
            order: 1 for velocities, 2 for accelerations, 3 for jerks.
            durations: durations of the steps [s], shape (M,).
        """
        c = self._coefficients
        for _ in range(order):
            c = [m * each / durations[:, None] for m, each in enumerate(c)][1:]
        c += [np.zeros_like(self.p)] * (3 - len(c))
        higher = np.reshape(c[3:], (len(c) - 3, *self.p.shape))
        return Steps(c[0], c[1], 2.0 * c[2], np.moveaxis(higher, 0, 1))

    def at(self, which: IntArray, u: FloatArray) -> FloatArray:
        """Return positions (P, S, D) in the steps `which`, shape (P,), at moments u, (P, S)."""
        p, v, a, u = self.p[which, None], self.v[which, None], self.a[which, None], u[..., None]
        positions: FloatArray = p + u * (v + u / 2 * a)
        for m in range(self.higher.shape[1]):
            positions += u ** (3 + m) * self.higher[which, m, None]
        return positions

    @cached_property
    def speeds(self) -> FloatArray:
        """Upper bound of the speed in each step [m per step], shape (M,).

        It is attained at an end where accelerations are constant.
        """
        return self._greatest_derivative(1)

    @cached_property
    def acceleration_norms(self) -> FloatArray:
        """Upper bound of the acceleration's norm in each step [m per step²], shape (M,).

        It is that norm where accelerations are constant.
        """
        return self._greatest_derivative(2)

    @property
    def _coefficients(self) -> list[FloatArray]:
        """Coefficients of the powers of u, from the lowest up, shape (M, D) each."""
        return [self.p, self.v, self.a / 2.0, *self.higher.swapaxes(0, 1)]

    def _greatest_derivative(self, order: int) -> FloatArray:
        """Return an upper bound of a derivative's norm in each step, by u, shape (M,).

        A polynomial is in the convex hull of its Bézier control points.
        """
        c = [perm(m, order) * each for m, each in enumerate(self._coefficients)][order:]
        degree, greatest = len(c) - 1, np.zeros(len(self.p))
        for i in range(len(c)):
            point = c[0]
            for m in range(1, i + 1):
                point = point + comb(i, m) / comb(degree, m) * c[m]
            greatest = np.maximum(greatest, np.sqrt(np.vecdot(point, point)))
        return greatest

    @cached_property
    def coordinate_bounds(self) -> FloatArray:
        """Upper bound of the coordinates' absolute values in each step [m], shape (M,)."""
        coordinate_bounds: FloatArray = np.abs(self.p).max(axis=1, initial=0.0) + self.speeds
        return coordinate_bounds


def without_higher(accelerations: FloatArray) -> FloatArray:
    """Return no coefficients of higher powers, for accelerations (..., D): shape (..., 0, D)."""
    return np.zeros((*accelerations.shape[:-1], 0, accelerations.shape[-1]))


def powers_of(u: FloatArray, higher: FloatArray) -> FloatArray:
    """Return coefficients (..., n, D) times u (..., 1, 1) to the powers from the third up."""
    return np.asarray(higher * u ** np.arange(3.0, 3.0 + higher.shape[-2])[:, None])
