"""Time scaling: how limits and motions change with the final time.

Replacing a motion's step h0 by h = h0 sqrt(y) divides velocities by sqrt(y), accelerations by y and
jerks by y^1.5, and leaves positions at the knots as they are. For the motion with the step h0, a
limit C of accelerations is therefore y C, and one of velocities s C with s = sqrt(y).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.minimum_effort import TerminalState
from drake_rho.planning.problem import Problem
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario

POWERS: dict[Quantity, float] = {"position": 0.0, "velocity": 0.5, "acceleration": 1.0, "jerk": 1.5}
"""Power of y by which time scaling divides the values of a quantity."""

_GROWTH: dict[Quantity, tuple[float, float]] = {
    "position": (0.0, 0.0),
    "velocity": (0.0, 1.0),
    "acceleration": (1.0, 0.0),
}
"""Growth of limits with y and with s, except for those of jerks."""

_PART = 1e-6
"""Relative change of a time for finite differences of bounds."""


def powers(scenario: Scenario) -> Mapping[Quantity, float]:
    """Return the power of y by which time scaling divides the values of each quantity.

    With a smoothing, a jerk is the change of an acceleration over the width of an average, which
    stays the same.
    """
    return POWERS if scenario.smoothing is None else {**POWERS, "jerk": POWERS["acceleration"]}


def bound_rates(rows: HalfSpaces) -> FloatArray:
    """Return the derivatives of bounds by y at y = 1, due to moving obstacles and tracks, (R,)."""
    constraint, times = rows.constraint, rows.times
    later = constraint.bounds_at(rows, times * (1.0 + _PART))
    earlier = constraint.bounds_at(rows, times * (1.0 - _PART))
    rates: FloatArray = (later - earlier) / (4.0 * _PART)  # t grows with the root of y
    return rates


@dataclasses.dataclass(frozen=True, eq=False)
class TimeScaling:
    """Derivatives by y and s of limits and of minimum-effort motions, from which motions differ."""

    by_y: Motion
    """derivative of minimum-effort motions by y"""
    by_s: Motion
    """derivative of minimum-effort motions by s"""
    growth: Mapping[Quantity, tuple[float, float]]
    """growth of limits with y and with s"""
    lower: tuple[float, float]
    """growth of lower limits of velocities above zero with y and with s"""

    @classmethod
    def around(cls, problem: Problem) -> Self:
        """Return the scaling of a program that is linearised at the step of a problem.

        Velocities at both ends grow with the square root of y, which is linearised at y = 1, and
        accelerations before the start and after the goal with y.
        """
        by_y = _derivative(problem, velocities=0.5, outside=1.0)
        by_s = _derivative(problem, velocities=0.0, outside=0.0)
        growth = _growth(problem, (1.5, 0.0))  # linearised at y = 1
        return cls(by_y, by_s, growth, (0.5, 0.0))  # s <= sqrt(y) would allow lower velocities

    @classmethod
    def relaxed(cls, problem: Problem, chord: float) -> Self:
        """Return the scaling of a relaxation, in which no motion is lost.

        Args:
            problem: problem in the longest final time.
            chord: slope of the chord of y^1.5, by which limits of jerks grow.
        """
        by_y = _derivative(problem, velocities=0.0, outside=1.0)
        by_s = _derivative(problem, velocities=1.0, outside=0.0)
        return cls(by_y, by_s, _growth(problem, (chord, 0.0)), _GROWTH["velocity"])

    def growth_of(self, constraint: Constraint) -> tuple[float, float]:
        """Return the growth of a constraint's limit with y and with s."""
        return self.growth[constraint.quantity]

    def of_bounds(self, rows: HalfSpaces) -> FloatArray:
        """Return the derivatives of bounds on changes of motions by y and s, shape (R, 2)."""
        derivatives = np.outer(rows.bounds, self.growth_of(rows.constraint))
        if rows.constraint.quantity == "velocity":
            above = rows.bounds > 0.0
            derivatives[above] = np.outer(rows.bounds[above], self.lower)
        derivatives[:, 0] += bound_rates(rows)
        for column, motion in enumerate((self.by_y, self.by_s)):
            derivatives[:, column] -= _values(motion, rows)
        return derivatives

    def of_positions(self, vehicles: IntArray, times: FloatArray) -> FloatArray:
        """Return the derivatives of positions by y and s at times [s], shape (R, 3, 2)."""
        both = (each.each_at("position", vehicles, times) for each in (self.by_y, self.by_s))
        return np.stack(list(both), axis=2)

    def accelerations(self, y: float, s: float) -> FloatArray:
        """Return the changes of minimum-effort accelerations for y and s [m/s²], (N, K-1, 3)."""
        changes: FloatArray = (y - 1.0) * self.by_y.accelerations
        return changes + (s - 1.0) * self.by_s.accelerations


def _growth(problem: Problem, jerk: tuple[float, float]) -> Mapping[Quantity, tuple[float, float]]:
    """Return the growth of limits, where that of jerks is given unless they are of averages."""
    smooth = problem.scenario.smoothing is not None
    return {**_GROWTH, "jerk": _GROWTH["acceleration"] if smooth else jerk}


def _values(motion: Motion, rows: HalfSpaces) -> FloatArray:
    """Return the values of a motion that rows bound, shape (R,)."""
    quantity = rows.constraint.quantity
    values = motion.each_at(quantity, rows.vehicles, rows.times)
    if rows.constraint.coupled:
        values = values - motion.each_at(quantity, rows.partners, rows.times)
    along: FloatArray = np.vecdot(rows.normals, values)
    return along


def _derivative(problem: Problem, *, velocities: float, outside: float) -> Motion:
    """Return the derivative of minimum-effort motions by y or s, at y = s = 1.

    Args:
        problem: the problem.
        velocities: derivative of given velocities at the start and the goal, relative to them.
        outside: derivative of given accelerations before the start and after the goal.
    """
    fleet, grid = problem.scenario.fleet, problem.scenario.grid
    first, last = velocities * fleet.start_velocities, velocities * fleet.goal_velocities
    terminal = TerminalState(grid)
    values, _ = terminal.values(last - first, -grid.duration * first)
    accelerations = terminal.rows.T @ values
    p, v = roll_out(np.zeros_like(first), first, accelerations, grid.step)
    ends = outside * fleet.accelerations_before, outside * fleet.accelerations_after
    return Motion(grid.step, p, v, accelerations, *ends)
