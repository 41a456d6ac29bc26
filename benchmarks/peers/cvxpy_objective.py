"""CVXPY with Clarabel: every term of an objective, as one cone program with states as variables."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

import drake_rho as rho

TOLERANCE = 1e-10
"""Clarabel's tolerances, of its gap and of feasibility."""


def least_cost(scenario: rho.Scenario) -> float:
    """Return the least cost [m²/s⁴] at the knots; infinite if there is no solution.

    Raises:
        RuntimeError: the solver neither reaches its tolerances nor finds that there is no solution.
    """
    cost: Any = 0.0
    constraints, positions = list[cp.Constraint](), dict[str, cp.Variable]()
    for number, vehicle in enumerate(scenario.vehicles):
        own, terms, p = _vehicle(scenario, number)
        constraints += own
        cost += vehicle.weight * terms
        positions[vehicle.name] = p
    for each in scenario.requirements:
        assert isinstance(each.set, rho.Ball)  # noqa: S101  # of these scenes
        radius = each.set.radius
        for name in each.vehicles or scenario.names:
            away = positions[name] - (positions[each.leader] if each.leader else 0.0)
            constraints.append(cp.norm(away[1:], axis=1) <= radius)
    problem = cp.Problem(cp.Minimize(cost), constraints)
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
    problem.solve(solver=cp.CLARABEL, **tolerances)
    if problem.status == cp.INFEASIBLE:
        return np.inf
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise RuntimeError(f"Clarabel: {problem.status}")
    return float(problem.value)


def _vehicle(scenario: rho.Scenario, number: int) -> tuple[list[Any], Any, cp.Variable]:
    """Return the constraints of one vehicle, the terms of its cost, and its positions."""
    grid, o, vehicle = scenario.grid, scenario.objective, scenario.vehicles[number]
    K, h, start, goal = grid.knots, grid.step, vehicle.start, vehicle.goal
    p, v, a = cp.Variable((K, 3)), cp.Variable((K, 3)), cp.Variable((K - 1, 3))
    constraints = [
        v[1:] == v[:-1] + h * a,
        p[1:] == p[:-1] + h * v[:-1] + h**2 / 2 * a,
        p[0] == start.position,
        v[0] == start.velocity,
    ]
    arrives = o.terminal_velocity == 0.0
    constraints += _in(goal.position, p[-1]) if o.terminal_position == 0.0 else []
    constraints += _in(goal.velocity, v[-1]) if arrives else []
    exact = arrives and isinstance(goal, rho.State)
    before, after = _outside(start), _outside(goal) if exact else None
    jerks, counts = [(a[1:] - a[:-1]) / h], [np.ones(K - 2)]
    if before is not None:
        jerks.insert(0, (a[:1] - before[None]) / h)
        counts.insert(0, np.array([1.0 + _rests(start)]))
    if after is not None:
        jerks.append((after[None] - a[-1:]) / h)
        counts.append(np.array([1.0 + _rests(goal)]))
    j, each = cp.vstack(jerks), np.sqrt(np.concatenate(counts))[:, None]
    limits = scenario.limits_of(vehicle)
    if limits.velocity is not None:
        constraints += [v[1:] >= limits.velocity.lower[None], v[1:] <= limits.velocity.upper[None]]
    for most, values in ((limits.max_acceleration, a), (limits.max_jerk, j)):
        constraints += [] if most is None else [cp.norm(values, axis=1) <= most]
    terms: Any = o.effort * cp.sum_squares(a)
    if o.jerk > 0.0:
        terms += o.jerk * cp.sum_squares(cp.multiply(each @ np.ones((1, 3)), j))
    if o.snap > 0.0:
        terms += o.snap * cp.sum_squares((j[1:] - j[:-1]) / h)
    if o.position > 0.0 or o.velocity > 0.0:
        track = o.reference[number if len(o.reference) > 1 else 0]
        r = np.stack([np.interp(grid.times, track.times, x) for x in track.positions.T], axis=1)
        terms += o.position * cp.sum_squares((p - r)[1:])
        terms += o.velocity * cp.sum_squares((v - np.gradient(r, h, axis=0))[1:])
    if o.terminal_position > 0.0:
        terms += o.terminal_position * cp.sum_squares(p[-1] - goal.position)
    if o.terminal_velocity > 0.0:
        terms += o.terminal_velocity * cp.sum_squares(v[-1] - goal.velocity)
    return constraints, terms, p


def _in(wanted: Any, value: Any) -> list[Any]:
    """Return that a value is that of a goal, or in its set."""
    if wanted is None:
        return []
    if isinstance(wanted, rho.Sphere):
        return [cp.norm(value - wanted.center) <= wanted.radius]
    if isinstance(wanted, rho.Box):
        return [value >= wanted.lower, value <= wanted.upper]
    return [value == wanted]


def _outside(state: rho.State) -> np.ndarray | None:
    if state.acceleration is not None:
        return np.asarray(state.acceleration)
    moving = state.velocity is None or state.velocity.any()
    return None if moving else np.zeros(3)


def _rests(state: rho.State) -> bool:
    outside = _outside(state)
    return outside is not None and not (state.velocity.any() or outside.any())
