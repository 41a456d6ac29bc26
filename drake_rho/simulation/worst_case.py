"""The wind and the errors of the estimate that take an error to the bound of its ball."""

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
from drake_rho.motion.tube import ErrorTube, error_tube
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, IntArray, locked
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import WindOverTime, unit

_EARLY = 1e-9
"""Part of a sample by which a time may be short of a switch and still count as after it."""


@dataclasses.dataclass(frozen=True, eq=False)
class WorstCase(WindOverTime, metaclass=Described):
    """What drives every vehicle to the largest error in one direction at one time: a wind.

    A callable like the others of `drake_rho.simulation.winds`, constant between its switching
    times. The radius is reached together with the errors of the estimate and the first error only,
    which stand beside it.
    """

    radius: float
    """the error that is reached, in m, m/s or m/s²"""
    switching_times: FloatArray
    """when the wind changes, on the scenario's clock [s], shape (S,)"""
    accelerations: FloatArray
    """the wind from each switching time on [m/s²], shape (S, 3); none before the first"""
    position_errors: FloatArray
    """errors of the estimated position at every sample of the feedback [m], shape (J, 3)"""
    velocity_errors: FloatArray
    """errors of the estimated velocity at every sample of the feedback [m/s], shape (J, 3)"""
    first_position: FloatArray
    """error of the position at the first knot [m], shape (3,)"""
    first_velocity: FloatArray
    """error of the velocity at the first knot [m/s], shape (3,)"""
    early: float
    """how much before a switching time still counts as it, for rounded times [s]"""

    def __repr__(self) -> str:
        """As in '<WorstCase: an error of 0.2413, winds from 0 s to 6 s>': arrays are many."""
        first, last = self.switching_times[[0, -1]]
        return (
            f"<WorstCase: an error of {self.radius:.4g}, winds from {first:.4g} s to {last:.4g} s>"
        )

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """The wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""
        k = np.searchsorted(self.switching_times, times + self.early, side="right")
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
    """What takes a quantity of the error to its radius, in a direction at a time.

    Args:
        scenario: what is asked, with a disturbance.
        direction: of the error, of any length above 0, shape (3,).
        time: on the scenario's clock [s].
        quantity: position, velocity, or acceleration (of the feedback that acts then).
        tube: whose gains and first errors they are; that of `error_tube(scenario)` if not given.

    Raises:
        ValueError: the direction has no length, the time is outside the flight, or the quantity is
            none of the three.
    """
    if quantity not in ("position", "velocity", "acceleration"):
        raise ValueError(f"quantity: got {quantity!r}, expected position, velocity or acceleration")
    d = unit(direction)
    tube = error_tube(scenario) if tube is None else tube
    j, part = tube.located([time])
    x = tube.responses.at(quantity, part)[0]
    ages = int(j[0]) - np.arange(tube.samples)  # how many samples ago each sample began
    begins, signs = _switches(x, ages, part[0], blows_now=quantity != "acceleration")
    errors = np.sign(_at_ages(x[[POSITION_ERROR, VELOCITY_ERROR]], ages))
    first = np.sign(_at_ages(x[[POSITION, VELOCITY]], j))[:, 0]
    around = tube.disturbance
    radius = getattr(tube, quantity)(time)
    return WorstCase(
        float(radius),
        locked(tube.grid.start + tube.sample * begins),
        locked(around.acceleration * np.multiply.outer(signs, d)),
        locked(around.position_error * np.multiply.outer(errors[0], d)),
        locked(around.velocity_error * np.multiply.outer(errors[1], d)),
        locked(tube.initial[0] * first[0] * d),
        locked(tube.initial[1] * first[1] * d),
        max(_EARLY * tube.sample, tube.grid.rounding),
    )


def _at_ages(x: FloatArray, ages: IntArray) -> FloatArray:
    """Responses to causes of so many samples ago, 0 to those that are to come or have decayed."""
    known = (ages >= 0) & (ages < x.shape[-1])
    return np.asarray(np.where(known, x[..., np.where(known, ages, 0)], 0.0))


def _switches(
    x: FloatArray, ages: IntArray, part: float, *, blows_now: bool
) -> tuple[FloatArray, FloatArray]:
    """Times in samples from which on the wind has a sign, and these signs.

    In an earlier sample the response is linear, and changes its sign once or never; wind of the
    sample itself has a positive one until the time that is looked at.
    """
    first, last = _at_ages(x[WIND_AT_BEGIN], ages), _at_ages(x[WIND_AT_END], ages)
    changes = np.sign(first) * np.sign(last) < 0.0
    begins = [np.arange(len(ages), dtype=np.float64)]
    signs = [np.where(changes, np.sign(first), np.sign(first + last))]
    here = np.flatnonzero(changes)
    begins.append(here + first[here] / (first[here] - last[here]))
    signs.append(np.sign(last[here]))
    (now,) = np.flatnonzero(ages == 0)
    signs[0][now] = float(blows_now)
    begins.append(np.array([now + part]))  # and then none
    signs.append(np.zeros(1))
    order = np.argsort(np.concatenate(begins), kind="stable")
    times, values = np.concatenate(begins)[order], np.concatenate(signs)[order]
    values[times > now + part] = 0.0
    changed = np.diff(values, prepend=0.0) != 0.0
    return times[changed], values[changed]
