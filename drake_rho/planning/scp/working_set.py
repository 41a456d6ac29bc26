"""Working set: the rows in the programs, with the multipliers of the last solutions."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces, with_neighbours
from drake_rho.planning.programs.program import Answers
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid

_ACTIVE = 100.0
"""Largest margin, in tolerances, at which a row counts as active."""

_MAX_SIDES = 256
"""Largest number of sides that a row key can distinguish."""

_EQUAL_CUTS = 0.01
"""Relative difference up to which two cuts of the same instant count as equally violated."""

_MAX_FRACTIONS = 2**20
"""Largest number of fractions of a time step that a row key distinguishes, if its bits suffice."""


@dataclasses.dataclass(frozen=True)
class RowKeys:
    """Integer keys of the rows of one constraint, packed from vehicle, partner, side and time."""

    vehicles: int
    """number of vehicles, N"""
    grid: Grid
    """time step and knots"""

    def of(self, rows: HalfSpaces) -> IntArray:
        """Return an integer for each row of a constraint, equal for equal rows, shape (R,)."""
        radix = self.vehicles**2 * _MAX_SIDES
        parts = min(_MAX_FRACTIONS, 2**62 // (radix * self.grid.knots))
        instants = np.rint(rows.times * (parts / self.grid.step)).astype(np.int64)
        keys: IntArray = rows.vehicles * self.vehicles + rows.partners
        return (keys * _MAX_SIDES + rows.sides) * (parts * self.grid.knots) + instants


class WorkingSet:
    """Rows in the programs, and the last solved program of each vehicle.

    Args:
        keys: the integers that identify the rows of a constraint.

    Attributes:
        rows: the rows by the key of their constraint, in the order in which they were added.
        coupled: whether any row couples vehicles.
    """

    def __init__(self, keys: RowKeys) -> None:
        self.rows: dict[Hashable, HalfSpaces] = {}
        self.coupled = False
        self._keys, self._cuts = keys, 0
        self._known: dict[Hashable, IntArray] = {}
        self._not_indexed: dict[Hashable, list[HalfSpaces]] = {}
        self._solved: dict[int, tuple[Answers, int]] = {}

    def __len__(self) -> int:
        """Return the number of rows in the working set."""
        return sum(map(len, self.rows.values()))

    def known(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """Return flags of the rows of one constraint that are in the working set, shape (R,).

        Args:
            rows: the candidate rows.
            motion: the motion of all vehicles for which the rows were written.
        """
        constraint = rows.constraint
        if constraint.key not in self.rows:
            return np.zeros(len(rows), dtype=bool)
        if constraint.curved:
            return self._known_cuts(rows, motion)
        keys, index = self._keys.of(rows), self._index(constraint.key)
        place = np.minimum(np.searchsorted(index, keys), len(index) - 1)
        known: BoolArray = index[place] == keys
        return known

    def _known_cuts(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """Return flags of the known cuts of a curved set; cuts of one instant differ in normals.

        A cut is known if another of the same instant is violated as much, up to `_EQUAL_CUTS`. A
        solution satisfies all hard cuts in its program, so that a hard constraint is cut until it
        holds. A soft constraint is cut until the cuts measure its violation.
        """
        old = self.rows[rows.constraint.key]
        keys, theirs = (
            self._keys.of(dataclasses.replace(part, sides=np.zeros(len(part), dtype=int)))
            for part in (rows, old)
        )
        order = np.lexsort((old.margins(motion), theirs))  # the worst cut of an instant is first
        place = np.searchsorted(theirs[order], keys)
        worst = order[np.minimum(place, len(old) - 1)]
        exists, margins = theirs[worst] == keys, rows.margins(motion)
        equal = _EQUAL_CUTS if rows.constraint.prices is None else 0.0  # the slack decides
        as_deep = old.select(worst).margins(motion) <= margins + equal * np.abs(margins)
        known: BoolArray = exists & as_deep
        return known

    def enter(self, rows: HalfSpaces, motion: Motion) -> tuple[HalfSpaces, HalfSpaces]:
        """Add the rows that are not in the working set yet.

        Args:
            rows: the rows of one constraint.
            motion: the motion of all vehicles in the last solutions.

        Returns:
            The new rows, and the known hard rows that the motion violates.
        """
        known = self.known(rows, motion)
        if not known.any():
            self.add(rows)
            return rows, rows.constraint.none
        new = rows.select(~known)
        if len(new) > 0:
            self.add(new)
        unsatisfied = known & (rows.margins(motion) < -rows.tolerances)
        unsatisfied &= not rows.soft
        return new, rows.select(unsatisfied)

    def beyond_slack(self, rows: HalfSpaces, motion: Motion, neighbours: int) -> HalfSpaces:
        """Return the rows that a motion violates by more than the slack of their vehicle.

        The slack of a soft limit is the worst violation among the rows in the
        working set, which are in the last programs.

        Args:
            rows: rows of one such constraint, sorted by vehicle.
            motion: the motion of all vehicles in the last solutions.
            neighbours: number of rows before and after each that are returned as well.
        """
        constraint, margins = rows.constraint, rows.margins(motion)
        slack = np.zeros(int(rows.vehicles.max()) + 1)
        if constraint.key in self.rows:
            old = self.rows[constraint.key]
            old = old.select(old.vehicles < len(slack))
            np.maximum.at(slack, old.vehicles, -old.margins(motion))
        beyond = -margins > slack[rows.vehicles] + constraint.threshold * rows.tolerances
        return rows.select(with_neighbours(beyond, rows.vehicles, neighbours))

    def add(self, rows: HalfSpaces) -> None:
        """Add rows that are not known."""
        if len(rows) == 0:  # no earlier row is required around a new reference
            return
        constraint = rows.constraint
        if constraint.curved:
            self._cuts += 1
            rows = dataclasses.replace(rows, sides=np.full(len(rows), self._cuts))
        key = constraint.key
        self.coupled |= constraint.coupled
        self.rows[key] = self.rows[key].union(rows) if key in self.rows else rows
        if not constraint.curved:  # cuts of curved sets are compared by their margins
            self._not_indexed.setdefault(key, []).append(rows)

    def exchange(self, group: IntArray, rows: HalfSpaces) -> None:
        """Replace all rows of a curved set that a group of vehicles has."""
        old = self.rows.pop(rows.constraint.key, rows.constraint.none)
        self.add(old.select(~np.isin(old.vehicles, group)))
        self.add(rows)

    def _index(self, key: Hashable) -> IntArray:
        """Return the sorted keys of a constraint's rows, including those added since the last call.

        The index is built on demand, since many programs need none.
        """
        if new := self._not_indexed.pop(key, []):
            old = [self._known[key]] if key in self._known else []
            self._known[key] = np.sort(np.concatenate(old + [self._keys.of(each) for each in new]))
        return self._known[key]

    def of(self, vehicles: IntArray, count: int) -> list[HalfSpaces]:
        """Return the rows of some of `count` vehicles, by constraint."""
        rows = list(self.rows.values())
        if len(vehicles) == count:
            return rows
        own = np.zeros(count, dtype=bool)
        own[vehicles] = True
        chosen = (part.select(own[part.vehicles]) for part in rows)
        return [part for part in chosen if len(part) > 0]

    def active(self, motion: Motion) -> list[HalfSpaces]:
        """Return the rows that are active at a motion, by constraint."""
        active = (
            part.select(part.margins(motion) < _ACTIVE * part.tolerances)
            for part in self.rows.values()
        )
        return [part for part in active if len(part) > 0]

    def record(self, answers: Answers) -> None:
        """Record the solutions of the programs of some groups."""
        for index, group in enumerate(answers.groups.tolist()):
            for vehicle in group:
                self._solved[vehicle] = answers, index

    def group(self, vehicle: int) -> IntArray:
        """Return all vehicles in the last program of a vehicle, including itself."""
        if vehicle not in self._solved:
            return np.array([vehicle])
        answers, index = self._solved[vehicle]
        own: IntArray = answers.groups[index]
        return own

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """Return the rows in a vehicle's program and their multipliers y >= 0.

        The multipliers are those of the program as it is written, with unit rows and the cost in
        units squared. If the vehicle is coupled to others, the rows are those of the whole group.
        For an infeasible program the weights are a Farkas certificate, if the solver returns one.
        """
        if vehicle not in self._solved:
            return []
        answers, index = self._solved[vehicle]
        group = self.group(vehicle)
        every = (part.select(np.isin(part.vehicles, group)) for part in self.rows.values())
        rows = [part for part in every if len(part) > 0]
        y = answers.multipliers(index)
        return list(zip(rows, np.split(y, np.cumsum(list(map(len, rows)))[:-1]), strict=True))
