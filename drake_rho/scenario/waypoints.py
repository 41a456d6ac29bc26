"""The waypoints of all vehicles as arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.convex_sets import Balls
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.parts import Grid, Vehicle
from drake_rho.scenario.shapes.base import TOLERANCE

_AT_ONCE = 1e-6
"""Part of a step after the first knot, or before the last, in which nothing can be changed."""


@dataclasses.dataclass(frozen=True, eq=False)
class Waypoints:
    """The waypoint of one number of every vehicle that has so many."""

    times: FloatArray
    """on the scenario's clock [s], shape (N,); NaN where a vehicle has no such waypoint"""
    positions: FloatArray
    """[m], shape (N, 3); NaN where a vehicle has no such waypoint"""
    within: FloatArray
    """how far from there vehicles may be [m], shape (N,); infinite where they may be anywhere"""

    @property
    def due(self) -> BoolArray:
        """Which vehicles have such a waypoint, shape (N,)."""
        return np.isfinite(self.times)

    def tolerances(self, scale: FloatArray) -> FloatArray:
        """How much further still counts as there [m], shape (N,): what a goal may be missed by.

        Args:
            scale: length scales of the motions [m], shape (N,).
        """
        return TOLERANCE * scale

    def balls(self, scale: FloatArray) -> Balls:
        """Where vehicles may be at their times; `scale` as for `tolerances`."""
        return Balls(self.positions, self.tolerances(scale), self.within)


def waypoints_of(vehicles: Sequence[Vehicle]) -> list[Waypoints]:
    """The waypoints of all vehicles, number by number."""
    count, found = len(vehicles), list[Waypoints]()
    for index in range(max(len(vehicle.waypoints) for vehicle in vehicles)):
        times, positions = np.full(count, np.nan), np.full((count, 3), np.nan)
        within = np.full(count, np.inf)
        for place, vehicle in enumerate(vehicles):
            if index < len(vehicle.waypoints):
                waypoint = vehicle.waypoints[index]
                times[place], positions[place] = waypoint.time, waypoint.position
                within[place] = waypoint.within
        found.append(Waypoints(times, positions, within))
    return found


def is_under_way(time: float, grid: Grid) -> bool:
    """Whether a time on the scenario's clock [s] is after the first knot and before the last."""
    room = max(_AT_ONCE * grid.step, grid.rounding)
    return grid.start + room < time < grid.end - room
