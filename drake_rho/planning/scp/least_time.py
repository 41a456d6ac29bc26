"""Least time by sequential convex programming: final time and times of free waypoints are found.

Each iteration solves a program with a free final time around the latest motion, in which the times
of free waypoints may change as well. The program is then solved once more with the new times. The
motion that results meets every constraint, and is kept if it takes less time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np

from drake_rho.motion.dynamics import Motion, roll_out
from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.boxes import KeepInBox
from drake_rho.planning.constraints.convex_sets import KeepInSets
from drake_rho.planning.constraints.coupling import coupled
from drake_rho.planning.errors import OutOfTimeError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_time import POWERS, FreeTime, FreeTimePrograms, Passing
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Grid, Scenario

_ROUNDS = 60
"""Largest number of programs around one motion, each with the rows that the last one violated."""

_MOST = 200
"""Largest number of iterations."""

_CONVERGED = 1e-5
"""Relative fall of the final time in one iteration, predicted or reached, that ends the search."""

_GROWTH, _SHRINKAGE = 2.0, 0.1
"""Largest and least factor of the changes of waypoint times from one iteration to the next."""

_LEAST_GAP = 0.05
"""Least time from one waypoint of a vehicle to the next, in steps."""

_NO_TIME = 1e-12
"""Factor of the squared final time below which nothing bounds it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Timed:
    """Motion of a scenario in a final time, with the times of its free waypoints."""

    problem: Problem
    """problem on the grid of the motion"""
    accelerations: FloatArray
    """accelerations [m/s²], shape (N, K-1, 3)"""
    passing: Passing
    """free waypoints, with their times"""
    rows: Sequence[HalfSpaces] = ()
    """rows of the last program"""

    @property
    def duration(self) -> float:
        """Final time [s]."""
        return self.problem.scenario.grid.duration

    @cached_property
    def motion(self) -> Motion:
        """Motion of all vehicles."""
        grid = self.problem.scenario.grid
        return Motion.from_starts(self.problem.scenario.fleet, self.accelerations, grid.step)

    @property
    def plan(self) -> Plan:
        """Motion as a plan of the scenario without free waypoints."""
        return Plan.from_motion(self.problem.scenario, self.motion)

    def after(self, found: FreeTime, rows: Sequence[HalfSpaces]) -> Timed:
        """Return the motion that a program around this one has found, in its own time."""
        scenario, root = self.problem.scenario, float(np.sqrt(found.factor))
        grid = Grid(scenario.grid.step * root, scenario.grid.knots, scenario.grid.start)
        problem = Problem.of(scenario.on_grid(grid))
        passing = dataclasses.replace(
            self.passing,
            times=(self.passing.times + found.changes) * root,
            changes=self.passing.changes * root,
            least=self.passing.least * root,
        )
        accelerations = found.accelerations / found.factor
        accelerations = problem.effort.goals.met_by(accelerations, np.arange(len(problem)))
        later = [dataclasses.replace(each, times=each.times * root) for each in rows]
        return Timed(problem, accelerations, passing, later)


class LeastTime:
    """Search for the least time of a scenario.

    Args:
        backend: the solver and its settings.
        progress: called with the final time after each iteration.

    Attributes:
        statistics: statistics of all programs.
    """

    def __init__(self, backend: Backend, progress: Progress | None = None) -> None:
        self._backend, self._progress = backend, progress
        self.statistics = Statistics()

    def from_motion(self, timed: Timed) -> Timed | None:
        """Return the motion in the least time that is found; None if none is found around `timed`.

        Args:
            timed: motion to linearise around first, which need not meet any constraint.

        Raises:
            OutOfTimeError: time was up before a motion was found.
            SolverError: the solvers fail numerically.
        """
        best = self._with_same_times(timed)
        if best is None:
            return None
        with suppress(OutOfTimeError, SolverError):
            for _ in range(_MOST):
                self._tell(best)
                after, predicted = self._improved(best)
                fall = 1.0 - after.duration / best.duration
                best = after if fall > 0.0 else self._with_reach(best, after.passing.changes)
                if max(fall, predicted) <= _CONVERGED:
                    break
        return best

    def _improved(self, best: Timed) -> tuple[Timed, float]:
        """Return a motion that may take less time, and the fall that its program predicted."""
        if len(best.passing) == 0:
            after = self._with_same_times(best)
            return best if after is None else after, 0.0
        guess = self._solve(best)
        if guess is None:
            return self._with_reach(best, best.passing.changes / 4.0), 1.0
        predicted = 1.0 - guess.duration / best.duration
        if predicted <= _CONVERGED:
            return best, predicted
        after = self._with_same_times(guess)
        fall = -predicted if after is None else 1.0 - after.duration / best.duration
        # the fall is about predicted · x - error · x² for x times the changes
        x = predicted / (2.0 * max(predicted - fall, predicted / _GROWTH))
        moved = np.abs(guess.passing.times * best.duration / guess.duration - best.passing.times)
        reach = np.clip(x, _SHRINKAGE, _GROWTH) * np.full(len(moved), moved.max())
        print(f"    pred {predicted:.2e} fall {fall:.2e} x {x:.3g} moved {moved.max():.3g} reach {best.passing.changes.max():.3g}", self._last)
        return self._with_reach(best if after is None else after, reach), predicted

    def _with_reach(self, timed: Timed, reach: FloatArray) -> Timed:
        """Return a motion whose times of waypoints may change by at most `reach` [s], (W,)."""
        passing = dataclasses.replace(timed.passing, changes=reach)
        return dataclasses.replace(timed, passing=passing)

    def _with_same_times(self, timed: Timed) -> Timed | None:
        """Return the motion in least time around another, with its times of waypoints."""
        reach = timed.passing.changes
        found = self._solve(self._with_reach(timed, np.zeros(len(reach))))
        return None if found is None else self._with_reach(found, reach)

    def _tell(self, best: Timed) -> None:
        if self._progress is not None:
            self._progress(f"final time {best.duration:.6g} s")

    def _solve(self, timed: Timed) -> Timed | None:
        """Return the motion in least time around another; None if there is none.

        Rows of constraints on positions are added until none is violated.
        """
        problem, passing = timed.problem, timed.passing
        constraints = [
            each
            for each in problem.linearized(timed.plan, coupled)
            if not isinstance(each, KeepInSets)
            and not (isinstance(each, KeepInBox) and each.quantity != "position")
        ]
        programs = FreeTimePrograms(problem, self._backend)
        by_key = {each.key: each for each in constraints}
        rows = {
            each.constraint.key: by_key[each.constraint.key].renewed(each) for each in timed.rows
        }
        velocities = timed.motion.each_at("velocity", passing.vehicles, passing.times)
        every = np.arange(len(problem))
        for _ in range(_ROUNDS):
            check_time()
            found = programs.solve(list(rows.values()), passing, velocities)
            self._last = (found.solver, found.seconds) if found else None
            self.statistics += Statistics(programs=1)
            if found is None:
                return None
            motions = {q: in_time(found, problem, q) for q in POWERS}
            for between in (False, True):
                more = [
                    each.violated_rows(motions[each.quantity], every, between=between)
                    for each in constraints
                    if between is False or each.searches > 0
                ]
                more = [each for each in more if len(each) > 0]
                if more:
                    break
            if not more:
                return timed.after(found, list(rows.values()))
            for each in more:
                key = each.constraint.key
                rows[key] = rows[key].union(each) if key in rows else each
        raise SolverError(f"rows were still violated after {_ROUNDS} rounds")


def in_time(found: FreeTime, problem: Problem, quantity: Quantity) -> Motion:
    """Return a motion with the step of a program whose values of one quantity are those in time.

    Args:
        found: solution of the program.
        problem: problem of the program.
        quantity: quantity whose values are to be compared with limits.
    """
    divisor = found.factor ** POWERS[quantity]
    fleet, step = problem.scenario.fleet, problem.scenario.grid.step
    root = np.sqrt(found.factor)
    p, v = roll_out(fleet.start_positions, root * fleet.start_velocities, found.accelerations, step)
    before = fleet.accelerations_before * found.factor / divisor
    return Motion(step, p, v / divisor, found.accelerations / divisor, before)
