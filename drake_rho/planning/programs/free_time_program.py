"""Builder of one program with a free final time; the equations are in `free_time.py`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy  # its parts load when first used
from pydrake.solvers import MathematicalProgram

from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.constraints.rows import Rows
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.conic import Cones
from drake_rho.planning.programs.free_times import Change, FreeTime, Passing, TimeScaling
from drake_rho.planning.programs.program import Solution
from drake_rho.planning.programs.sparse import SparseRows, add_goal, scale_of
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

Moves = tuple[IntArray, FloatArray]
"""The waypoint with which each row moves, and the derivative of its value (`Passing.rates_of`)."""

_BLOCK = 300
"""Number of variables in a block of the cost, whose Hessian is dense."""

_CLOSE = 0.9
"""Least g / f for which a cone is transformed."""


class FreeTimeProgram:
    """Builder of a program with rows matrix @ x - by_time @ (y, s) >= needed.

    Args:
        effort: the minimum-effort motions; x is the change from them.
        unit: unit of accelerations in the program [m/s²].
        scaling: derivatives of limits and of these motions by y and s.
        limits: hard rows.
        cones: limits of norms.
        passing: the waypoints.
        velocities: velocities of the reference at their times [m/s], shape (W, 3).
    """

    def __init__(
        self,
        effort: MinimumEffort,
        unit: float,
        scaling: TimeScaling,
        limits: Sequence[HalfSpaces],
        cones: Sequence[Cones],
        passing: Passing,
        velocities: FloatArray,
    ) -> None:
        self._effort, self._scaling, self._limits = effort, scaling, limits
        self._cones, self._passing, self._velocities = cones, passing, velocities
        halves = [*limits, *(each.axes for each in cones)]
        parts = [*about(effort.motion, halves), passing.axes(effort)]
        group = np.arange(len(effort.changes.units))
        changes = dataclasses.replace(
            effort.changes, units=np.full(len(group), unit), factors=np.ones(len(group))
        )
        sparse = SparseRows(changes, group, parts)
        self._sparse, self._steps, self._unit = sparse, sparse.steps, unit
        self.program = MathematicalProgram()
        self._x = self.program.NewContinuousVariables(sparse.columns)
        self._time = self.program.NewContinuousVariables(2)  # y and s
        self._changes = self.program.NewContinuousVariables(len(passing))
        soft = ~passing.given & ~passing.in_proportion & np.isfinite(passing.price)
        self._soft = np.flatnonzero(soft)
        self._misses = self.program.NewContinuousVariables(len(self._soft))
        count = 3 * self._steps * len(group)
        self._weights = effort.changes.factors**-2
        self._about = effort.motion.accelerations.reshape(-1) / unit
        add_goal(self.program, changes, group, self._x[:count])
        powers = np.repeat(float(self._steps) ** np.arange(3), count)
        self._scales = scipy.sparse.diags_array(powers[: len(self._x)])
        for order, equations in enumerate(sparse.dynamics()):
            scaled = scipy.sparse.csc_matrix(equations @ self._scales) / float(self._steps) ** order
            self.program.AddLinearEqualityConstraint(scaled, np.zeros(count), self._x)
        by_time = [*map(self._by_time, halves), self._passing_by_time(velocities)]
        self._matrix, self._needed = self._in_time(parts, np.concatenate(by_time))
        ends = np.cumsum([0, *map(len, parts)])
        self._first = int(ends[len(limits)])
        self._parts = [slice(*each) for each in pairwise(ends[len(limits) :].tolist())]

    def add_costs(self, effort: float) -> None:
        """Add the cost: y, and the mean squared acceleration with a weight."""
        program, (y, s) = self.program, self._time
        program.AddLinearCost(np.ones(1), 0.0, np.array([y]))
        u = self._x[: 3 * self._steps * len(self._effort.changes.units)]
        weights = 2.0 * effort / len(u) * np.repeat(self._weights, 3 * self._steps)
        for first in range(0, len(u) if effort > 0.0 else 0, _BLOCK):
            own = slice(first, first + _BLOCK)
            linear = weights[own] * self._about[own]
            program.AddQuadraticCost(np.diag(weights[own]), linear, u[own], is_convex=True)
        if len(misses := self._misses) > 0:
            price = self._passing.price * self._unit_of("position") / self._unit**2
            program.AddLinearCost(np.full(len(misses), effort / len(u) * price), 0.0, misses)
            program.AddBoundingBoxConstraint(0.0, np.inf, misses)
        # norm(s, (y - 1) / 2) <= (y + 1) / 2, which is s² <= y
        root = np.array([[0.5, 0.0], [0.0, 1.0], [0.5, 0.0]])
        program.AddLorentzConeConstraint(root, np.array([0.5, 0.0, -0.5]), np.array([y, s]))

    def add_times(self, change: Change) -> None:
        """Add the bounds on the final time and on the times of free waypoints."""
        passing, program, T = self._passing, self.program, self._effort.grid.duration
        least, most = change.final
        ends = np.array([least, np.sqrt(least)]), np.array([most, np.sqrt(most)])
        program.AddBoundingBoxConstraint(*ends, self._time)
        if len(passing) == 0:
            return
        largest = np.where(passing.may_change, change.waypoints, 0.0)
        allowed = np.clip(passing.allowed, passing.least, T - passing.least)
        earliest = np.maximum(-largest, np.minimum(allowed[:, 0] - passing.times, 0.0))
        latest = np.minimum(largest, np.maximum(allowed[:, 1] - passing.times, 0.0))
        if (own := passing.in_steps).any():
            step = self._effort.grid.step
            begins = step * passing.steps(step) - passing.times
            earliest[own] = np.maximum(earliest, np.minimum(begins, 0.0))[own]
            latest[own] = np.minimum(latest, np.maximum(begins + step, 0.0))[own]
        program.AddBoundingBoxConstraint(earliest, latest, self._changes)
        if change.curvature > 0.0:
            curvatures = np.diag(change.curvature * passing.curvatures(T))
            program.AddQuadraticCost(
                curvatures, np.zeros(len(earliest)), self._changes, is_convex=True
            )
        if len(later := passing.ordered) > 0:
            # on the program's time scale, a given time t is earlier by t (y - 1) / 2
            by_y = np.where(passing.given, passing.times, 0.0) / 2.0
            both = np.eye(len(largest), 1 + len(largest), 1)
            both[:, 0] = -by_y
            both = both[later] - both[later - 1]
            gaps = passing.times[later] - passing.times[later - 1] - passing.dwells[later - 1]
            needed = np.minimum(passing.least - gaps, 0.0) + both[:, 0]
            above = np.full(len(later), np.inf)
            variables = np.array([self._time[0], *self._changes])
            program.AddLinearConstraint(both, needed, above, variables)

    def add_rests(self, resting: IntArray) -> None:
        """Constrain accelerations to zero from a knot on.

        Args:
            resting: index of that knot for each vehicle, shape (N,).
        """
        motion, n = self._effort.motion, self._steps
        rests = np.arange(n) >= resting[:, None]
        u = self._x[: 3 * n * len(resting)].reshape(len(resting), n, 3)[rests].reshape(-1)
        if len(u) > 0:
            values = -motion.accelerations[rests].reshape(-1) / self._unit
            self.program.AddBoundingBoxConstraint(values, values, u)

    def _unit_of(self, quantity: Quantity) -> float:
        """Return the unit of a quantity in rows.

        Positions and velocities are in units of the motion's length, to which tolerances refer. In
        a straight line, a motion at its limits would be several times as long.
        """
        grid = self._effort.grid
        if quantity in ("position", "velocity"):
            return float(self._effort.changes.units.max()) * scale_of(quantity, grid.duration)
        return self._unit * scale_of(quantity, grid.step)

    def _finer(self, quantity: Quantity) -> float:
        """Return the unit of a quantity in sparse rows, relative to this program's."""
        own = self._unit * scale_of(quantity, self._effort.grid.step)
        return own / self._unit_of(quantity)

    def _in_time(
        self, parts: Sequence[Rows], by_time: FloatArray
    ) -> tuple[scipy.sparse.csc_array, FloatArray]:
        """Return rows as matrix @ (x, y, s) >= needed, in the units of this program.

        Args:
            parts: the rows, by form.
            by_time: derivatives of their bounds by y and s, shape (R, 2).
        """
        sparse = SparseRows(self._sparse.changes, self._sparse.group, parts)
        matrix, needed, _, _ = sparse.matrix()
        finer = [np.full(len(each), self._finer(each.form.quantity)) for each in parts]
        unit = np.concatenate(finer)
        matrix = scipy.sparse.diags_array(unit) @ matrix @ self._scales
        both = scipy.sparse.csc_array(
            scipy.sparse.hstack([matrix, scipy.sparse.csc_array(-by_time)], format="csc")
        )
        return both, needed * unit - by_time.sum(axis=1)

    def _by_time(self, rows: HalfSpaces) -> FloatArray:
        """Return the derivatives of bounds by y and s, in units of the program, shape (R, 2)."""
        return self._scaling.of_bounds(rows) / self._unit_of(rows.constraint.quantity)

    def _passing_by_time(self, velocities: FloatArray) -> FloatArray:
        """Return the derivatives by y and s for the axes of waypoints, shape (3 W, 2).

        On the program's time scale, a given time t is earlier by t (y - 1) / 2.
        """
        passing = self._passing
        earlier = np.where(passing.given, passing.times, 0.0) / 2.0
        by_time = -self._scaling.of_positions(passing.vehicles, passing.times)
        by_time[:, :, 0] += earlier[:, None] * velocities
        scaled: FloatArray = by_time.reshape(-1, 2) / self._unit_of("position")
        return scaled

    @property
    def _variables(self) -> np.ndarray:
        return np.concatenate([self._x, self._time])

    def add_limits(self, moves: Sequence[Moves] = ()) -> None:
        """Add the hard rows.

        Args:
            moves: how the rows of each table move with waypoints; none if no row does.
        """
        if (first := self._first) == 0:
            return
        above, variables = np.full(first, np.inf), self._variables
        matrix = self._matrix[:first]
        if any(np.any(at >= 0) for at, _ in moves):
            matrix = scipy.sparse.hstack(
                [matrix, scipy.sparse.vstack(list(map(self._moved, self._limits, moves)))]
            )
            variables = np.concatenate([variables, self._changes])
        self.program.AddLinearConstraint(
            scipy.sparse.csc_matrix(matrix), self._needed[:first], above, variables
        )

    def _moved(self, rows: HalfSpaces, moves: Moves) -> scipy.sparse.csc_array:
        """Return the coefficients of changes of times of waypoints in rows, shape (R, W)."""
        (at, along), unit = moves, self._unit_of(rows.constraint.quantity)
        r = np.flatnonzero(at >= 0)
        return scipy.sparse.csc_array(
            (along[r] / unit, (r, at[r])), (len(rows), len(self._changes))
        )

    def add_cones(self, number: int, moves: Moves | None = None) -> None:
        """Add the limits of a norm, norm(B z) <= a · z + c, with c scaled by y or s.

        Args:
            number: index of the cones.
            moves: how their axes move with waypoints; None if they do not.
        """
        cones, own = self._cones[number], self._parts[number]
        quantity, count = cones.constraint.quantity, len(cones)
        unit = self._unit_of(quantity)
        each = np.arange(count + 1)
        matrix, variables = self._matrix[own], self._variables
        if moves is not None:
            matrix = scipy.sparse.csc_array(
                scipy.sparse.hstack([matrix, self._moved(cones.axes, moves)], format="csc")
            )
            variables = np.concatenate([variables, self._changes])
        if cones.are_points:
            needed = self._needed[own]
            self.program.AddLinearEqualityConstraint(
                scipy.sparse.csc_matrix(matrix), needed, variables
            )
            return
        transform = scipy.sparse.bsr_array((cones.matrices, each[:-1], each))  # block-diagonal
        offsets = np.zeros((count, 4))
        offsets[:, 0] = cones.constants / unit
        grown = np.outer(offsets.reshape(-1), self._scaling.growth_of(cones.constraint))
        constant = offsets.reshape(-1) - grown.sum(axis=1) - transform @ self._needed[own]
        empty = (
            scipy.sparse.csc_array((4 * count, len(self._x))),
            scipy.sparse.csc_array((4 * count, len(variables) - len(self._variables))),
        )
        matrix = transform @ matrix
        matrix = matrix + scipy.sparse.csc_array(scipy.sparse.hstack([empty[0], grown, empty[1]]))
        boosts = scipy.sparse.bsr_array((boosts_of(cones), each[:-1], each))
        self._add_lorentz(boosts @ matrix, boosts @ constant, variables)

    def add_passing(self) -> None:
        """Add the waypoint constraints."""
        passing, program, d = self._passing, self.program, self._changes
        unit = self._unit_of("position")
        moves = scipy.sparse.block_diag(
            [each[:, None] / unit for each in self._velocities], format="csc"
        )
        matrix = scipy.sparse.csc_array(
            scipy.sparse.hstack([self._matrix[self._parts[-1]], moves], format="csc")
        )
        needed, variables = self._needed[self._parts[-1]], np.concatenate([self._variables, d])
        exact = passing.within == 0.0
        exact[self._soft] = False
        axes = np.repeat(exact, 3)
        if exact.any():
            program.AddLinearEqualityConstraint(
                scipy.sparse.csc_matrix(matrix[axes]), needed[axes], variables
            )
        if not exact.all():
            count = int(np.count_nonzero(~exact))
            shifted = scipy.sparse.kron(scipy.sparse.eye_array(count), np.eye(4, 3, -1)).tocsc()
            constant = -(shifted @ needed[~axes])
            constant[::4] = passing.within[~exact] / unit
            balls = scipy.sparse.csc_array(shifted @ matrix[~axes])
            if len(self._soft) > 0:
                numbers = np.searchsorted(np.flatnonzero(~exact), self._soft)
                more = (np.ones(len(numbers)), (4 * numbers, np.arange(len(numbers))))
                balls = scipy.sparse.csc_array(
                    scipy.sparse.hstack(
                        [balls, scipy.sparse.csc_array(more, (4 * count, len(numbers)))]
                    )
                )
                variables = np.concatenate([variables, self._misses])
            self._add_lorentz(balls, constant, variables)

    def _add_lorentz(
        self, matrix: scipy.sparse.csc_array, constant: FloatArray, variables: np.ndarray
    ) -> None:
        """Add a Lorentz cone for every four values of matrix @ variables + constant."""
        rows = matrix.tocsr()
        number = np.repeat(np.arange(len(constant)), np.diff(rows.indptr))
        for first in range(0, len(constant), 4):
            own = slice(rows.indptr[first], rows.indptr[first + 4])
            columns, places = np.unique(rows.indices[own], return_inverse=True)
            entries = np.zeros((4, len(columns)))
            entries[number[own] - first, places] = rows.data[own]
            four = constant[first : first + 4]
            self.program.AddLorentzConeConstraint(entries, four, variables[columns])

    def found(self, solution: Solution) -> FreeTime:
        """Return a solution of the program."""
        effort, x = self._effort, solution.x
        columns, count = len(self._x), len(effort.changes.units)
        y, s = x[columns : columns + 2].tolist()
        u = x[: 3 * self._steps * count].reshape(count, self._steps, 3)
        accelerations = effort.motion.accelerations + self._unit * u
        accelerations = accelerations + self._scaling.accelerations(y, s)
        first = columns + 2 + len(self._passing)
        changes, misses = x[columns + 2 : first], x[first : first + len(self._soft)]
        missed = float(np.maximum(misses, 0.0).sum()) * self._unit_of("position")
        return FreeTime(accelerations, y, s, changes, solution.solver, solution.seconds, missed)


def boosts_of(cones: Cones) -> FloatArray:
    """Return Lorentz transformations of cones, (R, 4, 4), that centre balls at zero.

    A ball of radius f around an origin at the distance g < f from zero, as for thrusts, is a cone
    whose values are of the size of f, while accelerations may be much smaller. In the frame that
    moves with g / f the value zero is the middle of the cone, whose height is (f² - g²)^½. Other
    cones do not change.
    """
    boosts: FloatArray = np.tile(np.eye(4), (len(cones), 1, 1))
    origins, away = cones.constraint.sets.origins[cones.vehicles], cones.away
    ball = ~cones.matrices[:, 0].any(axis=1) & (away < cones.constants)
    ball &= away > _CLOSE * cones.constants
    speeds, along = away[ball] / cones.constants[ball], -origins[ball] / away[ball, None]
    growth = cones.constants[ball] / cones.half_widths[ball]
    mixed = -(growth * speeds)[:, None] * along
    boosts[ball, 0, 0], boosts[ball, 0, 1:], boosts[ball, 1:, 0] = growth, mixed, mixed
    boosts[ball, 1:, 1:] += (growth - 1.0)[:, None, None] * along[:, :, None] * along[:, None]
    return boosts
