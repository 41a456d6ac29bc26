"""Rows of programs: picklable arrays that refer to changes of a motion."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Self

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.smooth import response_of
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Quantity
from drake_rho.scenario.smoothing import Smoothing


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one constraint: normal · (change of a quantity) + slack >= needed."""

    quantity: Quantity
    """bounded quantity"""
    penalty: float
    """cost of each unit of slack; infinite if there is no slack"""
    coupled: bool
    """whether rows bound the change of a vehicle's quantity minus that of its partner"""
    vehicles: IntArray
    """index of each row's vehicle, shape (R,)"""
    partners: IntArray
    """index of each row's other vehicle if `coupled`, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    normals: FloatArray
    """unit vectors, shape (R, 3)"""
    needed: FloatArray
    """required changes, in the quantity's unit, shape (R,)"""
    slacks: IntArray
    """index of each row's slack, equal for rows that share one, shape (R,)"""
    averaged: Smoothing | None = None
    """moving averages of positions that rows bound; None for the quantity itself"""

    @classmethod
    def of(cls, part: HalfSpaces, motion: Motion) -> Self:
        """Return half-spaces as rows that refer to changes of a motion of all vehicles."""
        return cls(
            part.constraint.quantity,
            part.constraint.penalty,
            part.constraint.coupled,
            part.vehicles,
            part.partners,
            part.times,
            part.normals,
            -part.margins(motion),
            part.slacks(),
            part.constraint.averaged,
        )

    def __len__(self) -> int:
        """Return the number of rows, R."""
        return len(self.times)

    def responses(self, grid: Grid) -> FloatArray:
        """Return the responses of rows to unit accelerations along their normals, (R, K-1)."""
        return response_of(self.quantity, self.averaged, grid, self.times)

    def select(self, rows: BoolArray | IntArray | slice) -> Rows:
        """Return some of the rows."""
        return dataclasses.replace(
            self,
            vehicles=self.vehicles[rows],
            partners=self.partners[rows],
            times=self.times[rows],
            normals=self.normals[rows],
            needed=self.needed[rows],
            slacks=self.slacks[rows],
        )

    @property
    def soft(self) -> bool:
        """Whether rows may be violated."""
        return bool(np.isfinite(self.penalty))


def groups_of(vehicles: int, coupled: Sequence[Rows | HalfSpaces]) -> IntArray:
    """Return the number of each vehicle's group; vehicles that rows couple are in one group.

    Args:
        vehicles: the number of vehicles, N.
        coupled: the rows that couple two vehicles.
    """
    if not coupled:
        return np.arange(vehicles)
    one = np.concatenate([part.vehicles for part in coupled])
    other = np.concatenate([part.partners for part in coupled])
    links = coo_array((np.ones(len(one)), (one, other)), shape=(vehicles, vehicles))
    labels: IntArray = connected_components(links, directed=False)[1]
    return labels


def each_of(
    wanted: IntArray, numbers: IntArray, rows: Sequence[Rows]
) -> Iterator[tuple[int, list[Rows]]]:
    """Yield the rows of parts of a fleet; rows are sorted by part once, since there may be many.

    Args:
        wanted: the numbers of the parts to yield.
        numbers: the number of each vehicle's part, shape (N,).
        rows: the rows of all vehicles.

    Yields:
        The number of each part, and the rows of its vehicles.
    """
    if len(wanted) == 0:
        return
    rows = [part.select(np.argsort(numbers[part.vehicles], kind="stable")) for part in rows]
    labels = [numbers[part.vehicles] for part in rows]
    for number in wanted.tolist():
        ranges = [slice(*np.searchsorted(label, [number, number + 1])) for label in labels]
        own = [part.select(each) for part, each in zip(rows, ranges, strict=True)]
        yield number, [part for part in own if len(part) > 0]


def about(motion: Motion, parts: Iterable[HalfSpaces]) -> list[Rows]:
    """Return half-spaces, constraint by constraint, as rows that refer to changes of a motion."""
    return [Rows.of(part, motion) for part in parts]
