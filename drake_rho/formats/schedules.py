"""Schedules: times for the places of a route that leave enough time for every leg.

Each leg gets the time of a motion from rest to rest along its length within the limits, in whole
steps of a grid. So there is a plan whenever nothing is in the way: the one that stops everywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.limits import GRAVITY, Limits

_STEPS = 400
"""Number of steps of a mission in which no leg is short."""
_MOST, _LONGER = 1500, 1.3
"""Largest number of steps of other missions, unless they have hundreds of legs, and the largest
flight beside the shortest one that is accepted while it is not reached. With 1950 steps, errors of
solvers add up to more than the tolerance of a mission of 100 legs."""
_SHORTEST = 0.1
"""Shortest step that is chosen [s]."""
_LEAST = 4
"""Least number of steps of a leg."""


@dataclasses.dataclass(frozen=True)
class Pace:
    """Speed, acceleration and jerk that limits allow in every direction; infinite if unbounded."""

    speed: float
    """norm of the velocity [m/s]"""
    acceleration: float
    """norm of the acceleration [m/s²]"""
    jerk: float
    """norm of the jerk [m/s³]"""

    @classmethod
    def of(cls, limits: Limits) -> Pace:
        """Return the pace that limits allow.

        Raises:
            ScenarioError: they bound neither speed nor acceleration, or exclude rest.
        """
        found = []
        for quantity, most in (
            ("velocity", limits.max_speed),
            ("acceleration", limits.max_acceleration),
            ("jerk", limits.max_jerk),
        ):
            box = getattr(limits, quantity)
            sides = [] if box is None else [*-box.lower, *box.upper]
            found.append(min([*sides, most or np.inf]))
        if limits.max_thrust is not None:
            found[1] = min(found[1], limits.max_thrust - GRAVITY)
        if limits.max_tilt is not None:
            found[1] = min(found[1], GRAVITY * np.sin(limits.max_tilt))
        if min(found) <= 0.0 or np.isinf(found[:2]).all():
            expected = "limits of speed or acceleration that allow rest and motion in any direction"
            raise ScenarioError("limits", limits, expected)
        return cls(*found)

    def times(self, lengths: Sequence[float], speeds: Sequence[float | None]) -> list[float]:
        """Return the times from rest to rest along straight legs of some lengths [m] [s]."""
        found = []
        for length, most in zip(lengths, speeds, strict=True):
            speed = min(self.speed, most or np.inf)
            rise = min(speed / self.acceleration, np.sqrt(length / self.acceleration))
            found.append(rise + max(length / speed, rise) + self._smoothing)
        return found

    @property
    def _smoothing(self) -> float:
        """Time over which jumps between opposite accelerations are averaged for the jerk [s]."""
        return 0.0 if np.isinf(self.jerk) else 2.0 * self.acceleration / self.jerk

    def steps(
        self, step: float, lengths: Sequence[float], speeds: Sequence[float | None]
    ) -> list[int]:
        """Return the numbers of steps of motions from rest to rest along straight legs.

        Accelerations are constant in each of them. There is a step more than needed, so that there
        is not a single motion only.
        """
        found = []
        for length, most in zip(lengths, speeds, strict=True):
            speed = min(self.speed, most or np.inf)
            rise = min(speed / self.acceleration, np.sqrt(length / self.acceleration)) / step
            rising = max(int(np.ceil(rise)), 1)
            cruising = max(int(np.ceil(length / (speed * step))) - rising, 0)
            smoothing = int(np.ceil(self._smoothing / step))
            found.append(max(2 * rising + cruising + smoothing + 1, _LEAST))
        return found


def step_for(seconds: float, steps: Callable[[float], int]) -> float:
    """Return a round step for a flight [s]: 1, 2 or 5 times 10ⁿ.

    It is the longest with about `_STEPS` steps at most or, where legs are short beside it, a
    shorter one with which the flight is at most `_LONGER` times as long as it need be.

    Args:
        seconds: time of the flight without a grid [s].
        steps: function from a step [s] to the number of steps of the flight.
    """
    best = rounded = _rounded_up(max(seconds / _STEPS, _SHORTEST))
    least = best * steps(best)
    most = max(_MOST, 1.25 * least / best)
    while least > _LONGER * seconds and rounded > _SHORTEST:
        rounded = _rounded_up(0.4 * rounded)
        if (count := steps(rounded)) > most:
            break
        if rounded * count < least:
            best, least = rounded, rounded * count
    return best


def _rounded_up(step: float) -> float:
    """Return the least of 1, 2 and 5 times 10ⁿ that is no shorter than a step, but for rounding."""
    power = 10.0 ** np.floor(np.log10(step) + 1e-9)
    return float(
        next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= step * 0.999)
    )


def arrivals(steps: Sequence[int], rests: Sequence[int]) -> IntArray:
    """Return the knots of arrival at places, shape (M,).

    Args:
        steps: numbers of steps of the legs to them.
        rests: numbers of steps at rest there.
    """
    return np.asarray(np.cumsum(steps) + np.concatenate([[0], np.cumsum(rests)[:-1]]).astype(int))
