"""CVXPY with Clarabel: vehicles whose positions are kept in balls and boxes, as one cone program.

Everything holds at the knots, and limits are those on the norms of velocity and acceleration.
"""

from __future__ import annotations

import dataclasses

import cvxpy as cp
import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray

TOLERANCE = 1e-9
"""Clarabel's tolerances, of its gap and of feasibility."""


@dataclasses.dataclass(frozen=True)
class Answer:
    """Solution of the program."""

    cost: float
    """f (13) [m²/s⁴]; infinite if there is no solution"""
    accelerations: FloatArray | None
    """accelerations [m/s²], shape (N, K-1, 3); None if there is no solution"""


def solve(scenario: rho.Scenario) -> Answer:
    """Solve the program, written anew.

    Raises:
        RuntimeError: the solver neither reaches its tolerances nor finds that there is no solution.
    """
    h, K, N = scenario.grid.step, scenario.grid.knots, len(scenario.vehicles)
    fleet = scenario.fleet
    p, v, a = (cp.Variable((rows, 3 * N)) for rows in (K, K, K - 1))
    constraints = [
        v[1:] == v[:-1] + h * a,
        p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * a,
        p[0] == fleet.start_positions.ravel(),
        v[0] == fleet.start_velocities.ravel(),
        p[-1] == fleet.goal_positions.ravel(),
        v[-1] == fleet.goal_velocities.ravel(),
        *_limited(scenario.limits, _of_each(v, N), _of_each(a, N)),
        *_kept(scenario, _of_each(p, N)),
    ]
    problem = cp.Problem(cp.Minimize(cp.sum_squares(a)), constraints)
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    problem.solve(solver=cp.CLARABEL, **tolerances)
    if problem.status == cp.INFEASIBLE:
        return Answer(np.inf, None)
    if problem.status != cp.OPTIMAL:
        raise RuntimeError(f"Clarabel: {problem.status}")
    found = np.asarray(a.value).reshape(K - 1, N, 3).transpose(1, 0, 2)
    return Answer(float(np.sum(found**2)), found)


def _of_each(values: cp.Variable, count: int) -> list[cp.Expression]:
    """Return the three columns of each vehicle."""
    return [values[:, 3 * i : 3 * i + 3] for i in range(count)]


def _limited(
    limits: rho.Limits, velocities: list[cp.Expression], accelerations: list[cp.Expression]
) -> list[cp.Constraint]:
    found = []
    for most, values in (
        (limits.max_speed, velocities),
        (limits.max_acceleration, accelerations),
    ):
        if most is not None:
            found += [cp.norm(each, axis=1) <= most for each in values]
    return found


def _kept(scenario: rho.Scenario, positions: list[cp.Expression]) -> list[cp.Constraint]:
    """Return the requirements, of the knots of their intervals, both ends included."""
    grid, names = scenario.grid, list(scenario.names)
    times, found = grid.start + grid.step * np.arange(grid.knots), []
    for asked in scenario.requirements:
        first, last = asked.active or (grid.start, grid.end)
        inside = (times >= first - 1e-9 * grid.step) & (times <= last + 1e-9 * grid.step)
        knots = np.flatnonzero(inside)
        for name in asked.vehicles or [each for each in names if each != asked.relative_to]:
            values = positions[names.index(name)][knots]
            if isinstance(asked.relative_to, str):
                values = values - positions[names.index(asked.relative_to)][knots]
            found += _inside(asked.set, values)
    return found


def _inside(kept: object, values: cp.Expression) -> list[cp.Constraint]:
    if isinstance(kept, rho.Sphere):
        return [cp.norm(values - kept.center[None], axis=1) <= kept.radius]
    if isinstance(kept, rho.Box):
        return [values >= kept.lower[None], values <= kept.upper[None]]
    raise TypeError(f"set: got {kept}, expected a ball or a box")
