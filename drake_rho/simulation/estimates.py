"""Estimation errors (measured minus true states) and lost measurements."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, read_only
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import Wind


@dataclasses.dataclass(frozen=True, eq=False)
class EstimationErrors:
    """Measured minus true states at every sample of the feedback, and lost measurements."""

    positions: FloatArray
    """errors of positions [m], shape (J, N, 3)"""
    velocities: FloatArray
    """errors of velocities [m/s], shape (J, N, 3)"""
    lost: BoolArray
    """whether each measurement is lost, shape (J, N)"""
    held: int = 1
    """number of steps of the simulated grid in a sample, if more than one"""

    @classmethod
    def of(
        cls, scenario: Scenario, wind: Wind, rng: np.random.Generator | None
    ) -> EstimationErrors:
        """Return the errors for a flight.

        Args:
            scenario: scenario with the bounds of the errors and the number of samples.
            wind: wind; if it has `position_errors` and `velocity_errors`, shape (J, 3) or
                (J, N, 3), as `rho.worst_case` does, these are used, and `lost`, shape (J,) or
                (J, N), if it has that.
            rng: generator that otherwise draws errors uniformly from their balls, and lost
                measurements; without one there are neither.

        Raises:
            ValueError: `rng` is not a generator.
        """
        if rng is not None and not isinstance(rng, np.random.Generator):
            expected = "a numpy.random.Generator, as numpy.random.default_rng(1), or None"
            raise ValueError(f"rng: got {rng!r}, expected {expected}")
        vehicles, grid = len(scenario.vehicles), scenario.grid
        disturbance = scenario.disturbance_or_calm
        samples, held = disturbance.samples(grid), disturbance.steps_per_sample(grid.step)
        if hasattr(wind, "position_errors") and hasattr(wind, "velocity_errors"):
            given = (wind.position_errors, wind.velocity_errors)
            lost = np.asarray(getattr(wind, "lost", np.zeros(samples)), dtype=bool)[:samples]
            each = np.broadcast_to(lost if lost.ndim == 2 else lost[:, None], (samples, vehicles))
            shape = samples, vehicles, 3
            positions, velocities = (_for_each(errors[:samples], shape) for errors in given)
            return cls(positions, velocities, each, held)
        if rng is None or not scenario.disturbance:
            none = read_only(np.zeros((samples, vehicles, 3)))
            return cls(none, none, np.zeros((samples, vehicles), dtype=bool), held)
        sizes = disturbance.position_error, disturbance.velocity_error
        positions, velocities = (size * _in_ball(rng, (samples, vehicles)) for size in sizes)
        lost = _lost(rng, (samples, vehicles), disturbance.dropouts)
        return cls(positions, velocities, lost, held)

    def added_to(self, sample: int, states: FloatArray) -> FloatArray:
        """Return the measurements of states (N, 6) at a sample from 0; NaN if they are lost."""
        at = min(sample // self.held, len(self.positions) - 1)
        measured = states + np.concatenate([self.positions[at], self.velocities[at]], axis=1)
        return np.asarray(np.where(self.lost[at, :, None], np.nan, measured))


def _for_each(errors: FloatArray, shape: tuple[int, int, int]) -> FloatArray:
    """Return errors broadcast to every vehicle, (J, N, 3)."""
    each = errors[:, None] if errors.ndim == 2 else errors
    return np.broadcast_to(each, shape)


def _in_ball(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """Return points drawn uniformly from the unit ball, shape (..., 3)."""
    points = rng.normal(size=(*shape, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    return np.asarray(points * np.cbrt(rng.uniform(size=shape))[..., None])


def _lost(rng: np.random.Generator, shape: tuple[int, int], most: int) -> BoolArray:
    """Return flags of randomly lost measurements, at most `most` in a row, (J, N).

    The loss rate of each vehicle is drawn from 0 to 1.
    """
    lost = np.zeros(shape, dtype=bool)
    if most == 0:
        return lost
    drawn = rng.uniform(size=shape) < rng.uniform(size=shape[1])
    run = np.zeros(shape[1], dtype=np.int64)
    for j, each in enumerate(drawn):
        lost[j] = each & (run < most)
        run = np.where(lost[j], run + 1, 0)
    return lost
