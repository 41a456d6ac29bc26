"""Scenarios from measured states, which deviate from planned ones within the error tube."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import BoolArray, FloatArray, unchecked
from drake_rho.scenario.records import TOLERANCE, Grid, Scenario
from drake_rho.scenario.rest_of_flight import from_states

Deviations = tuple[FloatArray, FloatArray]
"""Deviations of positions [m] and velocities [m/s], shape (N, 3) each."""

_ROUNDING = 1e-9
"""Largest difference of states that count as equal, in scales of the motion. It covers the rounding
errors of integration."""


def from_measured(scenario: Scenario, states: FloatArray) -> Scenario:
    """Return a scenario from measured states; itself if these are the starts.

    Starts are exact, and so are states equal to them. For other states, the tube begins with the
    errors of the estimate. With a smoothing, flights begin at rest at their starts.

    Args:
        scenario: to be flown.
        states: positions [m] and velocities [m/s], shape (N, 6). A vehicle with a row of NaN was
            not seen, and is taken to be at its start.
    """
    if scenario.smoothing is not None:
        return scenario
    fleet, tolerance = scenario.fleet, TOLERANCE if scenario.disturbance is None else _ROUNDING
    measured, away = deviations(states, fleet.start_states)
    if not exceeding(scenario, away, 0.0, 0.0, tolerance).any():
        return scenario
    tracking = _renewed_tracking(scenario, scenario, states, ahead=0)
    before = fleet.accelerations_before
    moved = from_states(scenario, scenario.grid, *_split(measured), before, tracking)
    return moved.derived(under_way=False)  # there is no previous plan


def continued(
    left: Scenario,
    whole: Scenario,
    states: FloatArray,
    measured: FloatArray,
    away: Deviations,
    ahead: int,
) -> Scenario:
    """Return the rest of a flight from measured states, with a new error tube.

    With a smoothing it continues the previous plan in its tube.

    Args:
        left: rest of the flight from the planned states.
        whole: scenario of the whole flight, whose feedback continues.
        states: positions [m] and velocities [m/s], shape (N, 6), with NaN for vehicles not seen.
        measured: the same with planned values for these, from `deviations`.
        away: deviations of these from planned values, from `deviations`.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if left.smoothing is not None:
        return left
    moves = exceeding(left, away, 0.0, 0.0, _ROUNDING).any()
    if not moves and left.disturbance is None:
        return left
    tracking = _renewed_tracking(whole, left, states, ahead)
    if moves:
        before = left.fleet.accelerations_before
        return from_states(left, left.grid, *_split(measured), before, tracking)
    return left.derived(
        disturbance=left.disturbance and unchecked(left.disturbance, tracking=tracking),
        under_way=True,
    )


def deviations(states: FloatArray, planned: FloatArray) -> tuple[FloatArray, Deviations]:
    """Return measured states, and their deviations from planned ones.

    Args:
        states: measured, shape (N, 6), with NaN for vehicles that were not seen.
        planned: shape (N, 6).

    Returns:
        The states with planned values for vehicles that were not seen, shape (N, 6), and the
        deviations of positions [m] and velocities [m/s], shape (N, 3) each.
    """
    measured = np.asarray(np.where(np.isnan(states), planned, states))
    return measured, _split(measured - planned)


def _renewed_tracking(
    whole: Scenario, left: Scenario, states: FloatArray, ahead: int
) -> Tracking | None:
    """Return the tracking of a plan for the rest of a flight: a new tube, the same feedback.

    A vehicle that was not seen may be anywhere in the previous tube, so that the new tube, which is
    common to all vehicles, begins with at least the radii of the previous one.
    """
    if left.disturbance is None:
        return None
    first = estimate_errors(whole, ahead)
    if np.isnan(states).any():
        before = tube_radii(left)
        first = max(first[0], before[0]), max(first[1], before[1])
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
    around = scenario.disturbance_or_calm
    if not scenario.disturbance or ahead == 0:
        return around.first_error(scenario.grid)
    own, oldest = tube_of(scenario), around.delay + around.dropouts
    steps = -(-(ahead + oldest) // around.samples_per_step(scenario.grid.step))
    measured = around.position_error, around.velocity_error
    grid = Grid(scenario.grid.step, steps + 1)
    tube = dataclasses.replace(own, grid=grid, initial=measured)
    times = own.sample * np.arange(ahead, ahead + oldest + 1)
    return float(tube.position(times).max()), float(tube.velocity(times).max())


def tube_radii(remaining: Scenario) -> tuple[float, float]:
    """Return the radii of the error tube at the start of a plan's rest [m, m/s]."""
    if remaining.disturbance is None:
        return 0.0, 0.0
    tube, now = tube_of(remaining), remaining.grid.start - remaining.lead
    return float(tube.position(now)), float(tube.velocity(now))


def off_tube(remaining: Scenario, away: Deviations, ahead: int = 0) -> BoolArray:
    """Return flags of vehicles off the tube, enlarged by the errors of the estimate.

    Args:
        remaining: scenario of the rest of the previous plan.
        away: estimated less planned positions [m] and velocities [m/s], shape (N, 3) each.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if not (away[0].any() or away[1].any()):
        return np.zeros(len(away[0]), dtype=bool)
    (position, velocity), estimate = tube_radii(remaining), estimate_errors(remaining, ahead)
    return exceeding(remaining, away, position + estimate[0], velocity + estimate[1])


def exceeding(
    scenario: Scenario,
    away: Deviations,
    position: float,
    velocity: float,
    tolerance: float = TOLERANCE,
) -> BoolArray:
    """Return flags of vehicles that deviate by more than given radii and a tolerance, (N,).

    Args:
        scenario: with the scales of the motions.
        away: deviations of positions [m] and velocities [m/s], shape (N, 3) each.
        position: radius of positions [m].
        velocity: radius of velocities [m/s].
        tolerance: in scales of the motions.
    """
    if not (away[0].any() or away[1].any()):
        return np.zeros(len(away[0]), dtype=bool)
    fleet = scenario.fleet
    far = np.linalg.norm(away[0], axis=1) > position + tolerance * fleet.scale("position")
    fast = np.linalg.norm(away[1], axis=1) > velocity + tolerance * fleet.scale("velocity")
    either: BoolArray = far | fast
    return either


def _split(states: FloatArray) -> Deviations:
    """Return positions [m] and velocities [m/s], (N, 3) each."""
    return states[:, :3], states[:, 3:]
