"""Programs of groups of vehicles by their duals: approximate, and fast.

With u the accelerations of a group less those of minimum effort, the least norm(u)² that keeps rows
M u >= b is that of u = M.T @ y, where y >= 0 minimises norm(M.T @ y)² / 2 - b · y. That needs no
more than the products of rows with each other, M @ M.T, whose size is the number of rows. It is
solved by the active-set method of Lawson and Hanson for non-negative least squares, from the last
multipliers.

A row is a response in time times a normal in space times the signs of one vehicle or two, and so is
the product of two rows that of these three.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv
from scipy.sparse import csr_array

from drake_rho.planning.errors import SolverError
from drake_rho.planning.half_spaces import HalfSpaces
from drake_rho.planning.minimum_effort import MinimumEffort
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

_RIDGE = 1e-9
"""What is added to the squared length of rows, which are of length one: rows of neighbouring
instants are almost the same, and may contradict each other."""

_BROKEN = 1e-9
"""By how much a row of length one may be broken, in the largest of what rows need."""

_MOST = 10
"""Bound on the changes of the set of active rows, in numbers of rows."""

_FIXED = 1e-9
"""Part of a row's length that is left where the goals decide all the rest, and it is left out."""


class LeastNorm:
    """The motions of least cost that keep some rows, which are added by and by.

    Args:
        effort: of the scenario.
        groups: for each vehicle the number of its group, shape (N,).

    Attributes:
        motion: of all vehicles, as last solved.
        programs: how many were solved.
    """

    def __init__(self, effort: MinimumEffort, groups: IntArray) -> None:
        steps = effort.grid.knots - 1
        self.motion, self.programs = effort.motion, 0
        self._effort, self._groups, self._parts = effort, groups, list[HalfSpaces]()
        self._one = self._other = np.zeros(0, dtype=int)
        self._responses, self._normals = np.zeros((0, steps)), np.zeros((0, 3))
        self._needed = self._multipliers = np.zeros(0)
        self._pending = np.zeros(len(groups), dtype=bool)

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self._needed)

    def add(self, rows: HalfSpaces) -> None:
        """Add rows; the vehicles of those that couple two are of the same group."""
        other = rows.partners if rows.constraint.coupled else np.full(len(rows), -1)
        responses = rows.responses(self._effort.grid)
        inside = self._effort.changes.inside(responses)
        several = 2.0 if rows.constraint.coupled else 1.0
        lengths = np.sqrt(several * np.einsum("rj,rj->r", inside, inside))
        fixed = lengths <= _FIXED * np.sqrt(np.einsum("rj,rj->r", responses, responses))
        scales = np.where(fixed, 0.0, 1.0 / np.where(fixed, 1.0, lengths))
        needed = -scales * rows.margins(self._effort.motion)
        self._parts.append(rows)
        self._one = np.append(self._one, rows.vehicles)
        self._other = np.append(self._other, other)
        self._responses = np.concatenate([self._responses, scales[:, None] * inside])
        self._normals = np.concatenate([self._normals, rows.normals])
        self._needed = np.append(self._needed, needed)
        self._multipliers = np.append(self._multipliers, np.zeros(len(rows)))
        self._pending[self._groups[rows.vehicles]] = True

    def solve(self) -> None:
        """Find the motions of the groups that have new rows.

        Raises:
            SolverError: it comes to no end.
        """
        groups = self._groups[self._one]
        rows = np.flatnonzero(self._pending[groups])
        rows = rows[np.argsort(groups[rows], kind="stable")]
        ends = np.flatnonzero(np.diff(groups[rows])) + 1
        for own in np.split(rows, ends) if len(rows) > 0 else ():
            self._multipliers[own] = self._solved(own)
            self.programs += 1
        self._move(self._pending[self._groups])
        self._pending[:] = False

    def pressing(self) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows with multipliers above zero, as they were added, and these [m/s²]."""
        ends = np.cumsum(list(map(len, self._parts)))[:-1]
        every = zip(self._parts, np.split(self._multipliers, ends), strict=True)
        return [(rows.select(y > 0.0), y[y > 0.0]) for rows, y in every]

    def _solved(self, own: IntArray) -> FloatArray:
        """The multipliers of the rows of one group."""
        responses, normals, needed = self._responses[own], self._normals[own], self._needed[own]
        signs = self._signs(own)
        products = (signs.T @ signs).toarray()
        products *= (responses @ responses.T) * (normals @ normals.T)
        np.fill_diagonal(products, products.diagonal() + _RIDGE)
        unit = np.abs(needed).max(initial=np.finfo(float).tiny)
        multipliers: FloatArray = unit * multipliers_of(
            products, needed / unit, self._multipliers[own] / unit
        )
        return multipliers

    def _signs(self, rows: IntArray) -> csr_array:
        """The sign of each vehicle in some rows, shape (N, R)."""
        one, other = self._one[rows], self._other[rows]
        place, both = np.arange(len(rows)), np.flatnonzero(other >= 0)
        values = np.append(np.ones(len(rows)), -np.ones(len(both)))
        where = np.append(one, other[both]), np.append(place, both)
        return csr_array((values, where), shape=(len(self._groups), len(rows)))

    def _move(self, moved: BoolArray) -> None:
        """Let some vehicles fly what the multipliers say."""
        vehicles = np.flatnonzero(moved)
        rows = np.flatnonzero((self._multipliers > 0.0) & moved[self._one])
        weighted = self._multipliers[rows, None] * self._responses[rows]
        each = weighted[:, :, None] * self._normals[rows, None, :]
        least = self._effort.motion.accelerations
        changes = self._signs(rows) @ each.reshape(len(rows), least[0].size)
        accelerations = least[vehicles] + changes[vehicles].reshape(-1, *least.shape[1:])
        self.motion = self.motion.with_some(vehicles, accelerations)


def multipliers_of(products: FloatArray, needed: FloatArray, y: FloatArray) -> FloatArray:
    """The y >= 0 that minimises y · products @ y / 2 - needed · y (Lawson and Hanson).

    Several rows become active at once, all that are broken half as much as the worst. The cost
    falls no less: those whose multipliers would be below zero leave again before they move.

    Args:
        products: positive definite, shape (R, R).
        needed: shape (R,).
        y: where to begin, at least 0; what is zero and broken there begins as active, shape (R,).

    Raises:
        SolverError: it comes to no end, or `products` is not what it should be.
    """
    active = (y > 0.0) | (needed - products @ y > _BROKEN)
    for _ in range(_MOST * len(y)):
        rows = np.flatnonzero(active)
        z = np.zeros_like(y)
        if len(rows) > 0:
            _, z[rows], failed = dposv(products[rows[:, None], rows], needed[rows])
            if failed:
                break
        leaving = np.flatnonzero(active & (z <= 0.0))
        if len(leaving) > 0:
            parts = y[leaving] / np.maximum(y[leaving] - z[leaving], np.finfo(float).tiny)
            y = y + parts.min() * (z - y)
            active[leaving[parts <= parts.min()]] = False
            y[~active] = 0.0
            continue
        y, broken = z, np.where(active, 0.0, needed - products @ z)
        if broken.max() <= _BROKEN:
            return y
        active |= broken > 0.5 * broken.max()
    raise SolverError("the multipliers of a group were not found")
