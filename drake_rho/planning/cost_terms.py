"""Cost of a vehicle as a sum of squares norm(A a - b)² of its accelerations a.

A depends on the grid, the weights and on what is known at the ends, and is equal on every axis; b
depends on the vehicle and the axis. Squared accelerations alone (13) need no A: it is the identity.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from drake_rho.motion.dynamics import response
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.objective import Weights
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True)
class CostTerms:
    """Terms of the cost of the vehicles of one class."""

    weights: Weights
    """weights of the terms"""
    step: float
    """h [s]"""
    knots: int
    """K"""
    ends: tuple[int, int]
    """how often the jerks at the first and the last knot count (`Fleet.counted_ends`)"""
    under_way: bool = False
    """whether the jerk before the first knot is known, from which the snap counts"""

    @property
    def matrix(self) -> FloatArray:
        """Rows A, shape (M, K-1)."""
        return _matrix(self)

    def values(self, scenario: Scenario, vehicles: IntArray) -> FloatArray:
        """Return b of some vehicles of this class, shape (P, M, 3)."""
        fleet, h, own = scenario.fleet, self.step, vehicles
        parts = [np.zeros((len(own), self.knots - 1, 3))] * (self.weights.effort > 0.0)
        jerks = np.zeros((len(own), self.knots, 3))
        before, after = fleet.accelerations_before[own], fleet.accelerations_after[own]
        jerks[:, 0] = np.where(np.isnan(before), 0.0, before / h)
        jerks[:, -1] = np.where(np.isnan(after), 0.0, -after / h)
        if self.weights.jerk > 0.0:
            parts.append(np.sqrt(self.weights.jerk) * self._counts[:, None] * jerks)
        if self.weights.snap > 0.0:
            jerks = jerks[:, self._known]
            if self.under_way:
                jerks = np.concatenate([-fleet.jerks_before[own, None], jerks], axis=1)
            changes = np.diff(jerks, axis=1)
            parts.append(np.sqrt(self.weights.snap) / h * changes)
        if not self.counted:
            return np.concatenate(parts, axis=1)
        times = h * np.arange(1, self.knots)[:, None]
        velocities = fleet.start_velocities[own, None]
        coasting = fleet.start_positions[own, None] + times * velocities
        if self.weights.position > 0.0 or self.weights.velocity > 0.0:
            references = scenario.objective.reference_at(scenario.grid)
            for each, weight, free in zip(
                references, self.weights[3:5], (coasting, velocities), strict=True
            ):
                if weight > 0.0:
                    there = each[own if len(each) > 1 else [0], 1:]
                    parts.append(np.sqrt(weight) * (there - free))
        goals = fleet.goal_positions, fleet.goal_velocities
        for goal, weight, free in zip(
            goals, self.weights[5:], (coasting[:, -1:], velocities), strict=True
        ):
            if weight > 0.0:
                parts.append(np.sqrt(weight) * (goal[own, None] - free))
        return np.concatenate(parts, axis=1)

    @property
    def counted(self) -> frozenset[Quantity]:
        """States at knots that have a cost."""
        w = self.weights
        weights: dict[Quantity, float] = {
            "position": w.position + w.terminal_position,
            "velocity": w.velocity + w.terminal_velocity,
        }
        return frozenset(each for each, weight in weights.items() if weight > 0.0)

    @property
    def of_accelerations(self) -> FloatArray:
        """Rows of A that read accelerations of neighbouring steps only, shape (M, K-1)."""
        weights = self.weights._replace(
            position=0.0, velocity=0.0, terminal_position=0.0, terminal_velocity=0.0
        )
        return dataclasses.replace(self, weights=weights).matrix

    @property
    def _counts(self) -> FloatArray:
        """Square roots of how often each jerk counts, shape (K,)."""
        counts = np.ones(self.knots)
        counts[[0, -1]] = np.sqrt(self.ends)
        return counts

    @property
    def _known(self) -> slice:
        """Knots with a known jerk."""
        first, last = (0 if each else 1 for each in self.ends)
        return slice(first, self.knots - last)


@lru_cache(maxsize=12)
def _matrix(terms: CostTerms) -> FloatArray:
    weights, h, knots = terms.weights, terms.step, terms.knots
    parts = [np.sqrt(weights.effort) * np.eye(knots - 1)] * (weights.effort > 0.0)
    times = h * np.arange(knots)
    jerks = response("jerk", h, knots, times)
    if weights.jerk > 0.0:
        parts.append(np.sqrt(weights.jerk) * terms._counts[:, None] * jerks)
    if weights.snap > 0.0:
        known = jerks[terms._known]
        if terms.under_way:
            known = np.concatenate([np.zeros((1, knots - 1)), known])
        parts.append(np.sqrt(weights.snap) / h * np.diff(known, axis=0))
    states: tuple[tuple[Quantity, float, slice], ...] = (
        ("position", weights.position, slice(1, None)),
        ("velocity", weights.velocity, slice(1, None)),
        ("position", weights.terminal_position, slice(-1, None)),
        ("velocity", weights.terminal_velocity, slice(-1, None)),
    )
    for quantity, weight, counted in states:
        if weight > 0.0:
            parts.append(np.sqrt(weight) * response(quantity, h, knots, times[counted]))
    matrix: FloatArray = np.concatenate([np.zeros((0, knots - 1)), *parts])
    matrix.setflags(write=False)
    return matrix


def terms_by_class(scenario: Scenario) -> tuple[list[CostTerms], IntArray]:
    """Return the terms of each class of vehicles, and the index of each vehicle's class, (N,)."""
    grid, weights = scenario.grid, scenario.objective.weights
    if not (weights.jerk or weights.snap):  # only these depend on the ends
        return [CostTerms(weights, grid.step, grid.knots, (0, 0))], np.zeros(
            len(scenario.vehicles), dtype=int
        )
    earlier: BoolArray = np.zeros(len(scenario.vehicles), dtype=bool)
    if weights.snap:
        earlier = np.asarray(np.isfinite(scenario.fleet.jerks_before).all(axis=1))
    first, last = scenario.fleet.counted_ends
    every = list(zip(first.tolist(), last.tolist(), earlier.tolist(), strict=True))
    kinds = sorted(set(every))
    terms = [
        CostTerms(weights, grid.step, grid.knots, (one, other), bool(third))
        for one, other, third in kinds
    ]
    return terms, np.array([kinds.index(each) for each in every])
