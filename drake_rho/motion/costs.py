"""Cost of motions: squared accelerations (13) or the terms of an `Objective`, by vehicle."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.objective import Weights
from drake_rho.scenario.records import Scenario


class AtKnots(Protocol):
    """Motions of all vehicles at the knots, as a plan or a `Motion`."""

    @property
    def positions(self) -> FloatArray:
        """Positions at the knots [m], shape (N, K, 3)."""
        ...

    @property
    def velocities(self) -> FloatArray:
        """Velocities at the knots [m/s], shape (N, K, 3)."""
        ...

    @property
    def accelerations(self) -> FloatArray:
        """Accelerations in the steps [m/s²], shape (N, K-1, 3)."""
        ...


def cost_of(scenario: Scenario, motion: AtKnots) -> float:
    """Return the cost [m²/s⁴] of the motions of all vehicles of a scenario."""
    return float(costs_of(scenario, motion).sum())


def costs_of(scenario: Scenario, motion: AtKnots) -> FloatArray:
    """Return the cost of each vehicle [m²/s⁴], shape (N,), of motions with arrays (N, ..., 3)."""
    flat = motion.accelerations.reshape(len(motion.accelerations), -1)
    if scenario.objective.is_effort:
        return np.asarray(scenario.fleet.weights * np.vecdot(flat, flat))
    return np.asarray(np.sum(list(costs_by_term(scenario, motion).values()), axis=0))


def savings(scenario: Scenario, before: AtKnots, after: AtKnots) -> FloatArray:
    """Return by how much each vehicle's cost falls [m²/s⁴], shape (N,), without cancellation."""
    if not scenario.objective.is_effort:
        return costs_of(scenario, before) - costs_of(scenario, after)
    differences = (before.accelerations**2 - after.accelerations**2).sum(axis=(1, 2))
    return np.asarray(scenario.fleet.weights * differences)


def costs_by_term(scenario: Scenario, motion: AtKnots) -> dict[str, FloatArray]:
    """Return the cost of each vehicle [m²/s⁴], shape (N,), by term with a weight."""
    fleet, weights = scenario.fleet, scenario.objective.weights
    sums = _Sums(scenario, motion)
    return {
        term: weight * fleet.weights * getattr(sums, term)()
        for term, weight in zip(Weights._fields, weights, strict=True)
        if weight > 0.0
    }


class _Sums:
    """Sums of squares of each term of a cost, before weights.

    Args:
        scenario: with the reference and the goals.
        motion: the motions of all vehicles.
    """

    def __init__(self, scenario: Scenario, motion: AtKnots) -> None:
        self._scenario, self._motion = scenario, motion

    def effort(self) -> FloatArray:
        """Return sums of squared accelerations over steps [m²/s⁴]."""
        return np.asarray(_squares(self._motion.accelerations).sum(axis=1))

    def jerk(self) -> FloatArray:
        """Return sums of squared jerks over knots [m²/s⁶], those from and to rest twice."""
        squares = np.nan_to_num(_squares(self._jerks()))
        before, after = self._scenario.fleet.counted_ends
        squares[:, 0] *= before
        squares[:, -1] *= after
        return np.asarray(squares.sum(axis=1))

    def snap(self) -> FloatArray:
        """Return sums of squared changes of known jerks over steps [m²/s⁸]."""
        earlier = self._scenario.fleet.jerks_before[:, None]
        changes = np.diff(self._jerks(), axis=1, prepend=earlier) / self._scenario.grid.step
        return np.asarray(np.nan_to_num(_squares(changes)).sum(axis=1))

    def _jerks(self) -> FloatArray:
        """Return jerks (7) at the knots [m/s³], (N, K, 3); NaN at ends where they are unknown."""
        fleet = self._scenario.fleet
        ends = fleet.accelerations_before[:, None], fleet.accelerations_after[:, None]
        changes = np.diff(self._motion.accelerations, axis=1, prepend=ends[0], append=ends[1])
        return np.asarray(changes / self._scenario.grid.step)

    def position(self) -> FloatArray:
        """Return sums of squared distances from the reference over knots [m²]."""
        reference, _ = self._scenario.objective.reference_at(self._scenario.grid)
        return np.asarray(_squares((self._motion.positions - reference)[:, 1:]).sum(axis=1))

    def velocity(self) -> FloatArray:
        """Return sums of squared differences from the reference's velocity over knots [m²/s²]."""
        _, reference = self._scenario.objective.reference_at(self._scenario.grid)
        return np.asarray(_squares((self._motion.velocities - reference)[:, 1:]).sum(axis=1))

    def terminal_position(self) -> FloatArray:
        """Return squared distances from the goals at the last knot [m²]."""
        return _squares(self._motion.positions[:, -1] - self._scenario.fleet.goal_positions)

    def terminal_velocity(self) -> FloatArray:
        """Return squared differences from the goals' velocities at the last knot [m²/s²]."""
        return _squares(self._motion.velocities[:, -1] - self._scenario.fleet.goal_velocities)


def _squares(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.vecdot(vectors, vectors))
