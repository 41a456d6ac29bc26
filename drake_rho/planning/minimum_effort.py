"""The motions of least cost that reach the goals, in closed form, and what programs start from."""

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
    """The terminal equalities (12) of each axis: `rows` times the accelerations are `values`."""

    rows: FloatArray
    """orthonormal, shape (2 or 1, K-1); shape (0, K-1) where the goals are not asked for"""
    values: FloatArray
    """[m/s²], shape (N, 2, 1 or 0, 3)"""

    def met_by(self, accelerations: FloatArray, vehicles: IntArray) -> FloatArray:
        """Return accelerations with the least change that closes what a solver leaves of (12).

        Args:
            accelerations: of `vehicles` [m/s²], shape (P, K-1, 3).
            vehicles: their indices, shape (P,).
        """
        missed = self.rows @ accelerations - self.values[vehicles]
        closed: FloatArray = accelerations - self.rows.T @ missed
        return closed


@dataclasses.dataclass(frozen=True)
class Changes:
    """Changes of motions that leave their goals where they are, in which programs are written."""

    grid: Grid
    """of the scenario"""
    goals: FloatArray
    """rows of (12), as in `Goals`"""
    units: FloatArray
    """acceleration that counts as one [m/s²], shape (N,)"""
    free: bool = False
    """whether changes cost nothing, and only slack does: goals may be missed then"""

    def inside(self, rows: FloatArray) -> FloatArray:
        """Return the part of rows (R, K-1) that leaves the goal alone; twice, for rounding."""
        for _ in range(2):
            rows = rows - (rows @ self.goals.T) @ self.goals
        return rows


@dataclasses.dataclass(frozen=True)
class MinimumEffort:
    """The motions of least cost of a scenario, whose changes its programs are about."""

    grid: Grid
    """of the scenario"""
    goals: Goals
    """what accelerations have to keep to"""
    motion: Motion
    """of all vehicles, the cheapest that reaches the goals, with nothing else asked"""
    units: FloatArray
    """acceleration that counts as one [m/s²], shape (N,)"""
    unreachable: BoolArray
    """which vehicles one step cannot bring to their goals, shape (N,)"""

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
        )

    @cached_property
    def changes(self) -> Changes:
        """Changes in which programs are written."""
        return Changes(self.grid, self.goals.rows, self.units, free=len(self.goals.rows) == 0)

    def without_goals(self) -> MinimumEffort:
        """Return these motions with goals that need not be reached."""
        goals = Goals(self.goals.rows[:0], self.goals.values[:, :0])
        return dataclasses.replace(self, goals=goals, unreachable=np.zeros_like(self.unreachable))


class TerminalState:
    """Terminal conditions on velocity and position, as equations of accelerations, by (10), (11).

    Args:
        grid: knots and step.

    Attributes:
        rows: orthonormal, what the goal decides, shape (2, K-1); (1, 1) for a single step.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.rows, self._triangle = _factors(grid.step, grid.knots)

    def changes(self, fleet: Fleet) -> tuple[FloatArray, FloatArray]:
        """Return the changes of velocity and of position that are required [m/s, m], (N, 3)."""
        faster = fleet.goal_velocities - fleet.start_velocities
        way = fleet.goal_positions - fleet.start_positions
        return faster, way - self.grid.duration * fleet.start_velocities

    def values(self, faster: FloatArray, further: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (12) in terms of `rows`; linear in the required changes.

        Args:
            faster: velocity to gain [m/s], shape (N, 3).
            further: way to gain on that of the first velocity [m], shape (N, 3).

        Returns:
            Products of the rows with the accelerations [m/s²], shape (N, 2 or 1, 3), and what they
            leave of `further`: with one step what the velocity does not decide, else nothing.
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
    """Return the QR factors of the responses of velocity and position at T: rows and a triangle."""
    T = step * (knots - 1)
    velocity, position = (response(each, step, knots, [T])[0] for each in ("velocity", "position"))
    basis, triangle = np.linalg.qr(np.stack([velocity, position / T], axis=1))
    return basis.T, triangle.T
