"""The one planning loop: solve, look for broken constraints, add their rows, solve again.

It begins with the motion of least index that reaches the goal, which is known in closed form.
Everything else enters as a row when a motion breaks it. When nothing is broken the answer is that
of the full program, because every row left out holds.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import islice

import numpy as np
from pydrake.solvers import SolverInterface
from scipy.ndimage import maximum_filter1d

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.conflict import conflict
from drake_rho.planning.constraints import WORST, Constraint, boxes_of, tangents_of
from drake_rho.planning.errors import Conflicts, InfeasibleError, Names, SolverError
from drake_rho.planning.frame import Frame
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.program import Batch, programs_of
from drake_rho.planning.solve import Solution, solve
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario

MAX_ROUNDS = 50
"""Bound on the rounds. Every round adds rows, and after the first few a growing neighbourhood of
them, so that all of a constraint's rows are in long before."""

BLOCK = 500
"""Vehicles whose rows are looked for together: enough to make the arithmetic worth its calls, few
enough for a processor's cache, and for all processors to have something to do."""

_PIECES = 4
"""In the first round the worst row of each quarter of a broken stretch enters, in the next that
of each eighth, and so on: neighbours ask for nearly the same, and a small program is a fast one."""

_PATIENCE = 3
"""Rounds in which only broken rows are added. Most scenarios need no more; where an active
stretch creeps along the knots, as jerk does, neighbours then come too, twice as many each round."""


def plan_around(
    scenario: Scenario, reference: Plan | None, solver: SolverInterface | None = None
) -> Plan:
    """The plan of least index with obstacles linearised (15) around `reference`.

    Args:
        scenario: what is asked.
        reference: a motion of the same vehicles on the same grid; None ignores the obstacles.
        solver: a Drake solver; Clarabel if not given.

    Raises:
        InfeasibleError: the linearised program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
        ValueError: the reference has other vehicles or another grid.
    """
    plan = plan_with(scenario, constraints_around(scenario, reference), solver)
    statistics = dataclasses.replace(plan.statistics, linearisations=0 if reference is None else 1)
    return dataclasses.replace(plan, statistics=statistics)


def constraints_around(scenario: Scenario, reference: Plan | None) -> list[Constraint]:
    """The boxes, and the obstacles linearised (15) around `reference` if there is one.

    Raises:
        ValueError: the reference has other vehicles or another grid.
    """
    if reference is None:
        return boxes_of(scenario)
    _check_fits(reference, scenario)
    return boxes_of(scenario) + tangents_of(scenario, reference)


def plan_with(
    scenario: Scenario, constraints: Sequence[Constraint], solver: SolverInterface | None = None
) -> Plan:
    """The plan of least index that reaches the goals and keeps to `constraints`.

    Raises:
        InfeasibleError: the program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
    """
    solved = solve_with(scenario, constraints, solver)
    return Plan.from_accelerations(scenario, solved.accelerations, solved.statistics)


@dataclasses.dataclass(frozen=True)
class Solved:
    """The solved programs of all vehicles."""

    frame: Frame
    """what the programs are written in"""
    searches: list[Search]
    """one for each block of vehicles"""
    accelerations: FloatArray
    """the solutions [m/s²], shape (N, K-1, 3)"""
    statistics: Statistics
    """what it took"""

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers, constraint by constraint."""
        return self.searches[vehicle // BLOCK].multipliers(vehicle)


def solve_with(
    scenario: Scenario, constraints: Sequence[Constraint], solver: SolverInterface | None = None
) -> Solved:
    """The loop of `plan_with`, which gives the solved programs rather than the plan.

    Nothing couples the vehicles, so blocks of them are worked on side by side.

    Raises:
        InfeasibleError: the program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
    """
    began = time.perf_counter()
    frame = Frame(scenario)
    every = np.arange(len(scenario.vehicles))
    blocks = [every[first : first + BLOCK] for first in range(0, len(every), BLOCK)]
    searches = [Search(scenario, frame, constraints, block) for block in blocks]
    if len(searches) == 1:
        searches[0].run(solver)
    else:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(lambda search: search.run(solver), searches))
    statistics = sum((search.statistics for search in searches), Statistics())
    statistics = dataclasses.replace(statistics, seconds=time.perf_counter() - began)
    failed = [search for search in searches if search.infeasible]
    if failed:
        raise _infeasible(scenario, frame, constraints, failed, statistics)
    accelerations = np.concatenate([search.accelerations for search in searches])
    return Solved(frame, searches, accelerations, statistics)


class Search:
    """The programs of a block of vehicles on their way to a solution, and in the end with it.

    Attributes:
        scenario: what is asked.
        frame: what the programs are written in.
        vehicles: the block, neighbouring indices, shape (B,).
        accelerations: of the latest solutions [m/s²], shape (B, K-1, 3).
        rows: the rows in the programs, for each constraint that has some.
        infeasible: vehicles found to have no solution.
    """

    def __init__(
        self,
        scenario: Scenario,
        frame: Frame,
        constraints: Sequence[Constraint],
        vehicles: IntArray,
    ) -> None:
        self.scenario, self.frame, self.vehicles = scenario, frame, vehicles
        self.accelerations = np.array(frame.free.accelerations[vehicles])
        self.rows: dict[str, HalfSpaces] = {}
        self.infeasible: list[int] = vehicles[frame.hopeless[vehicles]].tolist()
        self._constraints = constraints
        self._present: dict[str, BoolArray] = {}
        self._solutions: list[Solution] = []
        self._solved: dict[int, tuple[Batch, int, Solution]] = {}

    def run(self, solver: SolverInterface | None = None) -> None:
        """Go on until nothing is broken.

        Raises:
            SolverError: the solvers fail numerically.
        """
        pending = self.vehicles[~self.frame.hopeless[self.vehicles]]
        for number in range(MAX_ROUNDS):
            pending = self._add_broken(pending, number)
            if len(pending) == 0:
                return
            infeasible = self._solve(pending, solver)
            self.infeasible += infeasible
            pending = np.setdiff1d(pending, infeasible) if infeasible else pending
        raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")

    @property
    def statistics(self) -> Statistics:
        """What it took so far; wall time is not counted here."""
        return Statistics(
            programs=len(self._solutions),
            rows=sum(map(len, self.rows.values())),
            solver=self._solutions[-1].solver if self._solutions else "",
            solver_seconds=sum(solution.seconds for solution in self._solutions),
        )

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers y >= 0, constraint by constraint.

        For rows of length one and the index in units squared, as the program is written.
        """
        if vehicle not in self._solved:
            return []
        batch, index, solution = self._solved[vehicle]
        rows = self.rows_of(vehicle)
        y = np.maximum(solution.result.GetDualSolution(batch.rows[index]), 0.0)
        y *= batch.lengths[index]
        return list(zip(rows, np.split(y, np.cumsum(list(map(len, rows)))[:-1]), strict=True))

    def rows_of(self, vehicle: int) -> list[HalfSpaces]:
        """The rows in a vehicle's program, constraint by constraint, in the program's order."""
        return [rows.of(vehicle) for rows in self.rows.values()]

    def motion(self, vehicles: IntArray) -> Motion:
        """The latest motions of some vehicles of the block."""
        latest = self.accelerations[vehicles - self.vehicles[0]]
        return self.frame.free.of(vehicles).with_accelerations(latest)

    def _solve(self, vehicles: IntArray, solver: SolverInterface | None) -> list[int]:
        """Solve the programs of `vehicles`, all of which have rows; say which have no solution."""
        rows = list(self.rows.values())
        if len(vehicles) < len(self.vehicles):
            wanted = np.zeros(len(self.scenario.vehicles), dtype=bool)
            wanted[vehicles] = True
            rows = [part.select(wanted[part.vehicles]) for part in rows]
        batches = programs_of(self.frame, rows)
        answers = iter(solve([each for batch in batches for each in batch.programs], solver))
        units, free = self.frame.units, self.frame.free.accelerations
        infeasible: list[int] = []
        for batch in batches:
            solutions = list(islice(answers, len(batch.programs)))
            x = np.array([solution.result.get_x_val() for solution in solutions])
            u = units[batch.vehicles, None, None] * batch.solutions(x, self.frame.grid.knots - 1)
            reached = self.frame.reaching_goals(free[batch.vehicles] + u, batch.vehicles)
            feasible = np.array([solution.feasible for solution in solutions])
            self.accelerations[batch.vehicles[feasible] - self.vehicles[0]] = reached[feasible]
            infeasible += batch.vehicles[~feasible].tolist()
            self._solutions += solutions
            for index, vehicle in enumerate(batch.vehicles.tolist()):
                self._solved[vehicle] = batch, index, solutions[index]
        return infeasible

    def _add_broken(self, vehicles: IntArray, number: int) -> IntArray:
        """Add the rows that the motions of `vehicles` break, and say whose were broken.

        The instants between knots are looked at where nothing is broken at the knots.

        Raises:
            SolverError: a row that is in a program does not hold.
        """
        motion = self.motion(vehicles)
        broken = np.zeros(len(self.scenario.vehicles), dtype=bool)
        for constraint in self._constraints:
            self._add_knots(constraint, motion, vehicles, number, broken)
        here = ~broken[vehicles]
        if np.any(here):
            some = motion if np.all(here) else motion.of(np.flatnonzero(here))
            found = (each.broken_between(some, vehicles[here]) for each in self._constraints)
            for rows in found:
                if rows is not None and len(rows) > 0:
                    self._add(rows)
                    broken[rows.vehicles] = True
        return np.flatnonzero(broken)

    def _add_knots(
        self,
        constraint: Constraint,
        motion: Motion,
        vehicles: IntArray,
        number: int,
        broken: BoolArray,
    ) -> None:
        """Add rows of one constraint at the knots, and mark in `broken` whose they are."""
        margins = constraint.margins(motion, vehicles)
        if margins is None or not np.any(mask := margins < -WORST):
            return
        name = constraint.name
        if name not in self._present:
            shape = (len(self.vehicles), *margins.shape[1:])
            self._present[name] = np.zeros(shape, dtype=bool)
        present = self._present[name][vehicles - self.vehicles[0]]
        if np.any(present & (margins < -1.0)):
            first = int(np.argwhere(present & (margins < -1.0))[0, 0])
            vehicle = self.scenario.vehicles[vehicles[first]].name
            raise SolverError(f"the solver does not keep the {name} of {vehicle}")
        mask &= ~present
        which, sides, knots = _chosen(mask, margins, present, number)
        if len(which) == 0:
            return
        whose = vehicles[which]
        self._present[name][whose - self.vehicles[0], sides, knots] = True
        self._add(constraint.rows(whose, sides, constraint.times[knots]))
        broken[whose] = True

    def _add(self, rows: HalfSpaces) -> None:
        known = self.rows.get(rows.name)
        self.rows[rows.name] = rows if known is None else HalfSpaces.joined([known, rows])


def _infeasible(
    scenario: Scenario,
    frame: Frame,
    constraints: Sequence[Constraint],
    failed: Sequence[Search],
    statistics: Statistics,
) -> InfeasibleError:
    """The error for vehicles without a solution, or whose goal alone is out of reach."""
    finders: dict[str, Callable[[], Names]] = {}
    obstacles = {}
    for search, index in ((each, index) for each in failed for index in each.infeasible):
        name = scenario.vehicles[index].name
        if frame.hopeless[index]:
            finders[name] = partial(tuple, ("goal position", "goal velocity", "a single step"))
            continue
        rows = search.rows_of(index)
        finders[name] = partial(conflict, frame, index, constraints, rows)
        touched = (part.name for part in rows if len(part) > 0)
        obstacles[name] = frozenset(each for each in touched if each.startswith("obstacle"))
    return InfeasibleError(Conflicts(finders), statistics=statistics, obstacles=obstacles)


def _chosen(
    broken: BoolArray, margins: FloatArray, present: BoolArray, number: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Which rows to add of those that are broken: vehicles, sides and knots.

    Args:
        broken: which rows are, shape (P, S, T).
        margins: of all rows, the same shape.
        present: which rows are in their programs already.
        number: of the round.
    """
    which, sides, knots = np.nonzero(broken)
    if number > _PATIENCE:
        reach = 2 ** (number - _PATIENCE) // 2
        near = maximum_filter1d(broken, 2 * reach + 1, axis=2, mode="constant")
        which, sides, knots = np.nonzero(near & ~present)
        return which, sides, knots
    if len(knots) <= 1:
        return which, sides, knots
    begins = np.ones(len(knots), dtype=bool)  # of stretches of neighbouring knots
    begins[1:] = (np.diff(knots) != 1) | (np.diff(sides) != 0) | (np.diff(which) != 0)
    first = np.flatnonzero(begins)
    length = np.diff(np.append(first, len(knots)))
    place = np.arange(len(knots)) - np.repeat(first, length)
    pieces = _PIECES * 2**number
    piece = np.repeat(np.arange(len(first)) * pieces, length)
    piece += place * pieces // np.maximum(np.repeat(length, length), pieces)
    order = np.lexsort((margins[which, sides, knots], piece))
    worst = order[np.append(True, np.diff(piece[order]) != 0)]
    return which[worst], sides[worst], knots[worst]


def _check_fits(reference: Plan, scenario: Scenario) -> None:
    theirs, ours = (
        (len(asked.vehicles), asked.grid.knots, asked.grid.step)
        for asked in (reference.scenario, scenario)
    )
    if theirs != ours:
        words = "{} vehicles on {} knots, {:g} s apart"
        got, expected = words.format(*theirs), words.format(*ours)
        raise ValueError(f"reference: got {got}, expected {expected}")
