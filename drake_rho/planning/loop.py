"""The one planning loop: solve, look for broken constraints, add their rows, solve again.

It begins with the motion of least index that reaches the goal, which is known in closed form.
Everything else enters as a row when a motion breaks it. When nothing is broken the answer is that
of the full program, because every row left out holds.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from pydrake.solvers import SolverInterface
from scipy.ndimage import maximum_filter1d

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.conflict import conflict
from drake_rho.planning.constraints import WORST, Constraint, boxes_of, tangents_of
from drake_rho.planning.errors import Conflicts, InfeasibleError, Names, SolverError
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.program import Frame, VehicleProgram, programs_of
from drake_rho.planning.solve import Solution, solve
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario

MAX_ROUNDS = 50
"""Bound on the rounds. Every round adds rows, and after the first few a growing neighbourhood of
them, so that all of a constraint's rows are in long before."""

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
    search = Search(scenario, constraints)
    statistics = search.run(solver)
    return Plan.from_accelerations(scenario, search.accelerations, statistics)


class Search:
    """The programs of all vehicles on their way to a solution, and in the end with it.

    Attributes:
        scenario: what is asked.
        frame: what the programs are written in.
        accelerations: of the latest solutions [m/s²], shape (N, K-1, 3).
        rows: the rows in the programs, for each constraint that has some.
        solved: for each vehicle with rows, its latest program and the solver's answer.
    """

    def __init__(self, scenario: Scenario, constraints: Sequence[Constraint]) -> None:
        self.scenario = scenario
        self.frame = Frame(scenario)
        self.accelerations = np.array(self.frame.free.accelerations)
        self.rows: dict[str, HalfSpaces] = {}
        self.solved: dict[int, tuple[VehicleProgram, Solution]] = {}
        self._constraints = constraints
        self._present: dict[str, BoolArray] = {}

    def run(self, solver: SolverInterface | None = None) -> Statistics:
        """Go on until nothing is broken.

        Raises:
            InfeasibleError: the program of a vehicle has no solution.
            SolverError: the solvers fail numerically.
        """
        began = time.perf_counter()
        solutions: list[Solution] = []
        pending = np.flatnonzero(~self.frame.hopeless)
        stuck: list[int] = []
        for number in range(MAX_ROUNDS):
            pending = self._add_broken(pending, number)
            if len(pending) == 0:
                break
            latest = self._solve(pending, solver)
            solutions += latest
            infeasible = [
                int(vehicle)
                for vehicle, solution in zip(pending, latest, strict=True)
                if not solution.feasible
            ]
            stuck += infeasible
            pending = np.setdiff1d(pending, infeasible) if infeasible else pending
        else:
            raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")
        statistics = self._statistics(solutions, began)
        if stuck or np.any(self.frame.hopeless):
            raise self._infeasible(stuck, statistics)
        return statistics

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers y >= 0, constraint by constraint.

        For rows of length one and the index in units squared, as the program is written.
        """
        if vehicle not in self.solved:
            return []
        program, solution = self.solved[vehicle]
        rows = self.rows_of(vehicle)
        y = np.maximum(solution.result.GetDualSolution(program.rows), 0.0)
        return list(zip(rows, np.split(y, np.cumsum(list(map(len, rows)))[:-1]), strict=True))

    def rows_of(self, vehicle: int) -> list[HalfSpaces]:
        """The rows in a vehicle's program, constraint by constraint, in the program's order."""
        return [rows.of(vehicle) for rows in self.rows.values()]

    def motion(self, vehicles: IntArray) -> Motion:
        """The latest motions of some vehicles."""
        start = self.frame.free.of(vehicles)
        return start.with_accelerations(self.accelerations[vehicles])

    def _solve(self, vehicles: IntArray, solver: SolverInterface | None) -> list[Solution]:
        """Solve the programs of `vehicles`, all of which have rows."""
        if len(vehicles) == len(self.accelerations):
            rows = list(self.rows.values())
        else:
            wanted = np.zeros(len(self.accelerations), dtype=bool)
            wanted[vehicles] = True
            rows = [rows.select(wanted[rows.vehicles]) for rows in self.rows.values()]
        programs = programs_of(self.frame, rows)
        solutions = solve([each.program for each in programs], solver)
        units, free = self.frame.units, self.frame.free.accelerations
        for program, solution in zip(programs, solutions, strict=True):
            self.solved[program.vehicle] = program, solution
            if solution.feasible:
                u = program.solution(solution.result.get_x_val())
                vehicle = program.vehicle
                self.accelerations[vehicle] = free[vehicle] + units[vehicle] * u
        self.accelerations[vehicles] = self.frame.reaching_goals(
            self.accelerations[vehicles], vehicles
        )
        return solutions

    def _add_broken(self, vehicles: IntArray, number: int) -> IntArray:
        """Add the rows that the motions of `vehicles` break, and say whose were broken.

        The instants between knots are looked at where nothing is broken at the knots.

        Raises:
            SolverError: a row that is in a program does not hold.
        """
        motion = self.motion(vehicles)
        broken = np.zeros(len(self.accelerations), dtype=bool)
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
            shape = (len(self.accelerations), *margins.shape[1:])
            self._present[name] = np.zeros(shape, dtype=bool)
        present = self._present[name][vehicles]
        if np.any(present & (margins < -1.0)):
            first = int(np.argwhere(present & (margins < -1.0))[0, 0])
            vehicle = self.scenario.vehicles[vehicles[first]].name
            raise SolverError(f"the solver does not keep the {name} of {vehicle}")
        mask &= ~present
        which, sides, knots = _chosen(mask, margins, present, number)
        if len(which) == 0:
            return
        whose = vehicles[which]
        self._present[name][whose, sides, knots] = True
        self._add(constraint.rows(whose, sides, constraint.times[knots]))
        broken[whose] = True

    def _add(self, rows: HalfSpaces) -> None:
        known = self.rows.get(rows.name)
        self.rows[rows.name] = rows if known is None else HalfSpaces.joined([known, rows])

    def _statistics(self, solutions: Sequence[Solution], began: float) -> Statistics:
        return Statistics(
            programs=len(solutions),
            rows=sum(map(len, self.rows.values())),
            solver=solutions[-1].solver if solutions else "",
            solver_seconds=sum(solution.seconds for solution in solutions),
            seconds=time.perf_counter() - began,
        )

    def _infeasible(self, stuck: Sequence[int], statistics: Statistics) -> InfeasibleError:
        """The error for vehicles without a solution, and those whose goal alone is out of reach."""
        vehicles = self.scenario.vehicles
        finders: dict[str, Callable[[], Names]] = {}
        obstacles = {}
        for index in np.flatnonzero(self.frame.hopeless).tolist():
            reason = ("goal position", "goal velocity", "a single step")
            finders[vehicles[index].name] = partial(tuple, reason)
        for index in stuck:
            name = vehicles[index].name
            rows = self.rows_of(index)
            finders[name] = partial(conflict, self.frame, index, self._constraints, rows)
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
