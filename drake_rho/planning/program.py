"""The quadratic program (16) of one vehicle, on Drake's `MathematicalProgram`.

The decision variables are the accelerations, the paper's choice: position and velocity at any
time are affine in them by (10)-(11). They are kept in a unit of their own, `unit` [m/s²], and
every row has length one, so that the numbers a solver sees do not depend on the scenario's scale.

No row couples two vehicles, so each has a program of its own.
"""

from __future__ import annotations

import numpy as np
from pydrake.solvers import (
    Binding,
    LinearConstraint,
    MathematicalProgram,
    MathematicalProgramResult,
)
from scipy.sparse import csc_matrix

from drake_rho.motion.dynamics import RESPONSES, Motion, position_response, velocity_response
from drake_rho.planning.errors import InfeasibleError
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import TOLERANCE, Box, Grid, Scenario, Vehicle

_BLOCK = 150
"""Most variables in one quadratic cost."""


class VehicleProgram:
    """The quadratic program of one vehicle; begins with its cost, goal and acceleration box."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.grid = scenario.grid
        self.unit = scenario.scale(vehicle, "acceleration")
        self.coasting = Motion.from_start(
            vehicle.start, np.zeros((self.grid.knots - 1, 3)), self.grid.step
        )
        self.rows: list[tuple[Binding[LinearConstraint], HalfSpaces]] = []
        self.program = MathematicalProgram()
        self.accelerations = self.program.NewContinuousVariables(self.grid.knots - 1, 3, "a")
        self.goal_rows, self.goal_values = goal_equations(self.grid, vehicle)
        add_index(self)
        self.goal = add_goal(self, self.goal_rows, self.goal_values)
        box = scenario.limits_of(vehicle).acceleration
        self.acceleration_box = None if box is None else add_acceleration_box(self, box)

    def motion(self, result: MathematicalProgramResult) -> Motion:
        """The motion that a successful `result` stands for.

        The goal's equations, which the solver keeps to its tolerance, are closed to rounding by
        the smallest change of the accelerations.
        """
        a = self.unit * result.GetSolution(self.accelerations).reshape(-1, 3)
        a -= self.goal_rows.T @ (self.goal_rows @ a - self.goal_values)
        return Motion.from_start(self.vehicle.start, a, self.grid.step)


def goal_equations(grid: Grid, vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """The terminal equalities (12), rows @ accelerations = values, with orthonormal rows.

    The same rows serve the three axes. Two knots leave one row: velocity and position at the goal
    then follow from the one acceleration together.

    Returns:
        Rows of shape (2 or 1, K-1) and values [m/s²] of the same length, one column an axis.

    Raises:
        InfeasibleError: one step cannot bring the vehicle to its goal.
    """
    h, K, T = grid.step, grid.knots, grid.duration
    start, goal = vehicle.start, vehicle.goal
    response = np.concatenate([velocity_response(h, K, [T]), position_response(h, K, [T]) / T])
    change = np.stack(
        [
            goal.velocity - start.velocity,
            (goal.position - start.position) / T - start.velocity,
        ]
    )
    left, sizes, rows = np.linalg.svd(response, full_matrices=False)
    values = (left.T @ change) / sizes[:, None]
    missed = change - response @ (rows.T @ values)
    if np.any(np.abs(missed) > TOLERANCE * vehicle.length_scale(T) / T):
        conflict = ("goal position", "goal velocity", "a single step")
        raise InfeasibleError({vehicle.name: conflict})
    return rows, values


def add_index(to: VehicleProgram) -> None:
    """(13): f, the sum of squared accelerations."""
    variables = to.accelerations.reshape(-1)
    for first in range(0, len(variables), _BLOCK):  # Drake takes a dense matrix for each cost
        block = variables[first : first + _BLOCK]
        size = len(block)
        to.program.AddQuadraticCost(2.0 * np.eye(size), np.zeros(size), block, is_convex=True)


def add_goal(
    to: VehicleProgram, rows: FloatArray, values: FloatArray
) -> list[Binding[LinearConstraint]]:
    """(12): position and velocity at the last knot, one binding an axis."""
    bindings = []
    for axis, name in enumerate("xyz"):
        binding = to.program.AddLinearEqualityConstraint(
            rows, values[:, axis] / to.unit, to.accelerations[:, axis]
        )
        binding.evaluator().set_description(f"{to.vehicle.name}: goal {name}")
        bindings.append(binding)
    return bindings


def add_acceleration_box(to: VehicleProgram, box: Box) -> Binding[LinearConstraint]:
    """(5): bounds on every acceleration."""
    steps = to.grid.knots - 1
    binding = to.program.AddBoundingBoxConstraint(
        np.tile(box.lower, steps) / to.unit,
        np.tile(box.upper, steps) / to.unit,
        to.accelerations.reshape(-1),
    )
    binding.evaluator().set_description(f"{to.vehicle.name}: acceleration box")
    return binding


def add_halfspaces(to: VehicleProgram, halfspaces: HalfSpaces) -> None:
    """(4), (6), (7) and (15) in terms of the accelerations."""
    matrix, lower = rows_of(to, halfspaces)
    binding = to.program.AddLinearConstraint(
        matrix, lower, np.full(len(lower), np.inf), to.accelerations.reshape(-1)
    )
    binding.evaluator().set_description(f"{to.vehicle.name}: {halfspaces.name}")
    to.rows.append((binding, halfspaces))


def rows_of(of: VehicleProgram, halfspaces: HalfSpaces) -> tuple[csc_matrix, FloatArray]:
    """Half-spaces as rows matrix @ accelerations >= lower, by (10)-(11), each of length one."""
    step, knots, times = of.grid.step, of.grid.knots, halfspaces.times
    response = RESPONSES[halfspaces.quantity](step, knots, times)
    lengths = np.linalg.norm(response, axis=1)
    rows = np.einsum("rj,ri->rji", response / lengths[:, None], halfspaces.normals)
    needed = -halfspaces.everywhere().margins(of.coasting)
    return csc_matrix(rows.reshape(len(times), -1)), needed / lengths / of.unit
