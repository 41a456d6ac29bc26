"""Keep in a ball or a cone: the limits on norms."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.convex_sets import Asked, KeepInSets
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInNorm(KeepInSets):
    """A limit on a norm, at the knots.

    Velocities are linear between knots, accelerations and jerks constant, so that a value that
    leaves a convex set does so at a knot.
    """

    times: FloatArray
    """knots at which it is asked, since the first one [s], shape (T,)"""
    first: int
    """which of the quantity's values is that of the first of `times`"""

    def asked(self, motion: Motion, vehicles: IntArray) -> Asked:
        """Return the values at the knots."""
        motion, knots = (
            motion.subdivided(self.pieces),
            slice(self.first, self.first + len(self.times)),
        )
        values = motion.values(self.quantity)[vehicles, knots].reshape(-1, 3)
        who, times = np.repeat(vehicles, len(self.times)), np.tile(self.times, len(vehicles))
        if self.quantity == "jerk":  # the first acceleration may be free of a jerk limit
            limited = ~np.isnan(values[:, 0])
            who, times, values = who[limited], times[limited], values[limited]
        return Asked(who, times, values)


def norms_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the constraints of the limits on norms.

    The first and the last velocity are left out: start and goal decide them.
    """
    norms = list[Constraint]()
    for norm in NORMS:
        if norm not in scenario.fleet.norms:
            continue
        limit = scenario.fleet.norms[norm]
        inner = limit.kind.quantity == "velocity"
        own, pieces = margins.of(limit.kind.quantity)
        times = own.grid.elapsed
        norms.append(
            KeepInNorm(
                kind=norm,
                key=norm,
                name=limit.kind.name,
                quantity=limit.kind.quantity,
                sets=limit.sets,
                times=times[1:-1] if inner else times[:-1],
                first=int(inner),
                margins=own,
                pieces=pieces,
            )
        )
    return norms
