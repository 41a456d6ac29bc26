"""Keep in curved convex sets, by tangent planes where a motion is outside."""

from __future__ import annotations

import abc
import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.constraints.stretches import near
from drake_rho.scenario.convex_sets import ConvexSets
from drake_rho.scenario.fields import FloatArray, IntArray

_SOFT_ROUNDS = 16
"""Rounds in which tangent planes of a set that may be left are added. Where nothing but violations
costs anything, solutions jump about, and their tangent planes come to an end late."""

_SOFT_ROOM = 1e3
"""Tolerances by which a set that may be left is left without another tangent plane."""


@dataclasses.dataclass(frozen=True, eq=False)
class Asked:
    """Values that are to be in their sets."""

    vehicles: IntArray
    """whose, in rising order, shape (R,)"""
    times: FloatArray
    """when, since the first knot [s], shape (R,)"""
    values: FloatArray
    """in the quantity's unit, shape (R, 3)"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInSets(Constraint):
    """A quantity of every vehicle stays in a convex set C without corners.

    Where a value x is outside, the half-space of C that faces it is the row: with n the inward
    normal at the point of C nearest to x, n · value >= -h(-n), h being the support function of C.
    For a ball of radius r around c that is n · (value - c) >= -r.

    Each round adds the tangent planes of what is still outside, and divides the excess by four
    or more: between two tangent planes at an angle of 2 φ a value is longer by φ² / 2, and the next
    tangent plane halves the angle. Around a single point, the ball of radius zero, each plane is
    orthogonal to those at which a solution is, so that three will do unless others are in the way.
    """

    sets: ConvexSets
    """C of all vehicles"""
    margins: Margins
    """how far inside of C values stay: r of n · value >= r - h(-n)"""
    curved: bool = True
    room: float = VIOLATED
    """tolerances by which values may be outside without another row"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return how far inside values stay at times since the first knot, in their unit."""
        return self.margins.at(self.quantity, times)

    @abc.abstractmethod
    def asked(self, motion: Motion, vehicles: IntArray) -> Asked:
        """Return the values that have to be in their sets, vehicle by vehicle."""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Return tangent planes where a value is outside."""
        asked = self.asked(motion, vehicles)
        who, values = asked.vehicles, asked.values
        excess = self.sets.excess(who, values) + self.margin(asked.times)
        broken = excess > self.room * self.sets.tolerances[who]
        if not broken.any():
            return self.none
        wanted = np.flatnonzero(near(broken, who, reach))
        outward = self.sets.outward(who[wanted], values[wanted])
        pointing = np.any(outward, axis=1)  # at a center no half-space faces a value
        wanted, outward = wanted[pointing], outward[pointing]
        rows = self.rows(who[wanted], asked.times[wanted], outward)
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """Return the rows, and at their instants those of a polyhedron around the set.

        Without it a motion that only violations cost anything may fly off to where a half-space
        is still open.
        """
        outward = self.sets.around(rows.vehicles)
        every = np.tile(np.arange(len(rows)), len(outward))
        faces = self.rows(rows.vehicles[every], rows.times[every], outward.reshape(-1, 3))
        return rows.union(faces)

    def rows(self, vehicles: IntArray, times: FloatArray, outward: FloatArray) -> HalfSpaces:
        """Return tangent planes of vehicles at times, (R,), with outward normals, (R, 3)."""
        return HalfSpaces(
            self,
            vehicles=vehicles,
            partners=vehicles,
            sides=np.zeros(len(vehicles), dtype=int),
            times=times,
            normals=-outward,
            bounds=self.margin(times) - self.sets.support(vehicles, outward),
            tolerances=self.sets.tolerances[vehicles],
        )

    def softened(self, penalty: float) -> Self:
        """Return this constraint with a penalty; violations are known to `_SOFT_ROOM`."""
        soft = super().softened(penalty)
        rounds = min(self.rounds, _SOFT_ROUNDS)
        return dataclasses.replace(soft, rounds=rounds, room=_SOFT_ROOM)
