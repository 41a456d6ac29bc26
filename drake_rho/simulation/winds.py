"""Winds: accelerations that nobody has planned, never above the W of a scenario.

Each is a callable (time [s], positions (N, 3), velocities (N, 3)) -> accelerations [m/s²] (N, 3),
with times on the scenario's clock. The one that is worst is `rho.worst_case`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from drake_rho.scenario.fields import FloatArray, locked
from drake_rho.scenario.records import Scenario

Wind = Callable[[float, FloatArray, FloatArray], FloatArray]
"""Time [s], positions and velocities of all vehicles to accelerations [m/s²], (N, 3) each."""

_PER_CORRELATION = 20
"""Values of coloured noise in the time in which it forgets; between them it is linear."""


def none() -> Wind:
    """No wind."""
    return lambda time, positions, velocities: np.zeros_like(positions)


def constant(scenario: Scenario, direction: npt.ArrayLike) -> Wind:
    """The strongest wind of a scenario in one direction, all the time.

    Raises:
        ValueError: the scenario has no disturbance, or the direction no length; from the others
            too.
    """
    wind = _strongest(scenario) * unit(direction)
    return lambda time, positions, velocities: np.tile(wind, (len(positions), 1))


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
    wind = _strongest(scenario) * unit(direction)

    def blow(time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        passed = np.clip((time - begin) / duration, 0.0, 1.0)
        return np.tile((1.0 - np.cos(2.0 * np.pi * passed)) / 2.0 * wind, (len(positions), 1))

    return blow


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
class _Sampled:
    """Wind that is linear between values at equal distances, and keeps its last one."""

    start: float
    every: float
    values: FloatArray

    def __call__(self, time: float, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        passed = min(max((time - self.start) / self.every, 0.0), len(self.values) - 1.0)
        k = min(int(passed), len(self.values) - 2)
        part = passed - k
        return np.asarray((1.0 - part) * self.values[k] + part * self.values[k + 1])


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
