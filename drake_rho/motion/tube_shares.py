"""Tracking errors as shares of the error tube's radii."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity

_ROUNDING = 1e-9
"""Rounding error of a motion, relative to its scale."""


def largest_shares(
    errors: FloatArray, radii: FloatArray, negligible: float | FloatArray = 0.0
) -> FloatArray:
    """Return each vehicle's largest ratio of error to tube radius, shape (N,); 0 without a tube.

    Args:
        errors: errors at some times, shape (M, N).
        radii: radii at these times, in the same unit, shape (M,); times at which one is zero do not
            count.
        negligible: parts of the errors that are only rounding, in the same unit, shape (N,).
    """
    wide = radii > 0.0
    excess = np.maximum(errors[wide] - negligible, 0.0)
    shares: FloatArray = np.max(excess / radii[wide, None], axis=0, initial=0.0)
    return shares


def rounding_of(simulation: Simulation, quantity: Quantity) -> FloatArray:
    """Return rounding errors of vehicles' motions, in the quantity's unit, shape (N,)."""
    return np.asarray(_ROUNDING * simulation.scenario.fleet.scale(quantity))
