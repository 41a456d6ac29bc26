"""Sparse form of programs with many rows: velocities and positions are variables too.

In terms of accelerations only, a row of a velocity or position has an entry for every step before
it. With (1) and (2) as equalities it has a few entries, and the program grows linearly in K.

The variables are u, then the velocities and the positions at the knots after the first, if rows
need them; all are differences from the minimum-effort motion. Velocities are in units of u h and
positions in units of u h², so that (1) and (2) have entries of about one for any number of steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import coo_array, csc_array, csc_matrix, diags_array, eye_array, hstack, kron

from drake_rho.motion.dynamics import step_at
from drake_rho.motion.smooth import steps_around
from drake_rho.planning.constraints.rows import Rows
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs.program import add_cost
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

_Term = tuple[IntArray, FloatArray]
"""Indices of the vectors of variables with entries in rows (-1 for none), and factors."""


class SparseRows:
    """Rows of a group of vehicles as sparse rows matrix @ x >= needed.

    Args:
        changes: the changes of minimum-effort motions that rows refer to.
        group: the indices of the vehicles, shape (G,).
        rows: the rows, constraint by constraint.
        beside: other rows of the same program, whose quantities also need variables.

    Attributes:
        changes: the changes of minimum-effort motions that rows refer to.
        group: the indices of the vehicles, shape (G,).
        steps: the number of steps, K - 1.
    """

    def __init__(
        self,
        changes: Changes,
        group: IntArray,
        rows: Sequence[Rows],
        *,
        beside: Sequence[Rows] = (),
    ) -> None:
        self.changes, self.group, self.steps = changes, group, changes.grid.knots - 1
        self._rows = [part for part in rows if len(part) > 0]
        quantities = {part.form.quantity for part in (*self._rows, *beside)}
        self._positions = "position" in quantities
        self._velocities = self._positions or "velocity" in quantities

    @property
    def columns(self) -> int:
        """Number of variables."""
        return 3 * self.steps * len(self.group) * (1 + self._velocities + self._positions)

    def dynamics(self) -> Iterator[csc_matrix]:
        """Yield (1) and (2) for the states among the variables: matrices with matrix @ x = 0."""
        blocks = 1 + self._velocities + self._positions
        for order in range(1, blocks):
            yield _dynamics(self.steps, len(self.group), order, blocks)

    def matrix(self) -> tuple[csc_array, FloatArray, FloatArray, FloatArray]:
        """Return the rows.

        Returns:
            The matrix, `needed`, penalties of a violation by one, and factors by which multipliers
            of the rows become those of rows of length one.
        """
        grid, unit = self.changes.grid, self.changes.units[self.group].max()
        places, entries, needed, penalties, lengths = [], [], [], [], []
        first = 0
        for part in self._rows:
            scale, terms = scale_of(part.form.quantity, grid.step), self._terms(part)
            rows = first + np.arange(len(part))
            for vectors, factors in terms:
                there = vectors >= 0
                columns = 3 * vectors[there, None] + np.arange(3)
                places.append(np.stack([np.repeat(rows[there], 3), columns.reshape(-1)]))
                entries.append((factors[there, None] * part.normals[there]).reshape(-1))
            needed.append(part.bounds / (unit * scale))
            penalties.append(part.penalties * scale / unit)
            partners = part.partners if part.form.coupled else None
            several = self.changes.factors_of(part.vehicles, partners)
            norms = np.linalg.norm(part.responses(grid), axis=1)
            lengths.append(several * norms / scale)
            first += len(part)
        if first == 0:
            none = np.zeros(0)
            return csc_array((0, self.columns)), none, none, none
        values, (rows, columns) = np.concatenate(entries), np.concatenate(places, axis=1)
        matrix = coo_array((values, (rows, columns)), shape=(first, self.columns)).tocsc()
        matrix.eliminate_zeros()
        return matrix, np.concatenate(needed), np.concatenate(penalties), np.concatenate(lengths)

    def _terms(self, rows: Rows) -> list[_Term]:
        """Return the terms whose sum is the rows' quantity, in its scale."""
        terms = self._terms_of(rows, rows.vehicles)
        if rows.form.coupled:
            less = self._terms_of(rows, rows.partners)
            terms += [(vectors, -factors) for vectors, factors in less]
        return terms

    def _terms_of(self, rows: Rows, vehicles: IntArray) -> list[_Term]:
        n, h = self.steps, self.changes.grid.step
        one, all_steps = self.changes.factors_of(vehicles), n * len(self.group)
        u = n * np.searchsorted(self.group, vehicles)  # index of the vehicle's first vector
        if rows.form.quantity in ("acceleration", "jerk"):
            k = step_at(rows.times, h)
            if rows.form.quantity == "acceleration":
                return [(u + k, one)]
            later, earlier = np.where(k < n, u + k, -1), np.where(k > 0, u + k - 1, -1)
            return [(later, one), (earlier, -one)]
        # before the first knot, where only averages change, the plan is at its start
        times = np.maximum(rows.times, 0.0)
        k = np.minimum(step_at(times, h), n - 1)
        s = times / h - k
        # knots count from 0; the first state variable belongs to knot 1
        velocities = np.where(k > 0, all_steps + u + k - 1, -1)
        if rows.form.quantity == "velocity":
            return [(velocities, one), (u + k, s * one)]
        positions = np.where(k > 0, 2 * all_steps + u + k - 1, -1)
        terms = [(positions, one), (velocities, s * one), (u + k, s**2 / 2 * one)]
        if rows.form.averaged is not None:
            steps, added = steps_around(rows.form.averaged, self.changes.grid, rows.times)
            near = np.where(steps >= 0, u[:, None] + steps, -1)
            terms += [(near[:, i], added[:, i] / h**2 * one) for i in range(near.shape[1])]
        return terms


def scale_of(quantity: Quantity, step: float) -> float:
    """Return the unit of a quantity in rows of sparse programs, for a unit acceleration of 1."""
    return step ** {"position": 2, "velocity": 1, "acceleration": 0, "jerk": -1}[quantity]


def without_rows(sparse: SparseRows) -> tuple[MathematicalProgram, np.ndarray]:
    """Return a sparse program with only its cost, goal and dynamics, and its variables."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(sparse.columns)
    u = x[: 3 * sparse.steps * len(sparse.group)]
    if not sparse.changes.free:
        add_cost(program, u)
    add_goal(program, sparse.changes, u)
    for equations in sparse.dynamics():
        zero = np.zeros(equations.shape[0])
        program.AddLinearEqualityConstraint(equations, zero, x)
    return program, x


def add_goal(to: MathematicalProgram, changes: Changes, u: np.ndarray) -> None:
    """Add (12): position and velocity at the last knot remain those of minimum effort."""
    rows, steps = changes.goals, changes.grid.knots - 1
    for first in range(0, len(u) if len(rows) > 0 else 0, 3 * steps):
        for axis in range(3):
            own = u[first + axis : first + 3 * steps : 3]
            to.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), own)


@lru_cache(maxsize=16)
def _dynamics(steps: int, vehicles: int, order: int, blocks: int) -> csc_matrix:
    """Return (1), for order 1, or (2), for order 2, of all vehicles and axes.

    Args:
        steps: the number of steps, K - 1.
        vehicles: the number of vehicles, G.
        order: 1 or 2.
        blocks: the number of kinds of variables: accelerations, velocities, positions.
    """
    one = eye_array(steps)
    before = diags_array([np.ones(steps - 1)], offsets=[-1], shape=(steps, steps))
    parts = [-one, one - before] if order == 1 else [-one / 2, -before, one - before]
    every, axes = eye_array(vehicles), eye_array(3)
    whole = hstack([kron(kron(every, part), axes) for part in parts], format="csc")
    whole.resize((whole.shape[0], 3 * steps * vehicles * blocks))
    return csc_matrix(whole)
