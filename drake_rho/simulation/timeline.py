"""Times of a simulation: feedback samples, their subdivisions, and instants of change."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray, read_only
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import Clock, steps_lasting
from drake_rho.simulation.winds import Wind

_PARTS = 10
"""Smallest number of simulation steps in a sample of the feedback."""


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """Times of a simulation's steps. A sample lasts δ: without a disturbance, the grid's step.

    A feedback sample of several steps counts as that many samples here.
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
        grid, disturbance = scenario.grid, scenario.disturbance_or_calm
        # the nominal acceleration changes inside samples of several steps
        whole = disturbance.steps_per_sample(grid.step)
        sample = disturbance.sample(grid) / whole
        count = (grid.knots - 1) * disturbance.samples_per_step(grid.step)
        parts = max(_PARTS, steps_lasting(sample, longest))
        begins = sample * np.arange(count + 1)
        regular = (begins[:-1, None] + sample / parts * np.arange(parts)).reshape(-1)
        regular = np.append(regular, begins[-1])
        changes = _changes(scenario, wind)
        changes = changes[(changes > 0.0) & (changes < regular[-1])]
        clock = grid.clock
        elapsed = np.union1d(regular, clock.apart(clock.distinct(changes), regular))
        samples = np.searchsorted(elapsed, begins)
        times = grid.start + elapsed
        times[samples[:: disturbance.samples_per_step(grid.step)]] = grid.times
        return cls(read_only(elapsed), read_only(times), samples)

    def nearest(self, elapsed: float) -> float:
        """Return the clock time [s] of the latest step that begins at or before an elapsed time.

        The elapsed time is since the first knot [s]; rounding errors in it do not matter.
        """
        clock = Clock.of(float(self.elapsed[self.samples[1]]))
        return float(self.times[max(int(clock.last_begun(self.elapsed, elapsed)), 0)])


def _changes(scenario: Scenario, wind: Wind) -> FloatArray:
    """Return times since the first knot at which the wind or an obstacle's velocity jumps [s]."""
    given = [np.ravel(np.asarray(getattr(wind, "switching_times", ()), dtype=np.float64))]
    given += [obstacle.corners for obstacle in scenario.bodies]
    return np.asarray(np.concatenate(given) - scenario.grid.start)
