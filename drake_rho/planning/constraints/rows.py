"""Rows normal · quantity(vehicle, time) >= bound: half-spaces of motions, in a table."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from functools import cached_property
from operator import attrgetter

import numpy as np

from drake_rho.motion.smooth import response_of
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.smoothing import Smoothing
from drake_rho.system.table import Table


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Form:
    """Form of rows: the properties that programs need to write them."""

    quantity: Quantity
    """quantity that the rows bound"""
    penalty: float = np.inf
    """cost per unit of violation of a row; infinite if rows must hold"""
    prices: FloatArray | None = None
    """cost per unit of the worst violation among the rows of each vehicle, shape (N,), in place of
    `penalty`; None if rows of a vehicle have nothing in common"""
    coupled: bool = False
    """true if rows bound the difference to a partner, not the quantity of a single vehicle"""
    curved: bool = False
    """true if one instant may need several rows with different normals"""
    averaged: Smoothing | None = None
    """moving averages of positions that rows bound, in place of positions; None for these"""

    @property
    def soft(self) -> bool:
        """Whether rows may be violated."""
        return self.penalty < np.inf or self.prices is not None

    @cached_property
    def form(self) -> Form:
        """The form alone, which is picklable."""
        return Form(**dict(zip(_FIELDS, _values(self), strict=True)))


_FIELDS = [each.name for each in dataclasses.fields(Form)]
_values = attrgetter(*_FIELDS)


@dataclasses.dataclass(frozen=True, eq=False)
class Rows(Table):
    """Rows of one form. If it couples vehicles, they bound a vehicle's quantity minus a partner's.

    Rows of programs bound changes of a motion, and their bounds are the changes needed.
    """

    form: Form
    """form of all rows; the constraint to which they belong, if they are its half-spaces"""
    vehicles: IntArray
    """constrained vehicles, as indices into the scenario's vehicles, shape (R,)"""
    partners: IntArray
    """other vehicles of pairs; the vehicle itself if a row is not about a pair, shape (R,)"""
    sides: IntArray
    """sides of a box, or numbers of the cuts if the set is curved, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    normals: FloatArray
    """unit normals, shape (R, 3)"""
    bounds: FloatArray
    """least values along the normals, in the quantity's unit, shape (R,)"""
    tolerances: FloatArray
    """largest violations that count as satisfied, in the quantity's unit, shape (R,)"""

    def __len__(self) -> int:
        """Return the number of rows, R."""
        return len(self.times)

    @property
    def soft(self) -> bool:
        """Whether rows may be violated."""
        return self.form.soft

    @property
    def penalties(self) -> FloatArray:
        """Cost per unit of violation of each row's slack variable, shape (R,)."""
        if self.form.prices is not None:
            return np.asarray(self.form.prices[self.vehicles])
        return np.zeros(len(self)) + self.form.penalty

    def responses(self, grid: Grid) -> FloatArray:
        """Return the responses of rows to unit accelerations along their normals, (R, K-1).

        By (10)-(11) they are equal along every axis: acceleration a[j] of step j adds
        responses[r, j] normals[r] · a[j] to row r.
        """
        return response_of(self.form.quantity, self.form.averaged, grid, self.times)

    def slacks(self) -> IntArray:
        """Return the number of each row's slack variable, counted from 0, shape (R,).

        Soft rows of a curved set share one slack variable per instant, since the violation of the
        set is that of its worst row. Rows with prices share one per vehicle.
        """
        if self.form.prices is not None:
            whose: IntArray = np.unique(self.vehicles, return_inverse=True)[1]
            return whose
        if not self.form.curved or not self.soft:
            return np.arange(len(self))
        instants = np.stack([self.vehicles, self.partners, self.times])
        numbers: IntArray = np.unique(instants, axis=1, return_inverse=True)[1]
        return numbers


def slacks_of(rows: Sequence[Rows]) -> IntArray:
    """Return the index of each row's slack variable, constraint by constraint, shape (R,)."""
    if not any(part.form.soft for part in rows):
        return np.zeros(sum(map(len, rows)), dtype=int)  # no slacks
    first = np.cumsum([0, *(1 + part.slacks().max(initial=-1) for part in rows)])[:-1]
    return np.concatenate([n + part.slacks() for n, part in zip(first, rows, strict=True)])


def groups_of(vehicles: int, coupled: Sequence[Rows]) -> IntArray:
    """Return the number of each vehicle's group; vehicles that rows couple are in one group.

    Args:
        vehicles: the number of vehicles, N.
        coupled: the rows that couple two vehicles.
    """
    if not coupled:
        return np.arange(vehicles)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # slow to load, so only where needed

    one = np.concatenate([part.vehicles for part in coupled])
    other = np.concatenate([part.partners for part in coupled])
    links = coo_array((np.ones(len(one)), (one, other)), shape=(vehicles, vehicles))
    labels: IntArray = connected_components(links, directed=False)[1]
    return labels


def each_of(
    parts: IntArray, numbers: IntArray, rows: Sequence[Rows]
) -> Iterator[tuple[int, list[Rows]]]:
    """Yield the rows of each part of a fleet.

    Rows are sorted by part once, since there may be many.

    Args:
        parts: the numbers of the parts to yield.
        numbers: the number of each vehicle's part, shape (N,).
        rows: the rows of all vehicles.

    Yields:
        The number of each part, and the rows of its vehicles.
    """
    if len(parts) == 0:
        return
    rows = [part.select(np.argsort(numbers[part.vehicles], kind="stable")) for part in rows]
    labels = [numbers[part.vehicles] for part in rows]
    for number in parts.tolist():
        ranges = [slice(*np.searchsorted(label, [number, number + 1])) for label in labels]
        own = [part.select(each) for part, each in zip(rows, ranges, strict=True)]
        yield number, [part for part in own if len(part) > 0]
