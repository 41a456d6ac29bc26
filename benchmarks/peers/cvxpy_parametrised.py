"""CVXPY with Clarabel, one parametrised problem (DPP) for each horizon length.

A problem is compiled once a length, then updated and solved for every vehicle, without and with the
obstacles.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from benchmarks.peers.windows import Window, fly_windows
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray


def fly(scenario: Scenario) -> FloatArray:
    """Fly Example 4: accelerations [m/s²], shape (N, K-1, 3)."""
    problems: dict[int, _Problem] = {}

    def solve(window: Window) -> FloatArray:
        if window.knots not in problems:
            problems[window.knots] = _Problem(scenario, window.knots)
        problem = problems[window.knots]
        return np.array([problem.solve(window, i) for i in range(len(scenario.vehicles))])

    return fly_windows(scenario, solve)


class _Problem:
    """Program of one vehicle over K knots; start, goal and half-spaces are parameters."""

    def __init__(self, scenario: Scenario, K: int) -> None:
        h, limits = scenario.grid.step, scenario.limits
        self._vehicles = scenario.vehicles
        self._start, self._goal = cp.Parameter((2, 3)), cp.Parameter((2, 3))
        self._normals = [cp.Parameter((K - 2, 3)) for _ in scenario.spheres]
        self._offsets = [cp.Parameter(K - 2) for _ in scenario.spheres]
        p, v, self._a = cp.Variable((K, 3)), cp.Variable((K, 3)), cp.Variable((K - 1, 3))
        constraints = [
            v[1:] == v[:-1] + h * self._a,
            p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * self._a,
            p[0] == self._start[0],
            v[0] == self._start[1],
            p[-1] == self._goal[0],
            v[-1] == self._goal[1],
        ]
        boxes = ((limits.position, p), (limits.velocity, v), (limits.acceleration, self._a))
        for box, values in boxes:
            if box is not None:
                constraints += [values >= box.lower[None], values <= box.upper[None]]
        for n, least in zip(self._normals, self._offsets, strict=True):
            constraints.append(cp.sum(cp.multiply(n, p[1:-1]), axis=1) >= least)
        self._problem = cp.Problem(cp.Minimize(cp.sum_squares(self._a)), constraints)

    def solve(self, window: Window, vehicle: int) -> FloatArray:
        """Set the program's parameters to a vehicle's window and solve it."""
        goal, spaces = self._vehicles[vehicle].goal, window.half_spaces
        self._start.value = np.stack([window.positions[vehicle], window.velocities[vehicle]])
        self._goal.value = np.stack([goal.position, goal.velocity])
        for m, (normals, offsets) in enumerate(zip(self._normals, self._offsets, strict=True)):
            if spaces is None:  # 0 >= -1, which always holds
                normals.value, offsets.value = np.zeros(normals.shape), -np.ones(offsets.shape)
            else:
                normals.value = spaces.normals[vehicle, m]
                offsets.value = spaces.offsets[vehicle, m]
        self._problem.solve(solver=cp.CLARABEL)
        if self._problem.status != cp.OPTIMAL:
            raise RuntimeError(f"Clarabel: {self._problem.status}")
        return np.asarray(self._a.value)
