"""CasADi with IPOPT: one vehicle from rest to rest past balls, with costs of jerk and tracking."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

import drake_rho as rho

OPTIONS: dict[str, Any] = {
    "expand": True,
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-9,
    "ipopt.max_iter": 300,
    "ipopt.mu_strategy": "adaptive",
}
"""Options of CasADi and IPOPT."""


class Program:
    """Program of a scenario with balls that are avoided at the knots, to be solved from starts."""

    def __init__(self, scenario: rho.Scenario) -> None:
        K, h, o = scenario.grid.knots, scenario.grid.step, scenario.objective
        opti, vehicle = ca.Opti(), scenario.vehicles[0]
        p, v, a = opti.variable(3, K), opti.variable(3, K), opti.variable(3, K - 1)
        opti.subject_to(v[:, 1:] == v[:, :-1] + h * a)
        opti.subject_to(p[:, 1:] == p[:, :-1] + h * v[:, :-1] + h**2 / 2 * a)
        opti.subject_to(p[:, 0] == vehicle.start.position)
        opti.subject_to(p[:, -1] == vehicle.goal.position)
        opti.subject_to(v[:, 0] == np.zeros(3))
        opti.subject_to(v[:, -1] == np.zeros(3))
        for ball in scenario.spheres:
            away = p[:, 1:-1] - ca.repmat(ca.DM(ball.center), 1, K - 2)
            opti.subject_to(ca.sum1(away**2) >= ball.radius**2)
        ends = 2.0 * (ca.sumsqr(a[:, 0]) + ca.sumsqr(a[:, -1]))  # the jerks from and to rest
        jerks = (ca.sumsqr(a[:, 1:] - a[:, :-1]) + ends) / h**2
        cost = o.effort * ca.sumsqr(a) + o.jerk * jerks
        if o.position > 0.0:
            path = o.reference[0].at(scenario.grid.times).T
            cost += o.position * ca.sumsqr((p - ca.DM(path))[:, 1:])
        opti.minimize(cost)
        opti.solver("ipopt", OPTIONS)
        self._opti, self._variables, self._cost = opti, (p, v, a), cost

    def cost_from(self, start: rho.Plan) -> float:
        """Return the cost found from a motion [m²/s⁴]; infinite if IPOPT finds no solution."""
        values = start.positions[0], start.velocities[0], start.accelerations[0]
        for variable, value in zip(self._variables, values, strict=True):
            self._opti.set_initial(variable, value.T)
        try:
            return float(self._opti.solve().value(self._cost))
        except RuntimeError:  # no solution from this start
            return math.inf
