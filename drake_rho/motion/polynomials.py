"""Piecewise polynomial motions, and their form in Drake."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.scenario.fields import FloatArray

if TYPE_CHECKING:
    from pydrake.trajectories import PiecewisePolynomial


@dataclasses.dataclass(frozen=True, eq=False)
class Polynomials:
    """Motions of N vehicles as polynomials in J pieces of time, the same for all."""

    instants: FloatArray
    """times at which pieces begin and end, since the first knot [s], shape (J + 1,)"""
    coefficients: FloatArray
    """coefficients of the powers of the time since a piece began, from the lowest up: [m], [m/s],
    [m/s²], …, shape (N, J, 3, D + 1)"""

    def trajectory(self, vehicle: int, start: float) -> PiecewisePolynomial:
        """Return a vehicle's motion as Drake's type, on a clock with the first knot at `start`."""
        from pydrake.polynomial import Polynomial
        from pydrake.trajectories import PiecewisePolynomial

        pieces = [
            np.array([[Polynomial(axis)] for axis in piece]) for piece in self.coefficients[vehicle]
        ]
        return PiecewisePolynomial(pieces, start + self.instants)
