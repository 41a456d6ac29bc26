"""Waypoint constraints: a ball of positions at one time, which need not be a knot's."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.dynamics import Motion
from drake_rho.motion.smooth import SmoothMotion
from drake_rho.planning.constraints.base import Constraint
from drake_rho.planning.constraints.convex_sets import EvaluatedValues, KeepInSets
from drake_rho.planning.constraints.margins import PlanMargins
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PassWaypoint(KeepInSets):
    """Constraint on the k-th waypoint of every vehicle with at least k waypoints.

    A waypoint to be passed exactly is a ball of radius zero and needs no special treatment: the
    boundary of every half-space that a motion violates contains the waypoint. With a smoothing the
    ball is one of averaged positions, which are linear in the accelerations too.
    """

    times: FloatArray
    """times since the first knot [s], shape (N,); NaN for vehicles without such a waypoint"""

    def margin(self, times: FloatArray) -> FloatArray:
        """Return position radii at the instants themselves, not the largest in their steps."""
        return self.margins.position_radius(times)

    def required_values(self, motion: Motion, vehicles: IntArray) -> EvaluatedValues:
        """Return the positions at the waypoints' times."""
        who = vehicles[np.isfinite(self.times[vehicles])]
        times = self.times[who]
        if self.averaged is not None:
            smooth = SmoothMotion(motion, self.averaged)
            return EvaluatedValues(who, times, smooth.each_at(who, times))
        return EvaluatedValues(who, times, motion.each_at("position", who, times))


def waypoints_of(scenario: Scenario, margins: PlanMargins) -> list[Constraint]:
    """Return the waypoint constraints of all vehicles."""
    scale = scenario.fleet.scale("position")
    return [
        PassWaypoint(
            kind="waypoints",
            key=("waypoint", index),
            name=f"waypoint {index + 1}",
            quantity="position",
            sets=waypoints.balls(scale),
            roundings=scenario.fleet.coordinate_errors,
            times=scenario.grid.since_start(waypoints.times),
            averaged=scenario.smoothing,
            margins=margins.steps if margins.convex is None else margins.convex,
        )
        for index, waypoints in enumerate(scenario.fleet.waypoints)
    ]
