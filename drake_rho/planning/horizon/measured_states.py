"""Deviations of measured states from planned ones, and the bounds that the error tube gives."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import TOLERANCE, Scenario

ROUNDING = 1e-9
"""Relative difference, in scales of the motion, below which a state counts as that of the plan. It
covers the rounding errors of integration."""


def renewed_tracking(whole: Scenario, left: Scenario, unseen: Scenario | None) -> Tracking | None:
    """Return the tracking of a plan for the rest of a flight: a new tube, the same feedback.

    Args:
        whole: scenario of the whole flight, whose feedback continues.
        left: rest of it.
        unseen: rest of the previous plan's scenario, if a vehicle was not seen. Such a vehicle may
            be anywhere in the previous tube, so the new tube, which is common to all vehicles,
            begins with at least the radii of the previous one.
    """
    if left.disturbance is None:
        return None
    first = estimate_errors(left)
    if unseen is not None:
        first = max(first[0], tube_radii(unseen)[0]), max(first[1], tube_radii(unseen)[1])
    tube = tube_of(whole)
    return Tracking(left.grid.start, tube.gains, *first, tube.measurements.predicted)


def estimate_errors(scenario: Scenario) -> tuple[float, float]:
    """Return bounds on the error of an estimated state [m, m/s]."""
    around = scenario.disturbance
    return (0.0, 0.0) if around is None else around.first_error(scenario.grid)


def tube_radii(tail: Scenario) -> tuple[float, float]:
    """Return the radii of the error tube at the start of a plan's rest [m, m/s]."""
    if tail.disturbance is None:
        return 0.0, 0.0
    tube, now = tube_of(tail), tail.grid.start
    return float(tube.position(now)), float(tube.velocity(now))


def off_tube(tail: Scenario, deviations: tuple[FloatArray, FloatArray]) -> BoolArray:
    """Return which vehicles deviate by more than the tube and the errors of the estimate allow.

    Args:
        tail: scenario of the rest of the previous plan.
        deviations: estimated less planned positions [m] and velocities [m/s], shape (N, 3) each.
    """
    if not (deviations[0].any() or deviations[1].any()):
        return np.zeros(len(deviations[0]), dtype=bool)
    (position, velocity), estimate = tube_radii(tail), estimate_errors(tail)
    return exceeding(tail, deviations, position + estimate[0], velocity + estimate[1])


def exceeding(
    scenario: Scenario,
    deviations: tuple[FloatArray, FloatArray],
    position: float,
    velocity: float,
    tolerance: float = TOLERANCE,
) -> BoolArray:
    """Return which vehicles deviate by more than given radii and a relative tolerance, (N,).

    Args:
        scenario: with the scales of the motions.
        deviations: of positions [m] and velocities [m/s], shape (N, 3) each.
        position: radius of positions [m].
        velocity: radius of velocities [m/s].
        tolerance: in scales of the motions.
    """
    if not (deviations[0].any() or deviations[1].any()):
        return np.zeros(len(deviations[0]), dtype=bool)
    fleet = scenario.fleet
    far = np.linalg.norm(deviations[0], axis=1) > position + tolerance * fleet.scale("position")
    fast = np.linalg.norm(deviations[1], axis=1) > velocity + tolerance * fleet.scale("velocity")
    either: BoolArray = far | fast
    return either
