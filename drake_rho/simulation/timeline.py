"""The times of a simulation: samples of the feedback, parts of them, and whatever changes."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.fields import FloatArray, IntArray, locked
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import Wind

_PARTS = 10
"""Fewest steps of a simulation in a sample of the feedback."""

_SAME = 1e-9
"""Part of a sample by which two times may differ and be the same."""


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """When a simulation steps. A sample is δ; where nothing disturbs, it is the grid's step."""

    elapsed: FloatArray
    """since the first knot [s], shape (M,); sample j is exactly j times δ"""
    times: FloatArray
    """the same on the scenario's clock [s]; knots are exactly those of the grid"""
    samples: IntArray
    """where among the times each sample begins, and the last one ends, shape (J + 1,)"""

    @classmethod
    def of(cls, scenario: Scenario, wind: Wind, longest: float = np.inf) -> Timeline:
        """The times for a flight.

        Args:
            scenario: whose samples, knots, and corners of obstacles' tracks are times.
            wind: whose `switching_times`, if it has such, are times too.
            longest: no step is longer than this [s].
        """
        grid, around = scenario.grid, scenario.disturbance or Disturbance(0.0)
        sample, count = around.sample(grid), around.samples(grid)
        parts = max(_PARTS, int(np.ceil(sample / longest * (1.0 - _SAME))))
        begins = sample * np.arange(count + 1)
        regular = (begins[:-1, None] + sample / parts * np.arange(parts)).reshape(-1)
        regular = np.append(regular, begins[-1])
        apart = max(_SAME * sample, grid.rounding)
        elapsed = np.union1d(regular, _between(_changes(scenario, wind), regular, apart))
        samples = np.searchsorted(elapsed, begins)
        times = grid.start + elapsed
        times[samples[:: around.samples_per_step(grid.step)]] = grid.times
        return cls(locked(elapsed), locked(times), samples)

    def nearest(self, elapsed: float) -> float:
        """The clock's time [s] of the step that begins at a time since the first knot [s].

        The latest step, if none begins there; rounding does not matter.
        """
        early = _SAME * self.elapsed[self.samples[1]]
        k = int(np.searchsorted(self.elapsed, elapsed + early, side="right")) - 1
        return float(self.times[max(k, 0)])


def _changes(scenario: Scenario, wind: Wind) -> FloatArray:
    """Times since the first knot at which wind or an obstacle's velocity changes at once [s]."""
    given = [np.ravel(np.asarray(getattr(wind, "switching_times", ()), dtype=np.float64))]
    given += [obstacle.corners for obstacle in scenario.bodies]
    return np.asarray(np.concatenate(given) - scenario.grid.start)


def _between(more: FloatArray, regular: FloatArray, apart: float) -> FloatArray:
    """Return those times that are `apart` or more from the regular ones and from each other."""
    more = np.unique(more)
    more = more[np.diff(more, prepend=-np.inf) > apart]
    after = np.clip(np.searchsorted(regular, more), 1, len(regular) - 1)
    near = np.minimum(more - regular[after - 1], regular[after] - more)
    return np.asarray(more[near > apart])  # negative outside the flight
