"""Relaxations that bound the least time of one vehicle from below.

In units of the longest final time T1, with s = T / T1 in [s0, 1] and y = s², a motion's positions
are affine in accelerations and s, and limits of accelerations and velocities grow with y and s
(`free_time.py`). Nothing is linearised around a reference. Only y = s² is relaxed, to s² <= y and
the chord y <= (1 + s0) s - s0, and limits of jerks grow with the chord of y^1.5, which is above it.
So every motion with a final time in the interval is a feasible point with the same y.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import block_diag, csc_array, csc_matrix, eye_array, hstack, kron

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.errors import SolverError
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_time import FreeTimePrograms
from drake_rho.planning.programs.free_time_program import FreeTimeProgram
from drake_rho.planning.programs.free_times import Passing, TimeScaling
from drake_rho.planning.programs.solve import solve
from drake_rho.scenario.fields import FloatArray

PRECISION = 1e-6
"""Relative precision to which solvers prove a lower bound on the final time."""

_LONGER = 4.0
"""Multiple of the longest final time that programs allow if only the motion depends on time. Most
programs are then feasible, which solvers detect more reliably than infeasibility.
"""


_NONE = np.zeros((0, 3))


class Place(NamedTuple):
    """Polyhedron that contains the vehicle at one instant."""

    part: float
    """instant as a part of the final time"""
    center: FloatArray
    """centre at that part of the longest final time [m], shape (3,)"""
    velocity: FloatArray
    """velocity of the centre [m/s], shape (3,)"""
    normals: FloatArray
    """unit vectors n of half-spaces n · (p - centre) >= b, shape (R, 3)"""
    bounds: FloatArray
    """b [m], shape (R,)"""


class Passage(NamedTuple):
    """Ball through which the vehicle passes in a window of instants."""

    window: FloatArray
    """first and last instant as parts of the final time, shape (2,)"""
    center: FloatArray
    """centre of the ball [m], shape (3,)"""
    radius: float
    """its radius [m]"""
    length: float
    """largest length of the path in the window [m]"""
    half: float
    """largest length of the path in each half of the window [m]"""

    @property
    def places(self) -> list[Place]:
        """Places in the beginning, in the middle and at the end, relative to the centre."""
        first, last = self.window.tolist()
        parts = first, (first + last) / 2.0, last
        return [Place(part, self.center, np.zeros(3), _NONE, np.zeros(0)) for part in parts]


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
        self._problem, self._scenario = problem, problem.scenario
        rows = [each.every_row(problem.effort.motion) for each in problem.boxes]
        self._rows = [each for each in rows if len(each) > 0]
        limits = [*problem.boxes, *problem.norms_and_waypoints]
        self._has_jerks = any(each.quantity == "jerk" for each in limits)
        self._written: dict[float, tuple[_Relaxation, float]] = {}

    def least(
        self, shortest: float, places: Sequence[Place], passages: Sequence[Passage] = ()
    ) -> Relaxed | None:
        """Return the least time of a relaxation; None if it has no motion.

        Args:
            shortest: lower end of the interval of final times [s].
            places: sets that contain the vehicle at some instants.
            passages: balls through which it passes.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        grid = self._scenario.grid
        first = min(max(shortest / grid.duration, 0.0), 1.0 - PRECISION)
        timed = not self._scenario.fleet.are_at_rest or any(
            np.any(each.velocity) for each in places
        )
        program, chord = self._without_places(first)
        program = program.copied()
        program.add_interval(first, 1.0 if timed else _LONGER)
        program.add_polyhedra(places)
        program.add_passages([each for each in passages if np.isfinite(each.half)])
        solution = solve([program.program], self._backend)[0]
        if not solution.feasible:
            return None
        if not solution.exact:
            raise SolverError("a relaxation was solved to a low accuracy only")
        found = program.found(solution)
        y, s = found.factor, found.root
        if y > 1.0 + PRECISION:
            return None
        y = max(y, first**2, PRECISION**2)
        step = grid.step * float(np.sqrt(y))
        motion = Motion.from_starts(self._scenario.fleet, found.accelerations / y, step)
        looseness = 1.0 - s**2 / y if timed else 0.0
        if self._has_jerks:
            limit = 1.0 - chord * (1.0 - y)
            looseness = max(looseness, limit / y**1.5 - 1.0)
        return Relaxed(grid.duration * float(np.sqrt(y)), motion, looseness)

    def _without_places(self, first: float) -> tuple[_Relaxation, float]:
        """Return the program with limits only, for s >= `first`, and the chord's slope; cached."""
        first = first if self._has_jerks else 0.0
        if first not in self._written:
            chord = (1.0 - first**3) / (1.0 - first**2)
            scaling = TimeScaling.relaxed(self._problem, chord)
            start = _passing(
                self._effort, [Place(0.0, np.zeros(3), np.zeros(3), _NONE, np.zeros(0))]
            )
            parts = self._rows, self._cones, start, np.zeros((1, 3))
            program = _Relaxation(self._effort, self._unit, scaling, *parts)
            program.add_costs(0.0)
            program.add_limits()
            for number in range(len(self._cones)):
                program.add_cones(number)
            self._written[first] = program, chord
        return self._written[first]


class _Relaxation(FreeTimeProgram):
    """Builder of one relaxation; its waypoints are the start."""

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

    def add_passages(self, passages: Sequence[Passage]) -> None:
        """Constrain the vehicle to pass through balls.

        It passes through some point of the ball. From its place in the beginning of the window the
        way to that point, and from there to its place in the end, is at most the path between; in
        the middle, the point is at most half of the window away.
        """
        if not passages:
            return
        count, unit = len(passages), self._unit_of("position")
        points = self.program.NewContinuousVariables(3 * count)
        ways = self.program.NewContinuousVariables(2 * count)  # before and after the point
        every, in_cone = eye_array(count), np.eye(4, 3, -1)
        radii = _heights([each.radius / unit for each in passages])
        self._add_lorentz(csc_array(kron(every, in_cone)), radii, points)
        matrix, needed = self._axes([place for each in passages for place in each.places])
        shifted = csc_array(kron(eye_array(3 * count), in_cone))
        of_points = kron(every, -np.tile(in_cone, (3, 1)))
        of_ways = kron(every, np.eye(12)[:, [0, 8]])
        rows = csc_array(hstack([of_points, of_ways, shifted @ matrix]))
        halves = _heights([h for each in passages for h in (0.0, each.half / unit, 0.0)])
        variables = np.array([*points, *ways, *self._variables])
        self._add_lorentz(rows, halves - shifted @ needed, variables)
        lengths = np.array([each.length for each in passages]) / unit
        sums, below = np.kron(np.eye(count), np.ones((1, 2))), np.full(count, -np.inf)
        self.program.AddLinearConstraint(sums, below, lengths, ways)

    def _axes(self, places: Sequence[Place]) -> tuple[csc_array, FloatArray]:
        """Return the positions less the centres, matrix @ variables - needed in their unit."""
        effort, passing = self._effort, _passing(self._effort, places)
        axes = passing.axes(effort)
        by_time = -self._scaling.of_positions(passing.vehicles, passing.times)
        by_time[:, :, 1] += passing.times[:, None] * np.array([each.velocity for each in places])
        return self._in_time([axes], by_time.reshape(-1, 2) / self._unit_of("position"))


def _heights(heights: Sequence[float]) -> FloatArray:
    """Return constants of Lorentz cones, four values for each height."""
    constants = np.zeros(4 * len(heights))
    constants[::4] = heights
    return constants


def _passing(effort: MinimumEffort, places: Sequence[Place]) -> Passing:
    """Return places as waypoints at their instants."""
    times = effort.grid.duration * np.array([each.part for each in places])
    centers, zeros = np.array([each.center for each in places]), np.zeros(len(times))
    none = zeros.astype(int)
    return Passing(none, times, centers, zeros, none == 0, 0.0)
