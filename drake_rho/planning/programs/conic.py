"""Second-order cone programs, for curved sets whose tangent planes do not converge.

Tangent planes find most solutions in a few small programs. Where a set is nearly empty, each round
of planes only halves the violation, and thousands of nearly parallel planes make programs
ill-conditioned. The sets themselves then enter one program, which Clarabel solves. By conic
duality, its multipliers determine the tangent planes that lead to the same solution or, if there is
none, contradict each other. All other modules therefore handle rows only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
import scipy  # its parts load when first used
from pydrake.solvers import MathematicalProgram

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces, about
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.constraints.rows import Rows, slacks_of
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.program import Answers, add_rows
from drake_rho.planning.programs.solve import solve
from drake_rho.planning.programs.sparse import SparseRows, scale_of, without_rows
from drake_rho.scenario.convex_sets import Each
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.shapes.unbounded import Cone

_INACTIVE = 1e-9
"""Multiplier of a set, relative to the largest one, up to which the set is inactive."""


@dataclasses.dataclass(frozen=True, eq=False)
class ConicAnswer:
    """Solution of the program of one group of vehicles, in terms of rows."""

    accelerations: FloatArray
    """u in units, shape (G, K-1, 3); meaningless if there is no solution"""
    feasible: bool
    """whether there is a solution; if false, infeasibility is proved"""
    exact: bool
    """whether the solution meets the solver's tolerances"""
    multipliers: FloatArray
    """multipliers of the given rows, scaled to length one, shape (R,)"""
    tangents: list[tuple[HalfSpaces, FloatArray]]
    """active tangent planes of each set, with their multipliers"""
    solver: str
    """name of the solver"""
    seconds: float
    """time reported by the solver [s]"""

    def answers(self, group: IntArray, rows: Sequence[HalfSpaces]) -> Answers:
        """Return the solution as an answer to a program of rows only.

        Args:
            group: the indices of the vehicles, shape (G,).
            rows: the given rows and the tangent planes, constraint by constraint.
        """
        tangents = {planes.constraint.key: y for planes, y in self.tangents}
        given, y = self.multipliers, list[FloatArray]()
        for part in rows:
            if part.constraint.key in tangents:
                y.append(tangents[part.constraint.key])
            else:
                own, given = np.split(given, [len(part)])
                y.append(own)
        every = np.concatenate([np.zeros(0), *y])
        return Answers(
            group[None],
            self.accelerations[None],
            np.array([self.feasible]),
            np.array([self.exact]),
            [lambda: every],
            np.ones((1, len(every))),
            self.solver,
            self.seconds,
        )


class ConicPrograms:
    """Programs of one scenario's vehicles with curved sets as cones.

    A feasibility restoration solves hundreds of programs that differ in their rows only, and cones
    take longest to write. Programs without rows are therefore stored and copied.

    Args:
        effort: the minimum-effort motions; solutions are changes from them.

    Attributes:
        needed: flags of vehicles whose sets enter as cones from the start, because their tangent
            planes did not converge in an earlier program, shape (N,).
    """

    def __init__(self, effort: MinimumEffort) -> None:
        self.needed: BoolArray = np.zeros(len(effort.changes.units), dtype=bool)
        self._effort = effort
        self._without_rows: dict[tuple[object, ...], _ProgramWithoutRows] = {}

    def solve(
        self,
        group: IntArray,
        rows: Sequence[HalfSpaces],
        sets: Sequence[KeepInSets],
        *,
        rough: bool = False,
    ) -> ConicAnswer:
        """Solve the program of a group of vehicles.

        Args:
            group: the indices of the vehicles, ascending, shape (G,).
            rows: the rows of all other constraints, constraint by constraint.
            sets: the constraints with curved sets; two with the same key and penalty are equal in
                all calls.
            rough: whether a solution of low accuracy is sufficient.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        changes, given = self._effort.changes, about(self._effort.motion, rows)
        common = self._program_without_rows(group, given, sets)
        program, lengths = common.program.Clone(), np.zeros(0)
        if count := sum(map(len, given)):
            sparse = SparseRows(changes, group, given, beside=common.axes)
            matrix, needed, penalties, lengths = sparse.matrix()
            add_rows(program, matrix, needed, penalties, slacks_of(given), common.x)
        solution, steps = (
            solve([program], Backend(accuracy="rough" if rough else "full"))[0],
            changes.grid.knots - 1,
        )
        y = solution.multipliers()
        ends = np.cumsum([len(each) for each in common.cones])
        duals = np.split(y[count:].reshape(-1, 4), ends[:-1])
        return ConicAnswer(
            solution.x[: 3 * steps * len(group)].reshape(-1, steps, 3),
            solution.feasible,
            solution.exact,
            np.maximum(y[:count], 0.0) * lengths,
            [
                cone.tangents(own, long)
                for cone, own, long in zip(common.cones, duals, common.lengths, strict=True)
            ],
            solution.solver,
            solution.seconds,
        )

    def _program_without_rows(
        self, group: IntArray, rows: Sequence[Rows], sets: Sequence[KeepInSets]
    ) -> _ProgramWithoutRows:
        """Return the program with its sets only, and with the variables that rows need."""
        quantities = frozenset(part.form.quantity for part in rows)
        key = *group.tolist(), quantities, *((each.key, each.penalty) for each in sets)
        if key not in self._without_rows:
            self._without_rows[key] = self._write(group, rows, sets)
        return self._without_rows[key]

    def _write(
        self, group: IntArray, rows: Sequence[Rows], sets: Sequence[KeepInSets]
    ) -> _ProgramWithoutRows:
        changes, motion = self._effort.changes, self._effort.motion
        cones = [cone for each in sets if len(cone := Cones.of(each, motion, group)) > 0]
        axes = about(motion, [cone.axes for cone in cones])
        sparse = SparseRows(changes, group, axes, beside=rows)
        program, x = without_rows(sparse)
        matrix, needed, penalties, lengths = sparse.matrix()
        ends = np.cumsum([0, *map(len, axes)]).tolist()
        parts = [slice(*each) for each in pairwise(ends)]
        unit, step = changes.units[group].max(), changes.grid.step
        for cone, own in zip(cones, parts, strict=True):
            scale = unit * scale_of(cone.constraint.quantity, step)
            cone.add(program, x, matrix[own], needed[own], penalties[own], scale)
        return _ProgramWithoutRows(program, x, cones, axes, [lengths[own] for own in parts])


class _ProgramWithoutRows(NamedTuple):
    """Program with cones, to which rows can be added."""

    program: MathematicalProgram
    """the program"""
    x: np.ndarray
    """its variables, except for slacks"""
    cones: list[Cones]
    """cones of each constraint"""
    axes: list[Rows]
    """rows whose values are in the cones, for each constraint"""
    lengths: list[FloatArray]
    """factors by which multipliers of the axes become those of rows of length one"""


@dataclasses.dataclass(frozen=True, eq=False)
class Cones:
    """Sets of a constraint as cones norm(B y) <= a · y + c, where y is the value minus the origin.

    The constants c include the constraint's margins.
    """

    constraint: KeepInSets
    """the constraint"""
    vehicles: IntArray
    """index of the vehicle of each cone, shape (R,)"""
    times: FloatArray
    """time of each cone since the first knot [s], shape (R,)"""
    matrices: FloatArray
    """rows a and B stacked, shape (R, 4, 3)"""
    constants: FloatArray
    """c, in the quantity's unit, shape (R,)"""

    @classmethod
    def of(cls, constraint: KeepInSets, motion: Motion, group: IntArray) -> Self:
        """Return the cones of some vehicles at all instants of the constraint."""
        local = constraint.values(motion, group)
        matrices, constants = constraint.sets.cones(local.vehicles)
        limited = np.isfinite(constants)
        vehicles, times = local.vehicles[limited], local.times[limited]
        room = constraint.roundings[vehicles] - constraint.margin(times)
        constants = constants[limited] + room
        return cls(constraint, vehicles, times, matrices[limited], constants)

    @classmethod
    def of_gate(cls, gate: KeepInSets, motion: Motion) -> Self:
        """Return the cones of velocities at a waypoint: of a ball, a value or a direction.

        There are none for other sets.
        """
        cones = cls.of(gate, motion, gate.members)
        sets = gate.sets
        if not (isinstance(sets, Each) and isinstance(sets.set, Cone)) or sets.set.apex.any():
            return cones
        if gate.margin(gate.times).any():
            return cones
        count = len(gate.times)
        matrices = np.tile(sets.set.matrix, (count, 1, 1))
        who = np.full(count, gate.members[0])
        return cls(gate, who, gate.times, matrices, np.zeros(count))

    @property
    def are_points(self) -> bool:
        """Whether all are balls of radius zero, single values."""
        return not self.matrices[:, 0].any() and not self.constants.any()

    def __len__(self) -> int:
        """Return the number of cones, R."""
        return len(self.times)

    @cached_property
    def away(self) -> FloatArray:
        """Distances of the origins from zero, in the quantity's unit, shape (R,)."""
        return np.asarray(np.linalg.norm(self.constraint.sets.origins[self.vehicles], axis=1))

    @cached_property
    def half_widths(self) -> FloatArray:
        """Half-widths of balls at zero, perpendicular to the origins; 0 outside, shape (R,)."""
        product = (self.constants - self.away) * (self.constants + self.away)
        return np.asarray(np.sqrt(np.maximum(product, 0.0)))

    @cached_property
    def axes(self) -> HalfSpaces:
        """Rows whose values are the components of y, three for each cone, 3 R rows."""
        vehicles, times = np.repeat(self.vehicles, 3), np.repeat(self.times, 3)
        return HalfSpaces(
            self.constraint,
            vehicles=vehicles,
            partners=vehicles,
            sides=np.zeros(len(times), dtype=int),
            times=times,
            normals=np.tile(np.eye(3), (len(self), 1)),
            bounds=self.constraint.sets.origins[self.vehicles].reshape(-1),
            tolerances=self.constraint.sets.tolerances[vehicles],
        )

    def add(
        self,
        program: MathematicalProgram,
        x: np.ndarray,
        matrix: scipy.sparse.csc_array,
        needed: FloatArray,
        penalties: FloatArray,
        scale: float,
    ) -> None:
        """Add the cones to a program; each cone of a soft constraint has a slack.

        Args:
            program: a program in the sparse form.
            x: its variables.
            matrix: coefficients of the axes, shape (3 R, V): y is `scale` (matrix @ x - needed).
            needed: right-hand sides of the axes, shape (3 R,).
            penalties: penalties of a violation by `scale`, shape (3 R,).
            scale: the unit of values in the program, in the quantity's unit.
        """
        values = program.NewContinuousVariables(len(self), 4)
        identity, zero = np.eye(4), np.zeros(4)
        each = np.arange(len(self) + 1)
        transform = scipy.sparse.bsr_array((self.matrices, each[:-1], each))  # block-diagonal
        offsets = -(transform @ needed).reshape(-1, 4)
        offsets[:, 0] += self.constants / scale
        parts, variables = (
            [transform @ matrix, -scipy.sparse.eye_array(values.size)],
            [x, values.reshape(-1)],
        )
        if np.isfinite(self.constraint.penalty):
            slacks = program.NewContinuousVariables(len(self))
            program.AddBoundingBoxConstraint(0.0, np.inf, slacks)
            program.AddLinearCost(penalties[::3], slacks)
            parts.append(scipy.sparse.kron(scipy.sparse.eye_array(len(self)), np.eye(4, 1)))
            variables.append(slacks)
        equations = scipy.sparse.csc_matrix(scipy.sparse.hstack(parts, format="csc"))
        program.AddLinearEqualityConstraint(
            equations, -offsets.reshape(-1), np.concatenate(variables)
        )
        for value in values:
            program.AddLorentzConeConstraint(identity, zero, value)

    def tangents(self, duals: FloatArray, lengths: FloatArray) -> tuple[HalfSpaces, FloatArray]:
        """Return the tangent half-spaces of the active cones, and their multipliers.

        If (p, q) is the multiplier of a cone, norm(q) <= p, all values inside satisfy
        p (a · y + c) + q · B y >= 0. If the cone is active, norm(q) is p.

        Args:
            duals: the multipliers of the cones, shape (R, 4).
            lengths: factors by which multipliers of the axes become those of rows of length one,
                shape (3 R,).
        """
        inward = np.einsum("ri,rij->rj", duals, self.matrices)
        sizes = np.linalg.norm(inward, axis=1)
        active = np.flatnonzero(sizes > _INACTIVE * sizes.max(initial=0.0))
        outward = -inward[active] / sizes[active, None]
        times = self.times[active]
        places = self.constraint.sets.offset(times)
        rows = self.constraint.rows(self.vehicles[active], times, outward, places)
        return rows, sizes[active] * lengths[::3][active]
