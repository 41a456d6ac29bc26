"""Positions, velocities, accelerations and jerks as affine functions of accelerations (10)-(11)."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np

from drake_rho.motion.dynamics import Motion, response
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, eq=False)
class Affine:
    """Vector x = matrix @ variables + offset."""

    matrix: FloatArray
    """coefficients, shape (M, V)"""
    offset: FloatArray
    """constants, shape (M,)"""
    variables: np.ndarray[Any, Any]
    """decision variables, shape (V,)"""

    def __sub__(self, other: Affine) -> Affine:
        """Return the difference of two vectors whose variables have nothing in common."""
        return Affine(
            np.hstack([self.matrix, -other.matrix]),
            self.offset - other.offset,
            np.concatenate([self.variables, other.variables]),
        )

    def mapped(self, matrix: FloatArray, offset: FloatArray | float = 0.0) -> Affine:
        """Return matrix @ x + offset."""
        return Affine(matrix @ self.matrix, matrix @ self.offset + offset, self.variables)

    @property
    def expressions(self) -> np.ndarray[Any, Any]:
        """Vector as Drake's symbolic expressions, shape (M,)."""
        with np.errstate(invalid="ignore"):  # numpy warns of Drake's symbols, without a cause
            return np.asarray(self.matrix @ self.variables + self.offset)


@dataclasses.dataclass(frozen=True, eq=False)
class Values:
    """Values of all quantities of a scenario's motions, affine in the accelerations."""

    scenario: Scenario
    """scenario with the starts"""
    accelerations: np.ndarray[Any, Any]
    """decision variables a[k] [m/s²], shape (N, K-1, 3)"""

    @cached_property
    def coasting(self) -> Motion:
        """Motions without acceleration: the constants of (10) and (11)."""
        shape, step = self.accelerations.shape, self.scenario.grid.step
        return Motion.from_starts(self.scenario.fleet, np.zeros(shape), step)

    def coefficients(self, quantity: Quantity, time: float) -> FloatArray:
        """Return the response of a quantity to the accelerations of one axis, shape (K-1,).

        Args:
            quantity: position (11), velocity (10), acceleration, or jerk (7).
            time: since the first knot [s].
        """
        grid = self.scenario.grid
        row: FloatArray = response(quantity, grid.step, grid.knots, [time])[0]
        return row

    def at(
        self, quantity: Quantity, vehicle: int, time: float, partner: int | None = None
    ) -> Affine:
        """Return a quantity of a vehicle at a time, less a partner's if there is one.

        Args:
            quantity: position, velocity, acceleration or jerk.
            vehicle: index of the vehicle.
            time: since the first knot [s], of a knot or not.
            partner: index of the other vehicle.
        """
        row = self.coefficients(quantity, time)
        steps = np.flatnonzero(row)
        offset = self.coasting.each_at(quantity, np.array([vehicle]), np.array([time]))[0]
        variables = self.accelerations[vehicle, steps].reshape(-1)
        own = Affine(on_every_axis(row[steps]), offset, variables)
        return own if partner is None else own - self.at(quantity, partner, time)


def on_every_axis(row: FloatArray) -> FloatArray:
    """Return the matrix (3, 3 M) of a row (M,) that is equal on every axis."""
    return np.asarray(np.kron(row, np.eye(3)), dtype=np.float64)
