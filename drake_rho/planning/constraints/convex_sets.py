"""Convex set constraints: tangent planes of curved sets where a motion is outside."""

from __future__ import annotations

import abc
import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import VIOLATED, Constraint, HalfSpaces
from drake_rho.planning.constraints.margins import Margins
from drake_rho.planning.constraints.stretches import with_neighbours
from drake_rho.scenario.convex_sets import ConvexSets
from drake_rho.scenario.fields import FloatArray, IntArray

_SOFT_ROUNDS = 16
"""Limit on the rounds that add tangent planes of soft sets. Where only violations are penalised,
successive solutions differ widely, and their tangent planes converge slowly."""

_SOFT_THRESHOLD = 1e3
"""Violation of a soft set, in tolerances, up to which no further tangent plane is added."""


@dataclasses.dataclass(frozen=True, eq=False)
class EvaluatedValues:
    """Values of a quantity to keep in their vehicles' sets."""

    vehicles: IntArray
    """indices of the vehicles in increasing order, shape (R,)"""
    times: FloatArray
    """times since the first knot [s], shape (R,)"""
    values: FloatArray
    """values in the quantity's unit, shape (R, 3)"""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInSets(Constraint):
    """Constraint that keeps a quantity of every vehicle in a smooth convex set C.

    The row of a value x outside of C is the supporting half-space n · value >= -h(-n). Here n is
    the inward normal at the point of C nearest to x, and h is the support function of C. For a
    ball of radius r around c the half-space is n · (value - c) >= -r.

    Each round adds the tangent planes of all values outside, and divides the excess by at least
    four: between two tangent planes at an angle of 2 φ the relative excess is at most φ² / 2, and
    the next tangent plane halves the angle. For a single point, the ball of radius zero, each plane
    is orthogonal to the active ones, so that three suffice if no other constraint interferes.
    """

    sets: ConvexSets
    """sets C of all vehicles"""
    margins: Margins
    """required distances r of values from the boundary of C: n · value >= r - h(-n)"""
    curved: bool = True
    as_cone: bool = True
    threshold: float = VIOLATED
    """violation, in tolerances, up to which no row is added"""
    roundings: FloatArray | float = 0.0
    """bounds on the rounding errors of values, subtracted from the rows' bounds, in the quantity's
    unit, shape (N,): else planes through one point far from the origin may contradict each other"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return margins of values at times since the first knot [s], in the quantity's unit."""
        return self.margins.at(self.quantity, times)

    @abc.abstractmethod
    def required_values(self, motion: Motion, vehicles: IntArray) -> EvaluatedValues:
        """Return the values that are required to be in their sets, sorted by vehicle."""

    def violated_rows(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, neighbours: int = 0
    ) -> HalfSpaces:
        """Return tangent planes of the sets whose required values are outside."""
        required = self.required_values(motion, vehicles)
        who, values = required.vehicles, required.values
        excess = self.sets.excess(who, values) + self.margin(required.times)
        violated = excess > self.threshold * self.sets.tolerances[who]
        if not violated.any():
            return self.none
        wanted = np.flatnonzero(with_neighbours(violated, who, neighbours))
        outward = self.sets.outward(who[wanted], values[wanted])
        pointing = np.any(outward, axis=1)  # the normal is not unique at a centre
        wanted, outward = wanted[pointing], outward[pointing]
        rows = self.rows(who[wanted], required.times[wanted], outward)
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """Return rows together with the faces of a polyhedron around the set at their instants.

        Without these faces, a motion with penalised violations only may move far away in a
        direction that no tangent plane bounds yet.
        """
        outward = self.sets.around(rows.vehicles)
        every = np.tile(np.arange(len(rows)), len(outward))
        faces = self.rows(rows.vehicles[every], rows.times[every], outward.reshape(-1, 3))
        return rows.union(faces)

    def rows(self, vehicles: IntArray, times: FloatArray, outward: FloatArray) -> HalfSpaces:
        """Return tangent planes for vehicles and times, (R,), with outward normals, (R, 3)."""
        roundings = np.broadcast_to(self.roundings, self.sets.tolerances.shape)[vehicles]
        return HalfSpaces(
            self,
            vehicles=vehicles,
            partners=vehicles,
            sides=np.zeros(len(vehicles), dtype=int),
            times=times,
            normals=-outward,
            bounds=self.margin(times) - self.sets.support(vehicles, outward) - roundings,
            tolerances=self.sets.tolerances[vehicles],
        )

    def softened(self, penalty: float) -> Self:
        """Return this constraint with a penalty, fewer rounds and the threshold of soft sets."""
        soft = super().softened(penalty)
        rounds = min(self.rounds, _SOFT_ROUNDS)
        return dataclasses.replace(soft, rounds=rounds, threshold=_SOFT_THRESHOLD)
