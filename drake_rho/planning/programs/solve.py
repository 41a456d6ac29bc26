"""The only call of a solver, and the one place that judges what it says."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextvars import copy_context
from functools import partial
from itertools import chain, islice

import numpy as np
from pydrake.common import Parallelism
from pydrake.solvers import (
    ClarabelSolver,
    ClpSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    OsqpSolver,
    SolutionResult,
    SolveInParallel,
    SolverOptions,
)

from drake_rho.planning.call.time_limit import check_time, seconds_left
from drake_rho.planning.errors import SolverError
from drake_rho.planning.programs import dense_duals
from drake_rho.planning.programs.backend import Backend, Solver, name_of
from drake_rho.planning.programs.daqp import Daqp
from drake_rho.planning.programs.dense import DenseProgram, Program
from drake_rho.planning.programs.solution import Solution
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.threads import thread_pool


def _is_told(record: logging.LogRecord) -> bool:
    """Return whether a line of Drake's log is for users: not how a solver ended."""
    return not record.getMessage().startswith("Clarabel returns")


logging.getLogger("drake").addFilter(_is_told)

_Options = dict[str, float | int]

_CLARABEL: _Options = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
"""One to two digits tighter than Drake's defaults, so that a row kept by the solver is kept by the
verifier too."""

_CLARABEL_QUICK: _Options = {**_CLARABEL, "iterative_refinement_enable": 0}
"""To the same tolerances, in two thirds of the time: the linear systems of its iterations, solved
to fewer digits, lead to the same solution as long as rows are well scaled."""

_CLARABEL_AGAIN: _Options = {}
"""Drake's defaults, 1e-8: for programs of many thousand variables, where rounding ends earlier."""

_OSQP: _Options = {
    # At its default tolerances OSQP reports success with a cost that is wrong in the fourth
    # digit; at these it agrees with Clarabel to 1e-6.
    "eps_abs": 1e-9,
    "eps_rel": 1e-9,
    "eps_prim_inf": 1e-9,
    "eps_dual_inf": 1e-9,
    "max_iter": 20_000,
    "polishing": 1,
    "polish_refine_iter": 10,
}

_LEAST_TIME = 1e-3
"""Time that a solver has at least [s]."""

_CHUNK = 40_000
"""Squared variables of the programs that a thread is given at once, some ten milliseconds: less
work than that is done where it is asked for, since to wake another core takes time too."""

MAX_RETRIES = 1
"""How often programs are solved again whose solutions do not keep their rows."""

_INFEASIBLE = {SolutionResult.kInfeasibleConstraints, SolutionResult.kInfeasibleOrUnbounded}


def solve(programs: Sequence[Program], backend: Backend | None = None) -> list[Solution]:
    """Solve independent programs, here and one after the other.

    A program on which the solver fails numerically is given to others: Clarabel with tight and
    then with its usual tolerances, and OSQP or, for one that is linear and thus none for OSQP, CLP.
    Where all fail, the first solution that is almost one is given, if there is any.

    Args:
        programs: convex quadratic programs, or linear ones.
        backend: its executor is left alone; Clarabel to full accuracy if not given.

    Raises:
        SolverError: no solver found a solution, almost one, or a proof that there is none.
    """
    backend = backend or Backend()
    solutions: dict[int, Solution] = {}
    almost: dict[int, Solution] = {}
    attempts: Iterable[tuple[Solver, _Options]] = _attempts(backend)
    if backend.others_first:
        own = name_of(backend.first)
        attempts = sorted(attempts, key=lambda attempt: name_of(attempt[0]) == own)
    for attempt, options in attempts:
        if len(solutions) == len(programs):
            break
        check_time()
        left = [
            index
            for index, program in enumerate(programs)
            if index not in solutions and _knows(attempt, program)
        ]
        if not left:
            continue
        answers = _solve_with(attempt, options, [programs[index] for index in left])
        for index, answer in zip(left, answers, strict=True):
            if answer is not None:
                kept = solutions if answer.exact else almost
                kept.setdefault(index, answer)
    solutions = almost | solutions
    failed = len(programs) - len(solutions)
    if failed:
        check_time()  # which may be why
        raise SolverError(f"all solvers failed numerically on {failed} of {len(programs)} programs")
    return [solutions[index] for index in range(len(programs))]


def solve_side_by_side(
    batches: Iterable[Sequence[Program]], backend: Backend | None = None
) -> list[list[Solution]]:
    """Solve batches of programs on all cores, the first while the next are still being written.

    The solvers themselves use one thread each.

    Args:
        batches: programs, made when they are asked for.
        backend: as for `solve`, which also says what is raised.

    Returns:
        The solutions, batch by batch.
    """
    backend = backend or Backend()
    dense, task = backend.is_dense, partial(solve, backend=backend)
    sizes, tasks, chunk, work = list[int](), list[Future[list[Solution]]](), [], 0
    for programs in batches:
        sizes.append(len(programs))
        for program in programs:
            chunk.append(program)
            work += _work(program, dense)
            if work > _CHUNK:
                tasks.append(thread_pool().submit(copy_context().run, task, chunk))
                chunk, work = [], 0
    rest = task(chunk) if chunk else []
    every = chain(*(each.result() for each in tasks), rest)
    return [list(islice(every, size)) for size in sizes]


def _attempts(backend: Backend) -> Iterator[tuple[Solver, _Options]]:
    """Yield solvers and their options in the order in which they are asked: mostly one."""
    name = name_of(first := backend.first)
    if name != "Clarabel":
        yield first, _OSQP if name == "OSQP" else {}
    if backend.accuracy == "quick":
        yield ClarabelSolver(), _CLARABEL_QUICK
    if backend.accuracy != "rough":
        yield ClarabelSolver(), _CLARABEL
    yield ClarabelSolver(), _CLARABEL_AGAIN
    if name in ("Clarabel", "DAQP"):
        yield OsqpSolver(), _OSQP
        yield ClpSolver(), {}


def _knows(solver: Solver, program: Program) -> bool:
    """Return whether the solver takes such a program: OSQP no linear ones, CLP no others.

    DAQP takes dense quadratic programs only; cones are for Clarabel alone.
    """
    dense = isinstance(program, DenseProgram)
    if not dense and program.lorentz_cone_constraints():
        return name_of(solver) == "Clarabel"
    linear = program.linear if dense else not program.quadratic_costs()
    if isinstance(solver, Daqp):
        return dense and not linear
    return {"OSQP": not linear, "Clp": linear}.get(name_of(solver), True)


def _work(program: Program, dense: bool) -> int:
    """Return the squared number of variables, or what takes a dense solver as long."""
    if not isinstance(program, DenseProgram):
        return int(program.num_vars()) ** 2
    if dense:
        return int(program.matrix.size) // 4
    return int(program.matrix.shape[1] + len(program.needed) * program.soft) ** 2


def _solve_with(
    solver: Solver, values: _Options, programs: Sequence[Program]
) -> list[Solution | None]:
    if isinstance(solver, Daqp):
        return [dense_duals.solved(each) for each in programs if isinstance(each, DenseProgram)]
    options = SolverOptions()
    for key, value in values.items():
        options.SetOption(solver.solver_id(), key, value)
    if name_of(solver) == "Clarabel" and (left := seconds_left()) < np.inf:
        options.SetOption(solver.solver_id(), "time_limit", max(left, _LEAST_TIME))
    written = [each.written if isinstance(each, DenseProgram) else each for each in programs]
    results = SolveInParallel(
        progs=written,
        solver_options=options,
        solver_id=solver.solver_id(),
        parallelism=Parallelism(1),
    )
    name = name_of(solver)
    return [_judge(name, *each) for each in zip(written, results, strict=True)]


def _judge(
    name: str, program: MathematicalProgram, result: MathematicalProgramResult
) -> Solution | None:
    """Return the solution, or None if the solver failed."""
    feasible = bool(result.is_success())
    if not feasible and result.get_solution_result() not in _INFEASIBLE:
        return None
    details = result.get_solver_details()
    exact = getattr(details, "status", "") != "AlmostSolved"  # Clarabel, far from its tolerances
    seconds = 0.0
    for field in ("solve_time", "run_time"):  # Clarabel's and OSQP's names for it
        seconds = float(getattr(details, field, seconds))
    multipliers = partial(_multipliers, program, result)
    return Solution(result.get_x_val(), feasible, name, seconds, multipliers, exact)


def _multipliers(program: MathematicalProgram, result: MathematicalProgramResult) -> FloatArray:
    rows = [*program.linear_constraints(), *program.lorentz_cone_constraints()]
    return np.concatenate([np.zeros(0), *(result.GetDualSolution(each) for each in rows)])
