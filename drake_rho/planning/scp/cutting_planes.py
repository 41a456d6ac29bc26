"""Rows are added as motions violate them: solve, look for violated constraints, solve again.

It begins with the motions of minimum effort, which are known in closed form. Everything else enters
as a row when a motion violates it: at the knots first and, where nothing is violated there, at the
worst instants between. When nothing is violated the answer is that of the full programs, because
every row left out holds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.planning.scp.curved_sets import CurvedSets
from drake_rho.planning.scp.farkas import conflict_of, in_the_way
from drake_rho.planning.scp.group_programs import GroupPrograms
from drake_rho.planning.scp.row_generation import generate_rows
from drake_rho.planning.scp.working_set import WorkingSet
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.system.threads import single_threaded_blas

MAX_ROUNDS = 200
"""Bound on the solves of one call. Every round adds rows, and after the first few a growing
neighbourhood of them, so that all of a constraint's rows are in long before."""

_PIECES = 4
"""In the first round the worst row of each quarter of a violated stretch enters, in the next that
of each eighth, and so on: neighbours require nearly the same, and a small program is a fast one."""

_PATIENCE = 3
"""Rounds in which only violated rows are added. Most scenarios need no more; where an active
stretch creeps along the knots, as jerk does, neighbours then come too, twice as many each round."""


class CuttingPlanes:
    """Programs of a problem's vehicles: solved, kept, and solved with more constraints.

    Args:
        problem: to be solved.
        backend: Clarabel if not given.
        vehicles: which of them are planned, rising indices; all if not given.
        accelerations: what the others fly [m/s²], shape (N, K-1, 3).
        cones: programs with curved sets that others of this problem have begun.

    Attributes:
        problem: as given.
    """

    def __init__(
        self,
        problem: Problem,
        backend: Backend | None = None,
        *,
        vehicles: IntArray | None = None,
        accelerations: FloatArray | None = None,
        cones: ConicPrograms | None = None,
    ) -> None:
        self.problem, count = problem, len(problem)
        self._curved = CurvedSets(cones or ConicPrograms(problem.effort))
        self._programs = GroupPrograms(problem, backend or Backend(), self._curved)
        self._planned = np.arange(count) if vehicles is None else vehicles
        self._constraints = list[Constraint]()
        if accelerations is not None and len(self._planned) < count:
            others = np.setdiff1d(np.arange(count), self._planned)
            flown = self.motion.with_vehicles(others, accelerations[others])
            self._programs.motion = flown

    @property
    def motion(self) -> Motion:
        """Motion of all vehicles, as found so far."""
        return self._programs.motion

    @property
    def working(self) -> WorkingSet:
        """Rows that are in, and their multipliers."""
        return self._programs.working

    def keep_to(
        self,
        constraints: Sequence[Constraint],
        *,
        warm: Sequence[HalfSpaces] = (),
        reference: Plan | None = None,
    ) -> None:
        """Solve until the solutions keep to these constraints too, beside those kept already.

        Args:
            constraints: more of them.
            warm: rows of these with which it begins, if there are any, rather than with a look.
            reference: what they are linearised around, for an error.

        Raises:
            InfeasibleError: a vehicle's program has no solution, or its goal is out of reach.
            SolverError: the solvers fail numerically.
        """
        with single_threaded_blas():
            infeasible = self._keep_to(constraints, warm)
        if infeasible:
            raise self._error(infeasible, reference)

    def plan(self, reference: Plan | None = None) -> Plan:
        """Return the solutions as a plan, found with constraints linearised around a reference."""
        statistics = self._programs.statistics(linearisations=int(reference is not None))
        plan = Plan.from_motion(self.problem.scenario, self.motion, statistics)
        return plan if reference is None else plan.found_around(reference)

    def _keep_to(self, more: Sequence[Constraint], warm: Sequence[HalfSpaces]) -> list[int]:
        """Add rows until nothing is violated; return the vehicles without a solution."""
        programs, unreachable = self._programs, self.problem.effort.unreachable
        infeasible: list[int] = self._planned[unreachable[self._planned]].tolist()
        if infeasible:
            self._planned = np.setdiff1d(self._planned, infeasible)
        self._constraints += more
        self._curved.add(more)
        violating = self._add([self._of_planned(rows) for rows in warm])
        programs.forget_lost()
        unseen, moved = self._planned, self._mask(self._planned)
        # what is kept already needs no look at first
        constraints, number, searches = more, 0, 0
        if not violating.any():
            violating, unseen = self._add_violated(more, unseen, 0), unseen[:0]

        def look() -> bool:
            nonlocal violating, number, searches
            if violating.any():
                return True
            if infeasible and self.problem.scenario.separation is not None:
                return False  # what pairs do between is worth nothing now
            whose = moved.nonzero()[0]
            violating = self._add_violated(constraints, whose, searches, between=True)
            moved[:], number, searches = False, 0, searches + 1
            return bool(violating.any())

        def solve() -> None:
            nonlocal violating, unseen, constraints, number
            pending = programs.with_groups(violating.nonzero()[0])
            failed = programs.solve(pending)
            moved[pending] = True
            if failed:
                infeasible.extend(failed)
                moved[failed] = False
                pending = np.setdiff1d(pending, failed)
                self._planned = np.setdiff1d(self._planned, failed)
            constraints, number = self._constraints, number + 1
            seen = np.union1d(unseen, pending)
            violating, unseen = self._add_violated(constraints, seen, number), unseen[:0]
            programs.check_inexact(pending, violating)

        if not generate_rows(look, solve, MAX_ROUNDS):
            raise SolverError(f"rows were still violated after {MAX_ROUNDS} rounds")
        return infeasible

    def _mask(self, vehicles: IntArray) -> BoolArray:
        """Return whether each of all vehicles is among some, shape (N,)."""
        mask = np.zeros(len(self.problem), dtype=bool)
        mask[vehicles] = True
        return mask

    def _add_violated(
        self, look: Sequence[Constraint], vehicles: IntArray, number: int, *, between: bool = False
    ) -> BoolArray:
        """Add rows that the motions of some vehicles violate; return whose they are, shape (N,)."""
        # a round of a large group is expensive
        patience = 0 if self._programs.are_coupled else _PATIENCE
        reach = 2 ** max(0, number - patience) // 2
        gap = np.inf if between else 1.5 * self.problem.scenario.grid.step
        found, cut = list[HalfSpaces](), list[IntArray]()
        for constraint in look if len(vehicles) > 0 else ():
            if number < (constraint.searches if between else constraint.rounds):
                rows = constraint.violated_rows(
                    self.motion, vehicles, between=between, neighbours=reach
                )
                if constraint.curved and len(rows) > 0:
                    rows = self._curved.planes_to_add(rows, self.motion)
                    cut.append(rows.vehicles)
                if len(rows) > 0:
                    if reach == 0:
                        rows = rows.worst(self.motion, _PIECES * 2**number, gap=gap)
                    found.append(self._of_planned(rows))
        if cut:
            self._curved.count_round(np.unique(np.concatenate(cut)))
        return self._add(found)

    def _add(self, rows: Sequence[HalfSpaces]) -> BoolArray:
        """Put rows in; return whose are new, or were in and are not kept, shape (N,)."""
        about = np.zeros(len(self.problem), dtype=bool)
        self._programs.forget_lost()
        for part in rows:
            about |= self._programs.add(part)
        return about

    def _of_planned(self, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows of planned vehicles: partners may not be, or have no solution."""
        if len(self._planned) == len(self.problem) or len(rows) == 0:
            return rows
        return rows.select(self._mask(self._planned)[rows.vehicles])

    def _error(self, vehicles: list[int], reference: Plan | None) -> InfeasibleError:
        """Return the error for vehicles without a solution, or whose goal alone is out of reach."""
        names = [vehicle.name for vehicle in self.problem.scenario.vehicles]
        return InfeasibleError(
            {
                names[vehicle]: conflict_of(self.working, self.problem.effort, vehicle, names)
                for vehicle in vehicles
            },
            statistics=self._programs.statistics(),
            scenario=self.problem.scenario,
            obstacles={names[vehicle]: in_the_way(self.working, vehicle) for vehicle in vehicles},
            reference=reference,
        )
