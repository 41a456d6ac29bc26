"""Relaxations for lower bounds on one vehicle's least time, over an interval of final times.

In units of the longest final time T1, with s = T / T1 in [s0, 1] and y = s², a motion's positions
are affine in accelerations and s, and limits of accelerations and velocities grow with y and s
(`free_time.py`). Nothing is linearised around a reference. Only y = s² is relaxed, to s² <= y and
the chord y <= (1 + s0) s - s0, and limits of jerks grow with the chord of y^1.5, which is above it.
So every motion with a final time in the interval is a feasible point with the same y.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csc_array, csc_matrix, diags_array, eye_array, hstack, kron

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.boxes import KeepInBox
from drake_rho.planning.errors import SolverError
from drake_rho.planning.minimum_effort import Changes, MinimumEffort, TerminalState
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import Cones
from drake_rho.planning.programs.free_time import FreeTimePrograms
from drake_rho.planning.programs.free_time_program import FreeTimeProgram
from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.programs.solution import Solution
from drake_rho.planning.programs.solve import solve
from drake_rho.planning.programs.sparse import SparseRows
from drake_rho.scenario.fields import FloatArray

PRECISION = 1e-6
"""Relative precision to which solvers prove a lower bound on the final time."""

_LONGER = 4.0
"""Multiple of the longest final time that programs allow if only the motion depends on time. Most
programs are then feasible, which solvers detect more reliably than infeasibility.
"""


class Place(NamedTuple):
    """Set that contains the vehicle at one instant: a polyhedron or a ball."""

    part: float
    """instant as a part of the final time"""
    center: FloatArray
    """centre at that part of the longest final time [m], shape (3,)"""
    velocity: FloatArray
    """velocity of the centre [m/s], shape (3,)"""
    normals: FloatArray
    """unit vectors n of half-spaces n · (p - centre) >= b, shape (R, 3); none for a ball"""
    bounds: FloatArray
    """b [m], shape (R,)"""
    radius: float = np.inf
    """radius of the ball [m]; infinite for a polyhedron"""


class Relaxed(NamedTuple):
    """Solution of a relaxation."""

    duration: float
    """lower bound on the final time of the relaxation's motions [s]"""
    motion: Motion
    """the relaxation's motion with this final time"""
    looseness: float
    """relative excess of y over s², or of a limit of jerks over its true value"""


class TimeRelaxations(FreeTimePrograms):
    """Relaxations of one vehicle's motions up to the final time of a problem.

    Args:
        problem: problem of the vehicle alone, in the longest final time.
        backend: the solver and its settings.
    """

    def __init__(self, problem: Problem, backend: Backend) -> None:
        super().__init__(problem, backend, 0.0)
        self._scenario, self._rates = problem.scenario, _rates_of(problem)
        boxes = [each for each in problem.convex if isinstance(each, KeepInBox)]
        rows = [each.every_row(problem.effort.motion) for each in boxes]
        self._rows = [each for each in rows if len(each) > 0]
        quantities = {each.quantity for each in problem.convex if each.kind != "requirements"}
        self._has_jerks = "jerk" in quantities
        self._written: dict[float, _Relaxation] = {}

    def least(self, shortest: float, places: Sequence[Place]) -> Relaxed | None:
        """Return the least time of a relaxation; None if it has no motion.

        Args:
            shortest: lower end of the interval of final times [s].
            places: sets that contain the vehicle at some instants.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        grid = self._scenario.grid
        first = min(max(shortest / grid.duration, 0.0), 1.0 - PRECISION)
        timed = self._rates is not None or any(np.any(each.velocity) for each in places)
        program = self._without_places(first).copied()
        program.add_interval(first, 1.0 if timed else _LONGER)
        program.add_polyhedra([each for each in places if len(each.bounds) > 0])
        program.add_balls([each for each in places if np.isfinite(each.radius)])
        solution = solve([program.program], self._backend)[0]
        if not solution.feasible:
            return None
        if not solution.exact:
            raise SolverError("a relaxation was solved to a low accuracy only")
        y, s, accelerations = program.solved(solution)
        if y > 1.0 + PRECISION:
            return None
        y = max(y, first**2, PRECISION**2)
        step = grid.step * float(np.sqrt(y))
        motion = Motion.from_starts(self._scenario.fleet, accelerations / y, step)
        looseness = 1.0 - s**2 / y if timed else 0.0
        if self._has_jerks:
            chord = 1.0 - program.slopes["jerk"][0] * (1.0 - y)
            looseness = max(looseness, chord / y**1.5 - 1.0)
        return Relaxed(grid.duration * float(np.sqrt(y)), motion, looseness)

    def _without_places(self, first: float) -> _Relaxation:
        """Return the program with limits only, for s >= `first`; cached."""
        first = first if self._has_jerks else 0.0
        if first not in self._written:
            chord = (1.0 - first**3) / (1.0 - first**2)
            parts = self._effort, self._unit, self._rates, self._rows, self._cones
            program = _Relaxation(*parts, chord)
            program.add_costs(0.0)
            program.add_limits()
            for number in range(len(self._cones)):
                program.add_cones(number)
            self._written[first] = program
        return self._written[first]


class _Relaxation(FreeTimeProgram):
    """Builder of one relaxation.

    Args:
        effort: the minimum-effort motion in the longest final time.
        unit: unit of accelerations in the program [m/s²].
        rates: derivative of this motion by s, and of given accelerations outside of it by y.
        limits: hard rows.
        cones: limits of norms.
        chord: slope of the chord of y^1.5.
    """

    def __init__(
        self,
        effort: MinimumEffort,
        unit: float,
        rates: Motion | None,
        limits: Sequence[HalfSpaces],
        cones: Sequence[Cones],
        chord: float,
    ) -> None:
        self.slopes = {**FreeTimeProgram.slopes, "jerk": (chord, 0.0)}
        self._rates = rates
        start = _passing(effort, [Place(0.0, np.zeros(3), np.zeros(3), _NONE, np.zeros(0))])
        super().__init__(effort, unit, None, limits, cones, start, np.zeros((1, 3)))
        self._sparse = SparseRows(
            Changes(effort.grid, effort.goals.rows, np.full(1, unit), np.ones(1)),
            np.zeros(1, dtype=int),
            [start.axes(effort)],
        )

    def copied(self) -> _Relaxation:
        """Return a copy for further constraints."""
        other = copy.copy(self)
        other.program = self.program.Clone()
        return other

    def add_interval(self, first: float, most: float) -> None:
        """Add the interval of s, and the chord unless longer times are allowed.

        Args:
            first: least s.
            most: largest s.
        """
        ends = np.array([first**2, first]), np.array([most**2, most])
        self.program.AddBoundingBoxConstraint(*ends, self._time)
        if most == 1.0:
            chord, below = np.array([[1.0, -1.0 - first]]), np.full(1, -np.inf)
            self.program.AddLinearConstraint(chord, below, np.full(1, -first), self._time)

    def add_polyhedra(self, places: Sequence[Place]) -> None:
        """Constrain the vehicle to polyhedra."""
        if places:
            matrix, needed = self._axes(places)
            normals = block_diag([each.normals for each in places], format="csc")
            bounds = np.concatenate([each.bounds for each in places])
            needed = normals @ needed + bounds / self._unit_of("position")
            above, matrix = np.full(len(needed), np.inf), csc_matrix(normals @ matrix)
            self.program.AddLinearConstraint(matrix, needed, above, self._variables)

    def add_balls(self, places: Sequence[Place]) -> None:
        """Constrain the vehicle to balls."""
        if places:
            matrix, needed = self._axes(places)
            shifted = kron(eye_array(len(places)), np.eye(4, 3, -1)).tocsc()
            constant = -(shifted @ needed)
            constant[::4] = [each.radius / self._unit_of("position") for each in places]
            self._add_lorentz(csc_array(shifted @ matrix), constant, self._variables)

    def solved(self, solution: Solution) -> tuple[float, float, FloatArray]:
        """Return y, s and the accelerations in the longest final time [m/s²], (1, K-1, 3)."""
        y, s = solution.x[len(self._x) : len(self._x) + 2]
        u = solution.x[: 3 * self._steps].reshape(1, self._steps, 3)
        accelerations = self._effort.motion.accelerations + self._unit * u
        if self._rates is not None:
            accelerations = accelerations + (s - 1.0) * self._rates.accelerations
        return float(y), float(s), accelerations

    def _axes(self, places: Sequence[Place]) -> tuple[csc_array, FloatArray]:
        """Return the positions less the centres, matrix @ variables - needed in their unit."""
        effort, passing = self._effort, _passing(self._effort, places)
        sparse = SparseRows(self._sparse.changes, self._sparse.group, [passing.axes(effort)])
        matrix, needed, _, _ = sparse.matrix()
        finer, count = self._finer("position"), 3 * self._steps
        powers = np.repeat(float(self._steps) ** np.arange(3), count)
        moved = passing.times[:, None] * np.array([each.velocity for each in places])
        if self._rates is not None:
            moved = moved - self._rates.each_at("position", passing.vehicles, passing.times)
        by_s = moved.reshape(-1) / self._unit_of("position")
        by_time = np.stack([np.zeros(len(by_s)), by_s], axis=1)
        every = hstack([finer * matrix @ diags_array(powers), csc_array(-by_time)], format="csc")
        return csc_array(every), finer * needed - by_s

    def _by_time(self, rows: HalfSpaces) -> FloatArray:
        """Return the derivatives of bounds by y and s, in units of the program, shape (R, 2)."""
        quantity, rates = rows.constraint.quantity, self._rates
        by_time = np.outer(rows.bounds, self.slopes_of(rows.constraint))
        if rates is not None:
            rest = np.zeros_like(rates.before)
            with_s = dataclasses.replace(rates, before=rest, after=rest)
            with_y = dataclasses.replace(rates, accelerations=np.zeros_like(rates.accelerations))
            values = with_s.each_at(quantity, rows.vehicles, rows.times)
            by_time[:, 1] -= np.vecdot(rows.normals, values)
            if quantity == "jerk":
                values = with_y.each_at(quantity, rows.vehicles, rows.times)
                by_time[:, 0] -= np.vecdot(rows.normals, values)
        scaled: FloatArray = by_time / self._unit_of(quantity)
        return scaled


_NONE = np.zeros((0, 3))


def _passing(effort: MinimumEffort, places: Sequence[Place]) -> Passing:
    """Return the instants of places, in the form of waypoints."""
    times = effort.grid.duration * np.array([each.part for each in places])
    centers, zeros = np.array([each.center for each in places]), np.zeros(len(times))
    none = zeros.astype(int)
    return Passing(none, times, centers, zeros, none == 0, 0.0)


def _rates_of(problem: Problem) -> Motion | None:
    """Return the derivative of minimum-effort motions by s; None where all are at rest.

    Given velocities at both ends grow with s, and given accelerations outside of them with y.
    """
    fleet, grid = problem.scenario.fleet, problem.scenario.grid
    if fleet.are_at_rest:
        return None
    first, last = fleet.start_velocities, fleet.goal_velocities
    terminal = TerminalState(grid)
    values, _ = terminal.values(last - first, -grid.duration * first)
    accelerations = terminal.rows.T @ values
    p, v = roll_out(np.zeros_like(first), first, accelerations, grid.step)
    outside = fleet.accelerations_before, fleet.accelerations_after
    return Motion(grid.step, p, v, accelerations, *outside)
