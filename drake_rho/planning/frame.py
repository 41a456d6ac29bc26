"""What all programs of a scenario are written in: goals, free motions and units."""

from __future__ import annotations

from copy import copy

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import TOLERANCE, Grid
from drake_rho.scenario.records import Scenario


class Frame:
    """The free motions of a scenario, and its goals and units in arrays.

    Attributes:
        grid: of the scenario.
        names: of the vehicles.
        goal_rows: orthonormal rows whose products with the accelerations of an axis the goal (12)
            decides, shape (2 or 1, K-1).
        free: the motions of least index that reach the goals, nothing else asked.
        units: acceleration that counts as one [m/s²], shape (N,).
        hopeless: vehicles that one step cannot bring to their goals, shape (N,).
    """

    def __init__(self, scenario: Scenario) -> None:
        fleet, grid = scenario.fleet, scenario.grid
        self.grid = grid
        self.names = [vehicle.name for vehicle in scenario.vehicles]
        self.units = fleet.scale("acceleration")
        self.goal_rows = goal_rows(grid.knots - 1)
        self._goal_values, self.hopeless = _goal_values(scenario, self.goal_rows)
        accelerations = np.einsum("gj,ngx->njx", self.goal_rows, self._goal_values)
        self.free = Motion.from_starts(fleet, accelerations, grid.step)

    def only(self, vehicles: IntArray) -> Frame:
        """The same for some of the vehicles, numbered from 0, in the largest of their units."""
        other = copy(self)
        other.units = np.full(len(vehicles), self.units[vehicles].max())
        other.names = [self.names[vehicle] for vehicle in vehicles]
        other.free, other.hopeless = self.free.of(vehicles), self.hopeless[vehicles]
        other._goal_values = self._goal_values[vehicles]
        return other

    def reaching_goals(self, accelerations: FloatArray, vehicles: IntArray) -> FloatArray:
        """The goals' equations (12), kept to a solver's tolerance, closed to rounding.

        Args:
            accelerations: of `vehicles`, shape (P, K-1, 3).
            vehicles: their indices, shape (P,).
        """
        missed = np.einsum("gj,pjx->pgx", self.goal_rows, accelerations)
        missed -= self._goal_values[vehicles]
        closed: FloatArray = accelerations - np.einsum("gj,pgx->pjx", self.goal_rows, missed)
        return closed


def goal_rows(steps: int) -> FloatArray:
    """What velocity and position at the last knot depend on, as orthonormal rows (2 or 1, K-1).

    The mean of the accelerations and, with more than one step, their linear trend.
    """
    rows = np.ones((min(steps, 2), steps))
    if steps > 1:
        rows[1] = np.arange(steps) - (steps - 1) / 2
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return rows


def goal_values(
    grid: Grid, rows: FloatArray, faster: FloatArray, further: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(12) in terms of `goal_rows`, with (10) and (11) at the last knot; linear in what to gain.

    Args:
        grid: knots and step.
        rows: `goal_rows` of the grid.
        faster: velocity to gain on the start's [m/s], shape (N, 3).
        further: way to gain on that of the start's velocity, over T [m/s], shape (N, 3).

    Returns:
        Products of the rows with the accelerations [m/s²], shape (N, 2 or 1, 3), and how much of
        `further` they leave: with one step what the velocity does not decide, else nothing.
    """
    h, T, steps = grid.step, grid.duration, grid.knots - 1
    mean = faster / (h * np.sqrt(steps))  # velocity: h in every step
    position = h * (T - h * np.arange(steps) - h / 2) / T  # (11) over T
    rest = further - (rows[0] @ position) * mean
    if steps == 1:
        return mean[:, None], rest
    return np.stack([mean, rest / (rows[1] @ position)], axis=1), np.zeros_like(rest)


def _goal_values(scenario: Scenario, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Products of the rows with accelerations that reach the goals, and the hopeless vehicles."""
    fleet, grid = scenario.fleet, scenario.grid
    faster = fleet.goal_velocities - fleet.start_velocities
    way = fleet.goal_positions - fleet.start_positions
    further = way / grid.duration - fleet.start_velocities
    values, missed = goal_values(grid, rows, faster, further)
    return values, np.abs(missed).max(axis=1) > TOLERANCE * fleet.lengths / grid.duration
