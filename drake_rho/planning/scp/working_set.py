"""Which rows are in the programs, and what their last solutions say of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.programs.parallel import Answers
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid

_TOUCHING = 100.0
"""Tolerances within which a row counts as active."""

_SIDES = 256
"""Bound on the sides of a box."""

_AS_MUCH = 0.01
"""Relative difference up to which a cut is broken as much as another at the same instant."""

_FINEST = 2**20
"""Parts of a step that are told apart in a key, if there are bits enough."""


@dataclasses.dataclass(frozen=True)
class RowKeys:
    """Integers for the rows of one constraint: vehicle, partner, side and time, packed."""

    vehicles: int
    """N"""
    grid: Grid
    """step and knots"""

    def of(self, rows: HalfSpaces) -> IntArray:
        """Return one integer for each row of a constraint, shape (R,), the same for equal rows."""
        radix = self.vehicles**2 * _SIDES
        parts = min(_FINEST, 2**62 // (radix * self.grid.knots))
        instants = np.rint(rows.times * (parts / self.grid.step)).astype(np.int64)
        keys: IntArray = rows.vehicles * self.vehicles + rows.partners
        return (keys * _SIDES + rows.sides) * (parts * self.grid.knots) + instants


class WorkingSet:
    """The rows that are in, and for each vehicle the program that was solved last.

    Args:
        keys: integers by which rows of a constraint are told apart.

    Attributes:
        rows: by the key of their constraint, in the order they were added.
    """

    def __init__(self, keys: RowKeys) -> None:
        self.rows: dict[Hashable, HalfSpaces] = {}
        self._keys, self._cuts = keys, 0
        self._known: dict[Hashable, IntArray] = {}
        self._not_indexed: dict[Hashable, list[HalfSpaces]] = {}
        self._solved: dict[int, tuple[Answers, int]] = {}

    def __len__(self) -> int:
        """Return the number of rows that are in."""
        return sum(map(len, self.rows.values()))

    def known(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """Return which rows of one constraint are in already, shape (R,).

        Args:
            rows: that may be added.
            motion: of all vehicles, for which they were written.
        """
        if rows.constraint.key not in self.rows:
            return np.zeros(len(rows), dtype=bool)
        if rows.constraint.curved:
            return self._known_cuts(rows, motion)
        keys, index = self._keys.of(rows), self._index(rows.constraint.key)
        place = np.minimum(np.searchsorted(index, keys), len(index) - 1)
        known: BoolArray = index[place] == keys
        return known

    def _known_cuts(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """`known` for a curved set, of which each new normal is another cut.

        A cut is known where one at the same instant is broken as much, to `_AS_MUCH`. What keeps to
        its cuts breaks none, so that a constraint that must hold is cut until it does; and one that
        may be broken, until its cuts tell by how much it is.
        """
        old = self.rows[rows.constraint.key]
        keys, theirs = (
            self._keys.of(dataclasses.replace(part, sides=np.zeros(len(part), dtype=int)))
            for part in (rows, old)
        )
        order = np.lexsort((old.margins(motion), theirs))  # of each instant the worst first
        place = np.searchsorted(theirs[order], keys)
        worst = order[np.minimum(place, len(old) - 1)]
        there, margins = theirs[worst] == keys, rows.margins(motion)
        close = old.select(worst).margins(motion) <= margins + _AS_MUCH * np.abs(margins)
        known: BoolArray = there & close
        return known

    def enter(self, rows: HalfSpaces, motion: Motion) -> tuple[HalfSpaces, HalfSpaces]:
        """Put those rows in that are not in yet.

        Args:
            rows: of one constraint.
            motion: of all vehicles, as last solved.

        Returns:
            The rows that are new, and those that were in, must hold, and are not kept.
        """
        known = self.known(rows, motion)
        if not known.any():
            self.add(rows)
            return rows, rows.constraint.none
        new = rows.select(~known)
        if len(new) > 0:
            self.add(new)
        lost = known & (rows.margins(motion) < -rows.tolerances)
        lost &= np.isinf(rows.constraint.penalty)
        return new, rows.select(lost)

    def add(self, rows: HalfSpaces) -> None:
        """Put rows in that are not known."""
        if len(rows) == 0:  # of a reference around which none of the rows before are asked for
            return
        if rows.constraint.curved:
            self._cuts += 1
            rows = dataclasses.replace(rows, sides=np.full(len(rows), self._cuts))
        key = rows.constraint.key
        self.rows[key] = self.rows[key].union(rows) if key in self.rows else rows
        if not rows.constraint.curved:  # whose cuts are compared by what they say
            self._not_indexed.setdefault(key, []).append(rows)

    def exchange(self, group: IntArray, rows: HalfSpaces) -> None:
        """Put rows of a curved set in, in place of all that a group of vehicles has of it."""
        old = self.rows.pop(rows.constraint.key, rows.constraint.none)
        self.add(old.select(~np.isin(old.vehicles, group)))
        self.add(rows)

    def _index(self, key: Hashable) -> IntArray:
        """Return the sorted keys of a constraint's rows, with what was added since the last look.

        Many programs need none.
        """
        if new := self._not_indexed.pop(key, []):
            old = [self._known[key]] if key in self._known else []
            self._known[key] = np.sort(np.concatenate(old + [self._keys.of(each) for each in new]))
        return self._known[key]

    def of(self, vehicles: IntArray, count: int) -> list[HalfSpaces]:
        """Return the rows of some of `count` vehicles, constraint by constraint."""
        rows = list(self.rows.values())
        if len(vehicles) == count:
            return rows
        wanted = np.zeros(count, dtype=bool)
        wanted[vehicles] = True
        chosen = (part.select(wanted[part.vehicles]) for part in rows)
        return [part for part in chosen if len(part) > 0]

    def active(self, motion: Motion) -> list[HalfSpaces]:
        """Return the rows at whose bounds a motion is, constraint by constraint."""
        touching = (
            part.select(part.margins(motion) < _TOUCHING * part.tolerances)
            for part in self.rows.values()
        )
        return [part for part in touching if len(part) > 0]

    def solved(self, answers: Answers) -> None:
        """Note what was found for some groups."""
        for index, group in enumerate(answers.groups.tolist()):
            for vehicle in group:
                self._solved[vehicle] = answers, index

    def group(self, vehicle: int) -> IntArray:
        """Return the vehicles that share a vehicle's program, itself among them."""
        if vehicle not in self._solved:
            return np.array([vehicle])
        answers, index = self._solved[vehicle]
        own: IntArray = answers.groups[index]
        return own

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """Return the rows in a vehicle's program and their multipliers y >= 0.

        For rows of length one and the cost in units squared, as the program is written. Where
        rows couple the vehicle to others, those of the whole group are given. Of a program without
        a solution they are weights with which its rows contradict each other, where the solver
        gives any (Farkas).
        """
        if vehicle not in self._solved:
            return []
        answers, index = self._solved[vehicle]
        group = self.group(vehicle)
        every = (part.select(np.isin(part.vehicles, group)) for part in self.rows.values())
        rows = [part for part in every if len(part) > 0]
        y = answers.multipliers(index)
        return list(zip(rows, np.split(y, np.cumsum(list(map(len, rows)))[:-1]), strict=True))
