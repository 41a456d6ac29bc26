"""The one planning loop: solve, look for broken constraints, add their rows, solve again.

A program begins with its cost, its goal and its acceleration box. Everything else enters as a row
when a solution breaks it. When nothing is broken the answer is that of the full program, because
every row left out holds.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from pydrake.solvers import MathematicalProgramResult, SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.conflict import conflict
from drake_rho.planning.errors import Conflicts, InfeasibleError, Names, SolverError
from drake_rho.planning.halfspaces import (
    WORST,
    BoolArray,
    Constraints,
    HalfSpaces,
    Watch,
    boxes_of,
    linearise,
    obstacles_as,
)
from drake_rho.planning.program import VehicleProgram, add_halfspaces
from drake_rho.planning.solve import Solution, solve
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario, Sphere

MAX_ROUNDS = 50
"""Bound on the rounds. Every round adds rows, and after the first few a growing neighbourhood of
them, so that all of a constraint's rows are in long before."""

_PATIENCE = 3
"""Rounds in which only broken rows are added. Most scenarios need no more; where an active
stretch creeps along the knots, as jerk does, neighbours then come too, twice as many each round."""


@dataclasses.dataclass
class Task:
    """One vehicle's program on its way to a solution, and in the end with it."""

    program: VehicleProgram
    rows: list[HalfSpaces]  # at the knots, and what the watches have found
    watches: Sequence[Watch]
    absent: list[BoolArray]  # which rows of each constraint are not in the program yet
    motion: Motion  # the latest solution; before the first, coasting
    result: MathematicalProgramResult | None = None  # Drake's, of the latest solution


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


def constraints_around(scenario: Scenario, reference: Plan | None) -> list[Constraints]:
    """For each vehicle its boxes and the obstacles linearised (15) around `reference`.

    Raises:
        ValueError: the reference has other vehicles or another grid.
    """
    boxes = [boxes_of(scenario, vehicle) for vehicle in scenario.vehicles]
    if reference is None:
        return boxes
    _check_fits(reference, scenario)
    return [
        own + obstacles_as(scenario, partial(_around, motion))
        for own, motion in zip(boxes, reference.motions(), strict=True)
    ]


def _around(reference: Motion, index: int, sphere: Sphere, times: FloatArray) -> HalfSpaces:
    return linearise(f"obstacle {index + 1}", sphere, reference, times)


def plan_with(
    scenario: Scenario,
    constraints: Sequence[Constraints],
    solver: SolverInterface | None = None,
) -> Plan:
    """The plan of least index that meets linear constraints: the loop itself.

    Args:
        scenario: grid, vehicles and acceleration boxes; its obstacles are not looked at.
        constraints: for each vehicle, everything else it has to keep to.
        solver: a Drake solver; Clarabel if not given.

    Raises:
        InfeasibleError: the program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
    """
    tasks, statistics = solve_tasks(scenario, constraints, solver)
    accelerations = np.array([task.motion.accelerations for task in tasks])
    return Plan.from_accelerations(scenario, accelerations, statistics)


def solve_tasks(
    scenario: Scenario, constraints: Sequence[Constraints], solver: SolverInterface | None = None
) -> tuple[list[Task], Statistics]:
    """The loop of `plan_with`, which gives the solved programs rather than the plan.

    Raises:
        InfeasibleError: the program of a vehicle has no solution.
        SolverError: the solvers fail numerically.
    """
    began = time.perf_counter()
    tasks, hopeless = _tasks(scenario, constraints)
    stuck: list[Task] = []
    solutions: list[Solution] = []
    pending = tasks
    for number in range(MAX_ROUNDS):
        if not pending:
            break
        latest = solve([task.program.program for task in pending], solver)
        solutions += latest
        reach = 2 ** max(0, number - _PATIENCE) // 2
        unfinished = []
        for task, solution in zip(pending, latest, strict=True):
            if not solution.feasible:
                stuck.append(task)
                continue
            task.result = solution.result
            task.motion = task.program.motion(solution.result)
            if _add_broken(task, reach):
                unfinished.append(task)
        pending = unfinished
    else:
        raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")
    statistics = _statistics(tasks, solutions, began)
    if stuck or hopeless:
        raise _infeasible(stuck, hopeless, statistics)
    return tasks, statistics


def _infeasible(
    stuck: Sequence[Task], hopeless: Mapping[str, Names], statistics: Statistics
) -> InfeasibleError:
    """The error for vehicles without a solution, and those whose goal alone is out of reach."""
    finders: dict[str, Callable[[], Names]] = {
        name: partial(tuple, names) for name, names in hopeless.items()
    }
    obstacles = {}
    for task in stuck:
        name = task.program.vehicle.name
        present = [~absent for absent in task.absent]
        finders[name] = partial(conflict, task.program, task.rows, present)
        touched = (rows.name for _, rows in task.program.rows)
        obstacles[name] = frozenset(each for each in touched if each.startswith("obstacle"))
    return InfeasibleError(Conflicts(finders), statistics=statistics, obstacles=obstacles)


def _check_fits(reference: Plan, scenario: Scenario) -> None:
    theirs, ours = (
        (len(asked.vehicles), asked.grid.knots, asked.grid.step)
        for asked in (reference.scenario, scenario)
    )
    if theirs != ours:
        words = "{} vehicles on {} knots, {:g} s apart"
        got, expected = words.format(*theirs), words.format(*ours)
        raise ValueError(f"reference: got {got}, expected {expected}")


def _tasks(
    scenario: Scenario, constraints: Sequence[Constraints]
) -> tuple[list[Task], dict[str, Names]]:
    """A task for every vehicle, and the conflicts of those whose goal alone is out of reach."""
    tasks: list[Task] = []
    conflicts: dict[str, Names] = {}
    for vehicle, own in zip(scenario.vehicles, constraints, strict=True):
        absent = [np.ones(len(rows.times), dtype=bool) for rows in own.rows]
        try:
            program = VehicleProgram(scenario, vehicle)
        except InfeasibleError as error:
            conflicts |= error.conflicts
        else:
            tasks.append(Task(program, list(own.rows), own.watches, absent, program.coasting))
    return tasks, conflicts


def _statistics(tasks: Sequence[Task], solutions: Sequence[Solution], began: float) -> Statistics:
    return Statistics(
        programs=len(solutions),
        rows=sum(len(rows.times) for task in tasks for _, rows in task.program.rows),
        solver=solutions[-1].solver if solutions else "",
        solver_seconds=sum(solution.seconds for solution in solutions),
        seconds=time.perf_counter() - began,
    )


def _add_broken(task: Task, reach: int) -> bool:
    """Add the rows that the task's motion breaks; False if it breaks none.

    Args:
        task: with its latest motion.
        reach: neighbours in time of a broken row that are added with it.

    Raises:
        SolverError: a row that is in the program does not hold.
    """
    found = False
    for rows, absent in zip(task.rows, task.absent, strict=True):
        margins = rows.margins(task.motion)
        if np.any(~absent & (margins < -rows.tolerances)):
            name = task.program.vehicle.name
            raise SolverError(f"the solver does not keep the {rows.name} of {name}")
        broken = absent & (margins < -WORST * rows.tolerances)
        if np.any(broken):
            added = absent & rows.near(broken, reach)
            add_halfspaces(task.program, rows.select(added))
            absent &= ~added
            found = True
    if found:
        return True
    beside = [_add_worst_instants(task, watch) for watch in task.watches]  # now between the knots
    return any(beside)


def _add_worst_instants(task: Task, watch: Watch) -> bool:
    """Add the rows of the instants that a watch finds; False if there are none."""
    worst = watch(task.motion)
    if len(worst.times) == 0:
        return False
    add_halfspaces(task.program, worst)
    names = [rows.name for rows in task.rows]
    index = names.index(worst.name)
    task.rows[index] = task.rows[index].with_rows(worst)
    task.absent[index] = np.append(task.absent[index], np.zeros(len(worst.times), dtype=bool))
    return True
