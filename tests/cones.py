"""The program of one vehicle with Drake's Lorentz cones: a twin of the planner's program."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydrake.solvers import ClarabelSolver, MathematicalProgram

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import acceleration_outside

TWIN = 1e-5
"""Relative tolerance for the cost of the program with cones at Drake's default tolerances.

The cost was 1.1e-6 above that of a plan whose certificate proved it within 1e-11 of the optimum.
"""


def integrals(scenario: rho.Scenario) -> tuple[FloatArray, FloatArray]:
    """Return the matrices by which accelerations change velocity and position after the first knot.

    By (1)-(2); the knots after the first are the rows.
    """
    h, n = scenario.grid.step, scenario.grid.knots - 1
    velocity = h * np.tril(np.ones((n, n)))
    position = np.cumsum(h * np.vstack([np.zeros(n), velocity[:-1]]) + h**2 / 2 * np.eye(n), axis=0)
    return velocity, position


class Twin:
    """Program of one vehicle with a cone for each knot, in its accelerations."""

    def __init__(self, scenario: rho.Scenario, index: int) -> None:
        vehicle, grid = scenario.vehicles[index], scenario.grid
        self.limits, self.start, self.goal = (
            scenario.limits_of(vehicle),
            vehicle.start,
            vehicle.goal,
        )
        self.waypoints = vehicle.waypoints
        self.duration, self.n = grid.duration, grid.knots - 1
        ways = (self.goal.position - self.start.position, self.duration * self.start.velocity)
        self.length = max(float(np.linalg.norm(way)) for way in ways)
        self.unit = self.length / self.duration**2
        self.velocity, self.position = (self.unit * each for each in integrals(scenario))
        times = grid.elapsed[1:, None]
        self.coasting = self.start.position + times * self.start.velocity
        self.program = MathematicalProgram()
        self.a = self.program.NewContinuousVariables(self.n, 3, "a")

    def keep(self, quantity: FloatArray, offset: FloatArray, limit: rho.Box | None) -> None:
        """Add rows that keep a quantity in a box, each scaled to length one."""
        if limit is None:
            return
        scale = np.linalg.norm(quantity, axis=1)
        for x in range(3):
            least = (limit.lower[x] - offset[:, x]) / scale
            most = (limit.upper[x] - offset[:, x]) / scale
            self.program.AddLinearConstraint(quantity / scale[:, None], least, most, self.a[:, x])

    def keep_norm(
        self, most: float | None, matrix: FloatArray, offset: npt.ArrayLike, x: np.ndarray
    ) -> None:
        """Add the constraint norm(matrix @ x + offset) <= `most`."""
        if most is not None:
            cone = np.vstack([np.zeros(len(x)), matrix]) / most
            ends = np.array([most, *np.asarray(offset)]) / most
            self.program.AddLorentzConeConstraint(cone, ends, x)

    def keep_acceleration(self, a: np.ndarray) -> None:
        """Add the cones of one acceleration, in scaled units; gravity is a number of its own."""
        limits, each = self.limits, self.unit * np.eye(3)
        self.keep_norm(limits.max_acceleration, each, np.zeros(3), a)
        self.keep_norm(limits.max_thrust, each, [0.0, 0.0, 9.81], a)
        if limits.max_tilt is not None:
            slope = np.tan(limits.max_tilt)
            cone = np.stack([slope * each[2], each[0], each[1]]) / (9.81 * slope)
            self.program.AddLorentzConeConstraint(cone, np.array([1.0, 0.0, 0.0]), a)

    def pass_waypoint(self, waypoint: rho.Waypoint, grid: rho.Grid, x: np.ndarray) -> None:
        """Add the position at the waypoint's time, by (1)-(2) with a part of a step."""
        assert waypoint.time is not None
        t = waypoint.time - grid.start
        k = min(int(t / grid.step), self.n - 1)
        s = t - k * grid.step
        row = np.zeros(self.n)
        if k > 0:
            row = self.position[k - 1] + s * self.velocity[k - 1]
        row = row + self.unit * s**2 / 2 * np.eye(self.n)[k]
        missed = self.start.position + t * self.start.velocity - waypoint.position
        if waypoint.within == 0.0:
            scale = np.linalg.norm(row)
            matrix = np.kron(row, np.eye(3)) / scale
            self.program.AddLinearEqualityConstraint(matrix, -missed / scale, x)
        else:
            self.keep_norm(waypoint.within, np.kron(row, np.eye(3)), missed, x)

    def solve(self, scenario: rho.Scenario, reference: FloatArray | None) -> float | None:
        """Return the least cost, or None; obstacles are linearised around a path (K, 3)."""
        coasting = np.tile(self.start.velocity, (self.n, 1))
        self.keep(self.velocity[:-1], coasting[:-1], self.limits.velocity)
        self.keep(self.position[:-1], self.coasting[:-1], self.limits.position)
        self.keep(self.unit * np.eye(self.n), np.zeros((self.n, 3)), self.limits.acceleration)
        jerk = self.unit * (np.eye(self.n + 1, self.n) - np.eye(self.n + 1, self.n, k=-1))
        outside = np.zeros((self.n + 1, 3))
        outside[0], outside[-1] = -acceleration_outside(self.start), acceleration_outside(self.goal)
        known = ~np.isnan(outside[:, 0])
        jerk, outside = jerk[known] / scenario.grid.step, outside[known] / scenario.grid.step
        self.keep(jerk, outside, self.limits.jerk)
        for row, offset in zip(jerk, outside, strict=True):
            flat = self.a.reshape(-1)
            self.keep_norm(self.limits.max_jerk, np.kron(row, np.eye(3)), offset, flat)
        end = rho.Box(self.goal.velocity, self.goal.velocity)
        self.keep(self.velocity[-1:], coasting[-1:], end)
        end = rho.Box(self.goal.position, self.goal.position)
        self.keep(self.position[-1:], self.coasting[-1:], end)
        flat, speed = self.a.reshape(-1), self.limits.max_speed
        for row in self.velocity[:-1] if speed is not None else ():
            self.keep_norm(speed, np.kron(row, np.eye(3)), self.start.velocity, flat)
        for own in self.a:
            self.keep_acceleration(own)
        for waypoint in self.waypoints:
            self.pass_waypoint(waypoint, scenario.grid, flat)
        for sphere in scenario.spheres:
            assert reference is not None
            for k, row in enumerate(self.position[:-1]):
                q = reference[k + 1] - sphere.center
                normal = q / np.linalg.norm(q)
                room = normal @ (self.coasting[k] - sphere.center) - sphere.radius
                scale = np.linalg.norm(row)
                matrix = np.kron(row, normal)[None] / scale
                self.program.AddLinearConstraint(matrix, [-room / scale], [np.inf], flat)
        size = 3 * self.n
        self.program.AddQuadraticCost(2.0 * np.eye(size), np.zeros(size), flat, is_convex=True)
        result = ClarabelSolver().Solve(self.program)
        return self.unit**2 * result.get_optimal_cost() if result.is_success() else None


def twin_cost(scenario: rho.Scenario, reference: rho.Plan | None = None) -> float | None:
    """Return the cost of all vehicles by the programs with cones; None if one has no solution."""
    costs = [
        Twin(scenario, i).solve(scenario, None if reference is None else reference.positions[i])
        for i in range(len(scenario.vehicles))
    ]
    return None if None in costs else sum(cost for cost in costs if cost is not None)
