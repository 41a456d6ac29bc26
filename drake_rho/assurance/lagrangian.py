"""The Lagrangian of one vehicle's true problem, obstacles not linearised, and its minimum.

Everything is in accelerations u = a / unit of the size of one, and of index norm(u)²:

    L(u) = norm(u)² + Σ λ_s (R_s² - norm(p_s(u) - c_s)²) / (2 R_s) + y · (b - A u)

For every λ, y >= 0 the minimum of L over the motions that reach the goal is a lower bound for the
index of every plan of the scenario. L is a quadratic with the same Hessian on each axis, so the
minimum is had in closed form wherever that Hessian is positive definite on the directions that
leave the goal where it is.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigvalsh, null_space
from scipy.sparse import csc_array, vstack

from drake_rho.planning.loop import Programs
from drake_rho.planning.program import rows_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

_LEAST_CURVATURE = 1e-6
"""Least eigenvalue of the Hessian, over that of norm(u)², at which the minimum is computed."""

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
    """The constraints that a converged program of one vehicle holds on to, and their multipliers.

    Attributes:
        unit: acceleration that is one [m/s²].
        weights: λ >= 0 that the converged program proposes, shape (S,).
        multipliers: y >= 0 that it proposes, shape (R,).
    """

    def __init__(self, scenario: Scenario, solved: Programs, vehicle: int) -> None:
        frame = solved.frame.alone(vehicle)
        self.unit = float(frame.units[0])
        self.solution = solved.accelerations[vehicle] / self.unit
        self._free = null_space(frame.goal_rows)
        self._fixed = frame.free.accelerations[0] / self.unit
        coasting = frame.free.with_accelerations(np.zeros_like(frame.free.accelerations))
        bent: list[_ObstacleTerms] = []
        straight: list[tuple[csc_array, FloatArray, FloatArray]] = []
        for rows, y in solved.multipliers(vehicle):
            alone = dataclasses.replace(rows, vehicles=np.zeros_like(rows.vehicles))
            if rows.name.startswith("obstacle"):
                sphere = scenario.obstacles[int(rows.name.split()[1]) - 1]
                pull = self.unit * alone.responses(frame.grid)
                offsets = coasting.at("position", rows.times)[0] - sphere.center
                radii = np.full(len(rows), sphere.radius)
                bent.append(_ObstacleTerms(pull, offsets, radii, y / np.linalg.norm(pull, axis=1)))
            else:
                matrix, needed, _ = rows_of(frame, np.zeros(1, dtype=int), [alone])
                straight.append((matrix, needed + matrix @ self._fixed.reshape(-1), y))
        steps = frame.grid.knots - 1
        self._pull = np.concatenate([np.zeros((0, steps)), *(each.pull for each in bent)])
        self._offsets = np.concatenate([np.zeros((0, 3)), *(each.offsets for each in bent)])
        self._radii = np.concatenate([np.zeros(0), *(each.radii for each in bent)])
        self.weights = np.concatenate([np.zeros(0), *(each.weights for each in bent)])
        self._matrix = vstack([csc_array((0, 3 * steps)), *(each[0] for each in straight)]).tocsr()
        self._lower = np.concatenate([np.zeros(0), *(each[1] for each in straight)])
        self.multipliers = np.concatenate([np.zeros(0), *(each[2] for each in straight)])
        self._only_used()

    def _only_used(self) -> None:
        """Forget constraints without a multiplier: they have no part in the bound."""
        bent, straight = self.weights > 0.0, self.multipliers > 0.0
        self._pull, self._offsets = self._pull[bent], self._offsets[bent]
        self._radii, self.weights = self._radii[bent], self.weights[bent]
        self._matrix, self._lower = self._matrix[straight], self._lower[straight]
        self.multipliers = self.multipliers[straight]

    def curvature(self, weights: FloatArray) -> float:
        """Least eigenvalue of the Hessian for λ = `weights`, over that of norm(u)²."""
        if self._free.shape[1] == 0:  # the goal leaves no choice
            return 1.0
        return float(eigvalsh(self._hessian(weights), subset_by_index=[0, 0])[0])

    def _hessian(self, weights: FloatArray) -> FloatArray:
        """Half the Hessian on the directions that leave the goal, the same on each axis."""
        pull = np.sqrt(weights / self._radii / 2)[:, None] * (self._pull @ self._free)
        hessian: FloatArray = np.eye(self._free.shape[1]) - pull.T @ pull
        return hessian

    def minimum(self, weights: FloatArray, multipliers: FloatArray) -> Minimum:
        """The least value of L for λ = `weights` and y = `multipliers`, both >= 0."""
        half, shape = weights / self._radii / 2, self._fixed.shape
        curvature = self.curvature(weights)
        if curvature < _LEAST_CURVATURE:
            return Minimum(-np.inf, self._fixed, curvature)
        linear = (self._matrix.T @ multipliers).reshape(shape)
        gradient = 2 * self._fixed - linear
        gradient -= self._pull.T @ (2 * half[:, None] * (self._pull @ self._fixed + self._offsets))
        at = self._fixed
        if self._free.shape[1] > 0:
            hessian = cho_factor(self._hessian(weights))
            at = at - self._free @ cho_solve(hessian, self._free.T @ gradient) / 2
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
        places = self._pull @ u + self._offsets
        breaches: FloatArray = self._radii**2 - np.sum(places**2, axis=1)
        return breaches

    def slopes(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How the minimum at u rises with λ and with y: the constraints' breaches there."""
        rows: FloatArray = self._lower - self._matrix @ u.reshape(-1)
        return self._breaches(u) / (2 * self._radii), rows

    def kkt_residuals(self) -> tuple[float, float]:
        """Stationarity and complementarity at the converged solution, both over the index."""
        index = float(np.sum(self.solution**2)) or 1.0
        bent, straight = self.slopes(self.solution)
        products = np.concatenate([self.weights * bent, self.multipliers * straight, [0.0]])
        return self._stationarity(), float(np.max(np.abs(products))) / index

    def _stationarity(self) -> float:
        """Norm of the gradient of L at the converged solution over that of norm(u)²."""
        u, half = self.solution, self.weights / self._radii / 2
        gradient = 2 * u - (self._matrix.T @ self.multipliers).reshape(u.shape)
        gradient -= self._pull.T @ (2 * half[:, None] * (self._pull @ u + self._offsets))
        size = float(np.linalg.norm(2 * u)) or 1.0
        return float(np.linalg.norm(self._free.T @ gradient)) / size


@dataclasses.dataclass(frozen=True)
class _ObstacleTerms:
    pull: FloatArray  # what u adds to the position at each instant [m], shape (S, K-1)
    offsets: FloatArray  # where coasting is then, from the centre [m], shape (S, 3)
    radii: FloatArray  # [m], shape (S,)
    weights: FloatArray  # λ [m], shape (S,): of rows of length one the multipliers are y
