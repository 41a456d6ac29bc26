"""Scenarios from measured states, which deviate from planned ones within the error tube."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np
import numpy.typing as npt

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import LARGEST, BoolArray, FloatArray, unchecked
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.records import TOLERANCE, Grid, Scenario
from drake_rho.scenario.rest_of_flight import from_states

_ROUNDING = 1e-9
"""Largest difference of states that count as equal, in scales of the motion. It covers the rounding
errors of integration."""


@dataclasses.dataclass(frozen=True, eq=False)
class Measured:
    """Measured states of all vehicles, and their deviations from planned ones."""

    states: FloatArray
    """positions [m] and velocities [m/s], shape (N, 6); for vehicles not seen, the planned ones"""
    deviations: FloatArray
    """these less the planned ones, shape (N, 6)"""
    all_seen: bool
    """whether all vehicles were seen"""

    @classmethod
    def of(cls, states: FloatArray, planned: FloatArray) -> Self:
        """Return measured states, with NaN for vehicles that were not seen, beside planned ones."""
        unseen = np.isnan(states)
        found = np.asarray(np.where(unseen, planned, states))
        return cls(found, found - planned, not unseen.any())

    def exceed(
        self, fleet: Fleet, radii: tuple[float, float] = (0.0, 0.0), tolerance: float = TOLERANCE
    ) -> BoolArray:
        """Return flags of vehicles that deviate by more than given radii and a tolerance, (N,).

        Args:
            fleet: vehicles, with the scales of their motions.
            radii: of positions [m] and velocities [m/s].
            tolerance: in scales of the motions.
        """
        if not self.deviations.any():
            return np.zeros(len(self.deviations), dtype=bool)
        far = np.linalg.norm(self.deviations[:, :3], axis=1)
        fast = np.linalg.norm(self.deviations[:, 3:], axis=1)
        either = np.zeros(len(far), dtype=bool)
        for scale in (fleet.largest_scale, fleet.scale):  # own scales take far longer
            either = (far > radii[0] + tolerance * scale("position")) | (
                fast > radii[1] + tolerance * scale("velocity")
            )
            if either.all():
                break
        return either


def checked_states(scenario: Scenario, states: npt.ArrayLike) -> FloatArray:
    """Return states as an array, shape (N, 6), with rows of NaN for vehicles that were not seen.

    Raises:
        ValueError: the shape is wrong, or a value of a vehicle that was seen is not finite.
    """
    count = len(scenario.vehicles)
    array = np.array(states, dtype=np.float64)
    if array.shape != (count, 6):
        raise ValueError(f"states: got shape {array.shape}, expected {(count, 6)}")
    unseen = np.isnan(array).all(axis=1)
    wrong = ~np.isfinite(array).all(axis=1) & ~unseen
    if wrong.any():
        vehicle = scenario.vehicles[int(np.argmax(wrong))].name
        expected = f"finite numbers for {vehicle}, or NaN in its whole row if it was not seen"
        raise ValueError(f"states: got {array.tolist()}, expected {expected}")
    array[(np.abs(array) > LARGEST).any(axis=1)] = np.nan  # no flight has such states
    return array


def from_measured(scenario: Scenario, states: FloatArray) -> Scenario:
    """Return a scenario from measured states; itself if these are the starts.

    Starts are exact, and so are states equal to them. For other states, the tube begins with the
    errors of the estimate. With a smoothing, flights begin at rest at their starts.

    Args:
        scenario: to be flown.
        states: positions [m] and velocities [m/s], shape (N, 6). A vehicle with a row of NaN was
            not seen, and is taken to be at its start.
    """
    if scenario.smoothing:
        return scenario
    measured = Measured.of(states, scenario.fleet.start_states)
    tolerance = _ROUNDING if scenario.disturbance else TOLERANCE
    if not measured.exceed(scenario.fleet, tolerance=tolerance).any():
        return scenario
    moved = _moved(scenario, measured, ahead=0)
    return moved.derived(under_way=False)  # there is no previous plan


def continued(remaining: Scenario, measured: Measured, ahead: int) -> Scenario:
    """Return the rest of a flight from measured states, with a new error tube.

    With a smoothing it continues the previous plan in its tube.

    Args:
        remaining: rest of the flight from the planned states.
        measured: states beside the planned ones.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if remaining.smoothing:
        return remaining
    if measured.exceed(remaining.fleet, tolerance=_ROUNDING).any():
        return _moved(remaining, measured, ahead)
    if not remaining.disturbance:
        return remaining
    tracking = _renewed_tracking(remaining, measured, ahead)
    disturbance = unchecked(remaining.disturbance, tracking=tracking)
    return remaining.derived(disturbance=disturbance, under_way=True)


def _moved(scenario: Scenario, measured: Measured, ahead: int) -> Scenario:
    """Return a scenario that begins at measured states, with a new error tube."""
    positions, velocities = measured.states[:, :3], measured.states[:, 3:]
    before = scenario.fleet.accelerations_before
    tracking = _renewed_tracking(scenario, measured, ahead)
    return from_states(scenario, scenario.grid, positions, velocities, before, tracking)


def _renewed_tracking(scenario: Scenario, measured: Measured, ahead: int) -> Tracking:
    """Return the tracking of a plan from measured states: a new tube, the same feedback.

    A vehicle that was not seen may be anywhere in the previous tube, so that the new tube, which is
    common to all vehicles, begins with at least the radii of the previous one.
    """
    first = estimate_errors(scenario, ahead)
    if not measured.all_seen:
        before = tube_radii(scenario)
        first = max(first[0], before[0]), max(first[1], before[1])
    tube = tube_of(scenario)
    return Tracking(scenario.grid.start, tube.gains, *first, tube.measurements.predicted)


def estimate_errors(scenario: Scenario, ahead: int = 0) -> tuple[float, float]:
    """Return bounds on the error of an estimated state [m, m/s].

    A state predicted ahead with the feedback in force deviates from the true one as in a tube that
    begins at the newest measurement with its errors: the difference of both obeys the same loop.

    Args:
        scenario: scenario with the disturbance and the feedback.
        ahead: number of samples of the feedback by which the state is predicted.
    """
    disturbance, grid = scenario.disturbance, scenario.grid
    if disturbance is None:
        return 0.0, 0.0
    if ahead == 0:
        return disturbance.first_error(grid)
    own, oldest = tube_of(scenario), disturbance.delay + disturbance.dropouts
    steps = -(-(ahead + oldest) // disturbance.samples_per_step(grid.step))
    measured = disturbance.position_error, disturbance.velocity_error
    tube = dataclasses.replace(own, grid=Grid(grid.step, steps + 1), initial=measured)
    times = own.sample * np.arange(ahead, ahead + oldest + 1)
    return float(tube.position(times).max()), float(tube.velocity(times).max())


def tube_radii(remaining: Scenario) -> tuple[float, float]:
    """Return the radii of the error tube at the start of a plan's rest [m, m/s]."""
    if remaining.disturbance is None:
        return 0.0, 0.0
    tube, now = tube_of(remaining), remaining.grid.start - remaining.lead
    return float(tube.position(now)), float(tube.velocity(now))


def off_tube(remaining: Scenario, measured: Measured, ahead: int) -> BoolArray:
    """Return flags of vehicles off the tube, enlarged by the errors of the estimate, (N,).

    Args:
        remaining: scenario of the rest of the previous plan.
        measured: states beside the planned ones.
        ahead: number of samples by which states are predicted, as in `estimate_errors`.
    """
    if not measured.deviations.any():
        return np.zeros(len(measured.states), dtype=bool)
    errors = zip(tube_radii(remaining), estimate_errors(remaining, ahead), strict=True)
    position, velocity = (radius + error for radius, error in errors)
    return measured.exceed(remaining.fleet, (position, velocity))
