"""Dual function of a Lagrangian: its minimum over motions as a function of the multipliers.

It is concave. Per axis, half the Lagrangian's Hessian is H = I - Rᵀ D R for the rows R of curved
terms, and half its linear part is -Kᵀ c for the rows K of all terms, so that its minimum has the
part -cᵀ K H⁻¹ Kᵀ c. Everything follows from inner products of the rows, which are few: with
M = I - sqrt(D) R Rᵀ sqrt(D), det H = det M and

    K H⁻¹ Kᵀ = K Kᵀ + K Rᵀ sqrt(D) M⁻¹ sqrt(D) R Kᵀ.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from drake_rho.analysis.lagrangian import Lagrangian
from drake_rho.scenario.fields import FloatArray

_INSIDE = 0.5
"""Part of the way to a Lagrangian that is not convex, and to prices, at which multipliers start."""

_LEAST = 0.1
"""Least multiplier to start with, as a part of the largest one."""


@dataclasses.dataclass(frozen=True, eq=False)
class Expansion:
    """Dual function and barrier around multipliers x, without a bound on rounding errors."""

    value: float
    """minimum of the Lagrangian"""
    slopes: FloatArray
    """its derivatives, shape (N,)"""
    falls: FloatArray
    """its second derivatives with the opposite sign, shape (N, N)"""
    barrier: float
    """logarithms of all multipliers, of what is left of prices, and of the determinants of H"""
    barrier_slopes: FloatArray
    """derivatives of the barrier, shape (N,)"""
    barrier_falls: FloatArray
    """second derivatives of the barrier with the opposite sign, shape (N, N)"""


class Dual:
    """Dual function of a Lagrangian, of N multipliers x of rows of length one.

    Args:
        lagrangian: the Lagrangian.

    Attributes:
        lagrangian: the Lagrangian.
        degree: number of logarithms in the barrier. Where the dual function with f times the
            barrier is largest, the dual function is at most f times `degree` below its maximum.
    """

    def __init__(self, lagrangian: Lagrangian) -> None:
        self.lagrangian = lagrangian
        curved, affine = lagrangian.curved, lagrangian.affine
        self._count = len(curved)
        # as multipliers of rows of length one, all have about the same curvature
        self._sizes = np.concatenate([1.0 / curved.sizes, np.ones(len(affine))])
        rows = (np.vstack([curved.responses, affine.matrix[:, :, axis]]) for axis in range(3))
        self._products = [each @ each.T for each in rows]
        labels = np.concatenate([curved.slacks, affine.slacks])
        parts = np.concatenate([curved.parts, affine.parts]) * self._sizes
        self._prices = (labels == np.unique(labels[labels >= 0])[:, None]) * parts
        squares = np.sum((curved.scales * curved.offsets) ** 2, axis=1)
        at_zero = (curved.radii - squares / curved.radii) / 2.0
        self._constants = self._sizes * np.concatenate([at_zero, affine.lower])
        self.degree = len(labels) + len(self._prices) + 3 * self._count

    def given(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the multipliers λ, shape (S,), and y, (R,), of the Lagrangian."""
        multipliers = x * self._sizes
        return multipliers[: self._count], multipliers[self._count :]

    def inside(self, weights: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return x near given λ and y, well inside of where the barrier is finite, shape (N,)."""
        x = np.concatenate([weights, multipliers]) / self._sizes
        scale = 1e-3 * (1.0 + abs(self.lagrangian.changes.least))
        x = np.maximum(x, _LEAST * max(float(x.max()), scale))
        loss = 1.0 - self.lagrangian.curvature(self.given(x)[0])  # proportional to λ
        x[: self._count] *= min(1.0, _INSIDE / loss if loss > 0.0 else 1.0)
        if len(self._prices) > 0:
            used = float((self._prices @ x).max())
            x *= min(1.0, _INSIDE / used if used > 0.0 else 1.0)
        return np.asarray(x)

    def around(self, x: FloatArray) -> Expansion | None:
        """Return the dual function around x; None where the barrier is infinite."""
        curved, left = self.lagrangian.curved, 1.0 - self._prices @ x
        if not (np.all(x > 0.0) and np.all(left > 0.0)):
            return None
        (weights, multipliers), count = self.given(x), self._count
        half, radii, used = weights / curved.radii / 2.0, curved.radii, self._prices / left[:, None]
        barrier = float(np.log(x).sum() + np.log(left).sum())
        barrier_slopes = 1.0 / x - used.sum(axis=0)
        barrier_falls = np.diag(1.0 / x**2) + used.T @ used
        value, falls = self._constants @ x + self.lagrangian.changes.least, 0.0 * barrier_falls
        slopes, gradients = self._constants.copy(), self._sizes.copy()
        for axes in self.lagrangian.alike:
            scales = curved.scales[:, axes.start]
            found = _inner_products(self._products[axes], np.sqrt(half) * scales)
            if found is None:
                return None
            inverses, logarithm = found
            per = self._sizes[:count] * scales**2 / radii / 2.0
            for inverse, offsets in zip(inverses, curved.offsets.T[axes], strict=True):
                pulls = np.concatenate([half * scales**2 * offsets, multipliers / 2.0])
                reached = inverse @ pulls  # K v at the minimiser
                value -= float(pulls @ reached)
                slopes[:count] -= per * reached[:count] * (2.0 * offsets + reached[:count])
                slopes[count:] -= reached[count:]
                gradients[:count] = 2.0 * per * (offsets + reached[:count])
                falls += inverse * (gradients / 2.0) * gradients[:, None]
            inner, alike = inverses[0][:count, :count], len(inverses)
            barrier += alike * logarithm
            barrier_slopes[:count] -= alike * per * np.diagonal(inner)
            barrier_falls[:count, :count] += alike * inner**2 * per * per[:, None]
        return Expansion(value, slopes, falls, barrier, barrier_slopes, barrier_falls)


def _inner_products(
    products: list[FloatArray], roots: FloatArray
) -> tuple[list[FloatArray], float] | None:
    """Return K H⁻¹ Kᵀ and log det H for K Kᵀ and sqrt(D); None if H is not positive definite.

    Args:
        products: K Kᵀ of axes with the same H, each of shape (N, N).
        roots: square roots of the diagonal of D, shape (S,).
    """
    if (count := len(roots)) == 0:
        return products, 0.0
    curved, across = products[0][:count, :count], [each[:count, count:] for each in products]
    factor, failed = dpotrf(np.eye(count) - roots[:, None] * curved * roots, lower=1, clean=0)
    if failed:
        return None
    solved = dtrtrs(factor, roots[:, None] * np.hstack([curved, *across]), lower=1)[0]
    of_curved, inverses = solved[:, :count], list[FloatArray]()
    inner = curved + of_curved.T @ of_curved
    by_axis = np.split(solved[:, count:], len(products), axis=1)
    for each, of_affine in zip(products, by_axis, strict=True):
        mixed, inverse = of_curved.T @ of_affine, each.copy()
        inverse[:count, :count] = inner
        inverse[:count, count:] += mixed
        inverse[count:, :count] += mixed.T
        inverse[count:, count:] += of_affine.T @ of_affine
        inverses.append(inverse)
    return inverses, 2.0 * float(np.log(np.diagonal(factor)).sum())
