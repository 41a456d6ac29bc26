"""CasADi with IPOPT on the non-convex program, obstacles as (8) at the knots.

The program is built once, with start and goal as parameters, and solved for each vehicle.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from benchmarks.peers.first_guess import obstacle_free
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray

_OPTIONS: dict[str, Any] = {
    "expand": True,  # scalar expressions, whose derivatives evaluate several times faster
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-8,
    "ipopt.mu_strategy": "adaptive",  # takes half the time of the default here
}


def solve(scenario: Scenario) -> FloatArray:
    """Solve the problem to convergence: accelerations [m/s²], shape (N, K-1, 3)."""
    guess, vehicles = obstacle_free(scenario), range(len(scenario.vehicles))
    opti, p, v, a, ends = _program(scenario)
    found = []
    for i in vehicles:
        start, goal = scenario.vehicles[i].start, scenario.vehicles[i].goal
        opti.set_value(
            ends, np.column_stack([start.position, start.velocity, goal.position, goal.velocity])
        )
        opti.set_initial(p, guess.positions[i].T)
        opti.set_initial(v, guess.velocities[i].T)
        opti.set_initial(a, guess.accelerations[i].T)
        found.append(np.asarray(opti.solve().value(a)).T)
    return np.array(found)


def _program(scenario: Scenario) -> tuple[ca.Opti, ca.MX, ca.MX, ca.MX, ca.MX]:
    """Return one vehicle's program, its variables by knot, and the parameter of its ends."""
    h, K, limits = scenario.grid.step, scenario.grid.knots, scenario.limits
    opti = ca.Opti()
    p, v, a = opti.variable(3, K), opti.variable(3, K), opti.variable(3, K - 1)
    ends = opti.parameter(3, 4)
    opti.minimize(ca.sumsqr(a))
    opti.subject_to(v[:, 1:] == v[:, :-1] + h * a)
    opti.subject_to(p[:, 1:] == p[:, :-1] + h * v[:, :-1] + h**2 / 2 * a)
    for column, values in enumerate((p[:, 0], v[:, 0], p[:, -1], v[:, -1])):
        opti.subject_to(values == ends[:, column])
    # Not at the ends, which are given: IPOPT needs fewer equalities than free variables.
    boxes = ((limits.position, p[:, 1:-1]), (limits.velocity, v[:, 1:-1]), (limits.acceleration, a))
    for box, values in boxes:
        if box is not None:
            columns = values.shape[1]
            lower, upper = (ca.repmat(ca.DM(side), 1, columns) for side in (box.lower, box.upper))
            opti.subject_to(opti.bounded(ca.vec(lower), ca.vec(values), ca.vec(upper)))
    for sphere in scenario.spheres:
        away = p[:, 1:-1] - ca.repmat(ca.DM(sphere.center), 1, K - 2)
        opti.subject_to(ca.sum1(away**2) >= sphere.radius**2)
    opti.solver("ipopt", _OPTIONS)
    return opti, p, v, a, ends
