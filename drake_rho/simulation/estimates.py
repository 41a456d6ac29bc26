"""Estimation errors: the states seen by feedback and planner minus the true states."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, read_only
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import Wind


@dataclasses.dataclass(frozen=True, eq=False)
class EstimationErrors:
    """Estimated minus true states at every sample of the feedback."""

    positions: FloatArray
    """errors of positions [m], shape (J, N, 3)"""
    velocities: FloatArray
    """errors of velocities [m/s], shape (J, N, 3)"""
    held: int = 1
    """number of steps of the simulated grid for which a sample lasts, if more than one"""

    @classmethod
    def of(
        cls, scenario: Scenario, wind: Wind, rng: np.random.Generator | None
    ) -> EstimationErrors:
        """Return the errors for a flight.

        Args:
            scenario: scenario with the bounds of the errors and the number of samples.
            wind: wind; if it has `position_errors` and `velocity_errors`, shape (J, 3) or
                (J, N, 3), as `rho.worst_case` does, these are used.
            rng: generator that otherwise draws errors uniformly from their balls; without one
                there are no errors.

        Raises:
            ValueError: `rng` is not a generator.
        """
        if rng is not None and not isinstance(rng, np.random.Generator):
            expected = "a numpy.random.Generator, as numpy.random.default_rng(1), or None"
            raise ValueError(f"rng: got {rng!r}, expected {expected}")
        vehicles, disturbance, grid = len(scenario.vehicles), scenario.disturbance, scenario.grid
        samples = grid.knots - 1 if disturbance is None else disturbance.samples(grid)
        held = 1 if disturbance is None else disturbance.steps_per_sample(grid.step)
        if hasattr(wind, "position_errors") and hasattr(wind, "velocity_errors"):
            given = (wind.position_errors, wind.velocity_errors)
            shape = samples, vehicles, 3
            positions, velocities = (_for_each(errors[:samples], shape) for errors in given)
            return cls(positions, velocities, held)
        if rng is None or disturbance is None:
            none = read_only(np.zeros((samples, vehicles, 3)))
            return cls(none, none, held)
        sizes = disturbance.position_error, disturbance.velocity_error
        positions, velocities = (size * _in_ball(rng, (samples, vehicles)) for size in sizes)
        return cls(positions, velocities, held)

    def added_to(self, sample: int, states: FloatArray) -> FloatArray:
        """Return the estimates of states (N, 6) at a sample, counted from 0."""
        at = min(sample // self.held, len(self.positions) - 1)
        return np.asarray(
            states + np.concatenate([self.positions[at], self.velocities[at]], axis=1)
        )


def _for_each(errors: FloatArray, shape: tuple[int, int, int]) -> FloatArray:
    """Return errors of every vehicle, (J, N, 3), from these or from common errors, (J, 3)."""
    each = errors[:, None] if errors.ndim == 2 else errors
    return np.broadcast_to(each, shape)


def _in_ball(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """Return points drawn uniformly from the unit ball, shape (..., 3)."""
    points = rng.normal(size=(*shape, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    return np.asarray(points * np.cbrt(rng.uniform(size=shape))[..., None])
