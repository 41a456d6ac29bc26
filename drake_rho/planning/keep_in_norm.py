"""Keep in a ball or a cone: the limits on norms, by tangent planes where a motion breaks them."""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.half_spaces import BROKEN, Constraint, HalfSpaces, near
from drake_rho.planning.keep_in import QUANTITIES
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import NORMS, NormLimit
from drake_rho.scenario.records import Scenario

_SOFT_ROUNDS = 16
"""Rounds in which tangent planes of a set that may be left are added. Where nothing but violations
costs anything, solutions jump about, and their tangent planes come to an end late."""

_SOFT_ROOM = 1e3
"""Tolerances by which a set that may be left is left without another tangent plane."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInNorm(Constraint):
    """A quantity of every vehicle stays in a convex set C that a limit on a norm makes.

    Where a value x is outside, the half-space of C that faces it is the row: with n the inward
    normal at the point of C nearest to x, n · value >= -h(-n), h being the support function of C.
    For a ball of radius r around c that is n · (value - c) >= -r. Velocities are linear between
    knots and accelerations constant, so that a value that leaves a convex set does so at a knot.

    Each round adds the tangent planes of what is still outside, and divides the excess by four
    or more: between two tangent planes at an angle of 2 φ a value is longer by φ² / 2, and the next
    tangent plane halves the angle.
    """

    limit: NormLimit
    """the sets of all vehicles"""
    times: FloatArray
    """knots at which it is asked [s], shape (T,)"""
    first: int
    """which of the quantity's values is that of the first of `times`"""
    room: float = BROKEN
    """tolerances by which values may be outside without another row"""

    def violated(
        self, motion: Motion, vehicles: IntArray, *, between: bool = False, reach: int = 0
    ) -> HalfSpaces:
        """Tangent planes at the knots where a value is outside."""
        knots = slice(self.first, self.first + len(self.times))
        values = motion.values(self.quantity)[vehicles, knots].reshape(-1, 3)
        who = np.repeat(vehicles, len(self.times))
        broken = self.limit.excess(who, values) > self.room * self.limit.tolerances[who]
        if not broken.any():
            return self.none
        wanted = np.flatnonzero(near(broken, who, reach))
        outward = self.limit.outward(who[wanted], values[wanted])
        pointing = np.any(outward, axis=1)  # at a centre no half-space faces a value
        wanted, outward = wanted[pointing], outward[pointing]
        rows = self.rows(who[wanted], self.times[wanted % len(self.times)], outward)
        return rows if np.isinf(self.penalty) else self._with_faces(rows)

    def _with_faces(self, rows: HalfSpaces) -> HalfSpaces:
        """The rows, and at their instants those of a polyhedron around the set.

        Without it a motion that only violations cost anything may fly off to where a half-space
        is still open.
        """
        outward = self.limit.around(rows.vehicles)
        every = np.tile(np.arange(len(rows)), len(outward))
        faces = self.rows(rows.vehicles[every], rows.times[every], outward.reshape(-1, 3))
        return rows.and_also(faces)

    def rows(self, vehicles: IntArray, times: FloatArray, outward: FloatArray) -> HalfSpaces:
        """Tangent planes of given vehicles at given times, (R,), with outward normals, (R, 3)."""
        return HalfSpaces(
            self,
            vehicles=vehicles,
            partners=vehicles,
            sides=np.zeros(len(vehicles), dtype=int),
            times=times,
            normals=-outward,
            bounds=-self.limit.support(vehicles, outward),
            tolerances=self.limit.tolerances[vehicles],
        )

    def softened(self, penalty: float) -> Self:
        """This set, to be left at a cost; how far it is left is known to `_SOFT_ROOM`."""
        soft = super().softened(penalty)
        rounds = min(self.rounds, _SOFT_ROUNDS)
        return dataclasses.replace(soft, rounds=rounds, room=_SOFT_ROOM)


def norms_of(scenario: Scenario) -> list[Constraint]:
    """The limits on norms that the vehicles have to keep to.

    The first and the last velocity are left out: start and goal decide them.
    """
    times, norms = scenario.grid.elapsed, list[Constraint]()
    for number, norm in enumerate(NORMS, start=len(QUANTITIES)):
        if norm not in scenario.fleet.norms:
            continue
        limit = scenario.fleet.norms[norm]
        inner = limit.quantity == "velocity"
        norms.append(
            KeepInNorm(
                number=number,
                name=limit.name,
                quantity=limit.quantity,
                curved=True,
                limit=limit,
                times=times[1:-1] if inner else times[:-1],
                first=int(inner),
            )
        )
    return norms
