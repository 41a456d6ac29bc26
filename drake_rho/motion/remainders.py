"""Scenarios of the remainder of a planned flight."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import from_states


def remainder(scenario: Scenario, motion: Motion, knot: int) -> Scenario:
    """Return the scenario of the remainder of a planned flight.

    Goals and arrival time remain. The start is the planned state at the knot, with the acceleration
    of the step before it. With a smoothing, its averages continue those before.

    Args:
        scenario: of a flight, or of its remainder.
        motion: planned for it, arrays of shape (N, ..., 3).
        knot: first knot, counted from 0.

    Raises:
        ValueError: no step begins at the knot.
    """
    grid = scenario.grid
    if not 0 <= knot < grid.knots - 1:
        raise ValueError(f"knot: got {knot}, expected 0 to {grid.knots - 2}")
    if knot == 0:
        return scenario
    return from_states(
        scenario,
        grid.from_knot(knot),
        _without_rounding(scenario.fleet, "position", motion.positions[:, knot]),
        _without_rounding(scenario.fleet, "velocity", motion.velocities[:, knot]),
        _without_rounding(scenario.fleet, "acceleration", motion.accelerations[:, knot - 1]),
        tracking_of(scenario),
        motion.flown_until(knot) if scenario.smoothing else None,
        motion.jerks()[:, knot - 1] if scenario.objective.snap > 0.0 else None,
    )


def goes_on(fleet: Fleet, planned: FloatArray, states: FloatArray) -> bool:
    """Return whether states equal those of a plan at a knot, to the last digit.

    Args:
        fleet: of the plan.
        planned: its positions [m] and velocities [m/s] at a knot, shape (N, 6).
        states: those at which another plan begins, shape (N, 6).
    """
    if np.array_equal(states, planned):
        return True
    at_limits = (
        _without_rounding(fleet, "position", planned[:, :3]),
        _without_rounding(fleet, "velocity", planned[:, 3:]),
    )
    return np.array_equal(states, np.concatenate(at_limits, axis=1))


def _without_rounding(fleet: Fleet, quantity: Quantity, values: FloatArray) -> FloatArray:
    """Return the vehicles' values, projected to their limits where within the tolerance.

    A value that violates a limit by more remains unchanged.
    """
    if (bounds := fleet.bounds(quantity)) is not None:
        nearest = np.minimum(np.maximum(values, bounds.lower), bounds.upper)
        values = np.where(np.abs(values - nearest) <= bounds.tolerances, nearest, values)
    for limit in fleet.norms.values():
        if limit.kind.quantity == quantity:
            excess = limit.sets.signed_distance(np.arange(len(values)), values)
            satisfied = excess <= limit.sets.tolerances
            values = np.where(satisfied[:, None], limit.sets.nearest(values), values)
    return values
