"""Error tubes after the end of a plan, while the feedback holds vehicles at their goals.

The feedback continues with the same gains. So the tube is that of a longer plan that ends at rest,
and its radii are constant from the sample on in which the effects of all earlier causes have
decayed. `docs/flight.md` contains the mathematics.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property, lru_cache
from typing import Final

import numpy as np

from drake_rho.motion.sampled_loop import Responses, is_stable, transition
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.parts import Quantity

_MOST: Final = 50_000
"""Largest number of samples after the end in which errors have to decay, to count as bounded."""

_MOST_GROWING: Final = 5_000
"""Number of samples after the end for which radii that are not bounded are computed."""

_GROWTH: Final = 200.0
"""Largest logarithm of the growth of unstable errors, far from an overflow."""

_DOUBLE_ROOT: Final = 1e-6
"""Rounding error of eigenvalues of 1 without feedback, which are double: errors grow as powers."""

_PRECISION: Final = 1e-6
"""Relative precision of the largest radius of the position."""

_PARTS, _ROUNDS = 8, 6
"""Number of parts into which pieces of time are divided, and how often, to reach the precision."""


@dataclasses.dataclass(frozen=True, eq=False)
class RestTube:
    """Error tube of vehicles that hold at the end of their plan."""

    tube: ErrorTube
    """tube on a grid so long that its radii are constant at the end, if they ever are"""
    begin: float
    """end of the plan on the scenario's clock [s]"""
    is_bounded: bool
    """whether radii stay bounded: the feedback lets every error decay"""

    @property
    def end(self) -> float:
        """Time from which radii are constant, or to which they are computed [s]."""
        return self.tube.grid.end

    def largest(self, quantity: Quantity, until: float = np.inf) -> float:
        """Return the largest radius of a quantity from `begin` to a time, in its unit.

        Radii of velocity and feedback are exact, that of the position is at most 1e-6 of it above
        the largest one.

        Args:
            quantity: position, velocity, or acceleration for the feedback.
            until: time on the scenario's clock [s]; without end if not given.

        Returns:
            The radius; infinite without an end if it is not bounded.
        """
        if until == np.inf and not self.is_bounded and self._is_disturbed:
            return np.inf
        last = min(max(until, self.begin), self.end)
        if quantity == "position":
            return self._largest_position_ever if last == self.end else self._to(last)
        over = self.tube.velocity_over if quantity == "velocity" else self.tube.acceleration_over
        return float(over(self.begin, last)[0])

    @property
    def _is_disturbed(self) -> bool:
        """Whether anything causes errors that grow without feedback."""
        return bool(self.tube.sizes[0] > 0.0 or self.tube.sizes[4] > 0.0 or any(self.tube.gains))

    @cached_property
    def _largest_position_ever(self) -> float:
        return self._to(self.end)

    def _to(self, last: float) -> float:
        """Return the largest radius of the position until a time, by branch and bound."""
        tube, first = self.tube, self.begin
        if not any(tube.initial):  # each sample has larger radii than the one before
            first = max(first, last - tube.sample)
        count = math.ceil(round((last - first) / tube.sample, 9))
        edges = np.linspace(first, last, max(1, count) + 1)
        begins, ends, best = edges[:-1], edges[1:], 0.0
        for _ in range(_ROUNDS):
            tops = tube.position_over(begins, ends)
            best = max(best, float(np.max(tube.position(np.append(begins, ends)))))
            above = tops > (1.0 + _PRECISION) * best
            if not above.any():
                return max(best, float(tops.max(initial=0.0)))
            parts = np.linspace(begins[above], ends[above], _PARTS + 1)
            begins, ends = parts[:-1].ravel(), parts[1:].ravel()
        return float(tube.position_over(begins, ends).max())


@lru_cache(maxsize=64)
def rest_tube(tube: ErrorTube, end: float | None = None) -> RestTube:
    """Return the continuation of a tube after its end.

    Args:
        tube: the tube.
        end: time from which vehicles rest, if that is before the end of the tube [s].
    """
    gains = tube.gains[0] * tube.sample**2, tube.gains[1] * tube.sample
    measurements, step = tube.measurements, tube.grid.step
    stable = is_stable(gains, measurements.queued)
    count = len(Responses.of(gains, measurements, _MOST)) if stable else _MOST
    bounded = count < _MOST
    if not bounded:
        growth = _growth(gains, measurements.queued)
        count = min(_MOST_GROWING, int(_GROWTH / growth) if growth > 0.0 else _MOST_GROWING)
    samples = tube.samples + count + 1
    whole = tube.disturbance.steps_per_sample(step)  # of small steps, more than one
    knots = 2 + math.ceil(samples * whole / tube.disturbance.samples_per_step(step))
    longer = dataclasses.replace(tube, grid=unchecked(tube.grid, knots=knots))
    return RestTube(longer, tube.grid.end if end is None else end, bounded)


def _growth(gains: tuple[float, float], queued: int) -> float:
    """Return the logarithm of the growth of errors per sample; 0 if it is not exponential."""
    largest = float(np.abs(np.linalg.eigvals(transition(gains, queued))).max())
    return max(0.0, math.log(largest) - _DOUBLE_ROOT)
