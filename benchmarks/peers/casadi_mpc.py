"""One window of MPC with CasADi, by solvers that are given the same program of stages.

States (p, v) and accelerations are variables, in the order x[1], a[1], x[2], ...; constraints are
in the order of stages too, as HPIPM and Fatrop need them. A program is built once for each length.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.peers.first_guess import obstacle_free
from drake_rho import Obstacle, Scenario, Sphere
from drake_rho.scenario.fields import FloatArray

_QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False}
_SQP: dict[str, Any] = {
    **_QUIET,
    "print_header": False,
    "print_iteration": False,
    "print_status": False,
    "tol_pr": 1e-6,
    "tol_du": 0.1,
    "max_iter": 5,
}


@dataclasses.dataclass(frozen=True)
class Method:
    """One of CasADi's solvers."""

    plugin: str
    """name of the solver of non-convex programs"""
    options: dict[str, Any]
    """its options"""
    by_stage: bool = False
    """whether it is told which constraints are equalities, to find the stages"""
    linearised: bool = False
    """whether distances from obstacles enter as they are and the cost alone has second derivatives,
    so that a linearisation of the program has the half-spaces of (15)"""


METHODS = {
    "IPOPT": Method(
        "ipopt",
        {
            **_QUIET,
            "expand": True,  # scalar expressions, whose derivatives evaluate several times faster
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-6,
            "ipopt.mu_strategy": "adaptive",
        },
    ),
    "SQP with OSQP": Method(
        "sqpmethod",
        {
            **_SQP,
            "qpsol": "osqp",
            "qpsol_options": {
                **_QUIET,
                # Tighter tolerances take up to a hundred times as long on the first windows.
                "osqp": {"verbose": False, "eps_abs": 1e-3, "eps_rel": 1e-3, "rho": 10.0},
            },
        },
        linearised=True,
    ),
    "SQP with qrqp": Method(
        "sqpmethod",
        {
            **_SQP,
            "qpsol": "qrqp",
            "qpsol_options": {
                **_QUIET,
                "print_iter": False,
                "print_header": False,
                "print_info": False,
            },
        },
        linearised=True,
    ),
    "Fatrop": Method(
        "fatrop",
        {
            **_QUIET,
            "expand": True,
            "structure_detection": "auto",
            "fatrop.print_level": 0,
            "fatrop.tol": 1e-6,
        },
        by_stage=True,
    ),
    "one SQP step with HPIPM": Method(
        "sqpmethod",
        {
            **_SQP,
            "qpsol": "hpipm",
            "qpsol_options": {**_QUIET, "hpipm": {"mode": "speed"}},
            "max_iter": 1,
        },
        linearised=True,
    ),
}
"""Solvers by name."""


@dataclasses.dataclass(frozen=True)
class Solution:
    """Solution of a window of M steps past B balls."""

    variables: FloatArray
    """states and accelerations by stage, shape (9 M + 6,)"""
    of_bounds: FloatArray
    """multipliers of their bounds, shape (9 M + 6,)"""
    of_rows: FloatArray
    """multipliers of the constraints by stage, shape (6 (M + 2) + B (M - 1),)"""
    success: bool = True
    """whether the solver says so"""

    @property
    def accelerations(self) -> FloatArray:
        """Accelerations [m/s²], shape (1, M, 3)."""
        return np.append(self.variables, np.zeros(3)).reshape(1, -1, 9)[:, :-1, 6:]

    def shifted(self, balls: int) -> Solution:
        """Return the part from the second stage on, a start for the next window."""
        rows = self.of_rows[12:]
        first, others = rows[:6], rows[6 + balls :]
        of_rows = np.concatenate([first, np.zeros(6), others])
        return Solution(self.variables[9:], self.of_bounds[9:], of_rows)


class Programs:
    """Programs of the windows of one vehicle, one for each length."""

    def __init__(self, scenario: Scenario, method: Method, windows: int) -> None:
        self._scenario, self._balls = scenario, len(scenario.obstacles)
        steps = scenario.grid.knots - 1
        self._programs = [_Program(scenario, steps - knot, method) for knot in range(windows)]

    def solve(self, knot: int, state: FloatArray, last: Solution | None) -> Solution:
        """Solve the window that begins at a knot, from the solution of the one before.

        Args:
            knot: number of the knot, from 0.
            state: measured position and velocity, shape (6,).
            last: solution of the window before; that without balls and limits if not given.
        """
        times = self._scenario.grid.times[knot:]
        places = [
            ball.center + times[:, None] * velocity for ball, velocity in _balls(self._scenario)
        ]
        start = _first_guess(self._scenario) if last is None else last.shifted(self._balls)
        return self._programs[knot].solve(state, np.concatenate(places, axis=1), start)


class _Program:
    """Least effort over some steps from a state to the goal, past balls at given places."""

    def __init__(self, scenario: Scenario, steps: int, method: Method) -> None:
        h, vehicle, radii = scenario.grid.step, scenario.vehicles[0], list[float]()
        for sphere, _ in _balls(scenario):
            radii.append(sphere.radius + vehicle.radius)
        self._goal = np.concatenate([vehicle.goal.position, vehicle.goal.velocity])
        x = [ca.SX.sym(f"x{k}", 6) for k in range(steps + 1)]
        a = [ca.SX.sym(f"a{k}", 3) for k in range(steps)]
        ends, centers = ca.SX.sym("ends", 12), ca.SX.sym("centers", 3 * len(radii), steps + 1)
        rows, lower, upper = [], [], []

        def add(row: Any, least: float, most: float) -> None:
            rows.append(row)
            lower.extend([least] * row.numel())
            upper.extend([most] * row.numel())

        for k in range(steps + 1):
            if k < steps:
                moved = ca.vertcat(x[k][:3] + h * x[k][3:] + h**2 / 2 * a[k], x[k][3:] + h * a[k])
                add(x[k + 1] - moved, 0.0, 0.0)
            if k in (0, steps):
                add(x[k] - ends[:6] if k == 0 else x[k] - ends[6:], 0.0, 0.0)
                continue
            for ball, radius in enumerate(radii):
                away = x[k][:3] - centers[3 * ball : 3 * ball + 3, k]
                if method.linearised:
                    add(ca.norm_2(away), radius, np.inf)
                else:
                    add(ca.sumsqr(away), radius**2, np.inf)
        stages = [each for pair in zip(x, [*a, ca.SX(0, 1)], strict=True) for each in pair]
        variables, effort = ca.vertcat(*stages), sum(ca.sumsqr(each) for each in a)
        parameters = ca.veccat(ends, centers)
        options = dict(method.options)
        if method.by_stage:
            options["equality"] = [a == b for a, b in zip(lower, upper, strict=True)]
        if method.linearised:
            scale, multipliers = ca.SX.sym("scale"), ca.SX.sym("multipliers", len(lower))
            hessian = ca.triu(scale * ca.hessian(effort, variables)[0])
            given = [variables, parameters, scale, multipliers]
            options["hess_lag"] = ca.Function("hessian", given, [hessian])
        program = {"x": variables, "p": parameters, "f": effort, "g": ca.vertcat(*rows)}
        self._solver = ca.nlpsol("window", method.plugin, program, options)
        self._rows = {"lbg": np.array(lower), "ubg": np.array(upper)}
        self._bounds = dict(zip(("lbx", "ubx"), _bounds(scenario, steps), strict=True))

    def solve(self, state: FloatArray, centers: FloatArray, start: Solution) -> Solution:
        """Solve it for a state, shape (6,), and centres at its knots [m], shape (M + 1, 3 B)."""
        found = self._solver(
            x0=start.variables,
            lam_x0=start.of_bounds,
            lam_g0=start.of_rows,
            p=np.concatenate([state, self._goal, centers.ravel()]),
            **self._bounds,
            **self._rows,
        )
        x, of_bounds, of_rows = (found[key].full().ravel() for key in ("x", "lam_x", "lam_g"))
        return Solution(x, of_bounds, of_rows, bool(self._solver.stats()["success"]))


def _first_guess(scenario: Scenario) -> Solution:
    """Return the motion of least effort without balls and limits."""
    guess, steps = obstacle_free(scenario), scenario.grid.knots - 1
    a = np.append(guess.accelerations[0], np.zeros((1, 3)), axis=0)
    variables = np.hstack([guess.positions[0], guess.velocities[0], a]).ravel()[:-3]
    rows = 6 * (steps + 2) + len(scenario.obstacles) * (steps - 1)
    return Solution(variables, np.zeros(len(variables)), np.zeros(rows))


def _balls(scenario: Scenario) -> Iterator[tuple[Sphere, FloatArray]]:
    """Yield balls at time 0 and their velocities [m/s], shape (3,).

    Raises:
        TypeError: an obstacle is no ball that moves at a constant velocity.
    """
    for obstacle in scenario.obstacles:
        shape = obstacle.shape if isinstance(obstacle, Obstacle) else obstacle
        velocity = obstacle.velocity if isinstance(obstacle, Obstacle) else None
        if not isinstance(shape, Sphere) or velocity is None:
            raise TypeError(f"obstacle: got {obstacle}, expected a ball that moves")
        yield shape, velocity


def _bounds(scenario: Scenario, steps: int) -> FloatArray:
    """Return lower and upper bounds of the variables, shape (2, 9 M + 6); none at the ends."""
    limits, free = scenario.limits, np.array([[-np.inf] * 3, [np.inf] * 3])
    sides = [
        free if box is None else np.stack([box.lower, box.upper])
        for box in (limits.position, limits.velocity, limits.acceleration)
    ]
    bounds = np.tile(np.hstack(sides), steps + 1)[:, :-3]
    bounds[:, :6] = bounds[:, -6:] = np.hstack([free, free])
    return np.asarray(bounds)
