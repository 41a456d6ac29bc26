"""Cost of accelerations: the sum of their squares (13), weighted by vehicle."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.fleet import Fleet


def cost_of(fleet: Fleet, accelerations: FloatArray) -> float:
    """Return the cost [m²/s⁴] of accelerations of all vehicles of a fleet, shape (N, K-1, 3)."""
    return float(costs_of(fleet, accelerations).sum())


def costs_of(fleet: Fleet, accelerations: FloatArray) -> FloatArray:
    """Return the cost of each vehicle [m²/s⁴], shape (N,), of accelerations (N, K-1, 3)."""
    flat = accelerations.reshape(len(accelerations), -1)
    return np.asarray(fleet.weights * np.vecdot(flat, flat))
