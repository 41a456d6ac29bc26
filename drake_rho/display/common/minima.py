"""Smallest values over time of clearances and of margins, of each vehicle and of all."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray


@dataclasses.dataclass(frozen=True)
class Minimum:
    """The smallest value of all vehicles over time."""

    row: int
    """row of the vehicle in `Minima`"""
    vehicle: int
    """index of the vehicle"""
    time: float
    """time since the first knot [s]"""
    value: float
    """value, such as a clearance [m]"""


@dataclasses.dataclass(frozen=True, eq=False)
class Minima:
    """Smallest values over time of some vehicles."""

    vehicles: IntArray
    """indices of the vehicles, shape (V,)"""
    times: FloatArray
    """times since the first knot [s], shape (V,)"""
    values: FloatArray
    """values, such as clearances [m], shape (V,)"""

    @property
    def least(self) -> Minimum:
        """Smallest value of all."""
        row = int(np.argmin(self.values))
        time, value = float(self.times[row]), float(self.values[row])
        return Minimum(row, int(self.vehicles[row]), time, value)
