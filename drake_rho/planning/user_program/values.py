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

    def term(self, term: str, vehicle: int) -> tuple[FloatArray, FloatArray]:
        """Return a term of a vehicle's cost, before its weight, as norm(A a + b)².

        Args:
            term: field of `Objective` that has the term's weight.
            vehicle: index of the vehicle.

        Returns:
            Rows A, equal on every axis, shape (M, K-1), and b, shape (M, 3).
        """
        fleet, grid = self.scenario.fleet, self.scenario.grid
        free, last = self.coasting.of(vehicle), slice(-1, None)
        jerks = self._rows("jerk", slice(None))
        r: tuple[FloatArray, ...] = ()
        if self.scenario.objective.reference is not None:
            every = self.scenario.objective.reference_at(grid)
            r = tuple(each[vehicle if len(each) > 1 else 0, 1:] for each in every)
        match term:
            case "effort":
                return np.eye(grid.knots - 1), np.zeros((grid.knots - 1, 3))
            case "jerk":
                ends = [each[vehicle] for each in fleet.counted_ends]
                counts = np.sqrt([ends[0], *np.ones(grid.knots - 2), ends[1]])[:, None]
                return counts * jerks, counts * np.nan_to_num(free.jerks())
            case "snap":
                offsets = np.concatenate([fleet.jerks_before[[vehicle]], free.jerks()])
                known, h = np.isfinite(offsets).all(axis=1), grid.step
                jerks = np.concatenate([np.zeros((1, grid.knots - 1)), jerks])[known]
                return np.diff(jerks, axis=0) / h, np.diff(offsets[known], axis=0) / h
            case "position":
                return self._rows("position", slice(1, None)), free.positions[1:] - r[0]
            case "velocity":
                return self._rows("velocity", slice(1, None)), free.velocities[1:] - r[1]
            case "terminal_position":
                goal = fleet.goal_positions[vehicle]
                return self._rows("position", last), free.positions[last] - goal
            case _:
                goal = fleet.goal_velocities[vehicle]
                return self._rows("velocity", last), free.velocities[last] - goal

    def _rows(self, quantity: Quantity, knots: slice) -> FloatArray:
        """Return the responses of a quantity at some knots, shape (M, K-1)."""
        grid = self.scenario.grid
        return response(quantity, grid.step, grid.knots, grid.elapsed[knots])


def on_every_axis(row: FloatArray) -> FloatArray:
    """Return the matrix (3 R, 3 M) of rows (R, M), or of one (M,), equal on every axis."""
    return np.asarray(np.kron(row, np.eye(3)), dtype=np.float64)
