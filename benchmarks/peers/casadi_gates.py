"""CasADi with IPOPT: least times through gates with a velocity, on one grid.

In one program every gate stays in its step; one that reaches an end of its step goes on to the
next, and the program is solved again, until the time falls no more.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import drake_rho as rho
from benchmarks.peers.casadi_objective import OPTIONS

_AT_AN_END, _MOVES = 1e-4, 12
"""Part of a step from its end at which a gate goes on, and the largest number of moves."""


def least_time(start: rho.Plan) -> float:
    """Return the least time found from a motion of one vehicle [s]; infinite if none is found."""
    scenario, best = start.scenario, np.inf
    grid = scenario.grid
    given = np.array([each.time for each in scenario.vehicles[0].waypoints], dtype=float)
    parts = (given - grid.start) / grid.step
    steps = np.minimum(parts.astype(int), grid.knots - 2)
    tried = set[tuple[int, ...]]()
    for _ in range(_MOVES):
        tried.add(tuple(steps.tolist()))
        duration, found = _solved(start, steps)
        if not duration < best * (1.0 - 1e-9):
            break
        best = duration
        moved = steps + (found > 1.0 - _AT_AN_END) - (found < _AT_AN_END)
        moved = np.clip(moved, 0, grid.knots - 2)
        if tuple(moved.tolist()) in tried:
            break
        steps = moved
    return best


def _solved(start: rho.Plan, steps: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the least time with gates in given steps, and their parts of these."""
    scenario = start.scenario
    vehicle, M = scenario.vehicles[0], scenario.grid.knots - 1
    opti = ca.Opti()
    p, v, a = opti.variable(3, M + 1), opti.variable(3, M + 1), opti.variable(3, M)
    h, s = opti.variable(), opti.variable(len(steps))
    motion = start.positions[0], start.velocities[0], start.accelerations[0]
    for variable, values in zip((p, v, a), motion, strict=True):
        opti.set_initial(variable, values.T)
    opti.set_initial(h, scenario.grid.step)
    opti.set_initial(s, 0.5)
    opti.subject_to(p[:, 1:] == p[:, :-1] + h * v[:, :-1] + h**2 / 2.0 * a)
    opti.subject_to(v[:, 1:] == v[:, :-1] + h * a)
    for x, ends in ((p, "position"), (v, "velocity")):
        opti.subject_to(x[:, 0] == getattr(vehicle.start, ends))
        opti.subject_to(x[:, -1] == getattr(vehicle.goal, ends))
    for most, x in (
        (scenario.limits.max_acceleration, a),
        (scenario.limits.max_speed, v[:, 1:-1]),
    ):
        if most is not None:
            opti.subject_to(ca.vec(ca.sum1(x**2)) <= most**2)
    opti.subject_to(h >= 1e-4)
    opti.subject_to(opti.bounded(0.0, s, 1.0))
    for j, (k, each) in enumerate(zip(steps.tolist(), vehicle.waypoints, strict=True)):
        t = s[j] * h
        opti.subject_to(p[:, k] + t * v[:, k] + t**2 / 2.0 * a[:, k] == each.position)
        _gate(opti, v[:, k] + t * a[:, k], each.velocity)
    opti.minimize(M * h)
    opti.solver("ipopt", OPTIONS)
    try:
        found = opti.solve()
    except RuntimeError:  # no solution from this start
        return np.inf, np.full(len(steps), 0.5)
    return float(M * found.value(h)), np.atleast_1d(found.value(s))


def _gate(opti: ca.Opti, v: ca.MX, velocity: Any) -> None:
    """Require a velocity, or one of a ball, a half-space or a cone from the origin."""
    match velocity:
        case rho.Ball():
            opti.subject_to(ca.sumsqr(v - velocity.center) <= velocity.radius**2)
        case rho.HalfSpace():
            opti.subject_to(ca.dot(v, velocity.normal) <= velocity.offset)
        case rho.Cone():
            along = ca.dot(v, velocity.axis)
            opti.subject_to(along >= 0.0)
            opti.subject_to(along**2 >= np.cos(velocity.half_angle) ** 2 * ca.sumsqr(v))
        case _:
            opti.subject_to(v == velocity)
