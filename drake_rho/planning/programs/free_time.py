"""Programs with a free final time: the least time of a linearised problem.

Time scaling replaces a motion's step h0 by h = h0 sqrt(y): positions at the knots do not change,
velocities become v / sqrt(y), accelerations a / y, and jerks j / y^1.5. In terms of the motion with
step h0, positions and dynamics (1)-(2) do not depend on y, a limit C of accelerations is a in y C,
and one of velocities v in s C with s² <= y. So from rest to rest the least y is the solution of one
convex program, in which y and s are two more variables. A limit of jerks has
j in (1 + 1.5 (y - 1)) C, which is inside y^1.5 C.

The time of a free waypoint is a variable too, and its position is linearised: a change of the time
by d adds d v. Given velocities at the start or the goal are linearised in y.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import Cones
from drake_rho.planning.programs.free_time_program import FreeTimeProgram
from drake_rho.planning.programs.free_times import Change, FreeTime, Passing, TimeScaling
from drake_rho.planning.programs.solve import solve
from drake_rho.scenario.fields import FloatArray, IntArray

LITTLE_EFFORT = 1e-7
"""Small effort weight that breaks ties between motions of equal duration; y stays near its least
value."""


class FreeTimePrograms:
    """Programs of one problem with a free final time.

    Boxes of velocities, accelerations and jerks enter at all knots, norms and waypoints with given
    times as cones, required velocities and accelerations as cones or boxes around their sets, and
    other constraints as the rows passed to `solve`.

    Args:
        problem: the problem, on a grid with the step h0.
        backend: the solver and its settings.
        effort: weight of the mean squared acceleration, in units, relative to y.
    """

    def __init__(self, problem: Problem, backend: Backend, effort: float = LITTLE_EFFORT) -> None:
        self._effort, self._backend, self._weight = problem.effort, backend, effort
        self._scaling = TimeScaling.around(problem)
        group, motion = np.arange(len(problem)), problem.effort.motion
        boxes = [each for each in problem.boxes if each.quantity != "position"]
        rates = [each for each in problem.requirements if each.is_own_rate]
        sets = [*problem.norms_and_waypoints, *rates]
        cones = {each.key: Cones.of(each, motion, group) for each in sets}
        faces = [each.faces() for each in rates if len(cones[each.key]) == 0]
        self._cones = [each for each in cones.values() if len(each) > 0]
        gates = [Cones.of_gate(each, motion) for each in problem.requirements if each.is_on_leg]
        self._cones += [each for each in gates if len(each) > 0]
        self._boxes = [each.every_row(motion) for each in boxes]
        self._boxes += [each for each in faces if len(each) > 0]
        self._unit = self._limit() or float(problem.effort.changes.units.max())

    @property
    def bound_time(self) -> bool:
        """Whether a limit on velocity, acceleration or jerk bounds the final time from below."""
        return len(self._boxes) > 0 or len(self._cones) > 0

    def _limit(self) -> float:
        """Return the largest limit of accelerations [m/s²]; 0 if there is none.

        Least-time motions are often at their limits, so that values in this unit are about 1. For a
        ball around an origin away from zero, as for thrusts, it is the half-width perpendicular to
        the origin.
        """
        limits = [0.0]
        for rows in self._boxes:
            if rows.constraint.quantity == "acceleration":
                limits.append(float(np.abs(rows.bounds).max(initial=0.0)))
        for cones in self._cones:
            if cones.constraint.quantity == "acceleration":
                limits.append(float(cones.half_widths.max()))
        return max(limits)

    def solve(
        self,
        rows: Sequence[HalfSpaces],
        passing: Passing,
        velocities: FloatArray,
        change: Change,
        resting: IntArray | None = None,
        reference: Motion | None = None,
    ) -> FreeTime | None:
        """Return the solution subject to given rows; None if there is none.

        Args:
            rows: rows of all other constraints, around the step of the program.
            passing: the waypoints.
            velocities: velocities of the reference at their times [m/s], shape (W, 3).
            change: bounds on the changes of times.
            resting: indices of the knots from which vehicles rest, shape (N,); None for the last.
            reference: motion around which times of waypoints change; needed where rows move with
                these times.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        limits = [each for each in (*self._boxes, *rows) if len(each) > 0]
        parts = limits, self._cones, passing, velocities
        farthest = passing.farthest_from(self._effort.motion.positions[:, 0])
        units = np.maximum(self._effort.changes.units, farthest / self._effort.grid.duration**2)
        changes = dataclasses.replace(self._effort.changes, units=units)
        effort = dataclasses.replace(self._effort, changes=changes)
        written = FreeTimeProgram(effort, self._unit, self._scaling, *parts)
        written.add_costs(self._weight)
        written.add_times(change)
        if resting is not None:
            written.add_rests(resting)
        moves = [] if reference is None else [passing.rates_of(each, reference) for each in limits]
        written.add_limits(moves)
        for number, cones in enumerate(self._cones):
            if reference is not None and cones.constraint.moves:
                written.add_cones(number, passing.rates_of(cones.axes, reference))
            else:
                written.add_cones(number)
        if len(passing) > 0:
            written.add_passing()
        solution = solve([written.program], self._backend)[0]
        found = written.found(solution)
        return found if solution.feasible and 0.0 < found.factor < np.inf else None
