"""Programs of vehicles or coupled groups, to which violated rows are added.

The first motions are those of minimum effort, which are known in closed form. Every constraint
enters as a row when a motion violates it: first at the knots and, once the knots satisfy all, at
the worst instants between them. When nothing is violated, the solution is that of the full
programs, because every omitted row holds.
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
from drake_rho.planning.scp.farkas import conflict_of, obstacles_in
from drake_rho.planning.scp.group_programs import GroupPrograms
from drake_rho.planning.scp.row_generation import generate_rows
from drake_rho.planning.scp.working_set import WorkingSet
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.system.threads import single_threaded_blas

MAX_ROUNDS = 200
"""Largest number of solves in one call. Every round adds rows and, after the first few, a growing
neighbourhood of them. All rows of a constraint are therefore in the program long before this."""

_PIECES = 4
"""Pieces of a violated stretch whose worst rows enter in the first round; each later round doubles
their number. Neighbouring rows require nearly the same, and a small program is solved faster."""

_PATIENCE = 3
"""Rounds in which only violated rows are added. Most scenarios need no more. If an active
stretch moves slowly along the knots, as with jerk, neighbours are then added too, twice as many
each round."""


class CuttingPlanes:
    """Programs of a problem's vehicles, to which constraints are added by row generation.

    Args:
        problem: the problem to solve.
        backend: the solver and its settings; Clarabel if not given.
        vehicles: indices of the planned vehicles, ascending; all vehicles if not given.
        accelerations: accelerations that the other vehicles keep [m/s²], shape (N, K-1, 3).
        cones: programs with cones from earlier solves of this problem, to continue with.

    Attributes:
        problem: the problem to solve.
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
        self.problem, self._count = problem, len(problem)
        self._curved = CurvedSets(cones or ConicPrograms(problem.effort))
        self._programs = GroupPrograms(problem, backend or Backend(), self._curved)
        self._planned = np.arange(self._count) if vehicles is None else vehicles
        self._constraints = list[Constraint]()
        if accelerations is not None and len(self._planned) < self._count:
            others = (~self._mask(self._planned)).nonzero()[0]
            self._programs.fly(others, accelerations[others])

    @property
    def motion(self) -> Motion:
        """Motion of all vehicles in the latest solutions."""
        return self._programs.motion

    @property
    def working(self) -> WorkingSet:
        """Working set of rows, with their multipliers."""
        return self._programs.working

    @single_threaded_blas
    def keep_to(
        self,
        constraints: Sequence[Constraint],
        *,
        warm: Sequence[HalfSpaces] = (),
        reference: Plan | None = None,
    ) -> None:
        """Solve until the solutions satisfy these constraints as well as all earlier ones.

        Args:
            constraints: the constraints to add.
            warm: rows of these constraints to start with; without them violated rows are sought.
            reference: the plan around which they are linearised, recorded in errors.

        Raises:
            InfeasibleError: a vehicle's program has no solution, or its goal is unreachable.
            SolverError: the solvers fail numerically.
        """
        if infeasible := self._add_constraints(constraints, warm):
            raise self._error(infeasible, reference)

    def plan(self, reference: Plan | None = None) -> Plan:
        """Return the solutions as a plan; record the reference of the linearisation, if any."""
        statistics = self._programs.statistics(linearisations=int(reference is not None))
        plan = Plan.from_motion(self.problem.scenario, self.motion, statistics)
        return plan if reference is None else plan.found_around(reference)

    def _add_constraints(self, more: Sequence[Constraint], warm: Sequence[HalfSpaces]) -> list[int]:
        """Add rows until nothing is violated; return the vehicles whose programs are infeasible."""
        programs, unreachable = self._programs, self.problem.effort.unreachable
        infeasible: list[int] = self._planned[unreachable[self._planned]].tolist()
        if infeasible:
            self._planned = np.setdiff1d(self._planned, infeasible)
        self._constraints += more
        self._curved.add(more)
        unchecked, moved = self._planned, self._mask(self._planned)
        violating = unchecked[:0]
        if warm:
            violating = programs.add([self._rows_of_planned(rows) for rows in warm])
            programs.forget_unsatisfied()
        # earlier constraints hold already: the first search covers the new ones only
        constraints, number, searches = more, 0, 0
        if len(violating) == 0:
            violating, unchecked = self._add_violated(more, unchecked, 0), unchecked[:0]

        def search() -> bool:
            nonlocal violating, number, searches
            if len(violating) > 0:
                return True
            if infeasible and self.problem.scenario.separation is not None:
                return False  # pairs between the knots cannot make the fleet feasible
            changed = moved.nonzero()[0]
            violating = self._add_violated(constraints, changed, searches, between=True)
            moved[:], number, searches = False, 0, searches + 1
            return len(violating) > 0

        def solve() -> None:
            nonlocal violating, unchecked, constraints, number
            pending = programs.with_groups(violating)
            failed = programs.solve(pending)
            moved[pending] = True
            if failed:
                infeasible.extend(failed)
                moved[failed] = False
                pending = np.setdiff1d(pending, failed)
                self._planned = np.setdiff1d(self._planned, failed)
            constraints, number = self._constraints, number + 1
            to_check = np.union1d(unchecked, pending) if len(unchecked) > 0 else pending
            violating, unchecked = self._add_violated(constraints, to_check, number), unchecked[:0]
            programs.check_inexact(pending, violating)

        if not generate_rows(search, solve, MAX_ROUNDS):
            raise SolverError(f"rows were still violated after {MAX_ROUNDS} rounds")
        return infeasible

    def _mask(self, vehicles: IntArray) -> BoolArray:
        """Return flags that are set for the given vehicles, shape (N,)."""
        mask = np.zeros(self._count, dtype=bool)
        mask[vehicles] = True
        return mask

    def _add_violated(
        self, among: Sequence[Constraint], vehicles: IntArray, number: int, *, between: bool = False
    ) -> IntArray:
        """Add the rows that some vehicles violate; return those of them with rows to satisfy."""
        # a round of a large group is expensive
        patience = 0 if self.working.coupled else _PATIENCE
        nearby = 2 ** max(0, number - patience) // 2
        gap = np.inf if between else 1.5 * self.problem.scenario.grid.step
        motion = self.motion
        found, cut = list[HalfSpaces](), list[IntArray]()
        for constraint in among if len(vehicles) > 0 else ():
            if number < (constraint.searches if between else constraint.rounds):
                rows = constraint.violated_rows(
                    motion, vehicles, between=between, neighbours=nearby
                )
                if constraint.prices is not None and len(rows) > 0:
                    rows = self.working.beyond_slack(rows, motion, nearby)
                if len(rows) == 0:
                    continue
                if constraint.key in self._curved.sets:
                    rows = self._curved.planes_to_add(rows, motion)
                    cut.append(rows.vehicles)
                if nearby == 0:
                    rows = rows.worst(motion, _PIECES * 2**number, gap=gap)
                found.append(self._rows_of_planned(rows))
        if cut:
            self._curved.count_round(np.unique(np.concatenate(cut)))
        return self._programs.add(found)

    def _rows_of_planned(self, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows of planned vehicles; omit those of fixed or infeasible ones."""
        if len(self._planned) == self._count or len(rows) == 0:
            return rows
        return rows.select(self._mask(self._planned)[rows.vehicles])

    def _error(self, vehicles: list[int], reference: Plan | None) -> InfeasibleError:
        """Return the error for vehicles with an infeasible program or an unreachable goal."""
        names = [vehicle.name for vehicle in self.problem.scenario.vehicles]
        conflicts = {
            names[vehicle]: conflict_of(self.working, self.problem.effort, vehicle, names)
            for vehicle in vehicles
        }
        # a vehicle that is only linked to others may take no part in the conflict
        conflicts = {name: why for name, why in conflicts.items() if why} or conflicts
        return InfeasibleError(
            conflicts,
            statistics=self._programs.statistics(),
            scenario=self.problem.scenario,
            obstacles={names[vehicle]: obstacles_in(self.working, vehicle) for vehicle in vehicles},
            reference=reference,
        )
