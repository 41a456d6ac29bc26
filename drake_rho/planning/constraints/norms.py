"""Norm constraints: balls of speeds, accelerations, thrusts or jerks, and cones of tilts."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint, constrained_knots
from drake_rho.planning.constraints.convex_sets import EvaluatedValues, KeepInSets
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.planning.constraints.smooth_jerks import jerk_factor
from drake_rho.scenario.convex_sets import Balls
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInNorm(KeepInSets):
    """Limit on a norm, imposed at the knots.

    Velocities are linear between knots, accelerations constant, and jerks are their changes at the
    knots. A motion that is in a convex set at all knots is therefore in it at every instant.
    """

    times: FloatArray
    """times of the constrained knots since the first knot [s], shape (T,)"""
    first: int
    """index of the first of `times` among the quantity's values"""

    def required_values(self, motion: Motion, vehicles: IntArray) -> EvaluatedValues:
        """Return the values at the constrained knots."""
        knots = slice(self.first, self.first + len(self.times))
        motion = motion.subdivided(self.pieces)
        values = motion.values(self.quantity)[vehicles, knots].reshape(-1, 3)
        who, times = np.repeat(vehicles, len(self.times)), np.tile(self.times, len(vehicles))
        if self.quantity == "jerk":  # unknown ones are not limited
            known = ~np.isnan(values[:, 0])
            who, times, values = who[known], times[known], values[known]
        return EvaluatedValues(who, times, values)


def norms_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the norm constraints of all vehicles.

    The first and the last velocity are not constrained, since start and goal fix them. Jerks of
    averages follow from those of the plan (`jerk_factor`).
    """
    norms = list[Constraint]()
    for norm in NORMS:
        if norm not in scenario.fleet.norms:
            continue
        limit = scenario.fleet.norms[norm]
        quantity, sets = limit.kind.quantity, limit.sets
        factor = jerk_factor(scenario) if quantity == "jerk" else None
        if factor is not None:
            sets = Balls(factor * sets.origins, factor * sets.tolerances, factor * limit.limits)
        own, pieces = margins.of(quantity)
        norms.append(
            KeepInNorm(
                kind=norm,
                key=norm,
                name=limit.kind.name,
                quantity=quantity,
                sets=sets,
                per_width=factor is not None,
                times=own.grid.elapsed[constrained_knots(quantity)],
                first=int(quantity == "velocity"),
                margins=own,
                pieces=pieces,
            )
        )
    return norms
