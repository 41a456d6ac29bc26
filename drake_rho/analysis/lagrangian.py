"""Lagrangian of the non-convex problem, obstacles and pairs not linearised, and its minimum.

With changes u of the motion of least cost, in coordinates of order one (`Changes`), the cost is
norm(u)² more than its cost f:

    L(u) = f + norm(u)² + Σ λ_s (R_s² - norm(p_s(u) - c_s)²) / (2 R_s) + y · (b - A u)

The separation of a pair of vehicles is a term like an obstacle's, with the other vehicle's position
as the centre, the separation as the radius, and z divided by the downwash factor. For every
λ, y >= 0 the minimum of L over the changes that keep the goals is a lower bound on the cost of
every plan. L is a quadratic that does not couple the axes. So its minimum has a closed form
wherever its Hessians are positive definite on the directions that leave the final states unchanged.

With a disturbance, obstacles and separations are enlarged by the error radius, and limits are
tightened by it. Planners use the greatest radius of a step throughout the step. A plan is only
required to keep the radius at each instant, so a bound for all plans uses that radius in its rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, eigvalsh, null_space
from scipy.sparse import csc_array, vstack

from drake_rho.analysis.shared_multipliers import SharedMultipliers, Slacks
from drake_rho.motion.costs import costs_of
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces, Quadratic, about
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import FloatArray, IntArray

_LEAST_CURVATURE = 1e-6
"""Least eigenvalue of the Hessian, over that of norm(u)², for which the minimum is computed."""

_NEGLIGIBLE = 1e-6
"""Multiplier, relative to the norm of u, up to which a row counts as inactive."""

_ROUNDING = 1e-14
"""Rounding error of the closed form, relative to its terms, per step and over the curvature."""


@dataclasses.dataclass(frozen=True)
class Minimum:
    """Minimum of a Lagrangian."""

    value: float
    """least value less a bound on rounding errors; -inf if the Hessian is not positive definite"""
    at: FloatArray
    """minimiser u, shape (G (K-1), 3)"""
    curvature: float
    """least eigenvalue of the Hessian relative to that of norm(u)²; 1 without obstacles"""


class Lagrangian:
    """Lagrangian with the active constraints of a converged program and their multipliers.

    The program is that of a group of G vehicles: one vehicle or, with a separation, several.

    Attributes:
        unit: unit of u [m/s²].
        solution: u of the converged program, shape (G (K-1), 3).
        weights: λ >= 0 from the converged program, shape (S,).
        multipliers: y >= 0 from the converged program, shape (R,).
        cost: norm(u)² of the converged program, and the price of its soft limits.
        left_out: names of active constraints that are left out of the bound: convex shapes other
            than balls and ellipsoids have no quadratic form.

    Args:
        solved: converged program.
        group: indices of the vehicles, shape (G,).
        as_planned: whether the bound is for plans with the planners' margins only, or for all
            plans.
        priced: whether soft limits count; leaving them out lowers the bound.
    """

    def __init__(
        self,
        solved: CuttingPlanes,
        group: IntArray,
        *,
        as_planned: bool = True,
        priced: bool = True,
    ) -> None:
        effort = solved.problem.effort
        count, steps, changes = len(group), effort.grid.knots - 1, effort.changes
        self.unit = float(effort.changes.units[group].max())
        scale = self.unit * changes.factors_of(group)[:, None, None]
        added = solved.motion.accelerations[group] - effort.motion.accelerations[group]
        self.solution = (changes.coordinates(added, group) / scale).reshape(-1, 3)
        costs = costs_of(solved.problem.scenario, effort.motion)[group]
        self._least = float(costs.sum()) / self.unit**2
        spaces = [changes.space(vehicle) for vehicle in group.tolist()]
        self._free = block_diag(*(null_space(each.goals) for each in spaces))
        self.left_out, self.cost = set[str](), self._cost(self.solution)
        slacks, of_curved, of_affine = Slacks(), SharedMultipliers.none(), SharedMultipliers.none()
        curved = [_no_terms(count * steps)]
        affine = [(csc_array((0, 3 * count * steps)), np.zeros(0), np.zeros(0))]
        for planned, y in _multipliers(solved, group, self.unit):
            if planned.constraint.prices is not None and not priced:
                continue
            self.cost += _price(planned, solved.motion) / self.unit**2
            rows = planned if as_planned else _at_instants(planned)
            quadratic = rows.constraint.quadratics(rows)
            if quadratic is not None:
                if np.all(np.isin(rows.partners, group)):  # leaving out others lowers the bound
                    curved.append(_curved_terms(effort, group, rows, quadratic, y))
                    parts = self.unit**2 * quadratic.scales.max(axis=1) / rows.penalties
                    of_curved = of_curved.joined(slacks.of(rows, parts))
            elif not rows.constraint.linearised:  # linear in u without a linearisation
                about_effort = about(effort.motion, [rows])
                matrix, needed, penalties = rows_of(changes, group, about_effort)
                of_affine = of_affine.joined(slacks.of(rows, 1.0 / penalties))
                affine.append((matrix, needed, y))
            elif np.any(y > _NEGLIGIBLE * np.sqrt(self._cost(self.solution))):  # not quadratic
                self.left_out.add(rows.constraint.name)
        self._responses = np.concatenate([each.responses for each in curved])
        self._offsets = np.concatenate([each.offsets for each in curved])
        self._scales = np.concatenate([each.scales for each in curved])
        self._radii = np.concatenate([each.radii for each in curved])
        self.weights = np.concatenate([each.weights for each in curved])
        self._matrix = vstack([each[0] for each in affine]).tocsr()
        self._lower = np.concatenate([each[1] for each in affine])
        self.multipliers = np.concatenate([each[2] for each in affine])
        self._of_curved, self._of_affine = of_curved, of_affine
        self._only_used()

    def _only_used(self) -> None:
        """Remove constraints with zero multipliers, which do not change the bound."""
        curved, affine = self.weights > 0.0, self.multipliers > 0.0
        self._responses, self._offsets = self._responses[curved], self._offsets[curved]
        self._radii, self.weights = self._radii[curved], self.weights[curved]
        self._scales = self._scales[curved]
        self._matrix, self._lower = self._matrix[affine], self._lower[affine]
        self.multipliers = self.multipliers[affine]
        self._of_curved = self._of_curved.select(curved)
        self._of_affine = self._of_affine.select(affine)

    def curvature(self, weights: FloatArray) -> float:
        """Return the least curvature for weights λ, relative to that of norm(u)²."""
        if self._free.shape[1] == 0:  # the goal determines the motion
            return 1.0
        scales = self._scales  # axes with the same scales have the same Hessian
        axes = [x for x in range(3) if x == 0 or np.any(scales[:, x] != scales[:, x - 1])]
        least = [eigvalsh(self._hessian(weights, x), subset_by_index=[0, 0])[0] for x in axes]
        return float(min(least))

    def _hessian(self, weights: FloatArray, axis: int) -> FloatArray:
        """Return half the Hessian of an axis on directions with unchanged final states."""
        sizes = np.sqrt(weights / self._radii / 2) * self._scales[:, axis]
        responses = sizes[:, None] * (self._responses @ self._free)
        hessian: FloatArray = np.eye(self._free.shape[1]) - responses.T @ responses
        return hessian

    def _curved_gradient(self, u: FloatArray, half: FloatArray) -> FloatArray:
        """Return the negative gradient of the quadratic terms at u."""
        relative = self._scales**2 * (self._responses @ u + self._offsets)
        gradient: FloatArray = self._responses.T @ (2 * half[:, None] * relative)
        return gradient

    def minimum(self, weights: FloatArray, multipliers: FloatArray) -> Minimum:
        """Return the minimum of L for λ = `weights` and y = `multipliers`, both >= 0.

        Those of soft limits are scaled down to their price where they exceed it.
        """
        weights = self._of_curved.within_prices(weights)
        multipliers = self._of_affine.within_prices(multipliers)
        half, at = weights / self._radii / 2, np.zeros_like(self.solution)
        curvature = self.curvature(weights)
        if curvature < _LEAST_CURVATURE:
            return Minimum(-np.inf, at, curvature)
        gradient = -(self._matrix.T @ multipliers).reshape(at.shape)
        gradient -= self._curved_gradient(at, half)
        for axis in range(3 if self._free.shape[1] > 0 else 0):
            hessian = cho_factor(self._hessian(weights, axis))
            at[:, axis] -= self._free @ cho_solve(hessian, self._free.T @ gradient[:, axis]) / 2
        value = self._value(at, half, multipliers)
        sizes = self._cost(at) + np.sum(weights * self._radii) + np.abs(multipliers @ self._lower)
        lost = _ROUNDING * len(at) * float(sizes) / curvature
        return Minimum(value - lost, at, curvature)

    def _value(self, u: FloatArray, half: FloatArray, multipliers: FloatArray) -> float:
        return float(
            self._cost(u)
            + half @ self._violations(u)
            + multipliers @ (self._lower - self._matrix @ u.reshape(-1))
        )

    def _cost(self, u: FloatArray) -> float:
        """Return the cost of a motion, given as its change u from the one of least cost."""
        return self._least + float(np.sum(u**2))

    def _violations(self, u: FloatArray) -> FloatArray:
        """Return R_s² - norm(p_s - c_s)² of the motion u, shape (S,)."""
        relative = self._scales * (self._responses @ u + self._offsets)
        violations: FloatArray = self._radii**2 - np.sum(relative**2, axis=1)
        return violations

    def slopes(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the minimum, attained at u, with respect to λ and y.

        They are the constraints' violations at u.
        """
        rows: FloatArray = self._lower - self._matrix @ u.reshape(-1)
        return self._violations(u) / (2 * self._radii), rows

    def kkt_residuals(self) -> tuple[float, float]:
        """Return stationarity and complementarity at the converged solution.

        The former is relative to the norm of the cost's gradient, the latter to the cost.
        """
        index = self.cost or 1.0
        curved, affine = self.slopes(self.solution)
        curved = self._of_curved.beyond_slack(curved)
        affine = self._of_affine.beyond_slack(affine)
        products = np.concatenate([self.weights * curved, self.multipliers * affine, [0.0]])
        return self._stationarity(), float(np.max(np.abs(products))) / index

    def _stationarity(self) -> float:
        """Return the norm of L's gradient at the converged solution, relative to the cost's."""
        u, half = self.solution, self.weights / self._radii / 2
        gradient = 2 * u - (self._matrix.T @ self.multipliers).reshape(u.shape)
        gradient -= self._curved_gradient(u, half)
        size = 2.0 * float(np.sqrt(self._cost(u))) or 1.0
        return float(np.linalg.norm(self._free.T @ gradient)) / size


def _price(rows: HalfSpaces, motion: Motion) -> float:
    """Return the price of the worst violation of each vehicle [m²/s⁴]; 0 of hard limits."""
    prices = rows.constraint.prices
    if prices is None:
        return 0.0
    excess = np.zeros(len(prices))
    np.maximum.at(excess, rows.vehicles, -rows.margins(motion))
    return float(prices @ excess)


def _at_instants(rows: HalfSpaces) -> HalfSpaces:
    """Return rows tightened by the error radii at their times, not by the planners' margins.

    Every plan that satisfies the tightened constraints keeps these rows.
    """
    constraint = rows.constraint
    margins = getattr(constraint, "margins", None)
    if not isinstance(margins, Margins) or margins.tube is None:
        return rows
    exact = margins.pointwise
    if constraint.linearised:  # its quadratics are computed from its margins
        changes: dict[str, Any] = {"margins": exact}  # not all constraints have such a field
        changed = dataclasses.replace(constraint, **changes)
        return dataclasses.replace(rows, form=changed)
    more = margins.at(constraint.quantity, rows.times) - exact.at(constraint.quantity, rows.times)
    vehicles = 2.0 if constraint.coupled else 1.0
    return dataclasses.replace(rows, bounds=rows.bounds - vehicles * more)


@dataclasses.dataclass(frozen=True)
class _CurvedTerms:
    """Terms λ_s (R_s² - norm(p_s(u) - c_s)²) / (2 R_s) of the Lagrangian."""

    responses: FloatArray  # position at each instant as a linear map of u [m], shape (S, G (K-1))
    offsets: FloatArray  # position for u = 0, relative to centre or partner [m], shape (S, 3)
    scales: FloatArray  # factor on each axis: 1, except for z with a downwash, shape (S, 3)
    radii: FloatArray  # radius of the sphere, or the separation [m], shape (S,)
    weights: FloatArray  # λ [m], shape (S,), from the multipliers y of rows scaled to norm 1


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


def _no_terms(width: int) -> _CurvedTerms:
    none = np.zeros((0, 3))
    return _CurvedTerms(np.zeros((0, width)), none, none, np.zeros(0), np.zeros(0))


def _curved_terms(
    effort: MinimumEffort, group: IntArray, rows: HalfSpaces, quadratic: Quadratic, y: FloatArray
) -> _CurvedTerms:
    """Return the Lagrangian's terms for the rows of an obstacle or of a separation."""
    place = np.zeros(len(effort.changes.units), dtype=int)
    place[group] = np.arange(len(group))
    changes, motion = effort.changes, effort.motion
    responses = effort.changes.units[group].max() * rows.responses(effort.grid)
    offsets = motion.each_at("position", rows.vehicles, rows.times) - quadratic.centers
    blocks = np.zeros((len(rows), len(group), responses.shape[1]))
    factors = changes.factors_of
    own = factors(rows.vehicles)[:, None] * changes.whitened(responses, rows.vehicles)
    blocks[np.arange(len(rows)), place[rows.vehicles]] = own
    if np.any(rows.partners != rows.vehicles):
        offsets -= motion.each_at("position", rows.partners, rows.times)
        other = factors(rows.partners)[:, None] * changes.whitened(responses, rows.partners)
        blocks[np.arange(len(rows)), place[rows.partners]] = -other
    matrix = blocks.reshape(len(rows), -1)
    weights = y / (np.linalg.norm(matrix, axis=1) * quadratic.lengths)
    return _CurvedTerms(matrix, offsets, quadratic.scales, quadratic.sizes, weights)
