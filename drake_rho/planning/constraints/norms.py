"""Norm constraints: balls of speeds, accelerations, thrusts or jerks, and cones of tilts."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.convex_sets import EvaluatedValues, KeepInSets
from drake_rho.planning.constraints.margins import PlanMargins, without_errors
from drake_rho.planning.constraints.smooth_jerks import smooth_jerks
from drake_rho.scenario.convex_sets import Balls
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.norms import NORMS, NormLimit
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class KeepInNorm(KeepInSets):
    """Limit on a norm, imposed at the knots.

    Velocities are linear between knots, accelerations and jerks constant. A motion that is in a
    convex set at all knots is therefore in it at every instant.
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
        if self.quantity == "jerk":  # the first acceleration may be free of a jerk limit
            limited = (times > 0.0) | ~np.isnan(motion.before[who, 0])
            who, times, values = who[limited], times[limited], values[limited]
        return EvaluatedValues(who, times, values)


def norms_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the norm constraints of all vehicles.

    The first and the last velocity are not constrained, since start and goal fix them.
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
        if limit.kind.quantity == "jerk" and scenario.smoothing is not None:
            norms[-1:] = _of_smooth_jerks(scenario, limit)
    return norms


def _of_smooth_jerks(scenario: Scenario, limit: NormLimit) -> list[Constraint]:
    """Return the limits of what jerks of averages follow from (`smooth_jerks`)."""
    sets = limit.sets
    return [
        KeepInNorm(
            kind=limit.field,
            key=each.key(limit.field),
            name=limit.kind.name,
            quantity=each.quantity,
            sets=Balls(
                each.factor * sets.origins,
                abs(each.factor) * sets.tolerances,
                abs(each.factor) * limit.limits,
            ),
            times=each.times,
            first=each.first,
            margins=without_errors(scenario.grid),
            per_width=True,
        )
        for each in smooth_jerks(scenario)
    ]
