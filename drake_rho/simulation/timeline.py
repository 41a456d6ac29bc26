"""Times of a simulation: feedback samples, their subdivisions, and instants of change."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.fields import FloatArray, IntArray, read_only
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import Wind

_PARTS = 10
"""Smallest number of simulation steps in a sample of the feedback."""


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """Times of a simulation's steps. A sample lasts δ: without a disturbance, the grid's step.

    Samples of the feedback that last several steps count as that many here.
    """

    elapsed: FloatArray
    """times since the first knot [s], shape (M,); sample j is at exactly j times δ"""
    times: FloatArray
    """these times on the scenario's clock [s]; knots are exactly those of the grid"""
    samples: IntArray
    """indices of the times at which samples begin, and at which the last ends, shape (J + 1,)"""

    @classmethod
    def of(cls, scenario: Scenario, wind: Wind, longest: float = np.inf) -> Timeline:
        """Return the times for a flight.

        Args:
            scenario: scenario with samples, knots, and corners of obstacles' tracks.
            wind: wind; its `switching_times`, if it has any, are included.
            longest: longest step [s].
        """
        grid, disturbance = scenario.grid, scenario.disturbance or Disturbance(0.0)
        # the nominal acceleration changes inside of samples of several steps
        whole = disturbance.steps_per_sample(grid.step)
        sample = disturbance.sample(grid) / whole
        count = (grid.knots - 1) * disturbance.samples_per_step(grid.step)
        parts = max(_PARTS, int(np.ceil(sample / longest * (1.0 - SAME_TIME))))
        begins = sample * np.arange(count + 1)
        regular = (begins[:-1, None] + sample / parts * np.arange(parts)).reshape(-1)
        regular = np.append(regular, begins[-1])
        apart = max(SAME_TIME * sample, grid.rounding)
        elapsed = np.union1d(regular, _between(_changes(scenario, wind), regular, apart))
        samples = np.searchsorted(elapsed, begins)
        times = grid.start + elapsed
        times[samples[:: disturbance.samples_per_step(grid.step)]] = grid.times
        return cls(read_only(elapsed), read_only(times), samples)

    def nearest(self, elapsed: float) -> float:
        """Return the clock time [s] of the latest step that begins at or before an elapsed time.

        The elapsed time is since the first knot [s]; rounding errors in it do not matter.
        """
        early = SAME_TIME * self.elapsed[self.samples[1]]
        k = int(np.searchsorted(self.elapsed, elapsed + early, side="right")) - 1
        return float(self.times[max(k, 0)])


def _changes(scenario: Scenario, wind: Wind) -> FloatArray:
    """Return times since the first knot at which the wind or an obstacle's velocity jumps [s]."""
    given = [np.ravel(np.asarray(getattr(wind, "switching_times", ()), dtype=np.float64))]
    given += [obstacle.corners for obstacle in scenario.bodies]
    return np.asarray(np.concatenate(given) - scenario.grid.start)


def _between(more: FloatArray, regular: FloatArray, apart: float) -> FloatArray:
    """Return the times that are more than `apart` from regular times and from each other."""
    more = np.unique(more)
    more = more[np.diff(more, prepend=-np.inf) > apart]
    after = np.clip(np.searchsorted(regular, more), 1, len(regular) - 1)
    near = np.minimum(more - regular[after - 1], regular[after] - more)
    return np.asarray(more[near > apart])  # `near` is negative outside the flight
