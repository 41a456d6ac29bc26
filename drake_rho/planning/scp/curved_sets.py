"""Curved sets in programs: tangent planes at first, cones where these do not converge."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint, HalfSpaces
from drake_rho.planning.constraints.keep_in import KeepInSets
from drake_rho.planning.programs.conic import ConicPrograms
from drake_rho.scenario.fields import BoolArray, IntArray

_MAX_PLANE_ROUNDS = 10
"""Rounds that add tangent planes of a vehicle's curved sets before the sets enter as cones. Most
scenarios with slack need fewer, since each round reduces the violation to a quarter or less."""

_CONE_ACCURACY = 0.5
"""Largest violation, in tolerances, at which a set counts as satisfied if it is, or was, in a
program as a cone. Tangent planes would take dozens of rounds for the remaining digits."""


class CurvedSets:
    """Choice between cones and tangent planes for the curved sets of each vehicle.

    Args:
        cones: programs with cones; they record the vehicles whose sets entered as cones before.

    Attributes:
        cones: the programs with cones.
        as_cones: flags of the vehicles whose sets are in the programs as cones, shape (N,).
        sets: the constraints whose sets can be cones, by key.
        soft: whether any constraint may be violated, so that solutions are intermediate steps.
    """

    def __init__(self, cones: ConicPrograms) -> None:
        self.cones, self.as_cones = cones, cones.needed.copy()
        self.sets, self.soft = dict[Hashable, KeepInSets](), False
        self._rounds = np.zeros(len(self.as_cones), dtype=int)
        self._back_to_planes: BoolArray = np.zeros(len(self.as_cones), dtype=bool)

    def add(self, constraints: Iterable[Constraint]) -> None:
        """Register further constraints."""
        for each in constraints:
            self.soft |= bool(np.isfinite(each.penalty))
            if each.curved and isinstance(each, KeepInSets) and each.as_cone:
                self.sets[each.key] = each

    def planes_to_add(self, rows: HalfSpaces, motion: Motion) -> HalfSpaces:
        """Return the tangent planes to add; sets that are in the programs as cones need none.

        If a set is much smaller than its distance from zero, rows are more accurate than a cone. If
        a solution with cones violates such a set, tangent planes replace the cones and continue
        from that solution. With soft constraints the cones stay, since few digits suffice.
        """
        conic, again = self.as_cones[rows.vehicles], self._back_to_planes[rows.vehicles]
        if not (conic | again).any():
            return rows
        if self.soft:
            return rows.select(~conic)
        outside = rows.margins(motion) < -_CONE_ACCURACY * rows.tolerances
        self.back_to_planes(np.unique(rows.vehicles[conic & outside]))
        return rows.select(outside | ~(conic | again))

    def count_round(self, vehicles: IntArray) -> None:
        """Count a round that adds tangent planes for these vehicles; put slow sets in as cones."""
        self._rounds[vehicles] += 1
        slow = (self._rounds[vehicles] > _MAX_PLANE_ROUNDS) & ~self._back_to_planes[vehicles]
        self.to_cones(vehicles[slow])

    def cut_by_planes(self, vehicles: IntArray) -> IntArray:
        """Return the vehicles with tangent planes that cones could replace."""
        return vehicles[(self._rounds[vehicles] > 0) & ~self._back_to_planes[vehicles]]

    def to_cones(self, vehicles: IntArray) -> None:
        """Put the sets of some vehicles in as cones, in these programs and in later ones."""
        self.as_cones[vehicles] = self.cones.needed[vehicles] = True

    def back_to_planes(self, vehicles: IntArray) -> None:
        """Return the sets of some vehicles to tangent planes for the rest of these programs."""
        self.as_cones[vehicles], self._back_to_planes[vehicles] = False, True
