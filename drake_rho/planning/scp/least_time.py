"""Minimum-time motions by sequential convex programming, with the times of free waypoints.

Each iteration solves a program with a free final time around the latest motion, in which the times
of free waypoints change as well. A second program with the new times then finds a feasible motion,
which is accepted if it takes less time. Changes of times are bounded by a trust region and damped
by a second derivative, estimated for each waypoint and scaled by the measured decrease. Where no
constraint depends on time, the second program may shorten the final time, too: around a feasible
motion, its solution is feasible and takes no longer.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

import numpy as np

from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.errors import OutOfTimeError, SolverError
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_time import LITTLE_EFFORT, FreeTimePrograms
from drake_rho.planning.programs.free_times import NO_CHANGE, Change, FreeTime
from drake_rho.planning.scp.free_time_rows import near_rows, violated_rows
from drake_rho.planning.scp.row_generation import generate_rows
from drake_rho.planning.scp.stops import with_moved_stops
from drake_rho.planning.scp.timed import Timed
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.scenario.errors import Description, ScenarioError

_BEYOND = 20
"""Largest number of times that a waypoint with a velocity moves on to the next step or the last."""

_ASIDE = -0.5, 0.5, -0.05, 0.05
"""Changes of the time of a waypoint at a knot that are tried, in steps: large ones reach further,
after small ones more motions have the velocities of gates."""

_FARTHEST, _ENOUGH = 0.125, 0.01
"""First number of steps by which stops move, as a part of all, and the least relative fall of final
time or cost for which they do, as a part of the tolerance."""

_SHORTER = 1e-3
"""Relative fall of the final time for which stops move where constraints depend on time."""

_LONGER = 1.05
"""Multiple of the final time in which it does so at first."""

_ROUNDS = 60
"""Largest number of programs around one motion; each adds the rows that the last one violated."""

_MISSED = 1e-4
"""Largest miss of a waypoint with a fixed time, as a fraction of a motion's length."""

ROUGH = Backend(accuracy="rough")
"""Clarabel with tolerance 1e-8, relative to limits and lengths of motions in these programs."""

CONVERGED = 1e-5
"""Relative fall of the final time in one iteration, predicted or reached, that ends the search."""

_GROWTH = 0.1, 2.0
"""Least and largest factor from one trust region to the next."""

_FASTEST = 1e-8
"""Least factor on the squared final time in one program. It keeps quantities finite whose limits
enter as rows, which are added only when a solution violates them."""

_AT_ONCE = 1e-9
"""Fraction of the scenario's step, an initial guess, below which the time counts as unbounded."""

_CURVATURES = 0.2, 5.0
"""Least and largest factor on the estimated curvatures."""


class _Iteration(NamedTuple):
    """Result of one iteration."""

    after: Timed | None
    """motion that meets every constraint; None if none was found"""
    predicted: float
    """relative fall of the final time that the linearisation predicted"""
    moved: float
    """largest change of a time, as a fraction of the final time"""
    bent: float = 0.0
    """relative rise of the final time by the estimated curvatures, subtracted in `predicted`"""


class LeastTime:
    """Search for the least time of a problem.

    Args:
        backend: the solver and its settings.
        progress: called with the final time after each iteration.
        steady: whether no constraint depends on time.
        final_time: whether the final time is free; if not, the cost of the motion is minimised.

    Attributes:
        statistics: statistics of all programs.
    """

    def __init__(
        self,
        backend: Backend,
        progress: Progress | None = None,
        *,
        steady: bool = True,
        final_time: bool = True,
    ) -> None:
        self._backend, self._progress, self._steady = backend, progress, steady
        self._final_time = final_time
        self.statistics = Statistics()

    def around(
        self, timed: Timed, tolerance: float = CONVERGED, reach: float = 0.1
    ) -> Timed | None:
        """Return the minimum-time motion found from `timed`; None if no motion is found.

        Args:
            timed: motion to linearise around first; it may violate any constraint.
            tolerance: relative fall of the final time that ends the search.
            reach: first trust region, as a fraction of the final time.

        Raises:
            OutOfTimeError: time was up before a motion was found.
            SolverError: the solvers fail numerically.
        """
        best = self._with_same_times(timed.with_stops_at_knots())
        if best is None:
            return None
        best = self._improved(best, tolerance, reach)
        with self.or_cut():
            for _ in range(_BEYOND):
                best = self._with_better_stops(best, tolerance, reach)
                others = (self._improved(each, tolerance, reach) for each in self._beside(best))
                after = next((each for each in others if self._fall(best, each) > tolerance), None)
                if after is None:
                    break
                best = after
        return best

    def _with_better_stops(self, best: Timed, tolerance: float, reach: float) -> Timed:
        """Return the best motion found with its stops moved by whole steps, by ever fewer.

        Arguments are those of `around`.
        """
        if len(best.passing.stops) == 0:
            return best
        enough = _ENOUGH * tolerance
        less = self._final_time and not self._steady  # the time is not free in one program
        by = max(1, int(_FARTHEST * best.accelerations.shape[1]))
        while by >= 1:
            around = best.lasting((1.0 - _SHORTER) * best.duration) if less else best
            moved = with_moved_stops(around, by, shorter=self._final_time)
            found = (self._tried(each, self._same_times) for each in moved)
            better = (each for each in found if each and self._fall(best, each) > enough)
            if (after := next(better, None)) is None:
                by //= 2
            else:
                best = self._improved(after, tolerance, reach) if less else after
        return self._improved(best, tolerance, reach) if best.passing.may_change.any() else best

    def _beside(self, best: Timed) -> Iterator[Timed]:
        """Yield motions with a waypoint, if its velocity stops it at a knot, beside this knot.

        The derivatives of velocities jump there, so that the final time has local minima.
        """
        longer = _LONGER if self._final_time else 1.0
        for w in best.passing.at_knots(best.step):
            for by in _ASIDE:
                slower = best.lasting(longer * best.duration)
                passing = slower.passing.moved(w, by * slower.step)
                if passing.is_in_order and 0.0 < passing.times[w] < slower.duration:
                    beside = dataclasses.replace(slower, passing=passing)
                    if (found := self._tried(beside, self._same_times)) is not None:
                        yield found

    def _improved(self, best: Timed, tolerance: float, reach: float) -> Timed:
        """Return the minimum-time motion found from one that meets every constraint.

        Arguments are those of `around`.
        """
        moves = not self._steady or len(best.passing) > 0
        converged, curvature = False, 1.0 if self._final_time else 0.0
        with self.or_cut():
            for _ in range(200):
                tell(self._progress, self._described(best))
                after, predicted, moved, bent = (
                    self._with_moved_times(best, reach, curvature) if moves else self._again(best)
                )
                fall = -abs(predicted) if after is None else self._fall(best, after)
                if after is not None and fall > 0.0:
                    best = after
                if converged := max(fall, predicted) <= tolerance:
                    break
                if moves:
                    # the fall is about predicted · x - error · x² for x times the change
                    x = predicted / (2.0 * max(predicted - fall, predicted / 4.0))
                    other = moved * float(np.clip(x, *_GROWTH))
                    reach = max(reach, other) if x >= 1.0 else other
                    if bent > 0.0:
                        measured = curvature * (1.0 + (predicted - fall) / bent)
                        curvature = float(np.clip(measured, *_CURVATURES))
                    if converged := reach <= tolerance:
                        break
        return dataclasses.replace(best, converged=converged)

    def count(self, spent: Statistics) -> None:
        """Add the statistics of other work for the same result."""
        self.statistics += spent

    @contextmanager
    def or_cut(self) -> Iterator[None]:
        """Suppress the error when time is up, and record it in the statistics."""
        try:
            yield
        except OutOfTimeError:
            self.statistics = dataclasses.replace(self.statistics, cut=True)

    def at_same_times(self, timed: Timed) -> Timed | None:
        """Return a motion around another at the same times; None if none is found."""
        return self._tried(timed, self._same_times)

    def near(self, guess: Timed, reach: float = 1e-3) -> Timed | None:
        """Return a feasible motion with times close to those of a guess.

        If the final time is fixed, any error of the linearisation may make exactly these times
        infeasible, since minimum-time legs have no slack. Times of waypoints are then corrected
        around the guess, in the same final time.

        Args:
            guess: motion to linearise around, such as the solution of a linearised program.
            reach: bound on corrections of waypoint times, as a fraction of the final time.
        """
        after = self.at_same_times(guess)
        if self._same_times != NO_CHANGE or np.all(guess.passing.given):
            return after
        change = Change(NO_CHANGE.final, reach * guess.duration)
        for _ in range(2):  # second-order corrections
            if after is not None:
                break
            again = self._tried(guess, change)
            if again is None or not again.passing.is_in_order:
                break
            guess = again
            after = self.at_same_times(guess)
        return after

    def linearised(self, timed: Timed, reach: float, curvature: float = 0.0) -> Timed | None:
        """Return the solution of one linearised program; None if none is found.

        It satisfies constraints to first order in the changes of times.

        Args:
            timed: motion to linearise around.
            reach: trust region on changes of times, as a fraction of the final time.
            curvature: factor on the estimated curvatures of the final time.
        """
        final = ((1.0 - reach) ** 2, (1.0 + reach) ** 2)
        if self._steady or not self._final_time:
            final = self._same_times.final
        return self._tried(timed, Change(final, reach * timed.duration, curvature))

    def check_bounded(self, timed: Timed) -> None:
        """Check that the final time has a lower bound.

        Raises:
            ScenarioError: no limit or requirement bounds it.
        """
        programs = FreeTimePrograms(timed.problem, self._backend, LITTLE_EFFORT)
        if not _is_bounded(programs, timed.linearised()):
            raise nothing_bounds_the_time()

    def _again(self, best: Timed) -> _Iteration:
        """Return the minimum-time motion around the best one."""
        return _Iteration(self._tried(best, self._same_times), 0.0, 0.0)

    def _with_moved_times(self, best: Timed, reach: float, curvature: float) -> _Iteration:
        """Return a motion with new times of waypoints and a new final time.

        Args:
            best: a feasible motion.
            reach: trust region on changes of times, as a fraction of the final time.
            curvature: factor on the estimated curvatures of the final time.
        """
        guess = self.linearised(best, reach, curvature)
        if guess is None or not guess.passing.is_in_order:
            return _Iteration(None, 1.0, reach)
        scale = guess.duration / best.duration
        changes = np.where(
            best.passing.given, 0.0, guess.passing.times / scale - best.passing.times
        )
        moved = np.abs(changes).max(initial=0.0) / best.duration
        moved = max(moved, 0.0 if self._steady else 1.0 - scale)
        # the relative change of the final time is half of that of y
        bent = curvature * float(best.passing.curvatures(best.duration) @ changes**2) / 4.0
        predicted = self._fall(best, guess) - bent
        after = self.near(guess, reach) if predicted > CONVERGED else None
        return _Iteration(after, predicted, moved, bent)

    def _with_same_times(self, timed: Timed) -> Timed | None:
        """Return a motion around another with waypoints at the same fractions of the final time.

        Far from the program's final time a solution is too inexact, so it is then solved again.
        """
        change = self._same_times
        after = self._solve(timed, change)
        checked = self._checked(after, change)
        if checked is None and after is not None and timed.reference is None:
            checked = self._checked(self._solve(timed.lasting(after.duration), change), change)
        return checked

    def _checked(self, after: Timed | None, change: Change) -> Timed | None:
        """Return the solution of a program; None if it misses a waypoint with a fixed time.

        Solvers may accept contradictory equations as satisfied.

        Args:
            after: motion with the times of the solution; None without one.
            change: bounds on the changes of times in the program.
        """
        if after is None:
            return None
        same = change.final[0] == 1.0
        exact = change.waypoints == 0.0 and (same or self._steady)
        exact &= not np.isfinite(after.passing.price)
        exact &= same or after.scenario.smoothing is None  # its width does not change with y
        return None if exact and after.missed > _MISSED else after

    def _tried(self, timed: Timed, change: Change) -> Timed | None:
        """Return the minimum-time motion around another; None if none is found."""
        with suppress(SolverError):
            return self._checked(self._solve(timed, change), change)
        return None

    @property
    def _same_times(self) -> Change:
        return Change() if self._steady and self._final_time else NO_CHANGE

    def _fall(self, one: Timed, other: Timed) -> float:
        """Return the relative fall of final time or cost from one motion to another."""
        if self._final_time:
            return 1.0 - other.duration / one.duration
        return 1.0 - other.cost / one.cost if one.cost > 0.0 else 0.0

    def _described(self, best: Timed) -> str:
        if self._final_time:
            return f"final time {best.duration:.6g} s"
        return f"cost {best.cost:.6g} m²/s⁴"

    def _solve(self, timed: Timed, change: Change) -> Timed | None:
        """Return the minimum-time motion around another; None if there is none.

        Raises:
            ScenarioError: nothing bounds the time.
            SolverError: the solvers fail numerically.
        """
        if self._final_time and timed.step < _AT_ONCE * timed.scenario.grid.step:
            raise nothing_bounds_the_time()
        try:
            problem = timed.problem
        except ScenarioError:  # such as a goal that is occupied at this final time
            return None
        constraints = timed.linearised()
        least = max(timed.least_factor, min(change.final[1], _FASTEST))
        low, high = (max(each, least) for each in change.final)
        change = change._replace(final=(low, high))
        if np.any(timed.passing_tightened.within < 0.0):  # the errors of a disturbance are larger
            return None
        weight = LITTLE_EFFORT if self._final_time else 1.0
        programs = FreeTimePrograms(problem, self._backend, weight)
        if self._final_time and not _is_bounded(programs, constraints):
            raise nothing_bounds_the_time()
        found, rows = self._with_rows(programs, timed, constraints, change)
        return None if found is None else timed.after(found, near_rows(rows, found, problem))

    def _with_rows(
        self,
        programs: FreeTimePrograms,
        timed: Timed,
        constraints: Sequence[Constraint],
        change: Change,
    ) -> tuple[FreeTime | None, Sequence[HalfSpaces]]:
        """Return a solution that violates no row, or None, and the rows in its program.

        Raises:
            SolverError: the solvers fail numerically, or rows are still violated in the end.
        """
        problem, passing = timed.problem, timed.passing_tightened
        working = WorkingSet(RowKeys(len(problem), problem.scenario.grid))
        known = {each.key: each for each in constraints}
        for rows in timed.rows:
            if (key := rows.constraint.key) in known:
                working.add(known[key].renewed(rows))
        _, velocities = passing.states(timed.motion)
        found: FreeTime | None = None
        more: list[HalfSpaces] | None = None  # before the first solution

        def search() -> bool:
            for each in more or ():
                working.add(each)
            return more is None or len(more) > 0

        def solve() -> None:
            nonlocal found, more
            rows = list(working.rows.values())
            found = programs.solve(rows, passing, velocities, change, timed.resting, timed.motion)
            more = []
            if found is None:
                self.statistics += Statistics(programs=1)
                return
            if change.final[0] == change.final[1]:  # solvers satisfy it only to their tolerance
                found = dataclasses.replace(found, factor=change.final[0])
            more = violated_rows(constraints, found, problem, passing, timed.motion)
            self.statistics += Statistics(
                programs=1,
                rows=sum(map(len, more)),
                solver=found.solver,
                solver_seconds=found.seconds,
            )

        if not generate_rows(search, solve, _ROUNDS):
            raise SolverError(f"rows were still violated after {_ROUNDS} rounds")
        return found, list(working.rows.values())


def _is_bounded(programs: FreeTimePrograms, constraints: Sequence[Constraint]) -> bool:
    """Return whether a velocity, an acceleration or a jerk is limited or required."""
    return programs.bound_time or any(each.quantity != "position" for each in constraints)


def nothing_bounds_the_time() -> ScenarioError:
    """Return the error of a scenario whose motions can be arbitrarily fast."""
    given = Description("none of velocities, accelerations or jerks that bounds the time")
    return ScenarioError("limits", given, "one, without which there is no least time")
