"""Keep to waypoints: a ball of positions at one time, which need not be that of a knot."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.convex_sets import Asked, KeepInSets
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PassWaypoint(KeepInSets):
    """The waypoint of one number of every vehicle that has so many.

    Exactly there, within zero, is a ball like others: what a motion breaks first is a half-space
    with the waypoint on its boundary, and so is what it breaks then.
    """

    times: FloatArray
    """of all vehicles, since the first knot [s], shape (N,); NaN where one has no such waypoint"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return the radius of the position then: one instant counts, not a step."""
        return self.margins.exactly(times)

    def asked(self, motion: Motion, vehicles: IntArray) -> Asked:
        """Return the positions at the waypoints' times."""
        who = vehicles[np.isfinite(self.times[vehicles])]
        times = self.times[who]
        return Asked(who, times, motion.each_at("position", who, times))


def waypoints_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the constraints of the waypoints."""
    scale = scenario.fleet.scale("position")
    return [
        PassWaypoint(
            kind="waypoints",
            key=("waypoint", index),
            name=f"waypoint {index + 1}",
            quantity="position",
            sets=waypoints.balls(scale),
            times=waypoints.times - scenario.grid.start,
            margins=margins.steps,
        )
        for index, waypoints in enumerate(scenario.fleet.waypoints)
    ]
