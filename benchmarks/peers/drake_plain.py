"""Drake's `MathematicalProgram` written plainly: loops over knots, every constraint written out."""

from __future__ import annotations

import numpy as np
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions

from benchmarks.peers.windows import Window, fly_windows
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray


def fly(scenario: Scenario) -> FloatArray:
    """Fly Example 4: accelerations [m/s²], shape (N, K-1, 3)."""
    return fly_windows(scenario, lambda window: _solve_all(scenario, window))


def _solve_all(scenario: Scenario, window: Window) -> FloatArray:
    vehicles = range(len(scenario.vehicles))
    return np.array([_solve(scenario, window, vehicle) for vehicle in vehicles])


def _solve(scenario: Scenario, window: Window, vehicle: int) -> FloatArray:
    K, goal = window.knots, scenario.vehicles[vehicle].goal
    program = MathematicalProgram()
    p = program.NewContinuousVariables(K, 3, "p")
    v = program.NewContinuousVariables(K, 3, "v")
    a = program.NewContinuousVariables(K - 1, 3, "a")
    program.AddQuadraticCost(2 * np.eye(3 * K - 3), np.zeros(3 * K - 3), a.ravel(), is_convex=True)
    _add_dynamics(program, scenario.grid.step, p, v, a)
    for values, end in (
        (p[0], window.positions[vehicle]),
        (v[0], window.velocities[vehicle]),
        (p[-1], goal.position),
        (v[-1], goal.velocity),
    ):
        program.AddBoundingBoxConstraint(end, end, values)
    limits = scenario.limits
    for box, knots in ((limits.position, p), (limits.velocity, v), (limits.acceleration, a)):
        if box is not None:
            for values in knots:
                program.AddBoundingBoxConstraint(box.lower, box.upper, values)
    if window.half_spaces is not None:
        normals, offsets = window.half_spaces.normals[vehicle], window.half_spaces.offsets[vehicle]
        for m in range(len(scenario.obstacles)):
            for k in range(K - 2):
                n, least = normals[m, k], offsets[m, k : k + 1]
                program.AddLinearConstraint(n[None], least, np.array([np.inf]), p[k + 1])
    return _solution(program, a)


def _add_dynamics(
    program: MathematicalProgram, h: float, p: np.ndarray, v: np.ndarray, a: np.ndarray
) -> None:
    """Add (1) and (2), knot by knot."""
    one = np.eye(3)
    to_velocity = np.hstack([one, -one, -h * one])
    to_position = np.hstack([one, -one, -h * one, -(h**2) / 2 * one])
    for k in range(len(a)):
        program.AddLinearEqualityConstraint(
            to_velocity, np.zeros(3), np.concatenate([v[k + 1], v[k], a[k]])
        )
        program.AddLinearEqualityConstraint(
            to_position, np.zeros(3), np.concatenate([p[k + 1], p[k], v[k], a[k]])
        )


def _solution(program: MathematicalProgram, a: np.ndarray) -> FloatArray:
    options = SolverOptions()
    for tolerance in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        options.SetOption(ClarabelSolver.id(), tolerance, 1e-10)
    result = ClarabelSolver().Solve(program, None, options)
    if not result.is_success():
        raise RuntimeError(f"Clarabel: {result.get_solution_result()}")
    accelerations: FloatArray = result.GetSolution(a)
    return accelerations
