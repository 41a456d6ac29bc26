"""Waypoints of all vehicles as arrays."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.scenario.convex_sets import Balls
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid, Vehicle, Waypoint
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.times import steps_begun

_AT_ONCE = 1e-6
"""Part of a step after the first knot, or before the last, that counts as the knot itself: no
acceleration can have an effect in it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints with the same number and name, one of each vehicle."""

    index: int
    """index within each vehicle"""
    called: str
    """name in reports"""
    times: FloatArray
    """times on the scenario's clock [s], shape (N,); NaN where a vehicle has no such waypoint, or
    where its time is free"""
    positions: FloatArray
    """positions [m], shape (N, 3); NaN where a vehicle has no such waypoint"""
    within: FloatArray
    """largest distance from the waypoint [m], shape (N,); infinite where there is none"""
    penalties: FloatArray
    """cost of each metre further away [m/s⁴], shape (N,); infinite where it must be passed"""

    @property
    def soft(self) -> BoolArray:
        """Mask of the vehicles that may miss the waypoint at a price, shape (N,)."""
        return np.isfinite(self.penalties)

    @property
    def present(self) -> BoolArray:
        """Mask of the vehicles with such a waypoint and a time for it, shape (N,)."""
        return np.isfinite(self.times)

    def tolerances(self, scale: FloatArray) -> FloatArray:
        """Return the tolerances of the waypoint, as for a goal [m], shape (N,).

        Args:
            scale: length scales of the motions [m], shape (N,).
        """
        return TOLERANCE * scale

    def balls(self, scale: FloatArray) -> Balls:
        """Return the balls of positions allowed at the times; `scale` as for `tolerances`."""
        return Balls(self.positions, self.tolerances(scale), self.within)


def waypoints_of(vehicles: Sequence[Vehicle], grid: Grid) -> list[Waypoints]:
    """Return the waypoints of all vehicles, grouped by number and name.

    Positions at which vehicles dwell since the start are theirs, and not passed any more.

    Args:
        vehicles: all vehicles.
        grid: first and last knot.
    """
    found = list[Waypoints]()
    for index in range(max([len(vehicle.waypoints) for vehicle in vehicles])):
        own = [_numbered(vehicle, index, grid) for vehicle in vehicles]
        for name in dict.fromkeys(each.name for each in own if each is not None):
            of_name = [each if each and each.name == name else None for each in own]
            found.append(_grouped(index, of_name))
    return found


def _numbered(vehicle: Vehicle, index: int, grid: Grid) -> Waypoint | None:
    """Return a vehicle's waypoint by its index; None if there is none to be passed."""
    if index >= len(vehicle.waypoints):
        return None
    waypoint = vehicle.waypoints[index]
    return None if waypoint.dwell > 0.0 and _has_begun(waypoint, grid) else waypoint


def _has_begun(waypoint: Waypoint, grid: Grid) -> bool:
    """Return whether the time of a waypoint is not after the first knot."""
    return waypoint.time is not None and waypoint.time <= grid.start + _AT_ONCE * grid.step


def _grouped(index: int, waypoints: Sequence[Waypoint | None]) -> Waypoints:
    """Return waypoints with the same number and name, of which some vehicles have none."""
    count, called = len(waypoints), ""
    times, positions = np.full(count, np.nan), np.full((count, 3), np.nan)
    within, penalties = np.full(count, np.inf), np.full(count, np.inf)
    for i, waypoint in enumerate(waypoints):
        if waypoint is not None:
            called = waypoint.called(index + 1)
            times[i] = np.nan if waypoint.time is None else waypoint.time
            positions[i] = waypoint.position
            within[i] = waypoint.within
            if waypoint.penalty is not None:
                penalties[i] = waypoint.penalty
    return Waypoints(index, called, times, positions, within, penalties)


def in_order(vehicle: Vehicle) -> list[tuple[float, Waypoint]]:
    """Return the waypoints with a time, in the order of their times [s]."""
    timed = [(each.time, each) for each in vehicle.waypoints if each.time is not None]
    return sorted(timed, key=lambda pair: pair[0])


def check_times(vehicles: Sequence[Vehicle]) -> None:
    """Check that all waypoints have a time.

    Raises:
        ScenarioError: a waypoint has no time.
    """
    for i, vehicle in enumerate(vehicles):
        for k, each in enumerate(vehicle.waypoints):
            if each.time is None:
                expected = "a time, which `rho.plan` and `rho.plan_minimum_time` find"
                where = f"vehicles[{i}].waypoints[{k}].time"
                raise ScenarioError(where, Description("none"), expected)


def is_during_flight(time: float, grid: Grid, earlier: float = 0.0) -> bool:
    """Return whether a time on the scenario's clock is strictly between first and last knot.

    Args:
        time: the time [s].
        grid: the grid.
        earlier: time by which the motion begins before the first knot [s].
    """
    first, last = grid.start - earlier, grid.end
    inside = grid.clock.after(time, first) & grid.clock.before(time, last)
    return bool(inside) and first + _AT_ONCE * grid.step < time < last - _AT_ONCE * grid.step


def is_ahead(waypoint: Waypoint, grid: Grid, lead: float) -> bool:
    """Return whether a waypoint is in the rest of a flight, which begins `lead` [s] earlier.

    One at which a vehicle dwells is, until this is over.
    """
    if waypoint.time is None or is_during_flight(waypoint.time, grid, lead):
        return True
    if waypoint.dwell == 0.0 or not _has_begun(waypoint, grid):
        return False
    _, last = rests(waypoint, grid)
    return bool(grid.clock.after(grid.step * last, -lead))


def rests(waypoint: Waypoint, grid: Grid) -> tuple[int, int]:
    """Return the first and the last knot of the steps at rest at a waypoint with a time.

    These are the steps that the dwell meets, from 0; a dwell that began before has a negative one.
    """
    assert waypoint.time is not None  # noqa: S101  # callers check this
    begin, end = grid.since_start([waypoint.time, waypoint.time + waypoint.dwell])
    return int(steps_begun(begin, grid.step)), -int(steps_begun(-end, grid.step))


@dataclasses.dataclass(frozen=True, eq=False)
class AllWaypoints:
    """Waypoints of all vehicles in one sequence."""

    vehicles: IntArray
    """index of the vehicle of each waypoint, in increasing order, shape (W,)"""
    numbers: IntArray
    """index of each waypoint within its vehicle, shape (W,)"""
    times: FloatArray
    """times on the scenario's clock [s], NaN where they are free, shape (W,)"""
    positions: FloatArray
    """positions [m], shape (W, 3)"""
    within: FloatArray
    """largest distances from these [m], shape (W,)"""
    dwells: FloatArray
    """least times at rest there [s], shape (W,)"""

    @classmethod
    def of(cls, vehicles: Sequence[Vehicle]) -> AllWaypoints:
        """Return the waypoints of all vehicles."""
        found = [
            (
                i,
                k,
                np.nan if each.time is None else each.time,
                each.position,
                each.within,
                each.dwell,
            )
            for i, vehicle in enumerate(vehicles)
            for k, each in enumerate(vehicle.waypoints)
        ]
        columns = zip(*found, strict=True) if found else [()] * 6
        who, numbers, times, positions, within, dwells = columns
        return cls(
            np.array(who, dtype=int),
            np.array(numbers, dtype=int),
            np.array(times, dtype=float),
            np.array(positions, dtype=float).reshape(-1, 3),
            np.array(within, dtype=float),
            np.array(dwells, dtype=float),
        )

    def __len__(self) -> int:
        """Return the number of waypoints, W."""
        return len(self.vehicles)

    @property
    def given(self) -> BoolArray:
        """Mask of the waypoints with a time, shape (W,)."""
        return np.isfinite(self.times)

    def placed(self, vehicles: Sequence[Vehicle], times: FloatArray | None) -> tuple[Vehicle, ...]:
        """Return the vehicles with their waypoints at times [s], (W,); without any if None."""
        changed = [list(vehicle.waypoints) for vehicle in vehicles]
        if times is None:
            changed = [[] for _ in vehicles]
        else:
            for i, k, time in zip(self.vehicles, self.numbers, times, strict=True):
                changed[i][k] = dataclasses.replace(changed[i][k], time=float(time))
        return tuple(
            dataclasses.replace(vehicle, waypoints=tuple(own))
            for vehicle, own in zip(vehicles, changed, strict=True)
        )
