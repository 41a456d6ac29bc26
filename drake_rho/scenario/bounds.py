"""Boxes of a quantity for all vehicles as arrays."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True)
class Bounds:
    """One box for every vehicle, with infinite bounds where a vehicle has none."""

    lower: FloatArray
    """lower bounds in the quantity's unit, shape (N, 3)"""
    upper: FloatArray
    """upper bounds in the quantity's unit, shape (N, 3)"""
    tolerances: FloatArray
    """distance outside that still counts as inside, in the quantity's unit, shape (N, 3)"""

    def scaled(self, factor: float) -> Bounds:
        """Return the boxes of all values times a factor, which may be negative."""
        ends = factor * self.lower, factor * self.upper
        return Bounds(np.minimum(*ends), np.maximum(*ends), abs(factor) * self.tolerances)

    def check(self, where: str, values: FloatArray) -> None:
        """Check that `values`, shape (N, 3), are inside the boxes; NaN is not checked.

        Args:
            where: field of a vehicle that holds the values, such as `"start.velocity"`.
            values: one of each vehicle, in the quantity's unit.

        Raises:
            ScenarioError: a value is outside its box.
        """
        outside = values < self.lower - self.tolerances
        outside |= values > self.upper + self.tolerances
        if np.any(outside):
            i = int(np.argmax(np.any(outside, axis=1)))
            quantity, least, most = where.split(".")[1], self.lower[i], self.upper[i]
            expected = f"a {quantity} within {least.tolist()} to {most.tolist()}"
            raise ScenarioError(f"vehicles[{i}].{where}", values[i].tolist(), expected)
