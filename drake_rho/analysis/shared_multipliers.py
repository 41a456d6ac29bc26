"""Bounds on the sums of multipliers of soft limits.

The slack s of such a limit and vehicle enters all its rows and costs p s. So the Lagrangian has a
least value over s >= 0, at s = 0, only if the multipliers of the rows, each in the unit in which
the slack enters, add up to at most p. For a ball that is kept out,

    norm(x - c) >= R - s   implies   R² - norm(x - c)² <= 2 R s,

so that s enters its quadratic term over 2 R with a factor of at most one, or of the largest scale
for an ellipsoid.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from typing import Self

import numpy as np

from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True, eq=False)
class SharedMultipliers:
    """Terms of a Lagrangian that share slacks, with the part of the price that each uses."""

    labels: IntArray
    """number of each term's slack, -1 for those of hard limits, shape (R,)"""
    parts: FloatArray
    """part of the price for a multiplier of one, shape (R,)"""

    @classmethod
    def none(cls) -> Self:
        """Return no terms."""
        return cls(np.zeros(0, dtype=int), np.zeros(0))

    def select(self, used: BoolArray) -> Self:
        """Return some of the terms."""
        return dataclasses.replace(self, labels=self.labels[used], parts=self.parts[used])

    def joined(self, other: Self) -> Self:
        """Return these terms, then others."""
        labels = np.concatenate([self.labels, other.labels])
        return dataclasses.replace(
            self, labels=labels, parts=np.concatenate([self.parts, other.parts])
        )

    def within_prices(self, multipliers: FloatArray) -> FloatArray:
        """Return multipliers scaled down where they add up to more than their price, shape (R,)."""
        shared = self.labels >= 0
        if not shared.any():
            return multipliers
        sums = np.bincount(self.labels[shared], self.parts[shared] * multipliers[shared])
        factors = np.append(1.0 / np.maximum(sums, 1.0), 1.0)  # -1 stands for the last one
        return np.asarray(multipliers * factors[self.labels])

    def beyond_slack(self, violations: FloatArray) -> FloatArray:
        """Return the violations of terms less their slack, which is the largest of them, (R,)."""
        slacks = np.zeros(int(self.labels.max(initial=-1)) + 2)
        shared = self.labels >= 0
        np.maximum.at(slacks, self.labels[shared], violations[shared] / self.parts[shared])
        return np.asarray(violations - slacks[self.labels] * self.parts)


class Slacks:
    """Numbers of slacks, one for each vehicle of each soft limit."""

    def __init__(self) -> None:
        self._numbers: dict[tuple[Hashable, int], int] = {}

    def number(self, key: Hashable, vehicles: int) -> None:
        """Give numbers to the slacks of all vehicles of a soft limit."""
        for vehicle in range(vehicles):
            self._numbers.setdefault((key, vehicle), len(self._numbers))

    def of(self, rows: HalfSpaces, parts: FloatArray) -> SharedMultipliers:
        """Return the slacks of rows.

        Args:
            rows: rows of one constraint, hard or not.
            parts: part of the price for a multiplier of one, shape (R,); not used if it is hard.
        """
        if rows.constraint.prices is None:
            return SharedMultipliers(np.full(len(rows), -1), np.zeros(len(rows)))
        key = rows.constraint.key
        labels = [
            self._numbers.setdefault((key, vehicle), len(self._numbers))
            for vehicle in rows.vehicles.tolist()
        ]
        return SharedMultipliers(np.array(labels, dtype=int), parts)
