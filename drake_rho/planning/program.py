"""The quadratic program (16), on Drake's `MathematicalProgram`.

The decision variables are the accelerations, the paper's choice: position and velocity at any
time are affine in them by (10)-(11). They are counted from the free motion, the one of least index
(13) that reaches the goal, in a unit of the scenario's scale, and every row has length one, so
that the numbers a solver sees depend neither on the scale nor on where it lies.

The solution lies in the span of its rows: what is square to all of them and to the goal's only
costs. With few rows a program therefore has one variable for each row instead of 3 (K - 1), the
coordinates in an orthonormal basis of that span; this is exact.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from copy import copy

import numpy as np
from pydrake.solvers import Binding, LinearConstraint, MathematicalProgram
from scipy.sparse import csc_array, csc_matrix, diags_array, hstack, vstack

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.halfspaces import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import TOLERANCE
from drake_rho.scenario.records import Scenario

_FEW = 32
"""Rows up to which a program is written in their span, whatever they are. With more of them it is
if the span's dense triangle has no more numbers than the rows themselves."""

_BLOCK = 150
"""Most variables in one quadratic cost: Drake takes a dense matrix for each."""


class Frame:
    """What all programs of a scenario are written in: goals, free motions and units.

    Attributes:
        grid: of the scenario.
        goal_rows: orthonormal rows whose products with the accelerations of an axis the goal (12)
            decides, shape (2 or 1, K-1).
        free: the motions of least index that reach the goals, nothing else asked.
        units: acceleration that counts as one [m/s²], shape (N,).
        hopeless: vehicles that one step cannot bring to their goals, shape (N,).
    """

    def __init__(self, scenario: Scenario) -> None:
        fleet, grid = scenario.fleet, scenario.grid
        self.grid = grid
        self.units = fleet.scale("acceleration")
        self.goal_rows = _goal_rows(grid.knots - 1)
        self._goal_values, self.hopeless = _goal_values(scenario, self.goal_rows)
        accelerations = np.einsum("gj,ngx->njx", self.goal_rows, self._goal_values)
        self.free = Motion.from_starts(fleet, accelerations, grid.step)

    def alone(self, vehicle: int) -> Frame:
        """The same for one of the vehicles, whose index then is 0."""
        other = copy(self)
        own = slice(vehicle, vehicle + 1)
        other.units, other.hopeless = self.units[own], self.hopeless[own]
        other.free, other._goal_values = self.free.of(own), self._goal_values[own]
        return other

    def reaching_goals(self, accelerations: FloatArray, vehicles: IntArray) -> FloatArray:
        """The goals' equations (12), kept to a solver's tolerance, closed to rounding.

        Args:
            accelerations: of `vehicles`, shape (P, K-1, 3).
            vehicles: their indices, shape (P,).
        """
        missed = np.einsum("gj,pjx->pgx", self.goal_rows, accelerations)
        missed -= self._goal_values[vehicles]
        closed: FloatArray = accelerations - np.einsum("gj,pgx->pjx", self.goal_rows, missed)
        return closed


def _goal_rows(steps: int) -> FloatArray:
    """What velocity and position at the last knot depend on: the mean of the accelerations and,
    with more than one step, their linear trend."""  # noqa: D205, D209
    rows = np.ones((min(steps, 2), steps))
    if steps > 1:
        rows[1] = np.arange(steps) - (steps - 1) / 2
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    return rows


def _goal_values(scenario: Scenario, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(12) in terms of `rows`, with (10) and (11) at the last knot.

    Returns:
        Products of the rows with the accelerations [m/s²], shape (N, 2 or 1, 3), and which
        vehicles cannot reach their goals by one step.
    """
    fleet, grid = scenario.fleet, scenario.grid
    h, T, steps = grid.step, grid.duration, grid.knots - 1
    faster = fleet.goal_velocities - fleet.start_velocities
    further = (fleet.goal_positions - fleet.start_positions) / T - fleet.start_velocities
    mean = faster / (h * np.sqrt(steps))  # velocity: h in every step
    position = h * (T - h * np.arange(steps) - h / 2) / T  # (11) over T
    rest = further - (rows[0] @ position) * mean
    if steps == 1:
        missed = np.abs(rest).max(axis=1) > TOLERANCE * fleet.lengths / T
        return mean[:, None], missed
    values = np.stack([mean, rest / (rows[1] @ position)], axis=1)
    return values, np.zeros(len(values), dtype=bool)


@dataclasses.dataclass(frozen=True)
class VehicleProgram:
    """The quadratic program of one vehicle."""

    vehicle: int
    """its index in the scenario"""
    program: MathematicalProgram
    """minimise norm(x)² subject to the rows, u = basis @ x"""
    rows: Binding[LinearConstraint]
    """the half-spaces, in the order they were given in"""
    basis: FloatArray | None
    """shape (3 (K-1), number of variables); None if the variables are u itself"""

    def solution(self, x: FloatArray) -> FloatArray:
        """The accelerations u from the free motion, in units, shape (K-1, 3)."""
        return (x if self.basis is None else self.basis @ x).reshape(-1, 3)


def programs_of(frame: Frame, rows: Sequence[HalfSpaces]) -> list[VehicleProgram]:
    """The program of every vehicle that has rows, by the order of their indices.

    Args:
        frame: of the scenario.
        rows: constraint by constraint; those of a vehicle keep their order.
    """
    vehicles = np.concatenate([part.vehicles for part in rows])
    count = np.bincount(vehicles)
    few = count[vehicles] <= _FEW
    first = np.cumsum([0, *(len(part) for part in rows)])
    parts = [part.select(few[i : i + len(part)]) for part, i in zip(rows, first, strict=False)]
    programs = _of_few(frame, [part for part in parts if len(part) > 0])
    for vehicle in np.flatnonzero(count > _FEW).tolist():
        programs.append(_of_many(frame, vehicle, [part.of(vehicle) for part in rows]))
    return sorted(programs, key=lambda each: each.vehicle)


def _of_few(frame: Frame, rows: Sequence[HalfSpaces]) -> list[VehicleProgram]:
    """Programs in the span of their rows; the arithmetic of all of them at once."""
    if not rows:
        return []
    vehicles = np.concatenate([part.vehicles for part in rows])
    order = np.argsort(vehicles, kind="stable")
    responses = np.concatenate([part.responses(frame.grid) for part in rows])[order]
    normals = np.concatenate([part.normals for part in rows])[order]
    short = -np.concatenate([part.margins(frame.free) for part in rows])[order]
    lengths = np.sqrt(np.einsum("rj,rj->r", responses, responses))
    inside = _without_goal(frame, responses / lengths[:, None])
    needed = short / (lengths * frame.units[vehicles[order]])
    matrix = (inside[:, :, None] * normals[:, None, :]).reshape(len(order), -1)
    names, first = np.unique(vehicles[order], return_index=True)
    own = map(slice, first, [*first[1:], len(order)])
    return [
        _in_span(int(vehicle), matrix[rows], needed[rows])
        for vehicle, rows in zip(names, own, strict=True)
    ]


def _of_many(frame: Frame, vehicle: int, rows: Sequence[HalfSpaces]) -> VehicleProgram:
    """One program, in the span of its rows or, if that is no smaller, in all accelerations."""
    matrix, needed = rows_of(frame, vehicle, rows)
    if matrix.nnz < len(needed) ** 2:
        return _in_full(frame, vehicle, matrix, needed)
    dense = matrix.toarray().reshape(len(needed), -1, 3)
    inside = np.stack([_without_goal(frame, dense[:, :, axis]) for axis in range(3)], axis=2)
    return _in_span(vehicle, inside.reshape(len(needed), -1), needed)


def rows_of(frame: Frame, vehicle: int, rows: Sequence[HalfSpaces]) -> tuple[csc_array, FloatArray]:
    """Half-spaces as rows matrix @ u >= needed, by (10)-(11), each of length one.

    Here u are the accelerations of one vehicle from its free motion, in its unit.
    """
    blocks, needed = [csc_array((0, 3 * (frame.grid.knots - 1)))], [np.zeros(0)]
    for part in rows:
        responses = part.sparse_responses(frame.grid)
        lengths = np.sqrt(responses.power(2).sum(axis=1))
        along = [diags_array(part.normals[:, axis] / lengths) @ responses for axis in range(3)]
        by_axis = hstack(along, format="csc")
        steps = frame.grid.knots - 1
        blocks.append(by_axis[:, np.arange(3 * steps).reshape(3, steps).T.reshape(-1)])
        needed.append(-part.margins(frame.free) / (lengths * frame.units[vehicle]))
    return vstack(blocks, format="csc"), np.concatenate(needed)


def _without_goal(frame: Frame, rows: FloatArray) -> FloatArray:
    """The part of `rows` that leaves the goal where it is; projected twice, against rounding."""
    goal = frame.goal_rows
    for _ in range(2):
        rows = rows - (rows @ goal.T) @ goal
    return rows


def _in_span(vehicle: int, matrix: FloatArray, needed: FloatArray) -> VehicleProgram:
    """The program in coordinates of the span of its rows, which leave the goal alone."""
    basis, triangle = np.linalg.qr(matrix.T)
    program = MathematicalProgram()
    x = program.NewContinuousVariables(basis.shape[1])
    add_index(program, x)
    return VehicleProgram(vehicle, program, add_rows(program, triangle.T, needed, x), basis)


def _in_full(frame: Frame, vehicle: int, matrix: csc_array, needed: FloatArray) -> VehicleProgram:
    """The program in the accelerations themselves."""
    program = MathematicalProgram()
    u = program.NewContinuousVariables(matrix.shape[1])
    add_index(program, u)
    add_goal(program, frame, u)
    return VehicleProgram(vehicle, program, add_rows(program, csc_matrix(matrix), needed, u), None)


def add_index(to: MathematicalProgram, x: np.ndarray) -> None:
    """(13): f less that of the free motion, in units squared: the sum of squares."""
    for first in range(0, len(x), _BLOCK):
        block = x[first : first + _BLOCK]
        size = len(block)
        to.AddQuadraticCost(2.0 * np.eye(size), np.zeros(size), block, is_convex=True)


def add_goal(to: MathematicalProgram, frame: Frame, u: np.ndarray) -> None:
    """(12): position and velocity at the last knot stay those of the free motion."""
    rows = frame.goal_rows
    for axis in range(3):
        to.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), u[axis::3])


def add_rows(
    to: MathematicalProgram, matrix: FloatArray | csc_matrix, needed: FloatArray, x: np.ndarray
) -> Binding[LinearConstraint]:
    """(4) to (7) and (15): matrix @ x >= needed."""
    return to.AddLinearConstraint(matrix, needed, np.full(len(needed), np.inf), x)
