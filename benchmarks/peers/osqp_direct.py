"""OSQP called directly: sparse matrices, a new set-up for each solve, polished."""

from __future__ import annotations

import numpy as np
import osqp
from scipy import sparse

from benchmarks.peers.windows import HalfSpaces, Window, fly_windows
from drake_rho import Box, Scenario
from drake_rho.scenario.fields import FloatArray

_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-3,  # on metres; polishing does the rest: the index is right to 1e-10
    "eps_rel": 1e-6,
    "max_iter": 100_000,
    "polishing": True,
    "polish_refine_iter": 10,
}


def fly(scenario: Scenario) -> FloatArray:
    """Fly Example 4: accelerations [m/s²], shape (N, K-1, 3)."""
    programs: dict[int, _Program] = {}

    def solve(window: Window) -> FloatArray:
        if window.knots not in programs:
            programs[window.knots] = _Program(scenario, window.knots)
        program = programs[window.knots]
        return np.array([program.solve(window, i) for i in range(len(scenario.vehicles))])

    return fly_windows(scenario, solve)


class _Program:
    """Program of one vehicle over K knots in the variables (p, v, a), knot by knot.

    Its matrices are created once for each K; only bounds and obstacle rows differ between solves.
    """

    def __init__(self, scenario: Scenario, K: int) -> None:
        h, self._K, self._vehicles = scenario.grid.step, K, scenario.vehicles
        forward, axes = sparse.eye(K - 1, K, k=1), sparse.eye(3)
        here = sparse.eye(K - 1, K)
        difference = sparse.kron(forward - here, axes)
        steps, none = sparse.kron(h * here, axes), sparse.csc_matrix((3 * K - 3, 3 * K))
        push = sparse.eye(3 * K - 3)
        dynamics = sparse.bmat(
            [[difference, -steps, -(h**2) / 2 * push], [none, difference, -h * push]]
        )
        variables = 9 * K - 3
        self._cost = sparse.diags(np.repeat([0.0, 2.0], [6 * K, 3 * K - 3]), format="csc")
        self._rows = sparse.vstack([dynamics, sparse.eye(variables)], format="csc")
        limits = scenario.limits
        boxes = ((limits.position, K), (limits.velocity, K), (limits.acceleration, K - 1))
        bounds = np.hstack([_bounds(box, knots) for box, knots in boxes])
        self._lower, self._upper = np.hstack([np.zeros((2, 6 * K - 6)), bounds])

    def solve(self, window: Window, vehicle: int) -> FloatArray:
        """Return the accelerations of one vehicle [m/s²], shape (K-1, 3)."""
        K, goal = self._K, self._vehicles[vehicle].goal
        lower, upper, rows = self._lower.copy(), self._upper.copy(), self._rows
        first_p, first_v = 6 * K - 6, 9 * K - 6
        for row, value in (
            (first_p, window.positions[vehicle]),
            (first_p + 3 * K - 3, goal.position),
            (first_v, window.velocities[vehicle]),
            (first_v + 3 * K - 3, goal.velocity),
        ):
            lower[row : row + 3] = upper[row : row + 3] = value
        if window.half_spaces is not None:
            obstacles, least = _outside(window.half_spaces, vehicle, rows.shape[1])
            rows = sparse.vstack([rows, obstacles], format="csc")
            lower, upper = np.append(lower, least), np.append(upper, np.full(len(least), np.inf))
        solver = osqp.OSQP()
        solver.setup(self._cost, np.zeros(rows.shape[1]), rows, lower, upper, **_SETTINGS)
        result = solver.solve()
        if result.info.status != "solved":
            raise RuntimeError(f"OSQP: {result.info.status}")
        accelerations: FloatArray = result.x[6 * K :].reshape(K - 1, 3)
        return accelerations


def _bounds(box: Box | None, knots: int) -> FloatArray:
    """Return lower and upper bounds of a quantity at its knots, shape (2, 3 knots)."""
    sides = np.full((2, 3), [[-np.inf], [np.inf]]) if box is None else [box.lower, box.upper]
    return np.tile(sides, knots)


def _outside(
    half_spaces: HalfSpaces, vehicle: int, variables: int
) -> tuple[sparse.csc_matrix, FloatArray]:
    """Return (15) as rows over the variables, with their lower bounds."""
    normals = half_spaces.normals[vehicle].reshape(-1, 3)
    inner = half_spaces.normals.shape[2]
    rows = np.repeat(np.arange(len(normals)), 3)
    first = 3 + 3 * (np.arange(len(normals)) % inner)  # p[2] begins at the fourth variable
    columns = (first[:, None] + np.arange(3)).ravel()
    shape = (len(normals), variables)
    matrix = sparse.csc_matrix((normals.ravel(), (rows, columns)), shape=shape)
    return matrix, half_spaces.offsets[vehicle].ravel()
