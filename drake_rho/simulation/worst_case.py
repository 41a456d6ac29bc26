"""Worst case: wind, estimation errors and lost measurements whose error attains the tube radius."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from drake_rho.motion.sampled_loop import (
    POSITION,
    POSITION_ERROR,
    VELOCITY,
    VELOCITY_ERROR,
    WIND_AT_BEGIN,
    WIND_AT_END,
)
from drake_rho.motion.scenario_tube import error_tube
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray, read_only
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock
from drake_rho.simulation.winds import WindOverTime, unit


@dataclasses.dataclass(frozen=True, eq=False)
class WorstCase(WindOverTime, metaclass=Described):
    """Wind that drives every vehicle to the largest error in one direction at one time.

    It is a callable like those of `drake_rho.simulation.winds`, constant between its switching
    times. The error attains the tube's radius only together with the estimation errors, the lost
    measurements and the error at the first knot given here.
    """

    radius: float
    """largest error, in m, m/s or m/s²"""
    switching_times: FloatArray
    """times at which the wind changes, on the scenario's clock [s], shape (S,)"""
    accelerations: FloatArray
    """wind from each switching time on [m/s²], shape (S, 3); no wind before the first"""
    position_errors: FloatArray
    """errors of the estimated position at every sample of the feedback [m], shape (J, 3)"""
    velocity_errors: FloatArray
    """errors of the estimated velocity at every sample of the feedback [m/s], shape (J, 3)"""
    first_position: FloatArray
    """error of the position at the first knot [m], shape (3,)"""
    first_velocity: FloatArray
    """error of the velocity at the first knot [m/s], shape (3,)"""
    lost: BoolArray
    """whether the measurement of every sample of the feedback is lost, shape (J,)"""
    clock: Clock
    """clock for comparing times with the switching times"""

    def __repr__(self) -> str:
        """Return a short text, as '<WorstCase: an error of 0.2413, winds from 0 s to 6 s>'."""
        first, last = self.switching_times[[0, -1]]
        return (
            f"<WorstCase: an error of {self.radius:.4g}, winds from {first:.4g} s to {last:.4g} s>"
        )

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""
        k = self.clock.last_begun(self.switching_times, times) + 1
        winds = np.concatenate([np.zeros((1, 3)), self.accelerations])[k]
        return np.broadcast_to(winds[:, None], (len(times), vehicles, 3))


@checked
def worst_case(
    scenario: Scenario,
    direction: npt.ArrayLike,
    time: float,
    quantity: Quantity = "position",
    *,
    tube: ErrorTube | None = None,
) -> WorstCase:
    """Return the wind and errors that drive a quantity's error to its radius at a given time.

    If measurements may be lost, the worst case loses those that maximise the error.

    Args:
        scenario: scenario with a disturbance.
        direction: direction of the error, of any length above 0, shape (3,).
        time: time on the scenario's clock [s].
        quantity: position, velocity, or acceleration (that of the feedback at this time).
        tube: tube with the gains and the initial errors; `error_tube(scenario)` if not given.

    Raises:
        ValueError: the direction has length 0, the time is outside the flight, or the quantity is
            none of the three.
    """
    if quantity not in ("position", "velocity", "acceleration"):
        raise ValueError(f"quantity: got {quantity!r}, expected position, velocity or acceleration")
    d = unit(direction)
    tube = error_tube(scenario) if tube is None else tube
    j, part = tube.sample_at([time])
    x, lost = tube.responses.worst(quantity, float(part[0]), int(j[0]), tube.sizes)
    ages = int(j[0]) - np.arange(tube.samples)  # number of samples since each sample began
    begins, signs = _switches(x, ages, part[0], acts_now=quantity != "acceleration")
    errors = np.sign(_at_ages(x[[POSITION_ERROR, VELOCITY_ERROR]], ages))
    first = np.sign(_at_ages(x[[POSITION, VELOCITY]], j))[:, 0]
    disturbance = tube.disturbance
    radius = getattr(tube, quantity)(time)
    return WorstCase(
        float(radius),
        read_only(tube.grid.start + tube.sample * begins),
        read_only(disturbance.acceleration * np.multiply.outer(signs, d)),
        read_only(disturbance.position_error * np.multiply.outer(errors[0], d)),
        read_only(disturbance.velocity_error * np.multiply.outer(errors[1], d)),
        read_only(tube.initial[0] * first[0] * d),
        read_only(tube.initial[1] * first[1] * d),
        _at_ages(lost, ages).astype(bool),
        Clock.of(tube.sample, tube.grid.start, tube.grid.end),
    )


def _at_ages(x: FloatArray | BoolArray, ages: IntArray) -> FloatArray:
    """Return responses to inputs of given ages in samples; 0 for future or decayed ones."""
    known = (ages >= 0) & (ages < x.shape[-1])
    return np.asarray(np.where(known, x[..., np.where(known, ages, 0)], 0.0))


def _switches(
    x: FloatArray, ages: IntArray, part: float, *, acts_now: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the times, in samples, from which the wind has each sign, and these signs.

    Within an earlier sample the response is linear and changes its sign at most once. The response
    to wind in the current sample is positive until the time considered.
    """
    first, last = _at_ages(x[WIND_AT_BEGIN], ages), _at_ages(x[WIND_AT_END], ages)
    changes = np.sign(first) * np.sign(last) < 0.0
    begins = [np.arange(len(ages), dtype=np.float64)]
    signs = [np.where(changes, np.sign(first), np.sign(first + last))]
    here = np.flatnonzero(changes)
    begins.append(here + first[here] / (first[here] - last[here]))
    signs.append(np.sign(last[here]))
    (now,) = np.flatnonzero(ages == 0)
    signs[0][now] = float(acts_now)
    begins.append(np.array([now + part]))  # no wind from then on
    signs.append(np.zeros(1))
    order = np.argsort(np.concatenate(begins), kind="stable")
    times, values = np.concatenate(begins)[order], np.concatenate(signs)[order]
    values[times > now + part] = 0.0
    changed = np.diff(values, prepend=0.0) != 0.0
    return times[changed], values[changed]
