"""The one planning loop: solve, look for broken constraints, add their rows, solve again.

A program begins with its cost, its goal and its acceleration box. Everything else enters as a row
when a solution breaks it. When nothing is broken the answer is that of the full program, because
every row left out holds.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import numpy as np
from pydrake.solvers import SolverInterface

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.plan import Plan, Statistics
from drake_rho.planning.conflict import conflict
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.halfspaces import HalfSpaces, constraints_of
from drake_rho.planning.program import VehicleProgram, add_halfspaces
from drake_rho.planning.solve import Solution, solve
from drake_rho.scenario.records import Scenario

MAX_ROUNDS = 200
"""Far more than any scenario is known to need; every round adds rows, so the loop ends anyway."""

_BROKEN = 0.1
"""Part of the verifier's slack beyond which a row counts as broken and is added."""


@dataclasses.dataclass
class _Task:
    """One vehicle's program on its way to a solution."""

    program: VehicleProgram
    constraints: list[HalfSpaces]
    absent: list[np.ndarray]  # which rows of each constraint are not in the program yet
    motion: Motion  # the latest solution; before the first, coasting


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
    if reference is not None:
        _check_fits(reference, scenario)
    began = time.perf_counter()
    tasks = [_task(scenario, index, reference) for index in range(len(scenario.vehicles))]
    solutions: list[Solution] = []
    pending = tasks
    for _ in range(MAX_ROUNDS):
        solutions += solve_round(pending, solver)
        pending = [task for task in pending if add_broken(task)]
        if not pending:
            break
    else:
        raise SolverError(f"rows were still broken after {MAX_ROUNDS} rounds")
    statistics = Statistics(
        programs=len(solutions),
        rows=sum(len(rows.halfspaces.times) for task in tasks for rows in task.program.rows),
        linearisations=0 if reference is None else 1,
        solver=solutions[-1].solver,
        solver_seconds=sum(solution.seconds for solution in solutions),
        seconds=time.perf_counter() - began,
    )
    accelerations = np.array([task.motion.accelerations for task in tasks])
    return Plan.from_accelerations(scenario, accelerations, statistics)


def _check_fits(reference: Plan, scenario: Scenario) -> None:
    theirs, ours = (
        (len(asked.vehicles), asked.grid.knots, asked.grid.step)
        for asked in (reference.scenario, scenario)
    )
    if theirs != ours:
        words = "{} vehicles on {} knots, {:g} s apart"
        got, expected = words.format(*theirs), words.format(*ours)
        raise ValueError(f"reference: got {got}, expected {expected}")


def _task(scenario: Scenario, index: int, reference: Plan | None) -> _Task:
    vehicle = scenario.vehicles[index]
    around = None if reference is None else reference.positions[index]
    constraints = constraints_of(scenario, vehicle, around)
    absent = [np.ones(len(rows.times), dtype=bool) for rows in constraints]
    program = VehicleProgram(scenario, vehicle)
    return _Task(program, constraints, absent, program.coasting)


def solve_round(tasks: Sequence[_Task], solver: SolverInterface | None) -> list[Solution]:
    """Solve the programs as they stand and put the motions found into the tasks.

    Raises:
        InfeasibleError: at least one of the programs has no solution.
        SolverError: the solvers fail numerically.
    """
    solutions = solve([task.program.program for task in tasks], solver)
    conflicts = {}
    for task, solution in zip(tasks, solutions, strict=True):
        if solution.feasible:
            task.motion = task.program.motion(solution.result)
        else:
            conflicts[task.program.vehicle.name] = conflict(task.program)
    if conflicts:
        raise InfeasibleError(conflicts)
    return solutions


def add_broken(task: _Task) -> bool:
    """Add the rows that the task's motion breaks; False if it breaks none."""
    found = False
    for rows, absent in zip(task.constraints, task.absent, strict=True):
        broken = absent & (rows.margins(task.motion) < -_BROKEN * rows.slack)
        if np.any(broken):
            add_halfspaces(task.program, rows.select(broken))
            absent &= ~broken
            found = True
    return found
