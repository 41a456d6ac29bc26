"""Solvers, where they work, and how accurate they are to be."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Literal, TypeAlias

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, OsqpSolver, SolverInterface

from drake_rho.planning.programs.daqp import Daqp

Solver: TypeAlias = SolverInterface | Daqp
"""Type of `solver=` in planners."""

SolverName = Literal["clarabel", "daqp", "osqp"]
"""Solvers that a word stands for."""

SOLVERS: dict[str, Callable[[], Solver]] = {
    "clarabel": ClarabelSolver,
    "daqp": Daqp,
    "osqp": OsqpSolver,
}
"""Solver for each word."""

DEFAULT: Callable[[], Solver] = ClarabelSolver
"""Solver where none is given."""

Accuracy = Literal["full", "quick", "rough"]
"""Digits of a solution: full (1e-10, so that rows kept by the solver are kept by the verifier),
quick (the same, tried first without iterative refinement of linear systems) or rough (1e-8)."""


@dataclasses.dataclass(frozen=True)
class Backend:
    """The solver of programs, the executor that they are solved on, and their accuracy."""

    solver: Solver | None = None
    """a Drake solver or `Daqp()`; Clarabel if None"""
    executor: Executor | None = None
    """any of PEP 3148, to which blocks of programs are sent; None solves them here. A Drake solver
    cannot be sent to processes, DAQP can"""
    accuracy: Accuracy = "full"
    """digits that are enough"""
    others_first: bool = False
    """whether others are asked before the solver, as its solutions did not keep their rows"""

    @classmethod
    def of(
        cls, solver: Solver | SolverName | None = None, executor: Executor | None = None
    ) -> Backend:
        """Return the backend that a user asks for, with a solver by itself or by a word.

        Planners ask at once: where nothing is in the way they may not come to a program.

        Raises:
            NotInstalledError: the solver is DAQP, whose package is not there.
            ValueError: the solver is not available here, or not for quadratic programs.
        """
        return cls(None if solver is None else _checked(solver), executor)

    @property
    def first(self) -> Solver:
        """The solver, or the usual one."""
        return self.solver or DEFAULT()

    @property
    def is_dense(self) -> bool:
        """Whether the solver is for small dense programs, which are written in another way."""
        return isinstance(self.first, Daqp)

    def here(self) -> Backend:
        """Return this backend without its executor."""
        return dataclasses.replace(self, executor=None)


def name_of(solver: Solver) -> str:
    """Return what a solver is called."""
    return str(solver.solver_id().name())


def _checked(solver: Solver | SolverName) -> Solver:
    """Return a solver that is available and solves quadratic programs."""
    made = SOLVERS[solver]() if isinstance(solver, str) else solver
    if not (made.available() and made.enabled()):
        raise ValueError(f"solver: got {name_of(made)}, expected one available and enabled here")
    known = type(made) in SOLVERS.values()
    if not (known or isinstance(made, Daqp) or _is_for_quadratic_programs(made)):
        raise ValueError(f"solver: got {name_of(made)}, expected one of quadratic programs")
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
