"""Programs with curved sets as second-order cones, where tangent planes come to no end.

Tangent planes find most solutions in a few small programs. Where a set leaves nearly no room, each
round of them only halves what is left outside, and thousands of nearly parallel planes take the
solvers' digits. There the sets themselves enter one program, which Clarabel takes as it is. Its
multipliers say which tangent planes lead to the same solution or, where there is none, contradict
each other (conic duality), so that everything else goes on to know nothing but rows.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import bsr_array, csc_array, csc_matrix, eye_array, hstack, kron

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.convex_sets import KeepInSets
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dense import add_rows
from drake_rho.planning.programs.parallel import Answers
from drake_rho.planning.programs.reduced import slacks_of
from drake_rho.planning.programs.rows import Rows, about
from drake_rho.planning.programs.solve import solve
from drake_rho.planning.programs.sparse import SparseRows, scale_of, without_rows
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_NO_PART = 1e-9
"""Part of the largest multiplier up to which a set has no part in a solution."""


@dataclasses.dataclass(frozen=True, eq=False)
class ConicAnswer:
    """What was found for one group of vehicles, in terms of rows."""

    accelerations: FloatArray
    """u in units; they mean nothing where there is no solution, shape (G, K-1, 3)"""
    feasible: bool
    """whether there is a solution; if not, it is proved that there is none"""
    exact: bool
    """whether it is one to the solver's tolerances"""
    multipliers: FloatArray
    """of the rows that were given, if these have length one, shape (R,)"""
    tangents: list[tuple[HalfSpaces, FloatArray]]
    """the tangent planes of each set that take part, and their multipliers"""
    solver: str
    """which solver found it"""
    seconds: float
    """time that the solver reports for itself [s]"""

    def answers(self, group: IntArray, rows: Sequence[HalfSpaces]) -> Answers:
        """Return the same as the answer of a program of rows alone.

        Args:
            group: the indices of the vehicles, shape (G,).
            rows: those that were given and the tangent planes, constraint by constraint.
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
    """Programs of one scenario's vehicles with curved sets as they are.

    Restorations solve hundreds of them that differ in their rows only, and the cones take longest
    to write: programs without rows are kept and copied.

    Args:
        effort: minimum effort of the scenario, which changes are about and are added to.

    Attributes:
        needed: whose sets enter from the start, as tangent planes of them came to no end in one of
            the programs, shape (N,).
    """

    def __init__(self, effort: MinimumEffort) -> None:
        self.needed: BoolArray = np.zeros(len(effort.units), dtype=bool)
        self._effort = effort
        self._begun: dict[tuple[object, ...], _IterationOffset] = {}

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
            group: the indices of the vehicles, rising, shape (G,).
            rows: of everything else, constraint by constraint.
            sets: the constraints with curved sets; those of one key and penalty are the same
                whenever they are given.
            rough: whether few digits do.

        Raises:
            SolverError: Clarabel fails numerically.
        """
        changes, given = self._effort.changes, about(self._effort.motion, rows)
        begun = self._before_rows(group, given, sets)
        program, lengths = begun.program.Clone(), np.zeros(0)
        if count := sum(map(len, given)):
            sparse = SparseRows(changes, group, given, beside=begun.axes)
            matrix, needed, penalties, lengths = sparse.matrix()
            add_rows(program, matrix, needed, penalties, slacks_of(given), begun.x)
        solution, steps = (
            solve([program], Backend(accuracy="rough" if rough else "full"))[0],
            changes.grid.knots - 1,
        )
        y = solution.multipliers()
        ends = np.cumsum([len(each) for each in begun.cones])
        duals = np.split(y[count:].reshape(-1, 4), ends[:-1])
        return ConicAnswer(
            solution.x[: 3 * steps * len(group)].reshape(-1, steps, 3),
            solution.feasible,
            solution.exact,
            np.maximum(y[:count], 0.0) * lengths,
            [
                cone.tangents(own, long)
                for cone, own, long in zip(begun.cones, duals, begun.lengths, strict=True)
            ],
            solution.solver,
            solution.seconds,
        )

    def _before_rows(
        self, group: IntArray, rows: Sequence[Rows], sets: Sequence[KeepInSets]
    ) -> _IterationOffset:
        """Return the program with its sets only, for rows of the quantities of these."""
        quantities = frozenset(part.quantity for part in rows)
        key = *group.tolist(), quantities, *((each.key, each.penalty) for each in sets)
        if key not in self._begun:
            self._begun[key] = self._write(group, rows, sets)
        return self._begun[key]

    def _write(
        self, group: IntArray, rows: Sequence[Rows], sets: Sequence[KeepInSets]
    ) -> _IterationOffset:
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
        return _IterationOffset(program, x, cones, axes, [lengths[own] for own in parts])


class _IterationOffset(NamedTuple):
    """A program before its rows."""

    program: MathematicalProgram
    """with the cones"""
    x: np.ndarray
    """its variables but slacks"""
    cones: list[Cones]
    """one for each constraint"""
    axes: list[Rows]
    """the values in them, one for each constraint"""
    lengths: list[FloatArray]
    """factors that turn multipliers of the axes into those of rows of length one"""


@dataclasses.dataclass(frozen=True, eq=False)
class Cones:
    """A constraint's sets as cones: norm(B y) <= a · y + reach, y the value less the set's place.

    The margin by which values stay inside is taken off the reach.
    """

    constraint: KeepInSets
    """whose sets they are"""
    vehicles: IntArray
    """whose value is in each, shape (R,)"""
    times: FloatArray
    """when, since the first knot [s], shape (R,)"""
    matrices: FloatArray
    """a above B, shape (R, 4, 3)"""
    reaches: FloatArray
    """in the quantity's unit, shape (R,)"""

    @classmethod
    def of(cls, constraint: KeepInSets, motion: Motion, group: IntArray) -> Self:
        """Return the cones of some vehicles at all instants at which they are asked for."""
        required = constraint.required_values(motion, group)
        matrices, reaches = constraint.sets.cones(required.vehicles)
        limited = np.isfinite(reaches)
        who, times = required.vehicles[limited], required.times[limited]
        reaches = reaches[limited] - constraint.margin(times)
        return cls(constraint, who, times, matrices[limited], reaches)

    def __len__(self) -> int:
        """R."""
        return len(self.times)

    @cached_property
    def axes(self) -> HalfSpaces:
        """Rows whose margins are y, axis by axis of each instant, shape (3 R,)."""
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
        matrix: csc_array,
        needed: FloatArray,
        penalties: FloatArray,
        scale: float,
    ) -> None:
        """Add the cones to a program, with a slack for each where they may be left.

        Args:
            program: in the sparse form.
            x: its variables.
            matrix: of the axes, shape (3 R, V): y is `scale` times matrix @ x - needed.
            needed: shape (3 R,).
            penalties: what it costs to be outside by `scale`, shape (3 R,).
            scale: in the quantity's unit.
        """
        values = program.NewContinuousVariables(len(self), 4)
        identity, zero = np.eye(4), np.zeros(4)
        each = np.arange(len(self) + 1)
        transform = bsr_array((self.matrices, each[:-1], each))  # block-diagonal
        offsets = -(transform @ needed).reshape(-1, 4)
        offsets[:, 0] += self.reaches / scale
        parts, variables = [transform @ matrix, -eye_array(values.size)], [x, values.reshape(-1)]
        if np.isfinite(self.constraint.penalty):
            slacks = program.NewContinuousVariables(len(self))
            program.AddBoundingBoxConstraint(0.0, np.inf, slacks)
            program.AddLinearCost(penalties[::3], slacks)
            parts.append(kron(eye_array(len(self)), np.eye(4, 1)))
            variables.append(slacks)
        equations = csc_matrix(hstack(parts, format="csc"))
        program.AddLinearEqualityConstraint(
            equations, -offsets.reshape(-1), np.concatenate(variables)
        )
        for value in values:
            program.AddLorentzConeConstraint(identity, zero, value)

    def tangents(self, duals: FloatArray, lengths: FloatArray) -> tuple[HalfSpaces, FloatArray]:
        """Return the half-spaces that multipliers of the cones stand for, and their multipliers.

        With (p, q), norm(q) <= p, the multiplier of a cone, everything inside has
        p (a · y + reach) + q · B y >= 0. Where the cone takes part, norm(q) is p.

        Args:
            duals: shape (R, 4).
            lengths: factors that turn multipliers of the axes into those of rows of length one,
                shape (3 R,).
        """
        pulls = np.einsum("ri,rij->rj", duals, self.matrices)
        sizes = np.linalg.norm(pulls, axis=1)
        part = np.flatnonzero(sizes > _NO_PART * sizes.max(initial=0.0))
        outward = -pulls[part] / sizes[part, None]
        rows = self.constraint.rows(self.vehicles[part], self.times[part], outward)
        return rows, sizes[part] * lengths[::3][part]
