"""Programs with a free final time: the least time in which a linearisation can be flown.

A motion with step h0 is flown in another time with the step h = h0 sqrt(y): positions at the knots
stay, velocities become v / sqrt(y), accelerations a / y, and jerks j / y^1.5. In terms of the
motion with step h0, positions and dynamics (1)-(2) do not depend on y, a limit C of accelerations
is a in y C, and one of velocities v in s C with s² <= y. So from rest to rest the least y is the
solution of one convex program, in which y and s are two more variables. A limit of jerks has
j in (1 + 1.5 (y - 1)) C, which lies inside of y^1.5 C.

The time of a waypoint that is free is a variable too, and its position is linearised: a change of
the time by d adds d v. Velocities that are given at the start or at the goal are linearised in y.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import (
    block_diag,
    bsr_array,
    csc_array,
    csc_matrix,
    diags_array,
    eye_array,
    hstack,
    kron,
)

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.boxes import KeepInBox
from drake_rho.planning.constraints.convex_sets import KeepInSets
from drake_rho.planning.minimum_effort import Changes, MinimumEffort, TerminalState
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import Cones
from drake_rho.planning.programs.rows import Rows, about
from drake_rho.planning.programs.solution import Solution
from drake_rho.planning.programs.solve import solve
from drake_rho.planning.programs.sparse import SparseRows, add_goal, scale_of
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

POWERS: dict[Quantity, float] = {"position": 0.0, "velocity": 0.5, "acceleration": 1.0, "jerk": 1.5}
"""Power of y by which values of a quantity are divided in the time of a program's solution."""

_SLOPES: dict[Quantity, tuple[float, float]] = {
    "position": (0.0, 0.0),
    "velocity": (0.0, 1.0),
    "acceleration": (1.0, 0.0),
    "jerk": (1.5, 0.0),
}
"""Growth of limits with y and with s; that of jerks is linearised at y = 1."""

_BLOCK = 300
"""Number of variables in a block of the cost, whose Hessian is dense."""

_SLOWEST = 1e6
"""Largest factor y of one program."""

_PART = 1e-6
"""Part of a time by which it is changed to differentiate bounds."""


class Change(NamedTuple):
    """By how much a program may change times."""

    final: tuple[float, float] = (0.0, _SLOWEST)
    """least and largest y"""
    waypoints: float = 0.0
    """largest change of the time of a free waypoint [s]"""


NO_CHANGE = Change((1.0, 1.0))
"""No change, so that only the effort is minimised."""

LITTLE_EFFORT = 1e-7
"""Weight of the effort with which y is next to the least: where vehicles have time to spare, it
chooses between motions that take as long."""


@dataclasses.dataclass(frozen=True, eq=False)
class Passing:
    """Waypoints that vehicles pass, at given times or at times that are found."""

    vehicles: IntArray
    """index of the vehicle of each waypoint, in increasing order, shape (W,)"""
    times: FloatArray
    """times since the first knot around which a program is linearised [s], shape (W,)"""
    positions: FloatArray
    """positions [m], shape (W, 3)"""
    within: FloatArray
    """largest distances from these, less margins [m], shape (W,)"""
    given: BoolArray
    """mask of the waypoints whose times are given, and do not change with the step, shape (W,)"""
    least: float
    """least time between two waypoints of a vehicle, and from its start and goal [s]"""

    def __len__(self) -> int:
        """Return the number of waypoints, W."""
        return len(self.vehicles)

    def of(self, mask: BoolArray) -> Passing:
        """Return the waypoints of one vehicle, whose index is 0 then.

        Args:
            mask: mask of its waypoints, shape (W,).
        """
        return Passing(
            np.zeros(np.count_nonzero(mask), dtype=int),
            self.times[mask],
            self.positions[mask],
            self.within[mask],
            self.given[mask],
            self.least,
        )

    def axes(self, effort: MinimumEffort) -> Rows:
        """Return rows with the positions less the waypoints, three for each, as their values."""
        who, times = np.repeat(self.vehicles, 3), np.repeat(self.times, 3)
        normals = np.tile(np.eye(3), (len(self), 1))
        at = effort.motion.each_at("position", self.vehicles, self.times)
        needed = (self.positions - at).reshape(-1)
        none = np.zeros(len(who), dtype=int)
        return Rows("position", np.inf, False, who, who, times, normals, needed, none)


@dataclasses.dataclass(frozen=True, eq=False)
class FreeTime:
    """Solution of a program with a free final time."""

    accelerations: FloatArray
    """accelerations of the motion with the step of the program [m/s²], shape (N, K-1, 3)"""
    factor: float
    """y, the square of the final time over that of the program"""
    changes: FloatArray
    """changes of the times of the free waypoints, with the step of the program [s], shape (W,)"""
    solver: str
    """name of the solver"""
    seconds: float
    """time reported by the solver [s]"""


class FreeTimePrograms:
    """Programs of one problem with a free final time.

    Boxes of velocities, accelerations and jerks enter at all knots, norms and waypoints with given
    times as cones, and other constraints by rows that are given.

    Args:
        problem: the problem, on a grid with the step h0.
        backend: the solver and its settings.
        effort: weight of the mean of squared accelerations, in units, beside y.
    """

    def __init__(self, problem: Problem, backend: Backend, effort: float = LITTLE_EFFORT) -> None:
        self._effort, self._backend, self._weight = problem.effort, backend, effort
        self._drift = drift_of(problem)
        group, motion = np.arange(len(problem)), problem.effort.motion
        boxes = [each for each in problem.convex if isinstance(each, KeepInBox)]
        self._boxes = [each.every_row(motion) for each in boxes if each.quantity != "position"]
        sets = [each for each in problem.convex if isinstance(each, KeepInSets)]
        cones = [Cones.of(each, motion, group) for each in sets]
        self._cones = [each for each in cones if len(each) > 0]
        self._unit = self._limit() or float(problem.effort.units.max())

    @property
    def bound_time(self) -> bool:
        """Whether a velocity, an acceleration or a jerk is limited, so that a motion takes time."""
        return len(self._boxes) > 0 or len(self._cones) > 0

    def _limit(self) -> float:
        """Return the largest limit of accelerations [m/s²]; 0 without any.

        Motions in the least time are often at their limits. In this unit their values are about 1.
        """
        limits = [0.0]
        for rows in self._boxes:
            if rows.constraint.quantity == "acceleration":
                limits.append(float(np.abs(rows.bounds).max(initial=0.0)))
        for cones in self._cones:
            if cones.constraint.quantity == "acceleration":
                limits.append(float(cones.constants.max()))
        return max(limits)

    def solve(
        self, rows: Sequence[HalfSpaces], passing: Passing, velocities: FloatArray, change: Change
    ) -> FreeTime | None:
        """Return the solution with some rows; None if there is none.

        Args:
            rows: rows of all other constraints, around the step of the program.
            passing: the waypoints.
            velocities: velocities of the reference at their times [m/s], shape (W, 3).
            change: by how much times may change.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        limits = [each for each in (*self._boxes, *rows) if len(each) > 0]
        parts = limits, self._cones, passing, velocities
        written = _Program(self._effort, self._unit, self._drift, *parts)
        written.add_costs(self._weight)
        written.add_times(change)
        written.add_limits()
        for number in range(len(self._cones)):
            written.add_cones(number)
        if len(passing) > 0:
            written.add_passing()
        solution = solve([written.program], self._backend)[0]
        return written.found(solution) if solution.feasible else None


def drift_of(problem: Problem) -> Motion | None:
    """Return the derivative of minimum-effort motions by y at y = 1; None where all are at rest.

    Given velocities at both ends grow with the square root of y, and a given acceleration before
    the start with y.
    """
    fleet, grid = problem.scenario.fleet, problem.scenario.grid
    first, last, before = (
        fleet.start_velocities,
        fleet.goal_velocities,
        np.nan_to_num(fleet.accelerations_before),
    )
    if not (first.any() or last.any() or before.any()):
        return None
    terminal = TerminalState(grid)
    values, _ = terminal.values((last - first) / 2.0, -grid.duration * first / 2.0)
    accelerations = terminal.rows.T @ values
    p, v = roll_out(np.zeros_like(first), first / 2.0, accelerations, grid.step)
    return Motion(grid.step, p, v, accelerations, before)


def bound_rates(rows: HalfSpaces) -> FloatArray:
    """Return by how much bounds rise with y at y = 1 as obstacles and tracks move on, (R,)."""
    constraint, times = rows.constraint, rows.times
    later = constraint.bounds_at(rows, times * (1.0 + _PART))
    earlier = constraint.bounds_at(rows, times * (1.0 - _PART))
    rates: FloatArray = (later - earlier) / (4.0 * _PART)  # t grows with the root of y
    return rates


class _Program:
    """Program while it is written, with rows matrix @ x - by_time @ (y, s) >= needed.

    Args:
        effort: the minimum-effort motions, to which solutions are changes.
        unit: unit of accelerations in the program [m/s²].
        drift: derivative of these motions by y.
        limits: rows that have to hold.
        cones: limits of norms.
        passing: the waypoints.
        velocities: velocities of the reference at their times [m/s], shape (W, 3).
    """

    def __init__(
        self,
        effort: MinimumEffort,
        unit: float,
        drift: Motion | None,
        limits: Sequence[HalfSpaces],
        cones: Sequence[Cones],
        passing: Passing,
        velocities: FloatArray,
    ) -> None:
        self._effort, self._drift = effort, drift
        self._cones, self._passing, self._velocities = cones, passing, velocities
        halves = [*limits, *(each.axes for each in cones)]
        parts = [*about(effort.motion, halves), passing.axes(effort)]
        group = np.arange(len(effort.units))
        changes = Changes(effort.grid, effort.goals.rows, np.full(len(group), unit))
        sparse = SparseRows(changes, group, parts)
        self._steps, self._unit = sparse.steps, unit
        self.program = MathematicalProgram()
        self._x = self.program.NewContinuousVariables(sparse.columns)
        self._time = self.program.NewContinuousVariables(2)  # y and s
        self._changes = self.program.NewContinuousVariables(len(passing))
        count = 3 * self._steps * len(group)
        self._weights = np.ones(len(group)) if effort.factors is None else effort.factors**-2
        self._about = effort.motion.accelerations.reshape(-1) / unit
        add_goal(self.program, changes, self._x[:count])
        scales = diags_array(np.repeat(float(self._steps) ** np.arange(3), count)[: len(self._x)])
        for order, equations in enumerate(sparse.dynamics()):
            scaled = csc_matrix(equations @ scales) / float(self._steps) ** order
            self.program.AddLinearEqualityConstraint(scaled, np.zeros(count), self._x)
        matrix, needed, _, _ = sparse.matrix()
        by_time = np.concatenate([*map(self._by_time, halves), self._passing_by_time(velocities)])
        finer = np.concatenate([np.full(len(each), self._finer(each.quantity)) for each in parts])
        matrix = diags_array(finer) @ matrix @ scales
        self._matrix = csc_array(hstack([matrix, csc_array(-by_time)], format="csc"))
        self._needed = needed * finer - by_time.sum(axis=1)
        ends = np.cumsum([0, *map(len, parts)])
        self._first = int(ends[len(limits)])
        self._parts = [slice(*each) for each in pairwise(ends[len(limits) :].tolist())]

    def add_costs(self, effort: float) -> None:
        """Add the cost: y and the mean of squared accelerations with a weight."""
        program, (y, s) = self.program, self._time
        program.AddLinearCost(np.ones(1), 0.0, np.array([y]))
        u = self._x[: 3 * self._steps * len(self._effort.units)]
        weights = 2.0 * effort / len(u) * np.repeat(self._weights, 3 * self._steps)
        for first in range(0, len(u), _BLOCK):
            own = slice(first, first + _BLOCK)
            linear = weights[own] * self._about[own]
            program.AddQuadraticCost(np.diag(weights[own]), linear, u[own], is_convex=True)
        # norm(s, (y - 1) / 2) <= (y + 1) / 2, which is s² <= y
        root = np.array([[0.5, 0.0], [0.0, 1.0], [0.5, 0.0]])
        program.AddLorentzConeConstraint(root, np.array([0.5, 0.0, -0.5]), np.array([y, s]))

    def add_times(self, change: Change) -> None:
        """Add by how much the final time and the times of free waypoints may change."""
        passing, program, T = self._passing, self.program, self._effort.grid.duration
        least, most = change.final
        ends = np.array([least, np.sqrt(least)]), np.array([most, np.sqrt(most)])
        program.AddBoundingBoxConstraint(*ends, self._time)
        if len(passing) == 0:
            return
        reach = np.where(passing.given, 0.0, change.waypoints)
        low = np.maximum(-reach, np.minimum(passing.least - passing.times, 0.0))
        high = np.minimum(reach, np.maximum(T - passing.least - passing.times, 0.0))
        program.AddBoundingBoxConstraint(low, high, self._changes)
        free = ~passing.given
        later = 1 + np.flatnonzero((np.diff(passing.vehicles) == 0) & free[1:] & free[:-1])
        if len(later) > 0:
            both = np.eye(len(reach))[later] - np.eye(len(reach))[later - 1]
            gaps = passing.times[later] - passing.times[later - 1]
            above = np.full(len(later), np.inf)
            program.AddLinearConstraint(
                both, np.minimum(passing.least - gaps, 0.0), above, self._changes
            )

    def _unit_of(self, quantity: Quantity) -> float:
        """Return the unit of a quantity: that of accelerations, integrated over the duration."""
        grid = self._effort.grid
        return self._unit * scale_of(quantity, grid.step if quantity == "jerk" else grid.duration)

    def _finer(self, quantity: Quantity) -> float:
        """Return the unit of a quantity in sparse rows, in that of this program."""
        own = self._unit * scale_of(quantity, self._effort.grid.step)
        return own / self._unit_of(quantity)

    def _by_time(self, rows: HalfSpaces) -> FloatArray:
        """Return by how much bounds rise with y and s, in units of the program, shape (R, 2)."""
        quantity = rows.constraint.quantity
        slopes = _SLOPES[quantity]
        by_time = np.outer(rows.bounds, slopes)
        if quantity == "velocity":  # a lower bound above zero is linearised in y instead
            by_time[rows.bounds > 0.0] = np.outer(rows.bounds[rows.bounds > 0.0], [0.5, 0.0])
        by_time[:, 0] += bound_rates(rows) - self._rise(rows)
        scaled: FloatArray = by_time / self._unit_of(quantity)
        return scaled

    def _rise(self, rows: HalfSpaces) -> FloatArray:
        """Return by how much values rise with y at y = 1 while x is kept, shape (R,)."""
        drift, quantity = self._drift, rows.constraint.quantity
        if drift is None:
            return np.zeros(len(rows))
        values = drift.each_at(quantity, rows.vehicles, rows.times)
        if rows.constraint.coupled:
            values = values - drift.each_at(quantity, rows.partners, rows.times)
        rise: FloatArray = np.vecdot(rows.normals, values)
        return rise

    def _passing_by_time(self, velocities: FloatArray) -> FloatArray:
        """Return the same for the axes of waypoints, shape (3 W, 2).

        A given time t is by t (y - 1) / 2 earlier with the step of the program.
        """
        passing, drift = self._passing, self._drift
        earlier = np.where(passing.given, passing.times, 0.0) / 2.0
        values = earlier[:, None] * velocities
        if drift is not None:
            values = values - drift.each_at("position", passing.vehicles, passing.times)
        by_y = values.reshape(-1) / self._unit_of("position")
        return np.stack([by_y, np.zeros(len(by_y))], axis=1)

    @property
    def _variables(self) -> np.ndarray:
        return np.concatenate([self._x, self._time])

    def add_limits(self) -> None:
        """Add the rows that have to hold."""
        if (first := self._first) > 0:
            above = np.full(first, np.inf)
            matrix = csc_matrix(self._matrix[:first])
            self.program.AddLinearConstraint(matrix, self._needed[:first], above, self._variables)

    def add_cones(self, number: int) -> None:
        """Add the limits of a norm, norm(B z) <= a · z + c, with c as many times as y or s says."""
        cones, own = self._cones[number], self._parts[number]
        quantity, count = cones.constraint.quantity, len(cones)
        unit = self._unit_of(quantity)
        each = np.arange(count + 1)
        transform = bsr_array((cones.matrices, each[:-1], each))  # block-diagonal
        offsets = np.zeros((count, 4))
        offsets[:, 0] = cones.constants / unit
        grown = np.outer(offsets.reshape(-1), _SLOPES[quantity])
        matrix = transform @ self._matrix[own]
        matrix = matrix + csc_array(hstack([csc_array((4 * count, len(self._x))), grown]))
        constant = offsets.reshape(-1) - grown.sum(axis=1) - transform @ self._needed[own]
        self._add_lorentz(matrix, constant, self._variables)

    def add_passing(self) -> None:
        """Add that vehicles pass the waypoints."""
        passing, program, d = self._passing, self.program, self._changes
        unit = self._unit_of("position")
        moves = block_diag([each[:, None] / unit for each in self._velocities], format="csc")
        matrix = csc_array(hstack([self._matrix[self._parts[-1]], moves], format="csc"))
        needed, variables = self._needed[self._parts[-1]], np.concatenate([self._variables, d])
        exact = passing.within == 0.0
        axes = np.repeat(exact, 3)
        if exact.any():
            program.AddLinearEqualityConstraint(csc_matrix(matrix[axes]), needed[axes], variables)
        if not exact.all():
            count = int(np.count_nonzero(~exact))
            shifted = kron(eye_array(count), np.eye(4, 3, -1)).tocsc()
            constant = -(shifted @ needed[~axes])
            constant[::4] = passing.within[~exact] / unit
            self._add_lorentz(csc_array(shifted @ matrix[~axes]), constant, variables)

    def _add_lorentz(self, matrix: csc_array, constant: FloatArray, variables: np.ndarray) -> None:
        """Add that each four values of matrix @ variables + constant are in a cone."""
        values = self.program.NewContinuousVariables(len(constant) // 4, 4)
        equations = csc_matrix(hstack([matrix, -eye_array(values.size)], format="csc"))
        every = np.concatenate([variables, values.reshape(-1)])
        self.program.AddLinearEqualityConstraint(equations, -constant, every)
        identity, zero = np.eye(4), np.zeros(4)
        for value in values:
            self.program.AddLorentzConeConstraint(identity, zero, value)

    def found(self, solution: Solution) -> FreeTime:
        """Return a solution of the program."""
        effort, x = self._effort, solution.x
        columns, count = len(self._x), len(effort.units)
        y = float(x[columns])
        u = x[: 3 * self._steps * count].reshape(count, self._steps, 3)
        accelerations = effort.motion.accelerations + self._unit * u
        if self._drift is not None:
            accelerations = accelerations + (y - 1.0) * self._drift.accelerations
        changes = x[columns + 2 : columns + 2 + len(self._passing)]
        return FreeTime(accelerations, y, changes, solution.solver, solution.seconds)
