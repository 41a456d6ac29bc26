"""The one loop that adds rows: solve, look for broken constraints, add their rows, solve again.

It begins with the motions of minimum effort, which are known in closed form. Everything else enters
as a row when a motion breaks it: at the knots first and, where nothing is broken there, at the
worst instants between. When nothing is broken the answer is that of the full programs, because
every row left out holds.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.convex_sets import KeepInSets
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.options import SMALL_FLEET
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.planning.programs.parallel import Answers, solve_all
from drake_rho.planning.programs.rows import about, groups_of
from drake_rho.planning.programs.solve import MAX_RETRIES
from drake_rho.planning.scp.farkas import conflict_of, in_the_way
from drake_rho.planning.scp.working_set import RowKeys, WorkingSet
from drake_rho.planning.time_limit import check_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

MAX_ROUNDS = 200
"""Bound on the solves of one call. Every round adds rows, and after the first few a growing
neighbourhood of them, so that all of a constraint's rows are in long before."""

_PIECES = 4
"""In the first round the worst row of each quarter of a broken stretch enters, in the next that
of each eighth, and so on: neighbours ask for nearly the same, and a small program is a fast one."""

_PATIENCE = 3
"""Rounds in which only broken rows are added. Most scenarios need no more; where an active
stretch creeps along the knots, as jerk does, neighbours then come too, twice as many each round."""

_CREEPING = 10
"""Rounds that add tangent planes of a vehicle's curved sets before these enter as they are. Where
there is room most scenarios need fewer: each round quarters what is left outside, at least."""

_AS_GOOD_AS_KEPT = 0.5
"""Tolerances by which a solution may be outside of a set that is, or was, in a program as it is:
tangent planes that go on from there would take dozens of rounds for the digits that are left."""

_MAX_INEXACT = 3
"""Rounds in a row that may go on from a solution that is almost one."""


class CuttingPlanes:
    """The programs of a scenario's vehicles: solved, kept, and solved with more constraints.

    Args:
        problem: to be solved.
        backend: Clarabel if not given.
        vehicles: which of them are planned, rising indices; all if not given.
        accelerations: what the others fly [m/s²], shape (N, K-1, 3).
        cones: programs with curved sets that others of this problem have begun.

    Attributes:
        problem: as given.
        effort: minimum effort of the problem, which programs are written in changes of.
        working: the rows that are in.
        motion: of all vehicles, what was found so far.
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
        self.problem, self.effort, count = problem, problem.effort, len(problem)
        self.motion = self.effort.motion
        self.working = WorkingSet(RowKeys(count, problem.scenario.grid))
        self._scenario, self._backend = problem.scenario, backend or Backend()
        self._planned = np.arange(count) if vehicles is None else vehicles
        self._constraints: list[Constraint] = []
        self._programs, self._solver_name = 0, ""
        self._solver_seconds = 0.0
        self._lost: list[HalfSpaces] = []
        self._inexact = np.zeros(count, dtype=int)
        self._retries = 0
        self._cones = cones or ConicPrograms(self.effort)
        self._conic = self._cones.needed.copy()  # whose curved sets are in as they are
        self._cuts = np.zeros(count, dtype=int)
        if accelerations is not None and len(self._planned) < count:
            others = np.setdiff1d(np.arange(count), self._planned)
            self.motion = self.motion.with_some(others, accelerations[others])

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
        with one_for_arrays():
            infeasible = self._keep_to(constraints, warm)
        if infeasible:
            raise self._error(infeasible, reference)

    @property
    def _soft(self) -> bool:
        """Whether something may be broken: solutions are steps on the way to others."""
        return any(np.isfinite(each.penalty) for each in self._constraints)

    def plan(self, reference: Plan | None = None) -> Plan:
        """The solutions as a plan, found with constraints linearised around `reference`."""
        statistics = self.statistics(linearisations=int(reference is not None))
        plan = Plan.from_motion(self._scenario, self.motion, statistics)
        return plan if reference is None else plan.found_around(reference)

    def statistics(self, *, linearisations: int = 0) -> Statistics:
        """Counts and times of the work so far."""
        return Statistics(
            programs=self._programs,
            rows=len(self.working),
            linearisations=linearisations,
            solver=self._solver_name,
            solver_seconds=self._solver_seconds,
        )

    def _keep_to(self, more: Sequence[Constraint], warm: Sequence[HalfSpaces]) -> list[int]:
        """The loop; returns the vehicles without a solution."""
        infeasible: list[int] = self._planned[self.effort.unreachable[self._planned]].tolist()
        if infeasible:
            self._planned = np.setdiff1d(self._planned, infeasible)
        self._constraints += more
        look, number, searches = more, 0, 0  # what is kept already needs no look at first
        moved, unseen = self._mask(self._planned), self._planned
        broken = self._add([self._of_planned(rows) for rows in warm])
        self._lost = []  # nothing was solved yet
        if not broken.any():
            broken, unseen = self._add_violated(look, unseen, 0), unseen[:0]
        for _ in range(MAX_ROUNDS):
            check_time()
            if not broken.any():
                if infeasible and self._scenario.separation is not None:
                    return infeasible  # what pairs do between is worth nothing now
                broken = self._add_violated(look, moved.nonzero()[0], searches, between=True)
                if not broken.any():
                    return infeasible
                moved[:], number, searches = False, 0, searches + 1
            pending = self._with_groups(broken.nonzero()[0])
            failed = self._solve(pending)
            moved[pending] = True
            if failed:
                infeasible += failed
                moved[failed] = False
                pending = np.setdiff1d(pending, failed)
                self._planned = np.setdiff1d(self._planned, failed)
            look, number = self._constraints, number + 1
            broken = self._add_violated(look, np.union1d(unseen, pending), number)
            unseen = unseen[:0]
            self._check_inexact(pending, broken)
        raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")

    def _mask(self, vehicles: IntArray) -> BoolArray:
        """Whether each of all vehicles is among `vehicles`, shape (N,)."""
        mask = np.zeros(len(self.effort.units), dtype=bool)
        mask[vehicles] = True
        return mask

    def _add_violated(
        self, look: Sequence[Constraint], vehicles: IntArray, number: int, *, between: bool = False
    ) -> BoolArray:
        """Add rows that the motions of `vehicles` break, and say whose were broken."""
        coupled = any(part.constraint.coupled for part in self.working.rows.values())
        patience = 0 if coupled else _PATIENCE  # a round of a large group is expensive
        reach = 2 ** max(0, number - patience) // 2
        gap = np.inf if between else 1.5 * self.effort.grid.step
        found, cut = list[HalfSpaces](), list[IntArray]()
        for constraint in look if len(vehicles) > 0 else ():
            if number < (constraint.searches if between else constraint.rounds):
                rows = constraint.violated_rows(self.motion, vehicles, between=between, reach=reach)
                if constraint.curved and len(rows) > 0:
                    rows = self._to_cut(rows)
                    cut.append(rows.vehicles)
                if len(rows) > 0:
                    if reach == 0:
                        rows = rows.worst(self.motion, _PIECES * 2**number, gap=gap)
                    found.append(self._of_planned(rows))
        if cut:
            self._count_cuts(np.unique(np.concatenate(cut)))
        return self._add(found)

    def _to_cut(self, rows: HalfSpaces) -> HalfSpaces:
        """Return the tangent planes that are to be added: sets in programs as they are need none.

        A set that is much smaller than its distance from zero is kept by rows to more digits than
        as a cone. Tangent planes where the cone's solution is go on from there, unless something
        may be broken, for which few digits do.
        """
        conic, again = self._conic[rows.vehicles], self._cuts[rows.vehicles] < 0
        if not (conic | again).any():
            return rows
        if self._soft:
            return rows.select(~conic)
        outside = rows.margins(self.motion) < -_AS_GOOD_AS_KEPT * rows.tolerances
        self._cut_again(np.unique(rows.vehicles[conic & outside]))
        return rows.select(outside | ~(conic | again))

    def _count_cuts(self, vehicles: IntArray) -> None:
        """Note that another round cuts these vehicles' curved sets, and whose it cuts no more."""
        self._cuts[vehicles] += 1
        self._cut_no_more(vehicles[self._cuts[vehicles] > _CREEPING])

    def _add(self, rows: Sequence[HalfSpaces]) -> BoolArray:
        """Put rows in; say whose are new, or were in and are not kept."""
        about, self._lost = np.zeros(len(self.effort.units), dtype=bool), []
        for part in rows:
            new, lost = self.working.enter(part, self.motion)
            if len(lost) > 0:
                lost = lost.select(self._inexact[lost.vehicles] == 0)
                self._lost += [lost] * (len(lost) > 0)
            about[new.vehicles] = about[lost.vehicles] = True
        return about

    def _of_planned(self, rows: HalfSpaces) -> HalfSpaces:
        """The rows of vehicles that are planned: partners may not be, or have no solution."""
        if len(self._planned) == len(self.effort.units) or len(rows) == 0:
            return rows
        return rows.select(self._mask(self._planned)[rows.vehicles])

    def _with_groups(self, vehicles: IntArray) -> IntArray:
        """The vehicles and those that rows couple them to."""
        if not any(part.constraint.coupled for part in self.working.rows.values()):
            return vehicles
        labels = self._labels()
        return np.flatnonzero(np.isin(labels, labels[vehicles]))

    def _labels(self) -> IntArray:
        """The number of each vehicle's group, shape (N,)."""
        coupled = [part for part in self.working.rows.values() if part.constraint.coupled]
        return groups_of(len(self.effort.units), coupled)

    def _solve(self, vehicles: IntArray) -> list[int]:
        """Solve the programs of `vehicles`, all of which have rows; say which have no solution."""
        vehicles = self._with_groups(vehicles)
        plain, conic, answers = vehicles, vehicles[self._conic[vehicles]], list[Answers]()
        if len(conic) > 0:
            conic = self._with_groups(conic)
            plain = np.setdiff1d(vehicles, conic)
        if len(plain) > 0:
            try:
                answers = self._solve_rows(plain)
            except SolverError:
                cut = plain[self._cuts[plain] > 0]
                if len(cut) == 0:
                    raise
                self._cut_no_more(cut)  # tangent planes where there is no room take digits
                return self._solve(vehicles)
        if len(conic) > 0:
            answers += self._solve_conic(conic)
        solved = list(map(self._take, answers))
        vehicles = np.concatenate([whose for whose, _ in solved])
        found = self.effort.goals.met_by(np.concatenate([own for _, own in solved]), vehicles)
        order = np.argsort(vehicles)
        self.motion = self.motion.with_some(vehicles[order], found[order])
        every = np.concatenate([each.groups.reshape(-1) for each in answers])
        if len(every) == len(vehicles):
            return []
        infeasible: list[int] = np.setdiff1d(every, vehicles).tolist()
        return infeasible

    def _solve_rows(self, vehicles: IntArray) -> list[Answers]:
        """Solve programs of rows alone."""
        count = len(self.effort.units)
        quick = count > SMALL_FLEET  # others are planned to the last digit
        backend = dataclasses.replace(
            self._backend,
            accuracy="quick" if quick else "full",
            others_first=self._retry() > 0,
        )
        rows = about(self.effort.motion, self.working.of(vehicles, count))
        return solve_all(self.effort.changes, rows, backend)

    def _cut_no_more(self, vehicles: IntArray) -> None:
        """Put curved sets of some vehicles in as they are, here and in later programs."""
        self._conic[vehicles] = self._cones.needed[vehicles] = True

    def _solve_conic(self, vehicles: IntArray) -> list[Answers]:
        """Solve programs with curved sets as they are; keep tangent planes that say the same."""
        labels, answers = self._labels(), list[Answers]()
        sets = [each for each in self._constraints if isinstance(each, KeepInSets)]
        for label in np.unique(labels[vehicles]):
            group = np.flatnonzero(labels == label)
            rows = self.working.of(group, len(labels))
            rows = [part for part in rows if not part.constraint.curved]
            found = self._cones.solve(group, rows, sets, rough=self._soft)
            for tangents, _ in found.tangents:
                self.working.exchange(group, tangents)
            if not (found.exact or self._soft):
                self._cut_again(group)  # planes where the almost solution is lead to one
                answers += self._solve_rows(group)
                continue
            answers.append(found.answers(group, self.working.of(group, len(labels))))
        return answers

    def _cut_again(self, vehicles: IntArray) -> None:
        """Go back to tangent planes of these vehicles' curved sets, for good in these programs."""
        self._conic[vehicles], self._cuts[vehicles] = False, -MAX_ROUNDS

    def _check_inexact(self, solved: IntArray, broken: BoolArray) -> None:
        """See that whoever has almost a solution has other rows to be solved with.

        Where nothing can be met, solutions grow with every round before it can be proved, and no
        solver may reach its tolerances; they break other rows, with which it can.

        Raises:
            SolverError: someone has none, or they were no help.
        """
        rounds = self._inexact[solved]
        if not rounds.any():
            return
        left = np.setdiff1d(solved[rounds > 0], self._with_groups(np.flatnonzero(broken)))
        if len(left) > 0 or rounds.max() > _MAX_INEXACT:
            raise SolverError("all solvers failed numerically", self.statistics())

    def _take(self, answers: Answers) -> tuple[IntArray, FloatArray]:
        """Note some answers; the vehicles that have a solution, and their accelerations."""
        self.working.solved(answers)
        self._programs += len(answers.groups)
        self._solver_name = answers.solver
        self._solver_seconds += answers.seconds
        for group, exact in zip(answers.groups, answers.exact.tolist(), strict=True):
            self._inexact[group] = 0 if exact else self._inexact[group] + 1
        u, groups = answers.accelerations[answers.feasible], answers.groups[answers.feasible]
        units = self.effort.units[groups].max(axis=1)
        vehicles = groups.reshape(-1)
        a = np.repeat(units, groups.shape[1])[:, None, None] * u.reshape(-1, *u.shape[2:])
        return vehicles, a + self.effort.motion.accelerations[vehicles]

    def _retry(self) -> int:
        """How often the last rows were in a program and were not kept, so that others solve it."""
        if not self._lost:
            self._retries = 0
        elif self._retries == MAX_RETRIES:
            lost = self._lost[0]
            who = self._scenario.vehicles[lost.vehicles[0]].name
            raise SolverError(
                f"the solvers do not keep the {lost.constraint.name} of {who}", self.statistics()
            )
        else:
            self._retries += 1
        self._lost = []
        return self._retries

    def _error(self, vehicles: list[int], reference: Plan | None) -> InfeasibleError:
        """The error for vehicles without a solution, or whose goal alone is out of reach."""
        names = [vehicle.name for vehicle in self._scenario.vehicles]
        return InfeasibleError(
            {
                names[vehicle]: conflict_of(self.working, self.effort, vehicle, names)
                for vehicle in vehicles
            },
            statistics=self.statistics(),
            scenario=self._scenario,
            obstacles={names[vehicle]: in_the_way(self.working, vehicle) for vehicle in vehicles},
            reference=reference,
        )
