"""CVXPY with Clarabel, the problem written anew for each solve."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

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
    h, K = scenario.grid.step, window.knots
    goal, limits = scenario.vehicles[vehicle].goal, scenario.limits
    p, v, a = cp.Variable((K, 3)), cp.Variable((K, 3)), cp.Variable((K - 1, 3))
    constraints = [
        v[1:] == v[:-1] + h * a,
        p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * a,
        p[0] == window.positions[vehicle],
        v[0] == window.velocities[vehicle],
        p[-1] == goal.position,
        v[-1] == goal.velocity,
    ]
    for box, values in ((limits.position, p), (limits.velocity, v), (limits.acceleration, a)):
        if box is not None:
            constraints += [values >= box.lower[None], values <= box.upper[None]]
    if window.half_spaces is not None:
        normals, offsets = window.half_spaces.normals[vehicle], window.half_spaces.offsets[vehicle]
        for n, least in zip(normals, offsets, strict=True):
            constraints.append(cp.sum(cp.multiply(n, p[1:-1]), axis=1) >= least)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(a)), constraints)
    problem.solve(solver=cp.CLARABEL)
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(f"Clarabel: {problem.status}")
    return np.asarray(a.value)
