"""The programs of a scenario, kept while constraints are added, and the plans they give."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.conflict import conflict
from drake_rho.planning.constraints import Constraint, boxes_of, tangents_of
from drake_rho.planning.errors import Conflicts, InfeasibleError, Names
from drake_rho.planning.frame import Frame
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.planning.search import Search
from drake_rho.planning.threads import one_for_arrays
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario

BLOCK = 500
"""Vehicles whose rows are looked for together: enough to make the arithmetic worth its calls, few
enough for a processor's cache, and for all processors to have something to do."""


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
    programs = Programs(scenario)
    programs.keep_to(constraints_around(scenario, reference), solver)
    return programs.plan(reference)


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
    programs = Programs(scenario)
    programs.keep_to(constraints, solver)
    return programs.plan()


class Programs:
    """The programs of all vehicles of a scenario: solved, kept, and solved with more constraints.

    Where nothing couples the vehicles, blocks of them are worked on side by side.

    Args:
        scenario: what is asked.
        together: whether rows may couple any two of the vehicles.
        kept: vehicles that fly given accelerations and are not planned, a mask of shape (N,) and
            accelerations of all [m/s²], shape (N, K-1, 3).

    Attributes:
        frame: what the programs are written in.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        together: bool = False,
        kept: tuple[BoolArray, FloatArray] | None = None,
    ) -> None:
        self.frame = Frame(scenario)
        self._scenario = scenario
        every = np.arange(len(scenario.vehicles))
        self._size = len(every) if together else BLOCK
        blocks = [every[first : first + self._size] for first in range(0, len(every), self._size)]
        self._searches = [Search(scenario, self.frame, block) for block in blocks]
        if kept is not None:
            for search in self._searches:
                search.keep(*kept)
        self._seconds = 0.0

    def keep_to(
        self, constraints: Sequence[Constraint], solver: SolverInterface | None = None
    ) -> None:
        """Solve until the solutions keep to all of `constraints`, which include earlier ones.

        Raises:
            InfeasibleError: the program of a vehicle has no solution.
            SolverError: the solvers fail numerically.
        """
        began = time.perf_counter()
        with one_for_arrays():
            if len(self._searches) == 1:
                self._searches[0].run(constraints, solver)
            else:
                with ThreadPoolExecutor(os.cpu_count()) as pool:
                    list(pool.map(lambda search: search.run(constraints, solver), self._searches))
        self._seconds += time.perf_counter() - began
        if any(search.infeasible for search in self._searches):
            raise self._infeasible(constraints)

    @property
    def accelerations(self) -> FloatArray:
        """The solutions [m/s²], shape (N, K-1, 3)."""
        return np.concatenate([search.accelerations for search in self._searches])

    @property
    def motion(self) -> Motion:
        """The motions that the solutions are."""
        return self.frame.free.with_accelerations(self.accelerations)

    @property
    def statistics(self) -> Statistics:
        """What it took."""
        total = self._searches[0].statistics
        for search in self._searches[1:]:
            total += search.statistics
        return dataclasses.replace(total, seconds=self._seconds)

    @property
    def rows(self) -> list[HalfSpaces]:
        """The rows in the programs."""
        return [part for search in self._searches for part in search.rows.values()]

    def plan(self, reference: Plan | None = None) -> Plan:
        """The solutions as a plan, found with constraints linearised around `reference`."""
        statistics = self.statistics
        if reference is not None:
            statistics = dataclasses.replace(statistics, linearisations=1)
        plan = Plan.from_accelerations(self._scenario, self.accelerations, statistics)
        return plan if reference is None else plan.found_around(reference)

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers, constraint by constraint."""
        return self._searches[vehicle // self._size].multipliers(vehicle)

    def group(self, vehicle: int) -> IntArray:
        """The vehicles that share a vehicle's program, itself among them."""
        return self._searches[vehicle // self._size].group(vehicle)

    def _infeasible(self, constraints: Sequence[Constraint]) -> InfeasibleError:
        """The error for vehicles without a solution, or whose goal alone is out of reach."""
        finders: dict[str, Callable[[], Names]] = {}
        obstacles = {}
        failed = [(search, index) for search in self._searches for index in search.infeasible]
        for search, index in failed:
            name = self._scenario.vehicles[index].name
            if self.frame.hopeless[index]:
                finders[name] = partial(tuple, ("goal position", "goal velocity", "a single step"))
                continue
            rows = search.rows_of(index)
            finders[name] = partial(conflict, self.frame, index, constraints, rows)
            touched = (part.name for part in rows if len(part) > 0)
            obstacles[name] = frozenset(each for each in touched if not each.endswith("box"))
        return InfeasibleError(Conflicts(finders), statistics=self.statistics, obstacles=obstacles)


def _check_fits(reference: Plan, scenario: Scenario) -> None:
    theirs, ours = (
        (len(asked.vehicles), asked.grid.knots, asked.grid.step)
        for asked in (reference.scenario, scenario)
    )
    if theirs != ours:
        words = "{} vehicles on {} knots, {:g} s apart"
        got, expected = words.format(*theirs), words.format(*ours)
        raise ValueError(f"reference: got {got}, expected {expected}")
