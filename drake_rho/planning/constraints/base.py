"""Base class of constraints, and rows of half-spaces n · x(t) >= b on motions.

A constraint keeps a quantity in a convex set (`boxes`, `keep_in`) or out of one (`obstacles`,
`separation`). Both kinds are imposed by rows, which are added where a motion violates them.
"""

from __future__ import annotations

import abc
import dataclasses
import sys
from collections.abc import Hashable, Iterable, Sequence
from functools import cached_property
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.smooth import averaged
from drake_rho.planning.constraints.rows import Form, Rows
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import END_MARGIN

VIOLATED = 0.01
"""Fraction of the verifier's tolerance by which a motion has to violate a row for a planner to add
the row."""

_SOFT_SEARCHES = 5
"""Limit on the searches for worst instants between knots, for constraints with a penalty."""


def constrained_knots(quantity: Quantity, *, open_end: bool = False) -> slice:
    """Return the knots at which limits of a quantity apply.

    The first and, unless the end is open, the last position and velocity are given, and no step
    begins at the last knot.
    """
    if quantity in ("position", "velocity"):
        return slice(1, None if open_end else -1)
    return slice(None) if quantity == "jerk" else slice(-1)


@dataclasses.dataclass(frozen=True)
class Quadratic:
    """Nonconvex constraints before linearisation: norm(scales * (x(t) - c))² >= size² per row."""

    centers: FloatArray
    """centres c [m], shape (R, 3); zero where x is the position relative to a partner"""
    scales: FloatArray
    """factors of the three axes, shape (R, 3)"""
    sizes: FloatArray
    """least norms of the scaled offsets [m]; zero where there is no such constraint, shape (R,)"""
    lengths: FloatArray
    """lengths of the scaled directions, before normalisation to unit normals, shape (R,)"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Constraint(Form, abc.ABC):
    """Constraint on all vehicles. Loops and messages use all of it, programs its form only."""

    kind: str
    """kind of the requirement, one of `drake_rho.scenario.kinds.KINDS`"""
    key: Hashable
    """identifier, unique among the scenario's constraints and equal around every reference"""
    name: str
    """name in messages"""
    rounds: int = sys.maxsize
    """number of rounds that add violated rows at the knots; small while plans are intermediate"""
    searches: int = 0
    """number of searches for worst instants between knots; 0 if only knots can violate it"""
    open_end: bool = False
    """whether it applies at the last knot, where goals do not fix all positions and velocities"""
    threshold: float = VIOLATED
    """violation, in tolerances, up to which no row is added"""
    moves: bool = False
    """whether its interval begins or ends at waypoints, whose times may be variables"""
    is_gate: bool = False
    """whether it is of velocities at a waypoint, in a set with no zero inside"""
    given_end: GivenEnd | None = None
    """vehicles to which it does not apply there, beside others to which it does"""

    @abc.abstractmethod
    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return the rows that the motion violates.

        Args:
            motion: the motion of all vehicles.
            vehicles: the vehicles to check, as increasing indices, shape (P,).
            between: whether to check the worst instants between knots instead of the knots.
            neighbours: number of knots before and after each violated row whose rows are returned
                as well.
        """

    @property
    def linearised(self) -> bool:
        """Whether rows are valid around one reference only."""
        return False

    @property
    def obstacles(self) -> frozenset[int]:
        """Numbers of the avoided obstacles; 0 stands for other vehicles."""
        return frozenset()

    def encounters(self, rows: HalfSpaces) -> list[IntArray]:
        """Return labels that successive rows of one violated stretch have in common, (R,) each."""
        return [rows.vehicles, rows.sides]

    @cached_property
    def none(self) -> HalfSpaces:
        """Empty set of rows."""
        return HalfSpaces(self, *_NONE)

    def renewed(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows of another reference, linearised around this constraint's own."""
        return dataclasses.replace(rows, form=self)

    def bounds_at(self, rows: HalfSpaces, times: FloatArray) -> FloatArray:
        """Return the bounds of rows with the same normals at other times [s], shape (R,)."""
        return rows.bounds

    def quadratics(self, rows: HalfSpaces) -> Quadratic | None:
        """Return the constraints that rows linearise; None if the rows are exact."""
        return None

    def describe(self, rows: HalfSpaces, names: Sequence[str], start: float) -> str:
        """Return a description of rows of one vehicle: the constraint, details and times.

        Args:
            rows: rows of this constraint.
            names: the names of all vehicles.
            start: the time of the first knot on the scenario's clock [s].
        """
        first, last = start + rows.times.min(), start + rows.times.max()
        when = f"at {clock_time(first)}"
        if first != last:
            when = f"from {clock_time(first)} to {clock_time(last)}"
        return f"{self.name}{self.detail(rows, names)} {when}"

    def detail(self, rows: HalfSpaces, names: Sequence[str]) -> str:
        """Return details for `describe`, after a space; empty if there are none."""
        return ""

    def softened(self, penalty: float) -> Self:
        """Return this constraint with rows that may be violated at a penalty.

        Rows that stay violated have new worst instants in every motion, so searches are limited.
        """
        searches = min(self.searches, _SOFT_SEARCHES)
        return dataclasses.replace(self, penalty=penalty, searches=searches)


@dataclasses.dataclass(frozen=True, eq=False)
class GivenEnd:
    """Vehicles whose goals fix a quantity at the last knot, in a fleet with other goals."""

    since: float
    """time from which on rows are about that knot, since the first one [s]"""
    vehicles: BoolArray
    """mask of the vehicles, shape (N,)"""

    @classmethod
    def of(cls, scenario: Scenario, quantity: Quantity) -> GivenEnd | None:
        """Return the vehicles whose goals fix a quantity; None if there are none."""
        fixed, grid = scenario.fleet.fixed(quantity), scenario.grid
        return cls(grid.duration - END_MARGIN * grid.step, fixed) if fixed.any() else None

    def without(self, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows that are not about given values alone."""
        return rows.select(~self.includes(rows.vehicles, rows.partners, rows.times))

    def includes(self, vehicles: IntArray, partners: IntArray, times: FloatArray) -> BoolArray:
        """Return whether values of vehicles and of their partners at times are given, (R,)."""
        given = self.vehicles[vehicles] & self.vehicles[partners]
        return np.asarray(given & (times >= self.since))


@dataclasses.dataclass(frozen=True, eq=False)
class HalfSpaces(Rows):
    """Rows of one constraint."""

    @property
    def constraint(self) -> Constraint:
        """Constraint that the rows belong to."""
        return self.form  # type: ignore[return-value]  # of half-spaces, the form is the constraint

    def margins(self, motion: Motion) -> FloatArray:
        """Return the distances of rows above their bounds, in the quantity's unit, shape (R,).

        Args:
            motion: the motion of all vehicles of the scenario.
        """
        quantity, smooth = self.form.quantity, averaged(motion, self.form.averaged)
        values = smooth.each_at(quantity, self.vehicles, self.times)
        if self.form.coupled:
            values = values - motion.each_at(quantity, self.partners, self.times)
        margins: FloatArray = np.vecdot(self.normals, values) - self.bounds
        return margins

    def margins_at(self, motion: Motion, knots: IntArray) -> FloatArray:
        """Return `margins` of rows about positions of single vehicles at knots, shape (R,)."""
        values = motion.positions[self.vehicles, knots]
        margins: FloatArray = np.vecdot(self.normals, values) - self.bounds
        return margins

    def worst(self, motion: Motion, pieces: int, *, gap: float) -> HalfSpaces:
        """Return the worst row in each piece of every stretch of rows.

        Args:
            motion: the motion of all vehicles.
            pieces: the number of pieces of each stretch.
            gap: the time between successive rows of a vehicle and a side from which on a new
                stretch begins [s]. If it is infinite, a stretch may extend over several partners.
        """
        if len(self) <= 1:
            return self
        later = self.times[1:] - self.times[:-1]
        follows = (later > 0.0) & (later < gap)
        shared = self.constraint.encounters(self)
        if np.isfinite(gap):
            shared.append(self.partners)
        for labels in shared:
            follows &= labels[1:] == labels[:-1]
        if not follows.any():
            return self
        margins = self.margins(motion) / self.tolerances
        return self.select(worst_of_pieces(follows, margins, pieces))


def about(motion: Motion, parts: Iterable[HalfSpaces]) -> list[Rows]:
    """Return picklable rows that bound changes of a motion of all vehicles.

    Args:
        motion: the motion.
        parts: half-spaces, constraint by constraint.
    """
    return [
        Rows(
            part.constraint.form,
            part.vehicles,
            part.partners,
            part.sides,
            part.times,
            part.normals,
            -part.margins(motion),
            part.tolerances,
        )
        for part in parts
    ]


_WHOLE, _REAL = np.zeros(0, dtype=np.int64), np.zeros(0)
_NONE = _WHOLE, _WHOLE, _WHOLE, _REAL, np.zeros((0, 3)), _REAL, _REAL


def with_neighbours(marked: BoolArray, runs: IntArray, neighbours: int) -> BoolArray:
    """Return a mask of the marked rows and of their neighbours in the same run, shape (R,).

    Args:
        marked: the mask of the marked rows, shape (R,).
        runs: the increasing number of each row's run, shape (R,).
        neighbours: the number of neighbours before and after each marked row, at least 0.
    """
    if neighbours == 0:
        return marked
    count = len(marked)
    neighbours = min(neighbours, count)
    first, last = np.searchsorted(runs, runs), np.searchsorted(runs, runs, side="right")
    before = np.concatenate([[0], np.cumsum(marked)])
    place = np.arange(count)
    ends = before[np.minimum(place + neighbours + 1, last)]
    found: BoolArray = ends > before[np.maximum(place - neighbours, first)]
    return found


def worst_of_pieces(follows: BoolArray, margins: FloatArray, pieces: int) -> IntArray:
    """Return the index of the worst row in each piece of every stretch of violated rows.

    Args:
        follows: mask of the rows, except the first, that continue the stretch of the row before,
            shape (R-1,).
        margins: the margins of all violated rows, sorted by stretch, shape (R,).
        pieces: the number of pieces of each stretch.
    """
    begins = np.zeros(len(margins), dtype=bool)
    begins[0], begins[1:] = True, ~follows
    stretch = begins.cumsum() - 1
    place = np.arange(len(margins)) - begins.nonzero()[0][stretch]
    piece = stretch * pieces + place * pieces // np.maximum(np.bincount(stretch)[stretch], pieces)
    order = np.lexsort((margins, piece))
    piece = piece[order]
    begins[1:] = piece[1:] != piece[:-1]
    worst: IntArray = order[begins]
    return worst
