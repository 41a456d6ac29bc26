"""The only call of a solver, and the one place that judges what it says."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextvars import copy_context
from functools import partial
from itertools import chain, islice
from typing import Literal, TypeAlias

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
    SolverInterface,
    SolverOptions,
)

from drake_rho.motion.threads import threads
from drake_rho.planning.errors import SolverError
from drake_rho.planning.programs import dense_duals
from drake_rho.planning.programs.daqp import Daqp
from drake_rho.planning.programs.dense import DenseProgram, Program
from drake_rho.planning.programs.solution import Solution
from drake_rho.planning.time_limit import check_time, seconds_left
from drake_rho.scenario.fields import FloatArray


def _is_told(record: logging.LogRecord) -> bool:
    """Whether a line of Drake's log is for users: not how a solver ended, which is judged here."""
    return not record.getMessage().startswith("Clarabel returns")


logging.getLogger("drake").addFilter(_is_told)

Solver: TypeAlias = SolverInterface | Daqp
"""What a planner takes as `solver=`."""

SolverName = Literal["clarabel", "daqp", "osqp"]
"""Solvers that a word stands for."""

SOLVERS: dict[str, Callable[[], Solver]] = {
    "clarabel": ClarabelSolver,
    "daqp": Daqp,
    "osqp": OsqpSolver,
}
"""What each word stands for."""

DEFAULT: Callable[[], Solver] = ClarabelSolver
"""What solves where nothing is asked."""

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


def solver_of(solver: Solver | SolverName | None) -> Solver | None:
    """Return the solver that a user asks for, by itself or by a word; None is left as it is.

    Planners ask at once: where nothing is in the way they may not come to a program.

    Raises:
        NotInstalledError: it is DAQP, whose package is not there.
        ValueError: it is not available here, or not for quadratic programs.
    """
    if solver is None:
        return None
    made = SOLVERS[solver]() if isinstance(solver, str) else solver
    if not (made.available() and made.enabled()):
        raise ValueError(f"solver: got {_name(made)}, expected one available and enabled here")
    known = type(made) in SOLVERS.values()
    if not (known or isinstance(made, Daqp) or _is_for_quadratic_programs(made)):
        raise ValueError(f"solver: got {_name(made)}, expected one of quadratic programs")
    return made


def _is_for_quadratic_programs(solver: SolverInterface) -> bool:
    """Return whether a solver solves a small one; its name is all that Drake tells beside that."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(2)
    program.AddQuadraticCost(np.eye(2), np.zeros(2), x, is_convex=True)
    program.AddLinearConstraint(np.ones((1, 2)), np.ones(1), np.full(1, np.inf), x)
    try:
        return bool(solver.Solve(program, None, None).is_success())
    except (RuntimeError, ValueError):  # it is for programs of other kinds
        return False


def solve(
    programs: Sequence[Program],
    solver: Solver | None = None,
    *,
    retry: int = 0,
    quick: bool = False,
    rough: bool = False,
) -> list[Solution]:
    """Solve independent programs, here and one after the other.

    A program on which the solver fails numerically is given to others: Clarabel with tight and
    then with its usual tolerances, and OSQP or, for one that is linear and thus none for OSQP, CLP.
    Where all fail, the first solution that is almost one is given, if there is any.

    Args:
        programs: convex quadratic programs, or linear ones.
        solver: a Drake solver or `Daqp()`; Clarabel if not given.
        retry: how often these were solved and their solutions did not keep their rows; then
            others are asked before `solver`.
        quick: whether to try Clarabel without refining its linear systems first.
        rough: whether Clarabel's usual tolerances are enough.

    Raises:
        SolverError: no solver found a solution, almost one, or a proof that there is none.
    """
    first = solver or DEFAULT()
    solutions: dict[int, Solution] = {}
    almost: dict[int, Solution] = {}
    attempts: Iterable[tuple[Solver, _Options]] = _attempts(first, quick=quick, rough=rough)
    if retry > 0:  # others first: this one's solutions do not keep their rows
        attempts = sorted(attempts, key=lambda attempt: _name(attempt[0]) == _name(first))
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
    batches: Iterable[Sequence[Program]],
    solver: Solver | None = None,
    *,
    retry: int = 0,
    quick: bool = False,
) -> list[list[Solution]]:
    """Solve batches of programs on all cores, the first while the next are still being written.

    The solvers themselves use one thread each.

    Args:
        batches: programs, made when they are asked for.
        solver: as for `solve`, which also says what is raised.
        retry: as for `solve`.
        quick: as for `solve`.

    Returns:
        The solutions, batch by batch.
    """
    dense = is_dense(solver)
    task = partial(solve, solver=solver, retry=retry, quick=quick)
    sizes, tasks, chunk, work = list[int](), list[Future[list[Solution]]](), [], 0
    for programs in batches:
        sizes.append(len(programs))
        for program in programs:
            chunk.append(program)
            work += _work(program, dense)
            if work > _CHUNK:
                tasks.append(threads().submit(copy_context().run, task, chunk))
                chunk, work = [], 0
    rest = task(chunk) if chunk else []
    every = chain(*(each.result() for each in tasks), rest)
    return [list(islice(every, size)) for size in sizes]


def is_dense(solver: Solver | None) -> bool:
    """Whether a solver is for small dense programs, which are written for it in another way."""
    return isinstance(solver or DEFAULT(), Daqp)


def _attempts(first: Solver, *, quick: bool, rough: bool) -> Iterator[tuple[Solver, _Options]]:
    """Who is asked, one after the other: mostly nobody but the first."""
    name = _name(first)
    if name != "Clarabel":
        yield first, _OSQP if name == "OSQP" else {}
    if quick:
        yield ClarabelSolver(), _CLARABEL_QUICK
    if not rough:
        yield ClarabelSolver(), _CLARABEL
    yield ClarabelSolver(), _CLARABEL_AGAIN
    if name in ("Clarabel", "DAQP"):
        yield OsqpSolver(), _OSQP
        yield ClpSolver(), {}


def _knows(solver: Solver, program: Program) -> bool:
    """Whether the solver takes a program of this kind: OSQP no linear ones, CLP no others.

    DAQP takes dense quadratic programs only; cones are for Clarabel alone.
    """
    dense = isinstance(program, DenseProgram)
    if not dense and program.lorentz_cone_constraints():
        return _name(solver) == "Clarabel"
    linear = program.linear if dense else not program.quadratic_costs()
    if isinstance(solver, Daqp):
        return dense and not linear
    return {"OSQP": not linear, "Clp": linear}.get(_name(solver), True)


def _work(program: Program, dense: bool) -> int:
    """The square of the number of variables, or what takes a solver of dense programs as long."""
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
    if _name(solver) == "Clarabel" and (left := seconds_left()) < np.inf:
        options.SetOption(solver.solver_id(), "time_limit", max(left, _LEAST_TIME))
    written = [each.written if isinstance(each, DenseProgram) else each for each in programs]
    results = SolveInParallel(
        progs=written,
        solver_options=options,
        solver_id=solver.solver_id(),
        parallelism=Parallelism(1),
    )
    name = _name(solver)
    return [_judge(name, *each) for each in zip(written, results, strict=True)]


def _judge(
    name: str, program: MathematicalProgram, result: MathematicalProgramResult
) -> Solution | None:
    """The solution, or None if the solver failed."""
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


def _name(solver: Solver) -> str:
    return str(solver.solver_id().name())
