"""The least cost by `rho.program`, with Drake's Lorentz cones: a twin of the planners' programs."""

from __future__ import annotations

import numpy as np
from pydrake.solvers import ClarabelSolver, SolverOptions

import drake_rho as rho
from tests.arrays import FloatArray

TWIN = 5e-6
"""Relative tolerance for the cost of the program: that of planners, which accept a violation of
requirements and waypoints by a part of the verifier's tolerance."""

PRECISE = SolverOptions()
"""Clarabel's tolerances where accelerations may be small: they are absolute, 1e-8 by default."""
for _name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
    PRECISE.SetOption(ClarabelSolver.id(), _name, 1e-12)


def integrals(scenario: rho.Scenario) -> tuple[FloatArray, FloatArray]:
    """Return the matrices by which accelerations change velocity and position after the first knot.

    By (1)-(2); the knots after the first are the rows.
    """
    h, n = scenario.grid.step, scenario.grid.knots - 1
    velocity = h * np.tril(np.ones((n, n)))
    position = np.cumsum(h * np.vstack([np.zeros(n), velocity[:-1]]) + h**2 / 2 * np.eye(n), axis=0)
    return velocity, position


def twin_cost(scenario: rho.Scenario, reference: rho.Plan | None = None) -> float | None:
    """Return the least cost, with obstacles linearised around a plan; None without a solution."""
    p = rho.program(scenario, around=reference)
    for options in (PRECISE, None):  # where it does not reach these tolerances, its defaults
        result = ClarabelSolver().Solve(p.prog, None, options)
        if result.is_success():
            return p.plan(result).cost
    return None
