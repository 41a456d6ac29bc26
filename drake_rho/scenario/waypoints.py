"""Waypoints of all vehicles as arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.convex_sets import Balls
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Vehicle
from drake_rho.scenario.shapes.base import TOLERANCE

_AT_ONCE = 1e-6
"""Part of a step after the first knot, or before the last, that counts as the knot itself: no
acceleration can have an effect in it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints with the same number, one of every vehicle that has so many."""

    times: FloatArray
    """times on the scenario's clock [s], shape (N,); NaN where a vehicle has no such waypoint, or
    where its time is free"""
    positions: FloatArray
    """positions [m], shape (N, 3); NaN where a vehicle has no such waypoint"""
    within: FloatArray
    """largest distance from the waypoint [m], shape (N,); infinite where there is none"""

    @property
    def present(self) -> BoolArray:
        """Mask of the vehicles that have such a waypoint, with a time, shape (N,)."""
        return np.isfinite(self.times)

    def tolerances(self, scale: FloatArray) -> FloatArray:
        """Return by how much vehicles may miss the waypoint [m], shape (N,): as for a goal.

        Args:
            scale: length scales of the motions [m], shape (N,).
        """
        return TOLERANCE * scale

    def balls(self, scale: FloatArray) -> Balls:
        """Return the balls of positions allowed at the times; `scale` as for `tolerances`."""
        return Balls(self.positions, self.tolerances(scale), self.within)


def waypoints_of(vehicles: Sequence[Vehicle]) -> list[Waypoints]:
    """Return the waypoints of all vehicles, number by number."""
    count, found = len(vehicles), list[Waypoints]()
    for index in range(max(len(vehicle.waypoints) for vehicle in vehicles)):
        times, positions = np.full(count, np.nan), np.full((count, 3), np.nan)
        within = np.full(count, np.inf)
        for i, vehicle in enumerate(vehicles):
            if index < len(vehicle.waypoints):
                waypoint = vehicle.waypoints[index]
                times[i] = np.nan if waypoint.time is None else waypoint.time
                positions[i] = waypoint.position
                within[i] = waypoint.within
        found.append(Waypoints(times, positions, within))
    return found


def is_during_flight(time: float, grid: Grid) -> bool:
    """Return whether a time on the scenario's clock [s] is strictly between first and last knot."""
    least = max(_AT_ONCE * grid.step, grid.rounding)
    return grid.start + least < time < grid.end - least


@dataclasses.dataclass(frozen=True, eq=False)
class FreeWaypoints:
    """Waypoints of vehicles that are passed in their order, at times that are found."""

    vehicles: IntArray
    """index of the vehicle of each waypoint, in increasing order, shape (W,)"""
    numbers: IntArray
    """index of each among the waypoints of its vehicle, shape (W,)"""
    positions: FloatArray
    """positions [m], shape (W, 3)"""
    within: FloatArray
    """largest distances from these [m], shape (W,)"""

    @classmethod
    def of(cls, vehicles: Sequence[Vehicle]) -> FreeWaypoints:
        """Return the waypoints without a time of all vehicles."""
        found = [
            (i, k, each)
            for i, vehicle in enumerate(vehicles)
            for k, each in enumerate(vehicle.waypoints)
            if each.time is None
        ]
        return cls(
            np.array([i for i, _, _ in found], dtype=int),
            np.array([k for _, k, _ in found], dtype=int),
            np.array([each.position for _, _, each in found]).reshape(-1, 3),
            np.array([each.within for _, _, each in found]),
        )

    def __len__(self) -> int:
        """Return the number of waypoints, W."""
        return len(self.vehicles)

    def placed(self, vehicles: Sequence[Vehicle], times: FloatArray | None) -> tuple[Vehicle, ...]:
        """Return the vehicles with these waypoints at times [s], (W,); without them if None."""
        changed = [list(vehicle.waypoints) for vehicle in vehicles]
        for index, (i, k) in enumerate(zip(self.vehicles, self.numbers, strict=True)):
            if times is not None:
                changed[i][k] = dataclasses.replace(changed[i][k], time=float(times[index]))
        return tuple(
            dataclasses.replace(vehicle, waypoints=tuple(w for w in own if w.time is not None))
            for vehicle, own in zip(vehicles, changed, strict=True)
        )
