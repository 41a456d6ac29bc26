"""The only call of a solver, and the one place that judges what it says."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from pydrake.solvers import (
    ClarabelSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    OsqpSolver,
    SolutionResult,
    SolveInParallel,
    SolverInterface,
    SolverOptions,
)

from drake_rho.planning.errors import SolverError

_OPTIONS: dict[str, dict[str, float | int]] = {
    # One to two digits tighter than Drake's defaults, so that a row kept by the solver is kept
    # by the verifier too.
    "Clarabel": {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10},
    # At its default tolerances OSQP reports success with an index that is wrong in the fourth
    # digit; at these it agrees with Clarabel to 1e-6.
    "OSQP": {
        "eps_abs": 1e-9,
        "eps_rel": 1e-9,
        "eps_prim_inf": 1e-9,
        "eps_dual_inf": 1e-9,
        "max_iter": 200_000,
        "polishing": 1,
        "polish_refine_iter": 10,
    },
}

_INFEASIBLE = {SolutionResult.kInfeasibleConstraints, SolutionResult.kInfeasibleOrUnbounded}


@dataclasses.dataclass(frozen=True)
class Solution:
    """What a solver says of one program."""

    result: MathematicalProgramResult
    """Drake's own result; its numbers mean nothing unless `feasible`"""
    feasible: bool
    """whether there is a solution; if not, the solver has proved that there is none"""
    solver: str
    """which solver said so"""
    seconds: float
    """time the solver reports for itself [s]"""


def solve(
    programs: Sequence[MathematicalProgram], solver: SolverInterface | None = None
) -> list[Solution]:
    """Solve independent programs side by side, on all cores.

    A program on which the solver fails numerically is given to another one: OSQP after Clarabel,
    Clarabel after any other.

    Args:
        programs: convex quadratic programs.
        solver: a Drake solver; Clarabel if not given.

    Raises:
        SolverError: neither solver found a solution or a proof that there is none.
        ValueError: the solver is not available.
    """
    first = solver or ClarabelSolver()
    if not (first.available() and first.enabled()):
        raise ValueError(f"solver: got {_name(first)}, expected one available and enabled here")
    solutions = _solve_with(first, programs)
    failed = [index for index, solution in enumerate(solutions) if solution is None]
    if failed:
        second = OsqpSolver() if _name(first) == "Clarabel" else ClarabelSolver()
        again = _solve_with(second, [programs[index] for index in failed])
        for index, solution in zip(failed, again, strict=True):
            solutions[index] = solution
        if None in again:
            raise SolverError(
                f"{_name(first)} and then {_name(second)} failed numerically on "
                f"{again.count(None)} of {len(programs)} programs"
            )
    return [solution for solution in solutions if solution is not None]


def _solve_with(
    solver: SolverInterface, programs: Sequence[MathematicalProgram]
) -> list[Solution | None]:
    options = SolverOptions()
    for key, value in _OPTIONS.get(_name(solver), {}).items():
        options.SetOption(solver.solver_id(), key, value)
    results = SolveInParallel(
        progs=list(programs), solver_options=options, solver_id=solver.solver_id()
    )
    return [_judge(_name(solver), result) for result in results]


def _judge(name: str, result: MathematicalProgramResult) -> Solution | None:
    """The solution, or None if the solver failed."""
    feasible = bool(result.is_success())
    if not feasible and result.get_solution_result() not in _INFEASIBLE:
        return None
    details = result.get_solver_details()
    if getattr(details, "status", "") == "AlmostSolved":  # Clarabel, far from its tolerances
        return None
    seconds = 0.0
    for field in ("solve_time", "run_time"):  # Clarabel's and OSQP's names for it
        seconds = float(getattr(details, field, seconds))
    return Solution(result, feasible, name, seconds)


def _name(solver: SolverInterface) -> str:
    return str(solver.solver_id().name())
