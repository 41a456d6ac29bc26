"""Linear constraints on motions, n · x(t) >= b, and what a constraint is to a planner.

Every constraint is one of two kinds, and both become such rows where a motion breaks them: keep in
a convex set (`boxes`, `convex_sets`), keep out of one (`obstacles`, `separation`).
"""

from __future__ import annotations

import abc
import dataclasses
import sys
from collections.abc import Hashable, Iterable, Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np

from drake_rho.motion.dynamics import Motion, response
from drake_rho.planning.constraints.stretches import worst_of_pieces
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Quantity

VIOLATED = 0.01
"""Part of the verifier's tolerance beyond which a row counts as broken for a planner, and is
added."""


AT_ONCE = 1e-6
"""Part of a step after the start, or before the end, in which nothing can be changed."""

_SOFT_SEARCHES = 5
"""Searches for worst instants of constraints that may be broken."""


@dataclasses.dataclass(frozen=True)
class Quadratic:
    """What rows were linearised from: norm(scales * (x(t) - c))² >= size², one for each row."""

    centers: FloatArray
    """c [m], shape (R, 3); zero where x is the way from a partner"""
    scales: FloatArray
    """shape (R, 3)"""
    sizes: FloatArray
    """[m], shape (R,)"""
    lengths: FloatArray
    """of the scaled directions, before they were made unit normals, shape (R,)"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Constraint(abc.ABC):
    """One constraint of all vehicles, in the only terms that programs and messages know."""

    kind: str
    """of the requirement, one of `drake_rho.scenario.kinds.KINDS`"""
    key: Hashable
    """by which it is told from the scenario's other constraints, the same around every reference"""
    name: str
    """what it is called in messages"""
    quantity: Quantity
    """what its rows bound"""
    penalty: float = np.inf
    """cost of each unit by which a row is broken; infinite if it must not be"""
    rounds: int = sys.maxsize
    """rounds in which broken rows at the knots are added; few while plans are intermediate"""
    searches: int = 0
    """searches for worst instants between the knots; 0 where it can be broken at knots only"""
    coupled: bool = False
    """whether its rows bound the difference to a partner, rather than one vehicle alone"""
    curved: bool = False
    """whether one instant may need several rows, each with another normal"""
    linearised: bool = False
    """whether its rows hold around one reference only"""
    obstacle_number: int | None = None
    """number of the obstacle that it is about, 0 for other vehicles; None for anything else"""
    active: tuple[float, float] | None = None
    """first and last time at which it holds, since the first knot [s]; all of them if None"""
    clock_rounding: float = 0.0
    """time by which an instant may be outside of that interval and still count as within it [s]"""
    pieces: int = 1
    """into how many pieces steps are cut, each with knots and a margin of its own; it is asked of
    `Motion.subdivided`"""

    @abc.abstractmethod
    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Rows for everything that the motion breaks.

        Args:
            motion: of all vehicles.
            vehicles: which of them are looked at, rising indices, shape (P,).
            between: whether to look elsewhere, at the worst instants, instead of at the knots.
            reach: up to how many knots away from a broken row its neighbours are wanted too.
        """

    def holds_at(self, times: FloatArray) -> BoolArray:
        """Return whether it holds at times since the first knot [s], shape (R,)."""
        if self.active is None:
            return np.ones(len(times), dtype=bool)
        first, last = self.active
        early, late = first - self.clock_rounding, last + self.clock_rounding
        return np.asarray((times >= early) & (times <= late))

    @cached_property
    def none(self) -> HalfSpaces:
        """No rows."""
        return HalfSpaces(self, *_NONE)

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Rows of this constraint around another reference, as this one writes them."""
        return dataclasses.replace(rows, constraint=self)

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Return what rows were linearised from; None where they are the constraint itself."""
        return None

    def describe(self, rows: HalfSpaces, names: Sequence[str], start: float) -> str:
        """Return some of its rows, of one vehicle, in words: which, and when.

        Args:
            rows: some of its own.
            names: of all vehicles.
            start: time of the first knot on the scenario's clock [s].
        """
        first, last = start + rows.times.min(), start + rows.times.max()
        when = f"at {clock_time(first)}"
        if first != last:
            when = f"from {clock_time(first)} to {clock_time(last)}"
        return f"{self.name}{self.detail(rows, names)} {when}"

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return what `describe` says between name and times: nothing, or a space and words."""
        return ""

    def softened(self, penalty: float) -> Self:
        """Return this constraint with rows that may be violated at a penalty.

        What stays broken has new worst instants in every motion: a few searches have to do.
        """
        searches = min(self.searches, _SOFT_SEARCHES)
        return dataclasses.replace(self, penalty=penalty, searches=searches)


@dataclasses.dataclass(frozen=True)
class HalfSpaces:
    """Rows normal · quantity(vehicle, time) >= bound, all of one constraint.

    The rows of a constraint that couples vehicles bound the quantity of a vehicle less that of
    its partner.
    """

    constraint: Constraint
    """the constraint that the rows are of"""
    vehicles: IntArray
    """whose quantity, as indices into the scenario's vehicles, shape (R,)"""
    partners: IntArray
    """the other vehicle where a row is about two, else the vehicle itself, shape (R,)"""
    sides: IntArray
    """which side of a box or, where the set is curved, which cut, shape (R,)"""
    times: FloatArray
    """when [s], shape (R,)"""
    normals: FloatArray
    """in which direction, unit vectors, shape (R, 3)"""
    bounds: FloatArray
    """least value along the normal, in the quantity's unit, shape (R,)"""
    tolerances: FloatArray
    """how far below the bound still counts as held, in the quantity's unit, shape (R,)"""

    def __len__(self) -> int:
        """R."""
        return len(self.times)

    def margins(self, motion: Motion) -> FloatArray:
        """How far above its bound each row is, in the quantity's unit, shape (R,).

        Args:
            motion: of all vehicles of the scenario.
        """
        quantity = self.constraint.quantity
        values = motion.each_at(quantity, self.vehicles, self.times)
        if self.constraint.coupled:
            values = values - motion.each_at(quantity, self.partners, self.times)
        margins: FloatArray = np.vecdot(self.normals, values) - self.bounds
        return margins

    def margins_at(self, motion: Motion, knots: IntArray) -> FloatArray:
        """`margins` of rows about positions of single vehicles at given knots, shape (R,)."""
        values = motion.positions[self.vehicles, knots]
        margins: FloatArray = np.vecdot(self.normals, values) - self.bounds
        return margins

    def worst(self, motion: Motion, pieces: int, *, gap: float) -> HalfSpaces:
        """Return the worst row in each piece of every stretch of rows.

        Args:
            motion: of all vehicles.
            pieces: into how many a stretch is cut.
            gap: rows of a vehicle and a side that are further apart in time are of two stretches
                [s]; where it is infinite, a stretch goes on from one partner to the next.
        """
        if len(self) <= 1:
            return self
        later = self.times[1:] - self.times[:-1]
        follows = (later > 0.0) & (later < gap)
        alike = [self.vehicles, self.sides] + [self.partners] * bool(np.isfinite(gap))
        for labels in alike:
            follows &= labels[1:] == labels[:-1]
        if not follows.any():
            return self
        margins = self.margins(motion) / self.tolerances
        return self.select(worst_of_pieces(follows, margins, pieces))

    def responses(self, grid: Grid) -> FloatArray:
        """Return what one unit of each acceleration adds along the normal, by (10)-(11), (R, K-1).

        It is the same along every axis, so row r stands for responses[r, j] normals[r] · a[j].
        """
        return response(self.constraint.quantity, grid.step, grid.knots, self.times)

    def slacks(self) -> IntArray:
        """Numbers from 0, the same for rows that share a slack if they may be broken, shape (R,).

        A curved set is broken once at an instant, by as much as the worst of its rows says.
        """
        if not self.constraint.curved or np.isinf(self.constraint.penalty):
            return np.arange(len(self))
        instants = np.stack([self.vehicles, self.partners, self.times])
        numbers: IntArray = np.unique(instants, axis=1, return_inverse=True)[1]
        return numbers

    def select(self, rows: BoolArray | IntArray | slice) -> HalfSpaces:
        """Return some of the rows."""
        return HalfSpaces(self.constraint, *some_of(self._arrays(), rows))

    def union(self, more: HalfSpaces) -> HalfSpaces:
        """Return these rows, then more of the same constraint."""
        pairs = zip(self._arrays(), more._arrays(), strict=True)
        return HalfSpaces(more.constraint, *(np.concatenate(pair) for pair in pairs))

    def _arrays(self) -> tuple[Any, ...]:
        return (
            self.vehicles,
            self.partners,
            self.sides,
            self.times,
            self.normals,
            self.bounds,
            self.tolerances,
        )


_WHOLE, _REAL = np.zeros(0, dtype=np.int64), np.zeros(0)
_NONE = _WHOLE, _WHOLE, _WHOLE, _REAL, np.zeros((0, 3)), _REAL, _REAL


def some_of(arrays: Iterable[Any], rows: BoolArray | IntArray | slice) -> list[Any]:
    """Return array[rows] of arrays with as many rows; vectors are taken several times as fast."""
    if isinstance(rows, slice):
        return [array[rows] for array in arrays]
    which = rows.nonzero()[0] if rows.dtype == bool else rows
    return [array.take(which, axis=0) for array in arrays]
