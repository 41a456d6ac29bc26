"""Winds: disturbance accelerations, never above the bound W of a scenario.

Each is a callable (time [s], positions (N, 3), velocities (N, 3)) -> accelerations [m/s²] (N, 3),
with times on the scenario's clock. `rho.worst_case` is the worst of them. A simulation evaluates
a wind at the beginning of each of its steps and holds it over the step.

A wind may also have these attributes. `over(times, vehicles)`, if the wind does not depend on the
states, returns its values at many times at once, which is faster. `switching_times`, if the wind
jumps, are times at which a simulation makes a step. `position_errors` and `velocity_errors` are
the wind's own estimation errors, and `lost` flags its lost measurements.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray, read_only
from drake_rho.scenario.records import Scenario

Wind = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Function of time [s], positions and velocities to accelerations [m/s²], (N, 3) each."""

_PER_CORRELATION = 20
"""Number of values of coloured noise per correlation time; between them it is linear."""


class WindOverTime(ABC):
    """Wind that does not depend on the states and can be evaluated at many times at once."""

    @abstractmethod
    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """Return the wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """Return the wind at one time, shape (N, 3)."""
        wind: FloatArray = self.over(np.array([time]), len(positions))[0]
        return wind


def none() -> Wind:
    """Return no wind."""
    return _Constant(read_only(np.zeros(3)))


@checked
def constant(scenario: Scenario, direction: npt.ArrayLike) -> Wind:
    """Return a constant wind: the strongest of a scenario in one direction, at all times.

    Raises:
        ValueError: the scenario has no disturbance, or the direction has length 0. The other
            functions of this module raise this too.
    """
    return _Constant(read_only(_strongest(scenario) * unit(direction)))


@checked
def gust(scenario: Scenario, direction: npt.ArrayLike, *, begin: float, duration: float) -> Wind:
    """Return a gust that rises to the strongest wind and falls again, as one minus a cosine.

    Args:
        scenario: scenario with the bound of the wind.
        direction: direction of the wind, of any length above 0, shape (3,).
        begin: beginning of the gust on the scenario's clock [s].
        duration: duration of the whole gust [s].
    """
    if not duration > 0.0:
        raise ValueError(f"duration: got {duration}, expected a time above 0 in seconds")
    return _Gust(read_only(_strongest(scenario) * unit(direction)), begin, duration)


@checked
def coloured_noise(
    scenario: Scenario,
    rng: np.random.Generator,
    *,
    correlation: float = 1.0,
    intensity: float = 0.5,
) -> Wind:
    """Return noise with the spectrum of Dryden's longitudinal gusts.

    Each vehicle and axis has an independent Gauss-Markov process with the spectrum
    1 / (1 + (τ ω)²); winds above the scenario's strongest are scaled down to it.

    Args:
        scenario: scenario with the bound of the wind, the vehicles and the duration.
        rng: source of randomness.
        correlation: correlation time τ [s].
        intensity: standard deviation of each axis before clipping, relative to the strongest wind.
    """
    for field, value in (("correlation", correlation), ("intensity", intensity)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"{field}: got {value}, expected a number above 0")
    grid, W = scenario.grid, _strongest(scenario)
    count = int(np.ceil(grid.duration / correlation * _PER_CORRELATION)) + 1
    keeps = np.exp(-1.0 / _PER_CORRELATION)
    noise = rng.normal(size=(count, len(scenario.vehicles), 3))
    noise[1:] *= np.sqrt(1.0 - keeps**2)
    for before, now in pairwise(noise):
        now += keeps * before
    norms = np.linalg.norm(noise, axis=2, keepdims=True) * intensity
    return _Sampled(
        grid.start,
        correlation / _PER_CORRELATION,
        read_only(W * intensity * noise / np.maximum(norms, 1.0)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Constant(WindOverTime):
    """Constant wind, equal for all vehicles."""

    wind: FloatArray

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        return np.broadcast_to(self.wind, (len(times), vehicles, 3))


@dataclasses.dataclass(frozen=True, eq=False)
class _Gust(WindOverTime):
    """Gust of the shape (1 - cos) / 2 times the strongest wind."""

    strongest: FloatArray
    begin: float
    duration: float

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        passed = np.clip((times - self.begin) / self.duration, 0.0, 1.0)
        winds = np.multiply.outer((1.0 - np.cos(2.0 * np.pi * passed)) / 2.0, self.strongest)
        return np.broadcast_to(winds[:, None], (len(times), vehicles, 3))


@dataclasses.dataclass(frozen=True, eq=False)
class _Sampled(WindOverTime):
    """Wind that is linear between values at equal time intervals, and constant after the last."""

    start: float
    every: float
    values: FloatArray

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        passed = np.clip((times - self.start) / self.every, 0.0, len(self.values) - 1.0)
        k = np.minimum(passed.astype(np.int64), len(self.values) - 2)
        part = (passed - k)[:, None, None]
        return np.asarray((1.0 - part) * self.values[k] + part * self.values[k + 1])


def checked_wind(
    wind: Wind, time: float, positions: FloatArray, velocities: FloatArray
) -> FloatArray:
    """Return a wind at one time [m/s²], shape (N, 3), after checking it.

    Raises:
        ValueError: the wind has another shape, or values that are not finite.
    """
    found = np.asarray(wind(time, positions, velocities), dtype=np.float64)
    if found.shape != positions.shape or not np.isfinite(found).all():
        got = f"shape {found.shape}" if found.shape != positions.shape else f"{found.tolist()}"
        expected = f"finite accelerations of shape {positions.shape}"
        raise ValueError(f"wind: got {got} at {time:g} s, expected {expected}")
    return found


def _strongest(scenario: Scenario) -> float:
    """Return W, the strongest wind of a scenario [m/s²]."""
    if scenario.disturbance is None:
        raise ValueError(
            "scenario.disturbance: got None, expected one with the strength of the wind"
        )
    return scenario.disturbance.acceleration


def unit(direction: npt.ArrayLike) -> FloatArray:
    """Return the direction scaled to length 1, shape (3,)."""
    d = np.asarray(direction, dtype=np.float64)
    if d.shape != (3,) or not 0.0 < float(np.linalg.norm(d)) < np.inf:
        raise ValueError(f"direction: got {direction!r}, expected three numbers, not all 0")
    return d / np.linalg.norm(d)
