"""Minimum-effort motions to the goals, in closed form.

The unknowns of programs are changes of these motions.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property, lru_cache

import numpy as np

from drake_rho.motion.dynamics import Motion, response
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.fleet import Fleet
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE


@dataclasses.dataclass(frozen=True)
class Goals:
    """Terminal equalities (12) of each axis: rows @ accelerations = values."""

    rows: FloatArray
    """orthonormal rows, shape (2 or 1, K-1); shape (0, K-1) if goals are not required"""
    values: FloatArray
    """right-hand sides [m/s²], shape (N, 2, 1 or 0, 3)"""

    def met_by(self, accelerations: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return the accelerations of an inexact solution projected onto (12).

        Args:
            accelerations: accelerations of `vehicles` [m/s²], shape (P, K-1, 3).
            vehicles: the indices of the vehicles, shape (P,).
        """
        residual = self.rows @ accelerations - self.values[vehicles]
        nearest: FloatArray = accelerations - self.rows.T @ residual
        return nearest


@dataclasses.dataclass(frozen=True)
class Changes:
    """Changes of motions in the null space of the goals: the unknowns of programs."""

    grid: Grid
    """grid of the scenario"""
    goals: FloatArray
    """rows of (12), as in `Goals`"""
    units: FloatArray
    """unit of each vehicle's accelerations in programs [m/s²], shape (N,)"""
    factors: FloatArray
    """accelerations of each vehicle for an unknown of one unit: one over the square root of its
    weight, so that the cost is the sum of squared unknowns, shape (N,)"""
    free: bool = False
    """whether changes have no cost: goals may then be missed, and only violations have a cost"""

    def factors_of(self, vehicles: IntArray, partners: IntArray | None = None) -> FloatArray:
        """Return factors on row lengths: of each vehicle, or the root sum of squares of two.

        Args:
            vehicles: indices of vehicles, shape (R,).
            partners: indices of the vehicles whose values are subtracted, if any, shape (R,).
        """
        one = self.factors[vehicles]
        return one if partners is None else np.hypot(one, self.factors[partners])

    def inside(self, rows: FloatArray) -> FloatArray:
        """Return rows (R, K-1) projected onto the null space of the goals."""
        for _ in range(2):  # the second projection removes rounding errors
            rows = rows - (rows @ self.goals.T) @ self.goals
        return rows


@dataclasses.dataclass(frozen=True)
class MinimumEffort:
    """Motions of minimum effort of all vehicles of a scenario."""

    grid: Grid
    """grid of the scenario"""
    goals: Goals
    """terminal equalities of accelerations"""
    motion: Motion
    """minimum-effort motions of all vehicles to the goals, without other constraints"""
    units: FloatArray
    """unit of each vehicle's accelerations in programs [m/s²], shape (N,)"""
    unreachable: BoolArray
    """flags of vehicles whose goals cannot be reached in a single step, shape (N,)"""
    factors: FloatArray
    """as in `Changes`"""

    @classmethod
    def of(cls, scenario: Scenario) -> MinimumEffort:
        """Return the minimum effort of a scenario."""
        fleet, grid = scenario.fleet, scenario.grid
        terminal = TerminalState(grid)
        values, missed = terminal.values(*terminal.changes(fleet))
        accelerations = terminal.rows.T @ values
        return cls(
            grid,
            Goals(terminal.rows, values),
            Motion.from_starts(fleet, accelerations, grid.step),
            fleet.units,
            np.abs(missed).max(axis=1) > TOLERANCE * fleet.lengths,
            1.0 / np.sqrt(fleet.weights),
        )

    @cached_property
    def changes(self) -> Changes:
        """Changes of these motions, the unknowns of programs."""
        free = len(self.goals.rows) == 0
        return Changes(self.grid, self.goals.rows, self.units, self.factors, free)

    def without_goals(self) -> MinimumEffort:
        """Return these motions with goals that need not be reached."""
        goals = Goals(self.goals.rows[:0], self.goals.values[:, :0])
        return dataclasses.replace(self, goals=goals, unreachable=np.zeros_like(self.unreachable))


class TerminalState:
    """Terminal conditions on velocity and position as equations in accelerations, (10)-(11).

    Args:
        grid: the grid of the flight.

    Attributes:
        rows: orthonormal rows of the equations, shape (2, K-1); (1, 1) for a single step.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.rows, self._triangle = _factors(grid.step, grid.knots)

    def changes(self, fleet: Fleet) -> tuple[FloatArray, FloatArray]:
        """Return the required changes of velocity [m/s] and of position [m], (N, 3) each."""
        faster = fleet.goal_velocities - fleet.start_velocities
        further = fleet.goal_positions - fleet.start_positions
        return faster, further - self.grid.duration * fleet.start_velocities

    def values(self, faster: FloatArray, further: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (12) in terms of `rows`; linear in the required changes.

        Args:
            faster: required change of velocity [m/s], shape (N, 3).
            further: required change of position, in addition to that by the initial velocity [m],
                shape (N, 3).

        Returns:
            Products of the rows with the accelerations [m/s²], shape (N, 2 or 1, 3), and the
            remainder of `further`: zero, except for a single step.
        """
        triangle, T = self._triangle, self.grid.duration
        first = faster / triangle[0, 0]
        rest = further / T - triangle[1, 0] * first
        if triangle.shape[1] == 1:
            return first[:, None], T * rest
        values = np.concatenate([first[:, None], (rest / triangle[1, 1])[:, None]], axis=1)
        return values, np.zeros(rest.shape)


@lru_cache(maxsize=256)
def _factors(step: float, knots: int) -> tuple[FloatArray, FloatArray]:
    """Return QR factors, orthonormal rows and a triangle, of the responses at the last knot."""
    T = step * (knots - 1)
    velocity, position = (response(each, step, knots, [T])[0] for each in ("velocity", "position"))
    basis, triangle = np.linalg.qr(np.stack([velocity, position / T], axis=1))
    return basis.T, triangle.T
