"""Programs of groups of vehicles by their duals: approximate, and fast.

The unknowns are the accelerations of a group less those of minimum effort
(`drake_rho.planning.programs.dual`). Of the rows only the Gram matrix is needed.

A row is a response in time times a normal in space times the signs of one vehicle or two, and so is
the inner product of two rows that of these three.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, get_args

import numpy as np

from drake_rho.motion.dynamics import Motion, response
from drake_rho.planning.constraints.base import HalfSpaces, some_of
from drake_rho.planning.minimum_effort import Changes, MinimumEffort
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dual import multipliers_of
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.system.threads import single_threaded_blas

_RIDGE = 1e-9
"""What is added to the squared length of rows, which are of length one: rows of neighbouring
instants are almost the same, and may contradict each other."""

_FIXED = 1e-9
"""Part of a row's length that is left where the goals decide all the rest, and it is left out."""

_BLOCK = 8000
"""Rows in a block, those of some hundred vehicles: tens of milliseconds of work. It does not depend
on who does it, so that neither do the last digits of what is found."""

_QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


@dataclasses.dataclass(frozen=True, eq=False)
class Duals:
    """Rows of some groups, one group after the other, as processes can be sent them."""

    changes: Changes
    """what they are about"""
    by_daqp: bool
    """whether DAQP was asked for"""
    groups: IntArray
    """the number of the group of each row, rising, shape (R,)"""
    one: IntArray
    """the vehicle of each, shape (R,)"""
    other: IntArray
    """the vehicle whose part is taken off, or -1, shape (R,)"""
    quantities: IntArray
    """what they bound, as numbers of `_QUANTITIES`, shape (R,)"""
    times: FloatArray
    """when [s], shape (R,)"""
    normals: FloatArray
    """unit vectors, shape (R, 3)"""
    needed: FloatArray
    """what the motions of minimum effort leave to be done, in the quantity's unit, shape (R,)"""
    most: FloatArray
    """bounds on the multipliers: half the cost of each unit of slack, shape (R,)"""
    multipliers: FloatArray
    """where to begin, shape (R,)"""

    def __len__(self) -> int:
        """R."""
        return len(self.times)

    def select(self, rows: IntArray | slice) -> Duals:
        """Return some of the rows."""
        return Duals(self.changes, self.by_daqp, *some_of(self._arrays(), rows))

    def union(self, more: Duals) -> Duals:
        """Return these rows, then more."""
        pairs = zip(self._arrays(), more._arrays(), strict=True)
        return Duals(self.changes, self.by_daqp, *map(np.concatenate, pairs))

    def _arrays(self) -> tuple[Any, ...]:
        return (
            self.groups,
            self.one,
            self.other,
            self.quantities,
            self.times,
            self.normals,
            self.needed,
            self.most,
            self.multipliers,
        )

    @single_threaded_blas()
    def solved(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return multipliers, vehicles, and what is added to their accelerations (V, K-1, 3).

        Raises:
            SolverError: the multipliers of a group are not found.
        """
        inside, which, lengths = self._responses()
        scales = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
        normals, needed = scales[:, None] * self.normals, scales * self.needed  # of length one
        begins = np.flatnonzero(np.diff(self.groups, prepend=-1))
        units = np.maximum(np.maximum.reduceat(np.abs(needed), begins), np.finfo(float).tiny)
        unit = np.repeat(units, np.diff(begins, append=len(self)))
        needed, begin, most = needed / unit, self.multipliers * lengths / unit, np.ones(len(self))
        np.multiply(self.most, lengths / unit, out=most, where=lengths > 0.0)
        y, vehicles, added = np.zeros(len(self)), [], []
        for first, last in pairwise([*begins.tolist(), len(self)]):
            own = slice(first, last)
            responses = inside[which[own]]
            several, signs = self._signs(own)
            gram = (responses @ responses.T) * (normals[own] @ normals[own].T)
            if signs is not None:
                gram *= signs.T @ signs
            gram.flat[:: len(gram) + 1] += _RIDGE
            y[own] = multipliers_of(gram, needed[own], most[own], begin[own], by_daqp=self.by_daqp)
            push = (unit[first] * y[own])[:, None] * normals[own]
            vehicles.append(several)
            if signs is None:
                added.append((responses.T @ push)[None])
            else:
                parts = [(signs * push[:, axis]) @ responses for axis in range(3)]
                added.append(np.stack(parts, axis=2))
        return unit * scales * y, np.concatenate(vehicles), np.concatenate(added)

    def _responses(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Responses that leave goals alone (U, K-1), which of them is each row's, and its length.

        A row that the goals decide has length zero.
        """
        grid = self.changes.grid
        keys = self.quantities + 1j * self.times  # sorted several times as fast as pairs of them
        instants, which = np.unique(keys, return_inverse=True)
        numbers, times = instants.real.astype(int), instants.imag
        every = np.zeros((len(instants), grid.knots - 1))
        for number in np.unique(numbers).tolist():
            own = numbers == number
            every[own] = response(_QUANTITIES[number], grid.step, grid.knots, times[own])
        inside = self.changes.inside(every)
        before, lengths = (np.sqrt(np.vecdot(each, each)) for each in (every, inside))
        lengths[lengths <= _FIXED * before] = 0.0
        return inside, which, lengths[which] * np.where(self.other >= 0, np.sqrt(2.0), 1.0)

    def _signs(self, own: slice) -> tuple[IntArray, FloatArray | None]:
        """Return a group's vehicles, and their signs in its rows, (G, R); None if it is one."""
        one, other = self.one[own], self.other[own]
        if other.max() < 0 and (one == one[0]).all():
            return one[:1], None
        several = np.unique(np.concatenate([one, other[other >= 0]]))
        signs = (several[:, None] == one).astype(np.float64)
        signs -= several[:, None] == other
        return several, signs


class GroupDuals:
    """The motions of least cost that keep some rows, which are added by and by.

    Args:
        effort: of the scenario.
        groups: for each vehicle the number of its group, shape (N,).
        motion: what those fly who have no rows; motions of minimum effort if not given.
        backend: DAQP is asked where it is the solver; others have no part here.

    Attributes:
        motion: of all vehicles, as last solved.
        programs: how many were solved.
    """

    def __init__(
        self,
        effort: MinimumEffort,
        groups: IntArray,
        motion: Motion | None = None,
        backend: Backend | None = None,
    ) -> None:
        self.motion, self.programs = motion or effort.motion, 0
        self._effort, self._groups = effort, groups
        backend = backend or Backend()
        self._executor = backend.executor
        self._parts = list[HalfSpaces]()
        nobody, nothing = np.zeros(0, dtype=int), np.zeros(0)
        self._rows = Duals(
            effort.changes,
            backend.is_dense,
            *(nobody, nobody, nobody, nobody),
            *(nothing, np.zeros((0, 3)), nothing, nothing, nothing),
        )
        self._pending = np.zeros(len(groups), dtype=bool)

    def __len__(self) -> int:
        """How many rows there are."""
        return len(self._rows)

    def add(self, rows: HalfSpaces) -> None:
        """Add rows; the vehicles of those that couple two are of the same group."""
        constraint = rows.constraint
        self._parts.append(rows)
        more = Duals(
            self._effort.changes,
            self._rows.by_daqp,
            groups=self._groups[rows.vehicles],
            one=rows.vehicles,
            other=rows.partners if constraint.coupled else np.full(len(rows), -1),
            quantities=np.full(len(rows), _QUANTITIES.index(constraint.quantity)),
            times=rows.times,
            normals=rows.normals,
            needed=-rows.margins(self._effort.motion),
            most=np.full(len(rows), constraint.penalty / 2.0),
            multipliers=np.zeros(len(rows)),
        )
        self._rows = self._rows.union(more)
        self._pending[more.groups] = True

    def solve(self) -> None:
        """Find the motions of the groups that have new rows.

        Raises:
            SolverError: it comes to no end.
        """
        rows = np.flatnonzero(self._pending[self._rows.groups])
        rows = rows[np.argsort(self._rows.groups[rows], kind="stable")]
        self._pending[:] = False
        if len(rows) == 0:
            return
        own = self._rows.select(rows)
        blocks, least = list(_in_blocks(own)), self._effort.motion.accelerations
        places = np.split(rows, np.cumsum(list(map(len, blocks)))[:-1])

        def flown() -> Iterator[tuple[IntArray, FloatArray]]:
            for place, (y, vehicles, added) in zip(places, self._solved(blocks), strict=True):
                self._rows.multipliers[place] = y
                yield vehicles, least[vehicles] + added

        self.motion = self.motion.with_parts(flown())  # while others are still being solved
        self.programs += len(np.unique(own.groups))

    def _solved(self, blocks: list[Duals]) -> Iterator[tuple[FloatArray, IntArray, FloatArray]]:
        if self._executor is None or len(blocks) == 1:
            return map(Duals.solved, blocks)
        return self._executor.map(Duals.solved, blocks)

    def pressing(self) -> list[tuple[HalfSpaces, FloatArray]]:
        """Return the rows with multipliers above zero, as they were added, and these.

        A multiplier is half of what the cost rises with each unit that a row asks for.
        """
        if not self._parts:
            return []
        ends = np.cumsum(list(map(len, self._parts)))[:-1]
        every = zip(self._parts, np.split(self._rows.multipliers, ends), strict=True)
        return [(rows.select(y > 0.0), y[y > 0.0]) for rows, y in every]


def _in_blocks(rows: Duals) -> Iterator[Duals]:
    """Yield about `_BLOCK` rows at a time; those of a group stay together."""
    begins = np.flatnonzero(np.diff(rows.groups, prepend=-1))
    cuts = begins[np.flatnonzero(np.diff(begins // _BLOCK, prepend=-1))]
    for first, last in pairwise([*cuts.tolist(), len(rows)]):
        yield rows.select(slice(first, last))
