"""OpenSCvx, penalised trust region, on the non-convex program, obstacles as (8) at the knots.

`python -m benchmarks.peers.openscvx_scp` runs in an environment of its own, and plans one scenario
a line (`benchmarks.apart.accelerations_apart`).

Lengths are in half-sides of the position box and times in durations: OpenSCvx 0.5.2 applies
gradients of constraints at knots to scaled states without scaling them (its issue 516), which is
harmless for a scale of 1. The index is a state that grows by a control `power`, bounded from below
by the squared acceleration, so that every subproblem has the true cost.
"""

from __future__ import annotations

import contextlib
import functools
import json
import sys
import time
from typing import Any

import numpy as np

from benchmarks.peers.first_guess import Guess, obstacle_free
from drake_rho import Box, Scenario, Vehicle
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.files import scenario_from_json, scenario_to_json

_ALGORITHM = {
    "autotuner": "ConstantProximalWeight",
    "lam_cost": 1.0,
    "lam_prox": 1e-2,
    "lam_vc": 1e3,
    "lam_vb": 1e3,
    "ep_tr": 3e-6,  # noise of the subproblems keeps it from going much lower
    "ep_vb": 1e-5,
    "ep_vc": 1e-6,
    "k_max": 100,
}
_TOLERANCES = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}
_SOLVER = {"cvx_solver": "CLARABEL", "solver_args": {"enforce_dpp": True, **_TOLERANCES}}


def solve(scenario: Scenario) -> FloatArray:
    """Solve the problem to convergence: accelerations [m/s²], shape (N, K-1, 3).

    The first call for a scenario also compiles its program, which takes much longer.

    Raises:
        RuntimeError: the iteration does not converge.
        ValueError: OpenSCvx does not support the scenario.
    """
    program, guess = _compiled(scenario_to_json(scenario)), obstacle_free(scenario)
    return np.array(
        [program.solve(vehicle, guess, index) for index, vehicle in enumerate(scenario.vehicles)]
    )


@functools.cache
def _compiled(scenario: str) -> _Program:
    """Return the program of a scenario given as JSON."""
    return _Program(scenario_from_json(scenario))


class _Program:
    """Program of one vehicle; start, goal and guess can be set."""

    def __init__(self, scenario: Scenario) -> None:
        import openscvx as ox

        limits, K = scenario.limits, scenario.grid.knots
        if limits.position is None or limits.velocity is None or limits.acceleration is None:
            raise ValueError("scenario: got a quantity without a box, OpenSCvx needs one for each")
        self._ox, self._knots, self._duration = ox, K, scenario.grid.duration
        self._length = float(np.max(limits.position.upper - limits.position.lower)) / 2
        self._units = [self._length / self._duration**power for power in range(3)]
        self._p = _boxed(ox.State("position", shape=(3,)), limits.position, self._units[0])
        self._v = _boxed(ox.State("velocity", shape=(3,)), limits.velocity, self._units[1])
        self._a = _boxed(
            ox.Control("acceleration", shape=(3,), parameterization="ZOH"),
            limits.acceleration,
            self._units[2],
        )
        greatest = np.sum(np.maximum(self._a.min**2, self._a.max**2))
        self._index = ox.State("index", shape=(1,))
        self._power = ox.Control("power", shape=(1,), parameterization="ZOH")
        for variable in (self._index, self._power):
            variable.min, variable.max = [0.0], [greatest]
        self._set(scenario.vehicles[0], obstacle_free(scenario), 0)
        self._problem = self._build(scenario)
        self._problem.settings.dev.printing = False
        self._problem.initialize()

    def _build(self, scenario: Scenario) -> Any:  # OpenSCvx has no types
        ox = self._ox
        constraints = [(ox.Sum(self._a**2) <= self._power[0]).convex()]
        for sphere in scenario.spheres:
            distance = ox.linalg.Norm(self._p - sphere.center / self._length)
            outside = sphere.radius / self._length <= distance
            constraints.append(outside.at(list(range(1, self._knots - 1))))
        one = {"time_dilation_min": 1.0, "time_dilation_max": 1.0}  # the grid is given
        return ox.Problem(
            dynamics={"position": self._v, "velocity": self._a, "index": self._power},
            constraints=constraints,
            states=[self._p, self._v, self._index],
            controls=[self._a, self._power],
            N=self._knots,
            time=ox.Time(initial=0.0, final=1.0, min=0.0, max=1.0, **one),
            algorithm=_ALGORITHM,
            solver=_SOLVER,
            float_dtype="float64",
        )

    def _set(self, vehicle: Vehicle, guess: Guess, index: int) -> None:
        length, speed, acceleration = self._units
        start, goal = vehicle.start, vehicle.goal
        self._p.initial, self._p.final = start.position / length, goal.position / length
        self._v.initial, self._v.final = start.velocity / speed, goal.velocity / speed
        self._p.guess = guess.positions[index] / length
        self._v.guess = guess.velocities[index] / speed
        a = np.append(guess.accelerations[index], np.zeros((1, 3)), axis=0) / acceleration
        power = np.sum(a**2, axis=1)
        grown = np.append(0.0, np.cumsum(power[:-1])) / (self._knots - 1)
        self._a.guess, self._power.guess = a, power[:, None]
        self._index.initial, self._index.final = [0.0], [self._ox.Minimize(grown[-1])]
        self._index.guess = grown[:, None]

    def solve(self, vehicle: Vehicle, guess: Guess, index: int) -> FloatArray:
        """Return one vehicle's accelerations [m/s²], shape (K-1, 3)."""
        self._set(vehicle, guess, index)
        self._problem.reset()
        results = self._problem.solve()
        if not results.converged:
            raise RuntimeError("OpenSCvx: not converged")
        return np.asarray(results.u)[: self._knots - 1, :3] * self._units[2]


def _boxed(variable: Any, box: Box, unit: float) -> Any:
    """Return a state or control of OpenSCvx within a box, in its own unit."""
    variable.min, variable.max = box.lower / unit, box.upper / unit
    return variable


def main() -> None:
    """Answer every scenario on standard input until it ends."""
    for line in sys.stdin:
        began = time.process_time()
        try:
            with contextlib.redirect_stdout(sys.stderr):  # it prints its progress
                answer: dict[str, Any] = {"accelerations": solve(scenario_from_json(line)).tolist()}
        except Exception as error:  # errors of its tools are its result
            answer = {"error": f"{type(error).__name__}: {error}"}
        answer["processor"] = time.process_time() - began
        # read by the parent process
        print(json.dumps(answer), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
