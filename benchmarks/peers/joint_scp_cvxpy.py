"""Joint SCP for fleets as published, written with CVXPY: every pair at every knot, one program.

Augugliaro, Schoellig and D'Andrea, "Generation of collision-free trajectories for a quadrocopter
fleet: a sequential convex programming approach", IROS 2012; here with the index (13) and with
ellipsoids, as in the comparison by Luis and Schoellig.
"""

from __future__ import annotations

import dataclasses
from itertools import combinations

import cvxpy as cp
import numpy as np
from scipy.sparse import csr_array, kron

from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray

MAX_ITERATIONS = 30
"""Largest number of programs solved."""

CONVERGED = 1e-3
"""Relative change of the index between two iterates at which the iteration ends."""

KEPT = 1e-6
"""Violation of the separation allowed at a knot [m]."""


@dataclasses.dataclass(frozen=True)
class Answer:
    """Result of the iteration."""

    accelerations: FloatArray
    """accelerations [m/s²], shape (N, K-1, 3)"""
    programs: int
    """number of programs solved"""
    converged: bool
    """true if all pairs are separated at the knots and the index did not change any more"""


def solve(scenario: Scenario) -> Answer:
    """Solve without the pairs, then linearise all of them around one iterate after another.

    Raises:
        RuntimeError: a program has no solution, or the solver fails.
    """
    program = _Program(scenario)
    index = program.solve([])
    for number in range(2, MAX_ITERATIONS + 1):
        before, index = index, program.solve([program.pairs_around_last()])
        if program.apart() and abs(before - index) <= CONVERGED * index:
            return Answer(program.accelerations, number, converged=True)
    return Answer(program.accelerations, MAX_ITERATIONS, converged=False)


class _Program:
    """Program of all vehicles: one row a knot, three columns a vehicle."""

    def __init__(self, scenario: Scenario) -> None:
        h, K, fleet = scenario.grid.step, scenario.grid.knots, scenario.fleet
        N, separation = len(scenario.vehicles), scenario.separation
        if separation is None:
            raise ValueError("scenario: got no separation, expected one")
        self._p, self._v = cp.Variable((K, 3 * N)), cp.Variable((K, 3 * N))
        self._a = cp.Variable((K - 1, 3 * N))
        p, v, a = self._p, self._v, self._a
        self._constraints = [
            v[1:] == v[:-1] + h * a,
            p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * a,
            p[0] == fleet.start_positions.ravel(),
            v[0] == fleet.start_velocities.ravel(),
            p[-1] == fleet.goal_positions.ravel(),
            v[-1] == fleet.goal_velocities.ravel(),
        ]
        limits = scenario.limits
        boxes = ((limits.position, p), (limits.velocity, v), (limits.acceleration, a))
        for box, values in boxes:
            if box is not None:
                self._constraints += [values >= np.tile(box.lower, N)[None]]
                self._constraints += [values <= np.tile(box.upper, N)[None]]
        pairs = np.array(list(combinations(range(N), 2)))
        P = len(pairs)
        signs, columns = np.tile([1.0, -1.0], P), np.repeat(np.arange(P), 2)
        difference = csr_array((signs, (pairs.ravel(), columns)), shape=(N, P))
        self._differences = kron(difference, np.eye(3), format="csc")
        self._sum = kron(np.eye(P), np.ones((3, 1)), format="csc")
        self._squares = np.array([1.0, 1.0, 1.0 / separation.downwash]) ** 2
        self._distance = separation.distance

    @property
    def accelerations(self) -> FloatArray:
        """Return the accelerations of the last iterate, shape (N, K-1, 3)."""
        a: FloatArray = np.asarray(self._a.value)
        return np.moveaxis(a.reshape(len(a), -1, 3), 0, 1)

    def pairs_around_last(self) -> cp.Constraint:
        """Return the row d + n · (dp - dq) >= R of every pair at every inner knot.

        The last iterate's difference is dq, its length d, and its gradient n there: n · dq = d.
        """
        q, d = self._apart_by()
        n = (q * self._squares / d[..., None]).reshape(len(q), -1)
        normal = cp.multiply(n, self._p[1:-1] @ self._differences)
        return normal @ self._sum >= self._distance

    def apart(self) -> bool:
        """Return whether all pairs of the last iterate are separated at the knots."""
        return bool(np.all(self._apart_by()[1] >= self._distance - KEPT))

    def _apart_by(self) -> tuple[FloatArray, FloatArray]:
        """Return differences (K-2, P, 3) and distances (K-2, P) of all pairs at the inner knots."""
        q = (np.asarray(self._p.value)[1:-1] @ self._differences).reshape(
            self._p.shape[0] - 2, -1, 3
        )
        distances: FloatArray = np.sqrt(q**2 @ self._squares)
        return q, distances

    def solve(self, more: list[cp.Constraint]) -> float:
        """Solve with the given rows of pairs, and return the index."""
        problem = cp.Problem(cp.Minimize(cp.sum_squares(self._a)), self._constraints + more)
        problem.solve(solver=cp.CLARABEL)
        if problem.status != cp.OPTIMAL:
            raise RuntimeError(f"Clarabel: {problem.status}")
        return float(problem.value)
