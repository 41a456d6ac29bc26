"""Solution of programs, with other solvers after failures, and of many vehicles in blocks."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextvars import copy_context
from functools import partial
from itertools import chain, islice
from threading import Lock
from typing import Any

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
    SolverId,
    SolverOptions,
)

from drake_rho.planning.call.time_limit import check_time, seconds_left
from drake_rho.planning.constraints.rows import Rows, each_of, groups_of
from drake_rho.planning.errors import SolverError
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs import dual
from drake_rho.planning.programs.backend import Backend, Solver, name_of
from drake_rho.planning.programs.program import Answers, DenseProgram, Program, Solution
from drake_rho.planning.programs.reduced import Batch, programs_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.drake_log import keep_to_news
from drake_rho.system.threads import single_threaded_blas, thread_pool

keep_to_news()

_Options = Mapping[str, float | int | str]

_CLARABEL: _Options = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
"""One to two digits tighter than Drake's defaults, so that a row satisfied for the solver is
satisfied for the verifier too."""

_CLARABEL_QUICK: _Options = {**_CLARABEL, "iterative_refinement_enable": 0}
"""The same tolerances in two thirds of the time: linear systems are solved to fewer digits, which
leads to the same solution as long as rows are well scaled."""

_CLARABEL_AGAIN: _Options = {}
"""Drake's defaults, 1e-8, for programs with many thousand variables and larger rounding errors."""

_OSQP: _Options = {
    # At its default tolerances OSQP reports success with a cost that is wrong in the fourth
    # digit; at these tolerances it agrees with Clarabel to 1e-6.
    "eps_abs": 1e-9,
    "eps_rel": 1e-9,
    "eps_prim_inf": 1e-9,
    "eps_dual_inf": 1e-9,
    "max_iter": 20_000,
    "polishing": 1,
    "polish_refine_iter": 10,
}

_ACCEPTS_ALL = "Clarabel"
"""Name of the solver that accepts every program."""

_CHUNK = 40_000
"""Sum of squared numbers of variables of the programs that a thread solves at once, about ten
milliseconds of work. Less work is done in the calling thread, since starting another takes time."""

_FAR = 100.0
"""Norm of a solution, relative to the largest bound, that a proof of none has to exclude. Proofs of
programs without a solution exclude a thousand times the largest bound and more."""

_INFEASIBLE = {SolutionResult.kInfeasibleConstraints, SolutionResult.kInfeasibleOrUnbounded}


class _LeastSquares:
    """Non-negative least squares, in the form of Drake's solvers."""

    def solver_id(self) -> SolverId:
        """Return the name in the form of Drake's solvers."""
        return SolverId(dual.NAME)


def solve(programs: Sequence[Program], backend: Backend | None = None) -> list[Solution]:
    """Solve independent programs one after the other in this process.

    If the solver fails numerically on a program, others follow: Clarabel with tight and then with
    default tolerances, and OSQP or, for linear programs, CLP. If all fail, the first inexact
    solution is returned, if there is one.

    Args:
        programs: convex quadratic programs, or linear ones.
        backend: solver and accuracy, without its executor; Clarabel to full accuracy if not given.

    Raises:
        SolverError: no solver found a solution or a proof that there is none.
    """
    backend = backend or Backend()
    solutions: dict[int, Solution] = {}
    inexact: dict[int, Solution] = {}
    attempts: Iterable[tuple[Solver, _Options]] = _attempts(backend)
    if backend.options:
        attempts = _with_options(attempts, backend)
    if backend.others_first:
        own = name_of(backend.first)
        attempts = sorted(attempts, key=lambda attempt: name_of(attempt[0]) == own)
    for attempt, options in attempts:
        name = name_of(attempt)
        if len(solutions) == len(programs):
            break
        check_time()
        pending = [
            index
            for index, program in enumerate(programs)
            if index not in solutions and (name == _ACCEPTS_ALL or _accepts(name, program))
        ]
        if not pending:
            continue
        answers = _solve_with(attempt, name, options, [programs[index] for index in pending])
        for index, answer in zip(pending, answers, strict=True):
            if answer is not None:
                found = solutions if answer.exact else inexact
                found.setdefault(index, answer)
    solutions = inexact | solutions
    failed = len(programs) - len(solutions)
    if failed:
        check_time()  # the time limit may be the reason
        raise SolverError(f"all solvers failed numerically on {failed} of {len(programs)} programs")
    return [solutions[index] for index in range(len(programs))]


def solve_side_by_side(
    batches: Iterable[Sequence[Program]], backend: Backend | None = None
) -> list[list[Solution]]:
    """Solve batches of programs on all cores, the first while others are still being written.

    Each solver uses one thread. Errors are those of `solve`.

    Args:
        batches: the programs, written when the iterator yields them.
        backend: as for `solve`.

    Returns:
        The solutions, batch by batch.
    """
    backend = backend or Backend()
    dense, task = backend.is_dense, partial(solve, backend=backend)
    sizes, tasks, chunk, work = list[int](), list[Future[list[Solution]]](), [], 0
    for programs in batches:
        sizes.append(len(programs))
        size = _work(programs[0], dense) if programs else 0  # programs of a batch are as large
        for program in programs:
            chunk.append(program)
            work += size
            if work > _CHUNK:
                tasks.append(thread_pool().submit(copy_context().run, task, chunk))
                chunk, work = [], 0
    rest = task(chunk) if chunk else []
    every = chain(*(each.result() for each in tasks), rest)
    return [list(islice(every, size)) for size in sizes]


def _attempts(backend: Backend) -> Iterator[tuple[Solver | _LeastSquares, _Options]]:
    """Yield solvers and their options in order; usually the first one succeeds."""
    name = name_of(first := backend.first)
    if backend.reduced:
        yield _LeastSquares(), {}
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


def _with_options(
    attempts: Iterable[tuple[Solver, _Options]], backend: Backend
) -> Iterator[tuple[Solver, _Options]]:
    """Yield attempts of which those of the chosen solver have its options."""
    own = name_of(backend.first)
    for solver, options in attempts:
        yield solver, {**options, **backend.options} if name_of(solver) == own else options


def _accepts(name: str, program: Program) -> bool:
    """Return whether a solver other than Clarabel, which accepts all programs, accepts one.

    None accepts cones. OSQP accepts no linear programs, CLP no others. DAQP accepts dense quadratic
    programs only, least squares those of them without soft rows.
    """
    dense = isinstance(program, DenseProgram)
    if not dense and program.lorentz_cone_constraints():
        return False
    linear = program.linear if dense else not program.quadratic_costs()
    if name == dual.NAME:
        return dense and not linear and bool(np.isinf(program.penalties).all())
    return {"DAQP": dense and not linear, "OSQP": not linear, "Clp": linear}.get(name, True)


def _work(program: Program, dense: bool) -> int:
    """Return the work of a solution, in squared numbers of variables."""
    if not isinstance(program, DenseProgram):
        return int(program.num_vars()) ** 2
    if dense:
        return int(program.matrix.size) // 4
    return int(program.matrix.shape[1] + len(program.needed) * program.soft) ** 2


def _solve_with(
    solver: Solver, name: str, values: _Options, programs: Sequence[Program]
) -> list[Solution | None]:
    if name == dual.NAME:
        every = [each for each in programs if isinstance(each, DenseProgram)]
        return [dual.solved_by_least_squares(each) for each in every]
    if name == "DAQP":
        return [dual.solved_by_daqp(each) for each in programs if isinstance(each, DenseProgram)]
    options = SolverOptions()
    for key, value in values.items():
        options.SetOption(solver.solver_id(), key, value)
    if name == "Clarabel" and (remaining := seconds_left()) < np.inf:
        options.SetOption(solver.solver_id(), "time_limit", max(remaining, 1e-3))
    in_drake = [each.written if isinstance(each, DenseProgram) else each for each in programs]
    results = SolveInParallel(
        progs=in_drake,
        solver_options=options,
        solver_id=solver.solver_id(),
        parallelism=Parallelism(1),
    )
    return [_solution(name, *each) for each in zip(in_drake, results, strict=True)]


def _solution(
    name: str, program: MathematicalProgram, result: MathematicalProgramResult
) -> Solution | None:
    """Return a solver's result, or None if the solver failed."""
    feasible = bool(result.is_success())
    if not feasible and result.get_solution_result() not in _INFEASIBLE:
        return None
    details = result.get_solver_details()
    exact = getattr(details, "status", "") != "AlmostSolved"  # Clarabel's name for a low accuracy
    exact &= feasible or _is_refuted(program, result)
    seconds = 0.0
    for field in ("solve_time", "run_time"):  # names of Clarabel and of OSQP
        seconds = float(getattr(details, field, seconds))
    multipliers = partial(_multipliers, program, result)
    return Solution(result.get_x_val(), feasible, name, seconds, multipliers, exact)


def _is_refuted(program: MathematicalProgram, result: MathematicalProgramResult) -> bool:
    """Return whether a solver's weights prove that no solution is nearer than `_FAR`.

    With weights y of rows A x >= b, every solution x has norm(A' y) norm(x) >= y · b. Solvers
    accept weights for which A' y is small beside other numbers, and then there may be a solution.
    Weights of cones are not checked.
    """
    if program.lorentz_cone_constraints() or program.rotated_lorentz_cone_constraints():
        return True
    gradient, gain, size = np.zeros(program.num_vars()), 0.0, 1.0
    for each in [*program.linear_constraints(), *program.linear_equality_constraints()]:
        y, terms = _dual(result, each), each.evaluator()
        bounds = np.where(y > 0.0, terms.lower_bound(), terms.upper_bound())
        bounds = np.where(y == 0.0, 0.0, bounds)
        columns = program.FindDecisionVariableIndices(each.variables())
        np.add.at(gradient, columns, terms.get_sparse_A().T @ y)
        gain += float(bounds @ y)
        size = max(size, float(np.abs(bounds).max(initial=0.0)))
    return gain > _FAR * size * float(np.linalg.norm(gradient))


def _multipliers(program: MathematicalProgram, result: MathematicalProgramResult) -> FloatArray:
    rows = [*program.linear_constraints(), *program.lorentz_cone_constraints()]
    return np.concatenate([np.zeros(0), *(_dual(result, each) for each in rows)])


_CONVERSIONS = Lock()
"""Lock of conversions of arguments: pybind11 refuses one while another thread is making one."""


def _dual(result: MathematicalProgramResult, rows: Any) -> FloatArray:
    """Return the multipliers of one constraint."""
    with _CONVERSIONS:
        y: FloatArray = result.GetDualSolution(rows)
    return y


_BLOCK = 128
"""Number of vehicles in a block: tens of milliseconds of work. It does not depend on the number of
workers, so that plans are equal to the last digit."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Block:
    """Block of vehicles in a picklable form."""

    changes: Changes
    rows: Sequence[Rows]
    backend: Backend

    def batches(self) -> Iterator[Batch]:
        dense = self.backend.is_dense and not self.changes.free  # DAQP: no linear ones
        return programs_of(self.changes, self.rows, dense=dense)

    @single_threaded_blas
    def solved(self) -> list[Answers]:
        """Solve all programs of the block in sequence."""
        answers = list[Answers]()
        for batch in self.batches():
            found = solve(batch.programs, self.backend)
            answers.append(_answers(batch, found, self.changes.grid.knots - 1).sent())
        return answers


def solve_all(
    changes: Changes, rows: Sequence[Rows], backend: Backend | None = None
) -> list[Answers]:
    """Write and solve the programs of all vehicles that have rows.

    Answers do not depend on the process that computes them, to the last digit.

    Args:
        changes: the changes of minimum-effort motions that rows refer to.
        rows: the rows, constraint by constraint.
        backend: if not given, Clarabel in this process, to full accuracy.

    Raises:
        SolverError: the solvers fail numerically.
    """
    backend = backend or Backend()
    executor, here = backend.executor, backend.here()
    blocks = [_Block(changes, own, here) for own in _in_blocks(len(changes.units), rows)]
    if executor is not None and len(blocks) > 1:
        found = [executor.submit(_Block.solved, block) for block in blocks]
        return [answers for each in found for answers in each.result()]
    batches = list[Batch]()

    def written() -> Iterator[Sequence[Program]]:
        for batch in chain.from_iterable(map(_Block.batches, blocks)):
            batches.append(batch)
            yield batch.programs

    answers = solve_side_by_side(written(), here)
    steps = changes.grid.knots - 1
    return [_answers(*each, steps) for each in zip(batches, answers, strict=True)]


def _in_blocks(vehicles: int, rows: Sequence[Rows]) -> Iterator[Sequence[Rows]]:
    """Yield the rows of blocks of about `_BLOCK` vehicles; rows of a group are in one block."""
    has_rows = np.zeros(vehicles, dtype=bool)
    for part in rows:
        has_rows[part.vehicles] = True
    if has_rows.sum() <= _BLOCK:
        yield rows
        return
    groups = groups_of(vehicles, [part for part in rows if part.form.coupled])
    sizes = np.bincount(groups, has_rows)
    numbers = ((np.cumsum(sizes) - sizes) // _BLOCK).astype(int)[groups]
    for _, own in each_of(np.unique(numbers[has_rows]), numbers, rows):
        yield own


def _answers(batch: Batch, solutions: list[Solution], steps: int) -> Answers:
    return Answers(
        batch.groups,
        batch.accelerations(solutions, steps),
        np.array([solution.feasible for solution in solutions]),
        np.array([solution.exact for solution in solutions]),
        [solution.multipliers for solution in solutions],
        batch.lengths,
        solutions[-1].solver,
        sum([solution.seconds for solution in solutions]),
    )
