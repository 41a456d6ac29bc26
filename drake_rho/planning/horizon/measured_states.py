"""Deviations of measured states from planned ones, and the bounds that the error tube gives."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import TOLERANCE, Grid, Scenario

ROUNDING = 1e-9
"""Relative difference, in scales of the motion, below which a state counts as that of the plan. It
covers the rounding errors of integration."""


def renewed_tracking(
    whole: Scenario, left: Scenario, unseen: Scenario | None, ahead: int = 0
) -> Tracking | None:
    """Return the tracking of a plan for the rest of a flight: a new tube, the same feedback.

    Args:
        whole: scenario of the whole flight, whose feedback continues.
        left: rest of it.
        unseen: rest of the previous plan's scenario, if a vehicle was not seen. Such a vehicle may
            be anywhere in the previous tube, so the new tube, which is common to all vehicles,
            begins with at least the radii of the previous one.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if left.disturbance is None:
        return None
    first = estimate_errors(whole, ahead)
    if unseen is not None:
        first = max(first[0], tube_radii(unseen)[0]), max(first[1], tube_radii(unseen)[1])
    tube = tube_of(whole)
    return Tracking(left.grid.start, tube.gains, *first, tube.measurements.predicted)


def estimate_errors(scenario: Scenario, ahead: int = 0) -> tuple[float, float]:
    """Return bounds on the error of an estimated state [m, m/s].

    A state predicted ahead with the feedback in force deviates from the true one as in a tube that
    begins at the newest measurement with its errors: the difference of both obeys the same loop.

    Args:
        scenario: scenario with the disturbance and the feedback.
        ahead: number of samples of the feedback by which the state is predicted.
    """
    around = scenario.disturbance
    if around is None or ahead == 0:
        return (0.0, 0.0) if around is None else around.first_error(scenario.grid)
    own, oldest = tube_of(scenario), around.delay + around.dropouts
    steps = -(-(ahead + oldest) // around.samples_per_step(scenario.grid.step))
    measured = around.position_error, around.velocity_error
    grid = Grid(scenario.grid.step, steps + 1)
    tube = dataclasses.replace(own, grid=grid, initial=measured)
    times = own.sample * np.arange(ahead, ahead + oldest + 1)
    return float(tube.position(times).max()), float(tube.velocity(times).max())


def tube_radii(tail: Scenario) -> tuple[float, float]:
    """Return the radii of the error tube at the start of a plan's rest [m, m/s]."""
    if tail.disturbance is None:
        return 0.0, 0.0
    tube, now = tube_of(tail), tail.grid.start - tail.lead
    return float(tube.position(now)), float(tube.velocity(now))


def off_tube(
    tail: Scenario, deviations: tuple[FloatArray, FloatArray], ahead: int = 0
) -> BoolArray:
    """Return which vehicles deviate by more than the tube and the errors of the estimate allow.

    Args:
        tail: scenario of the rest of the previous plan.
        deviations: estimated less planned positions [m] and velocities [m/s], shape (N, 3) each.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if not (deviations[0].any() or deviations[1].any()):
        return np.zeros(len(deviations[0]), dtype=bool)
    (position, velocity), estimate = tube_radii(tail), estimate_errors(tail, ahead)
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
