"""Errors of the estimated states: what the feedback and the planner see is not quite the truth."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, locked
from drake_rho.scenario.records import Scenario
from drake_rho.simulation.winds import Wind


@dataclasses.dataclass(frozen=True, eq=False)
class EstimationErrors:
    """Estimated less true states at every sample of the feedback."""

    positions: FloatArray
    """[m], shape (J, N, 3)"""
    velocities: FloatArray
    """[m/s], shape (J, N, 3)"""

    @classmethod
    def of(
        cls, scenario: Scenario, wind: Wind, rng: np.random.Generator | None
    ) -> EstimationErrors:
        """The errors for a flight.

        Args:
            scenario: how large they can be, and how many there are.
            wind: brings its own where it has `position_errors` and `velocity_errors`, shape (J, 3)
                or (J, N, 3), as `rho.worst_case` does.
            rng: draws them evenly from their balls otherwise; without one there are none.

        Raises:
            ValueError: `rng` is no generator.
        """
        if rng is not None and not isinstance(rng, np.random.Generator):
            expected = "a numpy.random.Generator, as numpy.random.default_rng(1), or None"
            raise ValueError(f"rng: got {rng!r}, expected {expected}")
        vehicles, around = len(scenario.vehicles), scenario.disturbance
        samples = scenario.grid.knots - 1 if around is None else around.samples(scenario.grid)
        if hasattr(wind, "position_errors") and hasattr(wind, "velocity_errors"):
            given = (wind.position_errors, wind.velocity_errors)
            return cls(*(_for_each(errors, (samples, vehicles, 3)) for errors in given))
        if rng is None or around is None:
            none = locked(np.zeros((samples, vehicles, 3)))
            return cls(none, none)
        sizes = around.position_error, around.velocity_error
        return cls(*(size * _in_ball(rng, (samples, vehicles)) for size in sizes))

    def added_to(self, sample: int, states: FloatArray) -> FloatArray:
        """The estimate of states (N, 6), positions and velocities, at a sample, from 0."""
        at = min(sample, len(self.positions) - 1)
        return np.asarray(
            states + np.concatenate([self.positions[at], self.velocities[at]], axis=1)
        )


def _for_each(errors: FloatArray, shape: tuple[int, int, int]) -> FloatArray:
    """Errors of every vehicle, from those of every vehicle or of all alike."""
    each = errors[:, None] if errors.ndim == 2 else errors
    return np.broadcast_to(each, shape)


def _in_ball(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """Points spread evenly in the unit ball, shape (..., 3)."""
    points = rng.normal(size=(*shape, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    return np.asarray(points * np.cbrt(rng.uniform(size=shape))[..., None])
