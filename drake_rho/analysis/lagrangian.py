"""The Lagrangian of the true problem, obstacles and pairs not linearised, and its minimum.

Accelerations u = a / unit are of the size of one, and the cost is norm(u)²:

    L(u) = norm(u)² + Σ λ_s (R_s² - norm(p_s(u) - c_s)²) / (2 R_s) + y · (b - A u)

A pair of vehicles that keep apart is a term like an obstacle's, with the other's place for the
centre, the separation for the radius, and z divided by the downwash. For every λ, y >= 0 the
minimum of L over the motions that reach the goals is a lower bound for the cost of every plan. L
is a quadratic that does not couple the axes, so the minimum is had in closed form wherever its
Hessians are positive definite on the directions that leave the goals where they are.

Where a disturbance is, sets and separations are larger by the radius of errors, and limits tighter.
Planners keep the greatest radius of a step in all of it. What a plan has to keep is the radius at
each instant, so for a bound of all plans rows have that one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigvalsh, null_space
from scipy.sparse import csc_array, vstack

from drake_rho.planning.constraints.base import HalfSpaces, Quadratic
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.reduced import rows_of
from drake_rho.planning.programs.rows import about
from drake_rho.planning.scp.cutting_planes import CuttingPlanes
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

_LEAST_CURVATURE = 1e-6
"""Least eigenvalue of the Hessian, over that of norm(u)², at which the minimum is computed."""

_NO_PART = 1e-6
"""Multiplier, in parts of the accelerations', up to which a program does not lean on a row."""

_ROUNDING = 1e-14
"""What the closed form may lose of its terms, for each step and over the curvature."""


@dataclasses.dataclass(frozen=True)
class Minimum:
    """The least value of a Lagrangian, and where."""

    value: float
    """a lower bound, rounding taken off; -inf where the Hessian is not positive definite"""
    at: FloatArray
    """u, shape (K-1, 3)"""
    curvature: float
    """least eigenvalue of the Hessian over that of norm(u)²; 1 without obstacles"""


class Lagrangian:
    """The constraints that a converged program holds on to, and their multipliers.

    The program is that of a group of G vehicles: of one or, where pairs keep apart, of several.

    Attributes:
        unit: acceleration that is one [m/s²].
        weights: λ >= 0 that the converged program proposes, shape (S,).
        multipliers: y >= 0 that it proposes, shape (R,).
        left_out: names of constraints that it leans on and that have no part in the bound: convex
            shapes other than balls and ellipsoids have no quadratic form.

    Args:
        solved: the program.
        group: the vehicles.
        as_planned: whether to bound the cost of plans that keep planners' margins; else of all.
    """

    def __init__(self, solved: CuttingPlanes, group: IntArray, *, as_planned: bool = True) -> None:
        effort = solved.problem.effort
        count, steps = len(group), effort.grid.knots - 1
        self.unit = float(effort.units[group].max())
        self.solution = solved.motion.accelerations[group].reshape(-1, 3) / self.unit
        self._free = np.kron(np.eye(count), null_space(effort.goals.rows))
        self._fixed = effort.motion.accelerations[group].reshape(-1, 3) / self.unit
        self.left_out = set[str]()
        bent = [_no_terms(count * steps)]
        straight = [(csc_array((0, 3 * count * steps)), np.zeros(0), np.zeros(0))]
        for kept, y in _multipliers(solved, group, self.unit):
            rows = kept if as_planned else _at_instants(kept)
            quadratic = rows.constraint.quadratics(rows)
            if quadratic is not None:
                if np.all(np.isin(rows.partners, group)):  # else left out, which lowers the bound
                    bent.append(_curved_terms(effort, group, rows, quadratic, y))
            elif not rows.constraint.linearised:  # what is linear by itself
                matrix, needed, _ = rows_of(effort.changes, group, about(effort.motion, [rows]))
                straight.append((matrix, needed + matrix @ self._fixed.reshape(-1), y))
            elif np.any(y > _NO_PART * np.linalg.norm(self.solution)):  # neither: a lower bound
                self.left_out.add(rows.constraint.name)
        self._pull = np.concatenate([each.pull for each in bent])
        self._offsets = np.concatenate([each.offsets for each in bent])
        self._scales = np.concatenate([each.scales for each in bent])
        self._radii = np.concatenate([each.radii for each in bent])
        self.weights = np.concatenate([each.weights for each in bent])
        self._matrix = vstack([each[0] for each in straight]).tocsr()
        self._lower = np.concatenate([each[1] for each in straight])
        self.multipliers = np.concatenate([each[2] for each in straight])
        self._only_used()

    def _only_used(self) -> None:
        """Forget constraints without a multiplier: they have no part in the bound."""
        bent, straight = self.weights > 0.0, self.multipliers > 0.0
        self._pull, self._offsets = self._pull[bent], self._offsets[bent]
        self._radii, self.weights = self._radii[bent], self.weights[bent]
        self._scales = self._scales[bent]
        self._matrix, self._lower = self._matrix[straight], self._lower[straight]
        self.multipliers = self.multipliers[straight]

    def curvature(self, weights: FloatArray) -> float:
        """Least eigenvalue of the Hessian for λ = `weights`, over that of norm(u)²."""
        if self._free.shape[1] == 0:  # the goal leaves no choice
            return 1.0
        scales = self._scales  # axes of the same scales have the same Hessian
        axes = [x for x in range(3) if x == 0 or np.any(scales[:, x] != scales[:, x - 1])]
        least = [eigvalsh(self._hessian(weights, x), subset_by_index=[0, 0])[0] for x in axes]
        return float(min(least))

    def _hessian(self, weights: FloatArray, axis: int) -> FloatArray:
        """Half the Hessian of an axis on the directions that leave the goals."""
        sizes = np.sqrt(weights / self._radii / 2) * self._scales[:, axis]
        pull = sizes[:, None] * (self._pull @ self._free)
        hessian: FloatArray = np.eye(self._free.shape[1]) - pull.T @ pull
        return hessian

    def _bend(self, u: FloatArray, half: FloatArray) -> FloatArray:
        """The gradient of the curved terms at u, less its sign."""
        places = self._scales**2 * (self._pull @ u + self._offsets)
        gradient: FloatArray = self._pull.T @ (2 * half[:, None] * places)
        return gradient

    def minimum(self, weights: FloatArray, multipliers: FloatArray) -> Minimum:
        """The least value of L for λ = `weights` and y = `multipliers`, both >= 0."""
        half, shape = weights / self._radii / 2, self._fixed.shape
        curvature = self.curvature(weights)
        if curvature < _LEAST_CURVATURE:
            return Minimum(-np.inf, self._fixed, curvature)
        linear = (self._matrix.T @ multipliers).reshape(shape)
        gradient = 2 * self._fixed - linear
        gradient -= self._bend(self._fixed, half)
        at = np.array(self._fixed)
        for axis in range(3 if self._free.shape[1] > 0 else 0):
            hessian = cho_factor(self._hessian(weights, axis))
            at[:, axis] -= self._free @ cho_solve(hessian, self._free.T @ gradient[:, axis]) / 2
        value = self._value(at, half, multipliers)
        sizes = np.sum(at**2) + np.sum(weights * self._radii) + np.abs(multipliers @ self._lower)
        lost = _ROUNDING * len(at) * float(sizes) / curvature
        return Minimum(value - lost, at, curvature)

    def _value(self, u: FloatArray, half: FloatArray, multipliers: FloatArray) -> float:
        return float(
            np.sum(u**2)
            + half @ self._breaches(u)
            + multipliers @ (self._lower - self._matrix @ u.reshape(-1))
        )

    def _breaches(self, u: FloatArray) -> FloatArray:
        """R_s² - norm(p_s - c_s)² of the motion u, shape (S,)."""
        places = self._scales * (self._pull @ u + self._offsets)
        breaches: FloatArray = self._radii**2 - np.sum(places**2, axis=1)
        return breaches

    def slopes(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How the minimum at u rises with λ and with y: the constraints' breaches there."""
        rows: FloatArray = self._lower - self._matrix @ u.reshape(-1)
        return self._breaches(u) / (2 * self._radii), rows

    def kkt_residuals(self) -> tuple[float, float]:
        """Stationarity and complementarity at the converged solution, relative to the cost."""
        index = float(np.sum(self.solution**2)) or 1.0
        bent, straight = self.slopes(self.solution)
        products = np.concatenate([self.weights * bent, self.multipliers * straight, [0.0]])
        return self._stationarity(), float(np.max(np.abs(products))) / index

    def _stationarity(self) -> float:
        """Norm of the gradient of L at the converged solution over that of norm(u)²."""
        u, half = self.solution, self.weights / self._radii / 2
        gradient = 2 * u - (self._matrix.T @ self.multipliers).reshape(u.shape)
        gradient -= self._bend(u, half)
        size = float(np.linalg.norm(2 * u)) or 1.0
        return float(np.linalg.norm(self._free.T @ gradient)) / size


@dataclasses.dataclass(frozen=True, eq=False)
class _AtInstants(Margins):
    """Margins that are the radii at times, not the greatest ones in steps."""

    def at(self, quantity: Quantity, times: FloatArray) -> FloatArray:
        """Radii at times since the first knot [s]; the feedback's is that of the whole step."""
        if self.tube is None or quantity not in ("position", "velocity"):
            return super().at(quantity, times)
        radii: FloatArray = getattr(self.tube, quantity)(self.grid.start + times)
        return radii


def _at_instants(rows: HalfSpaces) -> HalfSpaces:
    """Rows that no plan breaks that bears the disturbance, at the instants at which they are."""
    constraint = rows.constraint
    margins = getattr(constraint, "margins", None)
    if not isinstance(margins, Margins) or margins.tube is None:
        return rows
    fields = (getattr(margins, field.name) for field in dataclasses.fields(Margins))
    exact = _AtInstants(*fields)
    if constraint.linearised:  # its quadratics are made of its margins
        changes: dict[str, Any] = {"margins": exact}  # which not all constraints have
        changed = dataclasses.replace(constraint, **changes)
        return dataclasses.replace(rows, constraint=changed)
    more = margins.at(constraint.quantity, rows.times) - exact.at(constraint.quantity, rows.times)
    return dataclasses.replace(rows, bounds=rows.bounds - more)


@dataclasses.dataclass(frozen=True)
class _CurvedTerms:
    pull: FloatArray  # what u adds to the place at each instant [m], shape (S, G (K-1))
    offsets: FloatArray  # where coasting is then, from centre or partner [m], shape (S, 3)
    scales: FloatArray  # of each axis: 1, but for z where a downwash counts, shape (S, 3)
    radii: FloatArray  # of the sphere, or the separation [m], shape (S,)
    weights: FloatArray  # λ [m], shape (S,): of rows of length one the multipliers are y


def _multipliers(
    solved: CuttingPlanes, group: IntArray, unit: float
) -> Iterator[tuple[HalfSpaces, FloatArray]]:
    """The rows of all programs of a group and their multipliers, for accelerations in `unit`."""
    left = set(group.tolist())
    while left:
        vehicle = min(left)
        own = solved.working.group(vehicle)
        left -= set(own.tolist())
        scale = solved.problem.effort.units[own].max() / unit
        for rows, y in solved.working.multipliers(vehicle):
            yield rows, scale * y


def _no_terms(width: int) -> _CurvedTerms:
    none = np.zeros((0, 3))
    return _CurvedTerms(np.zeros((0, width)), none, none, np.zeros(0), np.zeros(0))


def _curved_terms(
    effort: MinimumEffort, group: IntArray, rows: HalfSpaces, quadratic: Quadratic, y: FloatArray
) -> _CurvedTerms:
    """What the Lagrangian needs of the rows of a set that is kept out of."""
    place = np.zeros(len(effort.units), dtype=int)
    place[group] = np.arange(len(group))
    coasting = effort.motion.with_accelerations(np.zeros_like(effort.motion.accelerations))
    responses = effort.units[group].max() * rows.responses(effort.grid)
    offsets = coasting.each_at("position", rows.vehicles, rows.times) - quadratic.centers
    blocks = np.zeros((len(rows), len(group), responses.shape[1]))
    blocks[np.arange(len(rows)), place[rows.vehicles]] = responses
    if np.any(rows.partners != rows.vehicles):
        offsets -= coasting.each_at("position", rows.partners, rows.times)
        blocks[np.arange(len(rows)), place[rows.partners]] = -responses
    pull = blocks.reshape(len(rows), -1)
    weights = y / (np.linalg.norm(pull, axis=1) * quadratic.lengths)
    return _CurvedTerms(pull, offsets, quadratic.scales, quadratic.sizes, weights)
