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
import scipy  # its parts load when first used
from pydrake.solvers import MathematicalProgram

from drake_rho.motion.dynamics import step_at
from drake_rho.motion.smooth import steps_around
from drake_rho.planning.constraints.rows import Rows
from drake_rho.planning.cost_terms import CostTerms
from drake_rho.planning.minimum_effort import Changes
from drake_rho.planning.programs.program import add_cost
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity

_BLOCK = 50
"""Number of steps in one quadratic cost, whose matrix is dense in Drake."""

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
        quantities |= set[Quantity]().union(*(each.counted for each in changes.spaces))
        self._positions = "position" in quantities
        self._velocities = self._positions or "velocity" in quantities

    @property
    def columns(self) -> int:
        """Number of variables."""
        return 3 * self.steps * len(self.group) * (1 + self._velocities + self._positions)

    def dynamics(self) -> Iterator[scipy.sparse.csc_matrix]:
        """Yield (1) and (2) for the states among the variables: matrices with matrix @ x = 0."""
        blocks = 1 + self._velocities + self._positions
        for order in range(1, blocks):
            yield _dynamics(self.steps, len(self.group), order, blocks)

    def matrix(self) -> tuple[scipy.sparse.csc_array, FloatArray, FloatArray, FloatArray]:
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
            responses = part.responses(grid)
            lengths.append(self.changes.lengths_of(responses, part.vehicles, partners) / scale)
            first += len(part)
        if first == 0:
            none = np.zeros(0)
            return scipy.sparse.csc_array((0, self.columns)), none, none, none
        values, (rows, columns) = np.concatenate(entries), np.concatenate(places, axis=1)
        matrix = scipy.sparse.coo_array(
            (values, (rows, columns)), shape=(first, self.columns)
        ).tocsc()
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
        _add_cost(program, sparse, x)
    add_goal(program, sparse.changes, sparse.group, u)
    for equations in sparse.dynamics():
        zero = np.zeros(equations.shape[0])
        program.AddLinearEqualityConstraint(equations, zero, x)
    return program, x


def _add_cost(program: MathematicalProgram, sparse: SparseRows, x: np.ndarray) -> None:
    """Add the cost of a group's changes, in squared units."""
    size = 3 * sparse.steps
    if all(space.terms is None for space in sparse.changes.spaces):
        add_cost(program, x[: size * len(sparse.group)])
        return
    blocks = x.reshape(-1, len(sparse.group), sparse.steps, 3)
    for number, vehicle in enumerate(sparse.group.tolist()):
        space = sparse.changes.space(vehicle)
        if space.terms is None:
            add_cost(program, blocks[0, number].reshape(-1))
        else:
            _add_terms(program, space.terms, space.unit, blocks[:, number])


def _add_terms(
    program: MathematicalProgram, terms: CostTerms, unit: float, blocks: np.ndarray
) -> None:
    """Add the terms of one vehicle's cost.

    Args:
        program: the program.
        terms: the terms.
        unit: the cost that counts as one.
        blocks: variables of the vehicle, shape (1 to 3, K-1, 3): accelerations, velocities in
            units of u h, and positions in units of u h².
    """
    steps, h, weights = terms.knots - 1, terms.step, terms.weights
    local = terms.of_accelerations / np.sqrt(unit)
    for first in range(0, steps, _BLOCK):
        # a row belongs to the block in which its first step is; it reaches two steps further
        begins = np.argmax(local != 0.0, axis=1)
        own = local[(begins >= first) & (begins < first + _BLOCK)][:, first : first + _BLOCK + 2]
        if len(own) > 0:
            for axis in range(3):
                u = blocks[0, first : first + _BLOCK + 2, axis]
                program.AddQuadraticCost(2.0 * own.T @ own, np.zeros(len(u)), u, is_convex=True)
    states = (
        (1, weights.velocity, weights.terminal_velocity),
        (
            2,
            weights.position,
            weights.terminal_position,
        ),
    )
    for order, tracked, terminal in states:
        if tracked > 0.0 or terminal > 0.0:
            scale = h ** (2 * order) / unit
            squares = np.full(steps, tracked * scale)
            squares[-1] += terminal * scale
            for first in range(0, steps, _BLOCK):
                own = blocks[order, first : first + _BLOCK].reshape(-1)
                hessian = np.diag(2.0 * np.repeat(squares[first : first + _BLOCK], 3))
                program.AddQuadraticCost(hessian, np.zeros(len(own)), own, is_convex=True)


def add_goal(to: MathematicalProgram, changes: Changes, group: IntArray, u: np.ndarray) -> None:
    """Add (12) of a group: changes leave what goals fix at the last knot as it is."""
    steps = changes.grid.knots - 1
    for number, vehicle in enumerate(group.tolist()):
        rows = changes.space(vehicle).rows
        for axis in range(3 if len(rows) > 0 else 0):
            own = u[3 * steps * number + axis : 3 * steps * (number + 1) : 3]
            to.AddLinearEqualityConstraint(rows, np.zeros(len(rows)), own)


@lru_cache(maxsize=16)
def _dynamics(steps: int, vehicles: int, order: int, blocks: int) -> scipy.sparse.csc_matrix:
    """Return (1), for order 1, or (2), for order 2, of all vehicles and axes.

    Args:
        steps: the number of steps, K - 1.
        vehicles: the number of vehicles, G.
        order: 1 or 2.
        blocks: the number of kinds of variables: accelerations, velocities, positions.
    """
    one = scipy.sparse.eye_array(steps)
    before = scipy.sparse.diags_array([np.ones(steps - 1)], offsets=[-1], shape=(steps, steps))
    parts = [-one, one - before] if order == 1 else [-one / 2, -before, one - before]
    every, axes = scipy.sparse.eye_array(vehicles), scipy.sparse.eye_array(3)
    whole = scipy.sparse.hstack(
        [scipy.sparse.kron(scipy.sparse.kron(every, part), axes) for part in parts], format="csc"
    )
    whole.resize((whole.shape[0], 3 * steps * vehicles * blocks))
    return scipy.sparse.csc_matrix(whole)
