"""DAQP called directly on the dense program in the accelerations alone, by (10) and (11).

The program already has DAQP's own form, a point of least norm, so no cost matrix is given. Data
shared by the solves of one horizon length are computed and set up once: without obstacles only
bounds change, with them the rows at the end are overwritten.
"""

from __future__ import annotations

import daqp
import numpy as np

from benchmarks.peers.windows import HalfSpaces, Window, fly_windows
from drake_rho import Box, Scenario
from drake_rho.scenario.fields import FloatArray

_EQUALITY = 5  # DAQP's codes for the kinds of rows
_UNBOUNDED = 1e30
_OPTIMAL = 1


def fly(scenario: Scenario) -> FloatArray:
    """Fly Example 4: accelerations [m/s²], shape (N, K-1, 3)."""
    programs: dict[int, _Program] = {}

    def solve(window: Window) -> FloatArray:
        if window.knots not in programs:
            programs[window.knots] = _Program(scenario, window.knots)
        return programs[window.knots].solve(window)

    return fly_windows(scenario, solve)


class _Program:
    """Programs of all vehicles over K knots.

    Bounds have DAQP's order: first those of the accelerations, then of the rows, which are p[K] and
    v[K], p and v at the inner knots, and the obstacles at the inner knots.
    """

    def __init__(self, scenario: Scenario, K: int) -> None:
        h, limits, self._fleet = scenario.grid.step, scenario.limits, scenario.fleet
        ahead = np.arange(1, K)[:, None] - np.arange(K - 1)  # k - j of (10) and (11)
        p, v = np.where(ahead > 0, h**2 / 2 * (2 * ahead - 1), 0.0), np.where(ahead > 0, h, 0.0)
        responses = np.vstack([p[-1], v[-1], p[:-1], v[:-1]])
        fixed, obstacles = 3 * len(responses), len(scenario.obstacles) * (K - 2)
        self._rows = np.zeros((fixed + obstacles, 3 * K - 3))
        by_axis = self._rows[:fixed].reshape(len(responses), 3, K - 1, 3)
        for axis in range(3):
            by_axis[:, axis, :, axis] = responses
        self._obstacle_rows = self._rows[fixed:].reshape(-1, K - 2, K - 1, 3)
        self._inner, self._times = p[:-1], h * np.arange(1, K)[:, None]
        self._simple = _sides(limits.acceleration, K - 1)
        self._boxes = _sides(limits.position, K - 2), _sides(limits.velocity, K - 2)
        self._sense = np.zeros(3 * K - 3 + len(self._rows), dtype=np.int32)
        self._sense[3 * K - 3 : 3 * K + 3] = _EQUALITY
        self._free: daqp.Model | None = None

    def solve(self, window: Window) -> FloatArray:
        """Return the accelerations of every vehicle [m/s²], shape (N, K-1, 3)."""
        N = len(window.positions)
        drift = window.positions[:, None] + self._times * window.velocities[:, None]
        bounds = self._bounds(window, drift)
        if window.half_spaces is None:
            found = [self._solve_free(lower, upper) for lower, upper in bounds]
        else:
            least = _least(window.half_spaces, drift)
            bounds = np.append(bounds, least, axis=2)
            normals = window.half_spaces.normals
            found = [
                self._solve_avoiding(n, lower, upper)
                for n, (lower, upper) in zip(normals, bounds, strict=True)
            ]
        return np.array(found).reshape(N, -1, 3)

    def _bounds(self, window: Window, drift: FloatArray) -> FloatArray:
        """Return lower and upper bounds except for the obstacles, shape (N, 2, ...)."""
        N, fleet = len(drift), self._fleet
        ends = np.hstack(
            [fleet.goal_positions - drift[:, -1], fleet.goal_velocities - window.velocities]
        )
        position, velocity = self._boxes
        p = position - drift[:, None, :-1].reshape(N, 1, -1)
        v = velocity - np.tile(window.velocities, len(self._inner))[:, None]
        simple = np.broadcast_to(self._simple, (N, *self._simple.shape))
        both_ends = np.broadcast_to(ends[:, None], (N, 2, 6))
        return np.concatenate([simple, both_ends, p, v], axis=2)

    def _solve_free(self, lower: FloatArray, upper: FloatArray) -> FloatArray:
        if self._free is None:
            self._free = daqp.Model()
            count = self._rows.shape[1]
            rows, sense = self._rows[: len(lower) - count], self._sense[: len(lower)]
            self._free.setup(np.eye(count), np.zeros(count), rows, upper, lower, sense)
        else:
            self._free.update(bupper=upper, blower=lower)
        return _checked(*self._free.solve())

    def _solve_avoiding(
        self, normals: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> FloatArray:
        np.multiply(normals[:, :, None], self._inner[:, :, None], out=self._obstacle_rows)
        return _checked(*daqp.solve(None, None, self._rows, upper, lower, self._sense))


def _sides(box: Box | None, knots: int) -> FloatArray:
    """Return lower and upper bounds of a quantity at all knots, shape (2, 3 knots)."""
    none = np.full((2, 3), [[-_UNBOUNDED], [_UNBOUNDED]])
    return np.tile(none if box is None else [box.lower, box.upper], knots)


def _least(half_spaces: HalfSpaces, drift: FloatArray) -> FloatArray:
    """Return bounds of the obstacle rows, shape (N, 2, M (K-2))."""
    inner = np.einsum("nmki,nki->nmk", half_spaces.normals, drift[:, :-1])
    least = (half_spaces.offsets - inner).reshape(len(drift), -1)
    return np.stack([least, np.full_like(least, _UNBOUNDED)], axis=1)


def _checked(x: FloatArray, _: float, flag: int, info: dict[str, object]) -> FloatArray:
    if flag != _OPTIMAL:
        raise RuntimeError(f"DAQP: exit flag {flag}")
    return x
