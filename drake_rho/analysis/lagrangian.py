"""Lagrangian of the non-convex problem, obstacles and pairs not linearised, and its minimum.

With changes v of the motion of least cost that keep the final states (`GroupChanges`), the cost is
norm(v)² more than its cost f:

    L(v) = f + norm(v)² + Σ λ_s (R_s² - norm(p_s(v) - c_s)²) / (2 R_s) + y · (b - A v)

The separation of a pair of vehicles is a term like an obstacle's, with the other vehicle's position
as the centre, the separation as the radius, and z divided by the downwash factor. For every
λ, y >= 0 the minimum of L is a lower bound on the cost of every plan. L is a quadratic that does
not couple the axes. So its minimum has a closed form wherever its Hessians are positive definite.

With a disturbance, obstacles and separations are enlarged by the error radius, and limits are
tightened by it. Planners use the greatest radius of a step throughout the step. A plan is only
required to keep the radius at each instant, so a bound for all plans uses that radius in its rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cached_property
from typing import Self

import numpy as np
from scipy.linalg import eigvalsh
from scipy.linalg.lapack import dpotrf, dpotrs

from drake_rho.analysis.shared_multipliers import SharedMultipliers
from drake_rho.analysis.terms import AffineTerms, CurvedTerms, GroupChanges
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import FloatArray, IntArray

_LEAST_CURVATURE = 1e-6
"""Least eigenvalue of the Hessian, over that of norm(v)², for which the minimum is computed."""

_NEGLIGIBLE = 1e-6
"""Multiplier, relative to the norm of v, up to which a row counts as inactive."""

_ROUNDING = 1e-14
"""Rounding error of the closed form, relative to its terms, per step and over the curvature."""


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Minimum of a Lagrangian."""

    value: float
    """least value less a bound on rounding errors; -inf if the Hessian is not positive definite"""
    at: FloatArray
    """minimiser v, shape (M, 3)"""
    curvature: float
    """least eigenvalue of the Hessian relative to that of norm(v)²; 1 without obstacles"""


class Lagrangian:
    """Lagrangian of some terms, as a function of the multipliers λ, shape (S,), and y, (R,).

    Args:
        changes: changes v of a group of vehicles.
        curved: terms of obstacles and separations.
        affine: terms of convex constraints.
    """

    def __init__(self, changes: GroupChanges, curved: CurvedTerms, affine: AffineTerms) -> None:
        self.changes, self.curved, self.affine = changes, curved, affine
        self._of_curved = SharedMultipliers(curved.slacks, curved.parts)
        self._of_affine = SharedMultipliers(affine.slacks, affine.parts)

    @cached_property
    def _rows(self) -> FloatArray:
        """Rows A of the affine terms, shape (R, 3 M)."""
        return self.affine.matrix.reshape(len(self.affine), 3 * self.changes.free.shape[1])

    @cached_property
    def alike(self) -> list[slice]:
        """Runs of axes whose Hessians are the same, since their scales are."""
        scales = self.curved.scales
        first = [x for x in range(3) if x == 0 or np.any(scales[:, x] != scales[:, x - 1])]
        return [slice(a, b) for a, b in zip(first, [*first[1:], 3], strict=True)]

    def curvature(self, weights: FloatArray) -> float:
        """Return the least eigenvalue of half the Hessian for weights λ."""
        if self.changes.free.shape[1] == 0:  # the goal determines the motion
            return 1.0
        half = self._half(weights)
        hessians = (self._hessian(half, axes.start) for axes in self.alike)
        return float(min(eigvalsh(each, subset_by_index=[0, 0])[0] for each in hessians))

    def _half(self, weights: FloatArray) -> FloatArray:
        return np.asarray(weights / self.curved.radii / 2)

    def _hessian(self, half: FloatArray, axis: int) -> FloatArray:
        """Return half the Hessian of an axis."""
        responses = self.curved.responses
        scaled = (np.sqrt(half) * self.curved.scales[:, axis])[:, None] * responses
        hessian: FloatArray = np.eye(responses.shape[1]) - scaled.T @ scaled
        return hessian

    def minimiser(self, weights: FloatArray, multipliers: FloatArray) -> FloatArray | None:
        """Return the v at which L is least, shape (M, 3); None if L is not convex."""
        half, curved = self._half(weights), self.curved
        pulls = curved.responses.T @ ((2 * half)[:, None] * curved.scales**2 * curved.offsets)
        pulls += (self._rows.T @ multipliers).reshape(pulls.shape)
        at = np.zeros_like(pulls)
        for axes in self.alike if len(at) > 0 else ():
            factor, failed = dpotrf(self._hessian(half, axes.start), lower=1, clean=0)
            if failed:
                return None
            at[:, axes] = dpotrs(factor, pulls[:, axes] / 2, lower=1)[0]
        return at

    def minimum(self, weights: FloatArray, multipliers: FloatArray) -> Minimum:
        """Return the minimum of L for λ = `weights` and y = `multipliers`, both >= 0.

        Those of soft limits are scaled down to their price where they exceed it.
        """
        weights, multipliers = self.within_prices(weights, multipliers)
        curvature = self.curvature(weights)
        at = self.minimiser(weights, multipliers) if curvature >= _LEAST_CURVATURE else None
        if at is None:
            width = self.changes.free.shape[1]
            return Minimum(-np.inf, np.zeros((width, 3)), min(curvature, 0.0))
        radii, lower = self.curved.radii, self.affine.lower
        sizes = self.cost(at) + np.sum(weights * radii) + np.abs(multipliers @ lower)
        lost = _ROUNDING * len(self.changes.free) * float(sizes) / curvature
        return Minimum(self.value(at, weights, multipliers) - lost, at, curvature)

    def within_prices(
        self, weights: FloatArray, multipliers: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the multipliers scaled down to the prices of soft limits."""
        return self._of_curved.within_prices(weights), self._of_affine.within_prices(multipliers)

    def value(self, v: FloatArray, weights: FloatArray, multipliers: FloatArray) -> float:
        """Return L(v)."""
        curved, affine = self.slopes(v)
        return float(self.cost(v) + weights @ curved + multipliers @ affine)

    def cost(self, v: FloatArray) -> float:
        """Return the cost of a motion, given as its change v from the one of least cost."""
        return self.changes.least + float(np.sum(v**2))

    def gradient(self, v: FloatArray, weights: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the gradient of L at v, shape (M, 3)."""
        curved = self.curved
        relative = curved.scales**2 * (curved.responses @ v + curved.offsets)
        pulls = curved.responses.T @ ((2 * self._half(weights))[:, None] * relative)
        pulls += (self._rows.T @ multipliers).reshape(pulls.shape)
        return np.asarray(2 * v - pulls)

    def beyond_slack(self, curved: FloatArray, affine: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return violations less the slack of soft limits."""
        return self._of_curved.beyond_slack(curved), self._of_affine.beyond_slack(affine)

    def slopes(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the minimum, attained at v, with respect to λ and y.

        They are the constraints' violations at v.
        """
        curved = self.curved
        relative = curved.scales * (curved.responses @ v + curved.offsets)
        beyond = curved.radii**2 - np.sum(relative**2, axis=1)
        rows: FloatArray = self.affine.lower - self._rows @ v.reshape(-1)
        return beyond / (2 * curved.radii), rows


@dataclasses.dataclass(frozen=True)
class Proposal:
    """Lagrangian of a converged program of a group of vehicles, with the program's multipliers."""

    lagrangian: Lagrangian
    """Lagrangian with the program's active constraints"""
    weights: FloatArray
    """λ >= 0 from the converged program, shape (S,)"""
    multipliers: FloatArray
    """y >= 0 from the converged program, shape (R,)"""
    solution: FloatArray
    """v of the converged program, shape (M, 3)"""
    index: float
    """cost of the converged program and the price of its soft limits, over unit²"""
    left_out: frozenset[str]
    """names of active constraints that have no term: of sets without an interior"""

    @classmethod
    def of(
        cls,
        solved: CuttingPlanes,
        group: IntArray,
        *,
        as_planned: bool = True,
        priced: bool = True,
    ) -> Self:
        """Return the Lagrangian of a converged program.

        Args:
            solved: converged program.
            group: indices of the vehicles, shape (G,).
            as_planned: whether the bound is for plans with the planners' margins only, or for all
                plans.
            priced: whether soft limits count; leaving them out lowers the bound.
        """
        changes = GroupChanges(solved.problem, group, as_planned=as_planned)
        solution = changes.of(solved.motion.accelerations[group])
        index = changes.least + float(np.sum(solution**2))
        negligible, left_out = _NEGLIGIBLE * np.sqrt(index), set[str]()
        curved, affine = changes.nothing
        weights, multipliers = [np.zeros(0)], [np.zeros(0)]
        for rows, y in _multipliers(solved, group, changes.unit):
            if rows.constraint.prices is not None and not priced:
                continue
            index += _price(rows, solved.motion) / changes.unit**2
            own_curved, own_affine = changes.terms([rows])
            if len(own_affine) > 0:
                used = y > 0.0  # others do not change the bound
                affine = affine.union(own_affine.select(used))
                multipliers.append(y[used])
            elif len(own_curved) > 0:
                if np.any(~np.isfinite(own_curved.sizes) & (y > negligible)):
                    left_out.add(rows.constraint.name)
                used = (y > 0.0) & np.isfinite(own_curved.sizes)
                curved = curved.union(own_curved.select(used))
                weights.append(y[used] / own_curved.sizes[used])
        return cls(
            Lagrangian(changes, curved, affine),
            np.concatenate(weights),
            np.concatenate(multipliers),
            solution,
            index,
            frozenset(left_out),
        )

    @property
    def curvature(self) -> float:
        """Least eigenvalue of half the Lagrangian's Hessian at the program's multipliers."""
        return self.lagrangian.curvature(self.weights)

    def kkt_residuals(self) -> tuple[float, float]:
        """Return stationarity and complementarity at the converged solution.

        The former is relative to the norm of the cost's gradient, the latter to the cost.
        """
        lagrangian = self.lagrangian
        curved, affine = lagrangian.beyond_slack(*lagrangian.slopes(self.solution))
        products = np.concatenate([self.weights * curved, self.multipliers * affine, [0.0]])
        gradient = lagrangian.gradient(self.solution, self.weights, self.multipliers)
        size = 2.0 * float(np.sqrt(lagrangian.cost(self.solution))) or 1.0
        largest = float(np.max(np.abs(products))) / (self.index or 1.0)
        return float(np.linalg.norm(gradient)) / size, largest


def _multipliers(
    solved: CuttingPlanes, group: IntArray, unit: float
) -> Iterator[tuple[HalfSpaces, FloatArray]]:
    """Yield the rows of a group's programs and their multipliers for accelerations in `unit`."""
    remaining = set(group.tolist())
    while remaining:
        vehicle = min(remaining)
        own = solved.working.group(vehicle)
        remaining -= set(own.tolist())
        scale = solved.problem.effort.changes.units[own].max() / unit
        for rows, y in solved.working.multipliers(vehicle):
            yield rows, scale * y


def _price(rows: HalfSpaces, motion: Motion) -> float:
    """Return the price of the worst violation of each vehicle [m²/s⁴]; 0 of hard limits."""
    prices = rows.constraint.prices
    if prices is None:
        return 0.0
    excess = np.zeros(len(prices))
    np.maximum.at(excess, rows.vehicles, -rows.margins(motion))
    return float(prices @ excess)
