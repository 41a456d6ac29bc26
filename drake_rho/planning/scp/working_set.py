"""Which rows are in the programs, and what their last solutions say of them."""

from __future__ import annotations

import dataclasses

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
class Keys:
    """How a row is packed into an integer: constraint, vehicle, partner, side, time."""

    constraints: int
    """bound on the constraints' numbers"""
    vehicles: int
    """N"""
    grid: Grid
    """step and knots"""

    def of(self, rows: HalfSpaces) -> IntArray:
        """One number for each row, shape (R,); rows that are the same have the same."""
        radix = self.constraints * self.vehicles**2 * _SIDES
        parts = min(_FINEST, 2**62 // (radix * self.grid.knots))
        instants = np.rint(rows.times * (parts / self.grid.step)).astype(np.int64)
        keys: IntArray = rows.vehicles * self.vehicles + rows.partners
        keys = (keys * _SIDES + rows.sides) * self.constraints + rows.constraint.number
        return keys * (parts * self.grid.knots) + instants


class WorkingSet:
    """The rows that are in, and for each vehicle the program that was solved last.

    Args:
        keys: how rows are told apart.

    Attributes:
        rows: by the number of their constraint, in the order they were added.
    """

    def __init__(self, keys: Keys) -> None:
        self.rows: dict[int, HalfSpaces] = {}
        self._keys, self._known, self._cuts = keys, np.zeros(0, dtype=np.int64), 0
        self._not_indexed: list[HalfSpaces] = []
        self._solved: dict[int, tuple[Answers, int]] = {}

    def __len__(self) -> int:
        """How many rows are in."""
        return sum(map(len, self.rows.values()))

    def known(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """Which rows of one constraint are in already, shape (R,).

        Args:
            rows: that may be added.
            motion: of all vehicles, for which they were written.
        """
        if rows.constraint.number not in self.rows:
            return np.zeros(len(rows), dtype=bool)
        if rows.constraint.curved:
            return self._known_cuts(rows, motion)
        keys = self._keys.of(rows)
        self._index()
        place = np.minimum(np.searchsorted(self._known, keys), len(self._known) - 1)
        known: BoolArray = self._known[place] == keys
        return known

    def _known_cuts(self, rows: HalfSpaces, motion: Motion) -> BoolArray:
        """`known` for a curved set, of which each new normal is another cut.

        A cut is known where one at the same instant is broken as much, to `_AS_MUCH`. What keeps to
        its cuts breaks none, so that a constraint that must hold is cut until it does; and one that
        may be broken, until its cuts tell by how much it is.
        """
        old = self.rows[rows.constraint.number]
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
        number = rows.constraint.number
        if number in self.rows:
            self.rows[number] = self.rows[number].and_also(rows)
        else:
            self.rows[number] = rows
        if not rows.constraint.curved:  # whose cuts are compared by what they say
            self._not_indexed.append(rows)

    def exchange(self, group: IntArray, rows: HalfSpaces) -> None:
        """Put rows of a curved set in, in place of all that a group of vehicles has of it."""
        old = self.rows.pop(rows.constraint.number, rows.constraint.none)
        self.add(old.select(~np.isin(old.vehicles, group)))
        self.add(rows)

    def _index(self) -> None:
        """Sort in the keys of what was added since the last look: many programs need none."""
        if self._not_indexed:
            new = np.sort(np.concatenate([self._keys.of(rows) for rows in self._not_indexed]))
            self._known = np.sort(np.concatenate([self._known, new]), kind="stable")
            self._not_indexed = []

    def of(self, vehicles: IntArray, count: int) -> list[HalfSpaces]:
        """The rows of some of `count` vehicles, constraint by constraint."""
        rows = list(self.rows.values())
        if len(vehicles) == count:
            return rows
        wanted = np.zeros(count, dtype=bool)
        wanted[vehicles] = True
        chosen = (part.select(wanted[part.vehicles]) for part in rows)
        return [part for part in chosen if len(part) > 0]

    def active(self, motion: Motion) -> list[HalfSpaces]:
        """The rows at whose bounds a motion of all vehicles is, constraint by constraint."""
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
        """The vehicles that share a vehicle's program, itself among them."""
        if vehicle not in self._solved:
            return np.array([vehicle])
        answers, index = self._solved[vehicle]
        own: IntArray = answers.groups[index]
        return own

    def multipliers(self, vehicle: int) -> list[tuple[HalfSpaces, FloatArray]]:
        """The rows in a vehicle's program and their multipliers y >= 0, constraint by constraint.

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
