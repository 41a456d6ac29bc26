"""Rows as programs take them: arrays about changes of a motion, which processes can be sent."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Self

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity


@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one constraint: normal · (what changes add to a quantity) + slack >= needed."""

    quantity: Quantity
    """what they bound"""
    penalty: float
    """cost of each unit of slack; infinite where there is none"""
    coupled: bool
    """whether they bound what a vehicle's changes add less what its partner's do"""
    vehicles: IntArray
    """shape (R,)"""
    partners: IntArray
    """shape (R,)"""
    times: FloatArray
    """when [s], shape (R,)"""
    normals: FloatArray
    """unit vectors, shape (R, 3)"""
    needed: FloatArray
    """in the quantity's unit, shape (R,)"""
    slacks: IntArray
    """numbers, the same for rows that share a slack, shape (R,)"""

    @classmethod
    def of(cls, part: HalfSpaces, motion: Motion) -> Self:
        """Return half-spaces as rows about what is added to a motion of all vehicles."""
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
        )

    def __len__(self) -> int:
        """R."""
        return len(self.times)

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
        """Whether they may be broken."""
        return bool(np.isfinite(self.penalty))


def groups_of(vehicles: int, coupled: Sequence[Rows | HalfSpaces]) -> IntArray:
    """Return the number of each vehicle's group: those that rows couple have the same.

    Args:
        vehicles: N.
        coupled: rows about differences.
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
    """Yield the rows of parts of a fleet, sorted by part once, as there may be many.

    Args:
        wanted: numbers of parts.
        numbers: the number of each vehicle's part, shape (N,).
        rows: of all vehicles.

    Yields:
        Each number that is wanted, and the rows of the vehicles that have it.
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
    """Return half-spaces, constraint by constraint, as rows about what is added to a motion."""
    return [Rows.of(part, motion) for part in parts]
