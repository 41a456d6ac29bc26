"""Winds: accelerations that nobody has planned, never above the W of a scenario.

Each is a callable (time [s], positions (N, 3), velocities (N, 3)) -> accelerations [m/s²] (N, 3),
with times on the scenario's clock. The one that is worst is `rho.worst_case`. A simulation asks it
at the beginning of each of its steps and holds it over the step.

A wind may also have `over(times, vehicles)`, if it does not depend on the states: its values at
many times at once, which is faster; `switching_times`, if it changes at once: a simulation steps
there; `position_errors` and `velocity_errors`, if errors of the estimate belong to it.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray, locked
from drake_rho.scenario.records import Scenario

Wind = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Time [s], positions and velocities of all vehicles to accelerations [m/s²], (N, 3) each."""

_PER_CORRELATION = 20
"""Values of coloured noise in the time in which it forgets; between them it is linear."""


class WindOverTime(ABC):
    """A wind that does not depend on the states, and so can be had at many times at once."""

    @abstractmethod
    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        """The wind at times on the scenario's clock [s], in m/s², shape (M, N, 3)."""

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """The wind at one time, shape (N, 3)."""
        wind: FloatArray = self.over(np.array([time]), len(positions))[0]
        return wind


def none() -> Wind:
    """No wind."""
    return _Constant(locked(np.zeros(3)))


@checked
def constant(scenario: Scenario, direction: npt.ArrayLike) -> Wind:
    """The strongest wind of a scenario in one direction, all the time.

    Raises:
        ValueError: the scenario has no disturbance, or the direction no length; from the others
            too.
    """
    return _Constant(locked(_strongest(scenario) * unit(direction)))


@checked
def gust(scenario: Scenario, direction: npt.ArrayLike, *, begin: float, duration: float) -> Wind:
    """A gust that rises to the strongest wind and falls again, as one minus a cosine.

    Args:
        scenario: how strong it may be.
        direction: in which it blows, of any length above 0, shape (3,).
        begin: on the scenario's clock [s].
        duration: of the whole gust [s].
    """
    if not duration > 0.0:
        raise ValueError(f"duration: got {duration}, expected a time above 0 in seconds")
    return _Gust(locked(_strongest(scenario) * unit(direction)), begin, duration)


@checked
def coloured_noise(
    scenario: Scenario,
    rng: np.random.Generator,
    *,
    correlation: float = 1.0,
    intensity: float = 0.5,
) -> Wind:
    """Noise with the spectrum of Dryden's longitudinal gusts, of its own for each vehicle and axis.

    A Gauss-Markov process, 1 / (1 + (τ ω)²), clipped to the strongest wind where it is above.

    Args:
        scenario: how strong it may be, which vehicles, and for how long.
        rng: where randomness comes from.
        correlation: τ, the time in which it forgets [s].
        intensity: standard deviation of each axis before clipping, as a part of the strongest.
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
        locked(W * intensity * noise / np.maximum(norms, 1.0)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Constant(WindOverTime):
    """The same wind at all times and on all vehicles."""

    wind: FloatArray

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        return np.broadcast_to(self.wind, (len(times), vehicles, 3))


@dataclasses.dataclass(frozen=True, eq=False)
class _Gust(WindOverTime):
    """One minus a cosine, half of it, times a wind."""

    strongest: FloatArray
    begin: float
    duration: float

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        passed = np.clip((times - self.begin) / self.duration, 0.0, 1.0)
        winds = np.multiply.outer((1.0 - np.cos(2.0 * np.pi * passed)) / 2.0, self.strongest)
        return np.broadcast_to(winds[:, None], (len(times), vehicles, 3))


@dataclasses.dataclass(frozen=True, eq=False)
class _Sampled(WindOverTime):
    """Wind that is linear between values at equal distances, and keeps its last one."""

    start: float
    every: float
    values: FloatArray

    def over(self, times: FloatArray, vehicles: int) -> FloatArray:
        passed = np.clip((times - self.start) / self.every, 0.0, len(self.values) - 1.0)
        k = np.minimum(passed.astype(np.int64), len(self.values) - 2)
        part = (passed - k)[:, None, None]
        return np.asarray((1.0 - part) * self.values[k] + part * self.values[k + 1])


def blown(wind: Wind, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
    """What a wind says at one time [m/s²], shape (N, 3), if it makes sense.

    Raises:
        ValueError: it has another shape, or numbers that are not finite.
    """
    found = np.asarray(wind(time, positions, velocities), dtype=np.float64)
    if found.shape != positions.shape or not np.isfinite(found).all():
        said = f"shape {found.shape}" if found.shape != positions.shape else f"{found.tolist()}"
        expected = f"finite accelerations of shape {positions.shape}"
        raise ValueError(f"wind: got {said} at {time:g} s, expected {expected}")
    return found


def _strongest(scenario: Scenario) -> float:
    """W [m/s²]."""
    if scenario.disturbance is None:
        raise ValueError(
            "scenario.disturbance: got None, expected one that says how strong wind is"
        )
    return scenario.disturbance.acceleration


def unit(direction: npt.ArrayLike) -> FloatArray:
    """The direction with length 1, shape (3,)."""
    d = np.asarray(direction, dtype=np.float64)
    if d.shape != (3,) or not 0.0 < float(np.linalg.norm(d)) < np.inf:
        raise ValueError(f"direction: got {direction!r}, expected three numbers, not all 0")
    return d / np.linalg.norm(d)
