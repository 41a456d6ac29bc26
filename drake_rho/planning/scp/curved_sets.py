"""Curved sets in programs: tangent planes at first, cones where these come to no end."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.convex_sets import KeepInSets
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.scenario.fields import BoolArray, IntArray

_CREEPING = 10
"""Rounds that add tangent planes of a vehicle's curved sets before these enter as they are. Where
there is room most scenarios need fewer: each round quarters what is left outside, at least."""

_AS_GOOD_AS_KEPT = 0.5
"""Tolerances by which a solution may be outside of a set that is, or was, in a program as a cone:
tangent planes that go on from there would take dozens of rounds for the digits that are left."""


class CurvedSets:
    """Choice between cones and tangent planes, for each vehicle's curved sets.

    Args:
        cones: programs with cones, which know whose sets entered as cones before.

    Attributes:
        cones: as given.
        as_cones: whose sets are in as cones, shape (N,).
        sets: the constraints with curved sets.
        soft: whether some constraint may be violated: solutions are steps on the way to others.
    """

    def __init__(self, cones: ConicPrograms) -> None:
        self.cones, self.as_cones = cones, cones.needed.copy()
        self.sets, self.soft = list[KeepInSets](), False
        self._rounds = np.zeros(len(self.as_cones), dtype=int)
        self._back_to_planes: BoolArray = np.zeros(len(self.as_cones), dtype=bool)

    def add(self, constraints: Iterable[Constraint]) -> None:
        """Note more constraints."""
        for each in constraints:
            self.soft |= bool(np.isfinite(each.penalty))
            if isinstance(each, KeepInSets):
                self.sets.append(each)

    def planes_to_add(self, rows: HalfSpaces, motion: Motion) -> HalfSpaces:
        """Return the tangent planes that are to be added: sets that are in as cones need none.

        A set that is much smaller than its distance from zero is kept by rows to more digits than
        as a cone. Tangent planes where the cone's solution is go on from there, unless something
        may be violated, for which few digits do.
        """
        conic, again = self.as_cones[rows.vehicles], self._back_to_planes[rows.vehicles]
        if not (conic | again).any():
            return rows
        if self.soft:
            return rows.select(~conic)
        outside = rows.margins(motion) < -_AS_GOOD_AS_KEPT * rows.tolerances
        self.back_to_planes(np.unique(rows.vehicles[conic & outside]))
        return rows.select(outside | ~(conic | again))

    def count_round(self, vehicles: IntArray) -> None:
        """Note that another round adds planes of these vehicles' sets; some enter as cones then."""
        self._rounds[vehicles] += 1
        creeping = (self._rounds[vehicles] > _CREEPING) & ~self._back_to_planes[vehicles]
        self.to_cones(vehicles[creeping])

    def cut_by_planes(self, vehicles: IntArray) -> IntArray:
        """Return the vehicles whose sets have tangent planes that could be cones instead."""
        return vehicles[(self._rounds[vehicles] > 0) & ~self._back_to_planes[vehicles]]

    def to_cones(self, vehicles: IntArray) -> None:
        """Put sets of some vehicles in as cones, here and in later programs."""
        self.as_cones[vehicles] = self.cones.needed[vehicles] = True

    def back_to_planes(self, vehicles: IntArray) -> None:
        """Go back to tangent planes of some vehicles' sets, for good in these programs."""
        self.as_cones[vehicles], self._back_to_planes[vehicles] = False, True
