"""Drake with SNOPT on the non-convex program, obstacles as (8) at the knots.

The variables are the accelerations alone, by (10) and (11): with positions and velocities as
variables SNOPT meets its iteration limit, or takes twice as long with the limit raised and its own
scaling.
"""

from __future__ import annotations

import numpy as np
from pydrake.solvers import MathematicalProgram, QuadraticConstraint, SnoptSolver, SolverOptions

from benchmarks.peers.first_guess import obstacle_free
from drake_rho import Box, Scenario
from drake_rho.scenario.fields import FloatArray

_OPTIONS = {
    "Major optimality tolerance": 1e-8,
    "Major feasibility tolerance": 1e-9,
    "Iterations limit": 200_000,
}


def solve(scenario: Scenario) -> FloatArray:
    """Solve the problem to convergence: accelerations [m/s²], shape (N, K-1, 3)."""
    guess = obstacle_free(scenario).accelerations
    return np.array([_solve(scenario, vehicle, each) for vehicle, each in enumerate(guess)])


def _solve(scenario: Scenario, vehicle: int, guess: FloatArray) -> FloatArray:
    h, K = scenario.grid.step, scenario.grid.knots
    ends, limits = scenario.vehicles[vehicle], scenario.limits
    ahead = np.arange(1, K)[:, None] - np.arange(K - 1)  # k - j of (10) and (11)
    position = np.where(ahead > 0, h**2 / 2 * (2 * ahead - 1), 0.0)
    velocity = np.where(ahead > 0, h, 0.0)
    coasting = ends.start.position + h * np.arange(1, K)[:, None] * ends.start.velocity
    steady = np.tile(ends.start.velocity, (K - 1, 1))
    program = MathematicalProgram()
    a = program.NewContinuousVariables(K - 1, 3, "a")
    program.AddQuadraticCost(2 * np.eye(a.size), np.zeros(a.size), a.ravel(), is_convex=True)
    # The goal's rows come before the boxes': in the order of time, SNOPT takes five times as long.
    goal = Box(ends.goal.position, ends.goal.position), Box(ends.goal.velocity, ends.goal.velocity)
    _add_box(program, goal[0], a, position[-1:], coasting[-1:])
    _add_box(program, goal[1], a, velocity[-1:], steady[-1:])
    _add_box(program, limits.position, a, position[:-1], coasting[:-1])
    _add_box(program, limits.velocity, a, velocity[:-1], steady[:-1])
    if limits.acceleration is not None:
        for values in a:
            box = limits.acceleration
            program.AddBoundingBoxConstraint(box.lower, box.upper, values)
    for sphere in scenario.spheres:
        for k in range(K - 2):
            _add_outside(program, a, position[k], coasting[k] - sphere.center, sphere.radius)
    program.SetInitialGuess(a, guess)
    return _solution(program, a)


def _add_box(
    program: MathematicalProgram,
    box: Box | None,
    a: np.ndarray,
    responses: FloatArray,
    drift: FloatArray,
) -> None:
    """Add a box on drift plus response at every given knot, shapes (k, K-1) and (k, 3)."""
    if box is not None:
        lower, upper = (box.lower - drift).ravel(), (box.upper - drift).ravel()
        program.AddLinearConstraint(np.kron(responses, np.eye(3)), lower, upper, a.ravel())


def _add_outside(
    program: MathematicalProgram, a: np.ndarray, response: FloatArray, away: FloatArray, R: float
) -> None:
    """Add (8) at one knot over R²: norm(away + sum_j response[j] a[j])² >= R²."""
    acting = response > 0.0
    rows = np.kron(response[acting], np.eye(3)) / R
    program.AddQuadraticConstraint(
        2 * rows.T @ rows,
        2 * rows.T @ (away / R),
        1.0 - away @ away / R**2,
        np.inf,
        a[acting].ravel(),
        hessian_type=QuadraticConstraint.HessianType.kPositiveSemidefinite,
    )


def _solution(program: MathematicalProgram, a: np.ndarray) -> FloatArray:
    options = SolverOptions()
    for name, value in _OPTIONS.items():
        options.SetOption(SnoptSolver.id(), name, value)
    result = SnoptSolver().Solve(program, None, options)
    if not result.is_success():
        raise RuntimeError(f"SNOPT: {result.get_solution_result()}")
    accelerations: FloatArray = result.GetSolution(a)
    return accelerations
