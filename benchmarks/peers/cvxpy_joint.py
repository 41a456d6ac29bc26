"""CVXPY with Clarabel, all vehicles in one problem, written anew for each solve.

CVXPY's own work outweighs the solver's here, so fewer and larger problems are faster.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from benchmarks.peers.windows import HalfSpaces, Window, fly_windows
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray


def fly(scenario: Scenario) -> FloatArray:
    """Fly Example 4: accelerations [m/s²], shape (N, K-1, 3)."""
    return fly_windows(scenario, lambda window: _solve(scenario, window))


def _solve(scenario: Scenario, window: Window) -> FloatArray:
    """Solve one problem whose columns are the three axes of each vehicle, vehicle after vehicle."""
    h, K, N = scenario.grid.step, window.knots, len(scenario.vehicles)
    fleet, limits = scenario.fleet, scenario.limits
    p, v, a = (cp.Variable((rows, 3 * N)) for rows in (K, K, K - 1))
    constraints = [
        v[1:] == v[:-1] + h * a,
        p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * a,
        p[0] == window.positions.ravel(),
        v[0] == window.velocities.ravel(),
        p[-1] == fleet.goal_positions.ravel(),
        v[-1] == fleet.goal_velocities.ravel(),
    ]
    for box, values in ((limits.position, p), (limits.velocity, v), (limits.acceleration, a)):
        if box is not None:
            lower, upper = np.tile(box.lower, N)[None], np.tile(box.upper, N)[None]
            constraints += [values >= lower, values <= upper]
    if window.half_spaces is not None:
        constraints += _outside(window.half_spaces, p[1:-1])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(a)), constraints)
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(f"Clarabel: {problem.status}")
    return np.asarray(a.value).reshape(K - 1, N, 3).transpose(1, 0, 2)


def _outside(half_spaces: HalfSpaces, p: cp.Expression) -> list[cp.Constraint]:
    """Return (15) for every obstacle, vehicle and inner knot; `p` has the shape (K-2, 3N)."""
    N, M, inner, _ = half_spaces.normals.shape
    sum_axes = np.kron(np.eye(N), np.ones((3, 1)))
    normals = half_spaces.normals.transpose(1, 2, 0, 3).reshape(M, inner, 3 * N)
    return [cp.multiply(normals[m], p) @ sum_axes >= half_spaces.offsets[:, m].T for m in range(M)]
