"""Cost of accelerations: the sum of their squares (13), weighted by vehicle."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.fleet import Fleet


def cost_of(fleet: Fleet, accelerations: FloatArray) -> float:
    """Return the cost [m²/s⁴] of accelerations of all vehicles of a fleet, shape (N, K-1, 3)."""
    if fleet.weights is None:
        return float(np.sum(accelerations**2))
    return float(np.sum(costs_of(fleet, accelerations)))


def costs_of(fleet: Fleet, accelerations: FloatArray) -> FloatArray:
    """Return the cost of each vehicle [m²/s⁴], shape (N,), of accelerations (N, K-1, 3)."""
    costs: FloatArray = np.sum(accelerations**2, axis=(1, 2))
    return costs if fleet.weights is None else fleet.weights * costs
