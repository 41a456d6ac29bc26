"""Slack of constraints: available and needed distances inside their boundaries."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import UNITS, Quantity

ENDS = {0: "start", -1: "goal"}
"""Names of the knots with given states, by index."""


@dataclasses.dataclass(frozen=True, eq=False)
class TighteningSlack:
    """Available and needed distances from the boundary of one constraint, for all vehicles."""

    name: str
    """name of the constraint"""
    where: str
    """place of the comparison: start, goal, or the middle of a set"""
    quantity: Quantity
    """quantity with the error"""
    available: FloatArray
    """distances of the vehicles inside the constraint's boundary, negative beyond it, in the
    quantity's unit, shape (N,)"""
    needed: FloatArray
    """needed margins, in the quantity's unit, shape (1,) or (N,)"""
    tolerances: FloatArray
    """tolerances of the constraint, in the quantity's unit, shape (1,) or (N,)"""

    def missing(self, tolerances: float) -> FloatArray:
        """Return the missing slack beyond a number of tolerances, at most 0 if none, shape (N,)."""
        missing: FloatArray = self.needed - self.available - tolerances * self.tolerances
        return missing

    def reason(self, vehicle: int) -> str:
        """Return a description of one vehicle's missing slack."""
        unit, needed = UNITS[self.quantity], np.broadcast_to(self.needed, self.available.shape)
        depth = float(self.available[vehicle])
        if needed[vehicle] <= 0.0:
            return f"{self.name} ({self.where} {-depth:.3g} {unit} beyond)"
        if depth < 0.0:
            inside = f"{needed[vehicle]:.3g} {unit} inside is needed"
            return f"{self.name} ({self.where} {-depth:.3g} {unit} beyond; {inside})"
        return f"{self.name} ({self.where} {depth:.3g} {unit} inside, of {needed[vehicle]:.3g})"
