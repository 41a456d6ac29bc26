"""Fast, approximate dual solution of the programs of groups of vehicles.

The unknowns are the accelerations of a group minus those of minimum effort. The dual
(`drake_rho.planning.programs.dual`) needs only the Gram matrix of the rows.

A row is the product of a response in time, a normal in space and the signs of one or two vehicles.
The inner product of two rows is therefore the product of three inner products.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from typing import get_args

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.smooth import response_of
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.minimum_effort import Changes, MinimumEffort
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.dual import multipliers_of
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.smoothing import Smoothing
from drake_rho.system.table import Table
from drake_rho.system.threads import single_threaded_blas

_RIDGE = 1e-9
"""Regularisation of the squared length of rows, which is one: rows of neighbouring instants are
almost equal and may contradict each other."""

_FIXED = 1e-9
"""Relative length of a row after projection onto the null space of the goals, below which the
goals alone determine its value, and the row is omitted."""

_BLOCK = 8000
"""Number of rows in a block: those of about a hundred vehicles, or tens of milliseconds of work. It
does not depend on the number of workers, so that results are equal to the last digit."""

_QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

_AVERAGED = len(_QUANTITIES)
"""Index of averaged positions, after the quantities."""


@dataclasses.dataclass(frozen=True, eq=False)
class Duals(Table):
    """Rows of several groups, sorted by group, in a picklable form."""

    changes: Changes
    """changes of minimum-effort motions that rows refer to"""
    by_daqp: bool
    """whether DAQP is the chosen solver"""
    averages: Smoothing | None
    """moving averages whose positions rows bound, if any do"""
    groups: IntArray
    """number of each row's group, ascending, shape (R,)"""
    one: IntArray
    """index of each row's vehicle, shape (R,)"""
    other: IntArray
    """index of the vehicle whose value is subtracted, or -1, shape (R,)"""
    quantities: IntArray
    """bounded quantities, as indices in `_QUANTITIES` or `_AVERAGED`, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    normals: FloatArray
    """unit vectors, shape (R, 3)"""
    needed: FloatArray
    """required changes of the minimum-effort motions, in the quantity's unit, shape (R,)"""
    most: FloatArray
    """upper bounds of the multipliers, half the penalties, shape (R,)"""
    multipliers: FloatArray
    """initial guess of the multipliers, shape (R,)"""

    @single_threaded_blas
    def solved(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return multipliers, vehicles, and changes of their accelerations, shape (V, K-1, 3).

        Raises:
            SolverError: no multipliers are found for a group.
        """
        every, which, lengths = self._responses()
        scales = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0.0)
        normals, needed = scales[:, None] * self.normals, scales * self.needed  # of unit length
        begins = np.flatnonzero(np.diff(self.groups, prepend=-1))
        units = np.maximum(np.maximum.reduceat(np.abs(needed), begins), np.finfo(float).tiny)
        unit = np.repeat(units, np.diff(begins, append=len(self)))
        needed, begin, most = needed / unit, self.multipliers * lengths / unit, np.ones(len(self))
        np.multiply(self.most, lengths / unit, out=most, where=lengths > 0.0)
        y, vehicles, added = np.zeros(len(self)), [], []
        for first, last in pairwise([*begins.tolist(), len(self)]):
            own = slice(first, last)
            several, signs = self._signs(own)
            parts = self._by_class(several, signs, every, which[own])
            gram = _gram(parts) * (normals[own] @ normals[own].T)
            gram.flat[:: len(gram) + 1] += _RIDGE
            y[own] = multipliers_of(gram, needed[own], most[own], begin[own], by_daqp=self.by_daqp)
            weighted = (unit[first] * y[own])[:, None] * normals[own]
            for part in parts:
                vehicles.append(part.vehicles)
                z = part.sum(weighted) * self.changes.factors[part.vehicles, None, None]
                added.append(self.changes.accelerations(z, part.vehicles))
        return unit * scales * y, np.concatenate(vehicles), np.concatenate(added)

    def _responses(self) -> tuple[list[FloatArray], IntArray, FloatArray]:
        """Return distinct projected responses, the index of each row's, and its length.

        Responses are projected onto the null space of the goals. A row whose value the goals alone
        determine has length zero.

        Returns:
            The responses about z for every class of vehicles, shape (U, K-1) each; indices and
            lengths, shape (R,).
        """
        grid = self.changes.grid
        keys = self.quantities + 1j * self.times  # sorts several times as fast as pairs
        instants, which = np.unique(keys, return_inverse=True)
        numbers, times = instants.real.astype(int), instants.imag
        every = np.zeros((len(instants), grid.knots - 1))
        for number in np.unique(numbers).tolist():
            own = numbers == number
            averaged = self.averages if number == _AVERAGED else None
            quantity: Quantity = "position" if averaged else _QUANTITIES[number]
            every[own] = response_of(quantity, averaged, grid, times[own])
        changes, spaces = self.changes, self.changes.spaces
        white = [space.whitened(every) for space in spaces]
        inside = [space.projected(own) for space, own in zip(spaces, white, strict=True)]
        lengths = [_lengths(*each) for each in zip(white, inside, strict=True)]
        if len(spaces) == 1:
            both = changes.factors_of(self.one, self.other)  # the last one's, if none
            several = np.where(self.other >= 0, both, changes.factors[self.one])
            return inside, which, lengths[0][which] * several
        classes, sizes = changes.classes, np.array(lengths)
        one = changes.factors[self.one] * sizes[classes[self.one], which]
        other = changes.factors[self.other] * sizes[classes[self.other], which]
        return inside, which, np.hypot(one, np.where(self.other >= 0, other, 0.0))

    def _by_class(
        self,
        several: IntArray,
        signs: FloatArray | None,
        every: list[FloatArray],
        which: IntArray,
    ) -> list[_Part]:
        """Return the rows of a group as seen by its vehicles of each class.

        Args:
            several: the group's vehicles, shape (G,).
            signs: their signs in its rows, (G, R); None for one vehicle.
            every: responses for every class.
            which: indices of the rows' responses, shape (R,).
        """
        classes = self.changes.classes[several]
        if (classes == classes[0]).all():
            return [_Part(several, signs, every[classes[0]][which])]
        return [
            _Part(several[own], None if signs is None else signs[own], every[number][which])
            for number in np.unique(classes).tolist()
            for own in (classes == number,)
        ]

    def _signs(self, own: slice) -> tuple[IntArray, FloatArray | None]:
        """Return a group's vehicles, and their signs in its rows, (G, R); None for one vehicle."""
        one, other = self.one[own], self.other[own]
        if other.max() < 0 and (one == one[0]).all():
            return one[:1], None
        several = np.unique(np.concatenate([one, other[other >= 0]]))
        signs = (several[:, None] == one).astype(np.float64)
        signs -= several[:, None] == other
        signs *= self.changes.factors[several, None]
        return several, signs


@dataclasses.dataclass(frozen=True, eq=False)
class _Part:
    """Rows of a group as seen by those of its vehicles that are of one class."""

    vehicles: IntArray
    """the vehicles, shape (G,)"""
    signs: FloatArray | None
    """their signs in the rows, times their factors, shape (G, R); None for a single vehicle"""
    responses: FloatArray
    """projected responses of the rows, shape (R, K-1)"""

    def gram(self) -> FloatArray:
        """Return the products of every two rows, shape (R, R), without their normals."""
        gram: FloatArray = self.responses @ self.responses.T
        return gram if self.signs is None else gram * (self.signs.T @ self.signs)

    def sum(self, weighted: FloatArray) -> FloatArray:
        """Return the sums of the rows for each vehicle, (G, K-1, 3), with weights (R, 3)."""
        if self.signs is None:
            return np.asarray((self.responses.T @ weighted)[None])
        axes = [(self.signs * weighted[:, axis]) @ self.responses for axis in range(3)]
        return np.stack(axes, axis=2)


def _gram(parts: list[_Part]) -> FloatArray:
    """Return the products of every two rows of a group, shape (R, R), without their normals."""
    first, *others = (part.gram() for part in parts)
    return sum(others, start=first)


def _lengths(rows: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the lengths of projected rows; zero for those that the goals alone determine."""
    before, lengths = (np.sqrt(np.vecdot(each, each)) for each in (rows, inside))
    lengths[lengths <= _FIXED * before] = 0.0
    return np.asarray(lengths)


class GroupDuals:
    """Minimum-effort motions subject to rows, with rows added over time.

    Args:
        effort: the minimum-effort motions of the scenario.
        groups: the number of each vehicle's group, shape (N,).
        motion: the motions of vehicles without rows; minimum-effort motions if not given.
        backend: provides the executor, and DAQP if this is the solver.

    Attributes:
        motion: latest motions of all vehicles.
        programs: number of programs that were solved.
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
            None,
            *(nobody, nobody, nobody, nobody),
            *(nothing, np.zeros((0, 3)), nothing, nothing, nothing),
        )
        self._pending = np.zeros(len(groups), dtype=bool)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    def add(self, rows: HalfSpaces) -> None:
        """Add rows; vehicles coupled by a row are in the same group."""
        constraint = rows.constraint
        quantity = _QUANTITIES.index(constraint.quantity)
        self._parts.append(rows)
        more = Duals(
            self._effort.changes,
            self._rows.by_daqp,
            constraint.averaged or self._rows.averages,
            groups=self._groups[rows.vehicles],
            one=rows.vehicles,
            other=rows.partners if constraint.coupled else np.full(len(rows), -1),
            quantities=np.full(len(rows), quantity if constraint.averaged is None else _AVERAGED),
            times=rows.times,
            normals=rows.normals,
            needed=-rows.margins(self._effort.motion),
            most=np.full(len(rows), constraint.penalty / 2.0),
            multipliers=np.zeros(len(rows)),
        )
        self._rows = self._rows.union(more)
        self._pending[more.groups] = True

    def solve(self) -> None:
        """Solve the programs of the groups that have new rows.

        Raises:
            SolverError: no multipliers are found for a group.
        """
        rows = np.flatnonzero(self._pending[self._rows.groups])
        rows = rows[np.argsort(self._rows.groups[rows], kind="stable")]
        self._pending[:] = False
        if len(rows) == 0:
            return
        own = self._rows.select(rows)
        blocks, least = list(_in_blocks(own)), self._effort.motion.accelerations
        places = np.split(rows, np.cumsum(list(map(len, blocks)))[:-1])

        def solutions() -> Iterator[tuple[IntArray, FloatArray]]:
            for place, (y, vehicles, added) in zip(places, self._solved(blocks), strict=True):
                self._rows.multipliers[place] = y
                yield vehicles, least[vehicles] + added

        self.motion = self.motion.with_parts(solutions())  # while other blocks are being solved
        self.programs += len(np.unique(own.groups))

    def _solved(self, blocks: list[Duals]) -> Iterator[tuple[FloatArray, IntArray, FloatArray]]:
        if self._executor is None or len(blocks) == 1:
            return map(Duals.solved, blocks)
        return self._executor.map(Duals.solved, blocks)

    def active_rows(self) -> list[tuple[HalfSpaces, FloatArray]]:
        """Return the rows with positive multipliers, part by part as added, and their multipliers.

        A multiplier is half the derivative of the cost with respect to the row's right-hand side.
        """
        if not self._parts:
            return []
        ends = np.cumsum(list(map(len, self._parts)))[:-1]
        every = zip(self._parts, np.split(self._rows.multipliers, ends), strict=True)
        return [(rows.select(y > 0.0), y[y > 0.0]) for rows, y in every]


def _in_blocks(rows: Duals) -> Iterator[Duals]:
    """Yield blocks of about `_BLOCK` rows; rows of a group are in one block."""
    begins = np.flatnonzero(np.diff(rows.groups, prepend=-1))
    cuts = begins[np.flatnonzero(np.diff(begins // _BLOCK, prepend=-1))]
    for first, last in pairwise([*cuts.tolist(), len(rows)]):
        yield rows.select(slice(first, last))
