"""Choice of solver, executor and accuracy for programs: `Backend`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    MathematicalProgram,
    OsqpSolver,
    SolverInterface,
    SolverOptions,
)

from drake_rho.planning.programs.daqp import Daqp

Solver: TypeAlias = SolverInterface | Daqp
"""Type of `solver=` in planners."""

SolverName = Literal["clarabel", "daqp", "osqp"]
"""Names of solvers that `solver=` accepts."""

SOLVERS: dict[str, Callable[[], Solver]] = {
    "clarabel": ClarabelSolver,
    "daqp": Daqp,
    "osqp": OsqpSolver,
}
"""Solver of each name."""

DEFAULT: Callable[[], Solver] = ClarabelSolver
"""Solver if none is given."""

Accuracy = Literal["full", "quick", "rough"]
"""Accuracy of a solution: full (1e-10, so that rows satisfied for the solver are satisfied for the
verifier), quick (the same, first without iterative refinement of linear systems), rough (1e-8)."""


@dataclasses.dataclass(frozen=True)
class Backend:
    """Solver of programs, executor on which they are solved, and their accuracy."""

    solver: Solver | None = None
    """a Drake solver or `Daqp()`; Clarabel if None"""
    executor: Executor | None = None
    """executor (PEP 3148) to which blocks of programs are sent; None for this process. DAQP can be
    sent to other processes, Drake's solvers cannot"""
    accuracy: Accuracy = "full"
    """required accuracy"""
    others_first: bool = False
    """whether other solvers come first, because solutions of `solver` violated their rows"""
    reduced: bool = False
    """whether programs are written in the reduced space and first solved by their dual, because
    another solver's proof that there is no solution does not hold"""
    options: Mapping[str, int | float | str] = dataclasses.field(default_factory=dict)
    """options of the solver by its own names, in place of this package's"""

    @classmethod
    def of(
        cls,
        solver: Solver | SolverName | None = None,
        executor: Executor | None = None,
        options: Mapping[str, int | float | str] | None = None,
    ) -> Backend:
        """Return the backend for a solver given as an object or by name.

        Planners call this first, so that an invalid solver is refused even where none is needed, as
        without obstacles.

        Raises:
            NotInstalledError: the solver is DAQP, and its package is not installed.
            ValueError: the solver is not available, does not solve quadratic programs, or does not
                know an option.
        """
        chosen = None if solver is None else _checked(solver)
        if options:
            _check_options(chosen or DEFAULT(), options)
        return cls(chosen, executor, options=dict(options or {}))

    @property
    def first(self) -> Solver:
        """The solver, or the default one."""
        return self.solver or DEFAULT()

    @cached_property
    def is_dense(self) -> bool:
        """Whether the solver is for dense programs, which have their own form."""
        return self.reduced or isinstance(self.first, Daqp)

    def here(self) -> Backend:
        """Return this backend without its executor."""
        return self if self.executor is None else dataclasses.replace(self, executor=None)


def name_of(solver: Solver) -> str:
    """Return the name of a solver."""
    return str(solver.solver_id().name())


def _checked(solver: Solver | SolverName) -> Solver:
    """Return a solver that is available and solves quadratic programs."""
    made = SOLVERS[solver]() if isinstance(solver, str) else solver
    if not (made.available() and made.enabled()):
        raise ValueError(f"solver: got {name_of(made)}, expected one available and enabled")
    known = type(made) in SOLVERS.values()
    if not (known or isinstance(made, Daqp) or _is_for_quadratic_programs(made)):
        raise ValueError(f"solver: got {name_of(made)}, expected one for quadratic programs")
    return made


def _check_options(solver: Solver, options: Mapping[str, int | float | str]) -> None:
    """Check that a solver knows options and the types of their values.

    Raises:
        ValueError: it does not.
    """
    name, got = name_of(solver), f"options.solver_options: got {dict(options)}"
    if isinstance(solver, Daqp):
        raise ValueError(f"{got}, expected none beside {name}")
    chosen = SolverOptions()
    try:
        for key, value in options.items():
            chosen.SetOption(solver.solver_id(), key, value)
        solver.Solve(_small_program(), None, chosen)
    except (RuntimeError, TypeError, ValueError) as error:
        reason = str(error).removeprefix(f"{name}: ")
        raise ValueError(f"{got}, expected options of {name}; {reason}") from None


def _small_program() -> MathematicalProgram:
    program = MathematicalProgram()
    x = program.NewContinuousVariables(2)
    program.AddQuadraticCost(np.eye(2), np.zeros(2), x, is_convex=True)
    program.AddLinearConstraint(np.ones((1, 2)), np.ones(1), np.full(1, np.inf), x)
    return program


def _is_for_quadratic_programs(solver: SolverInterface) -> bool:
    """Return whether a solver solves a small quadratic program; Drake cannot tell."""
    try:
        return bool(solver.Solve(_small_program(), None, None).is_success())
    except (RuntimeError, ValueError):  # a solver of other programs
        return False
