"""Ways of a fleet's vehicles in space and time, one after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.planning.path_search.lattice import KEPT_BYTES, POINT_BYTES, Lattice, Raster
from drake_rho.planning.path_search.moving_obstacles import (
    Bounds,
    Moving,
    MovingObstacle,
    MovingVehicle,
)
from drake_rho.planning.path_search.resolution import Resolution, Size
from drake_rho.planning.path_search.space_time import Layers, Search, TimedWay
from drake_rho.planning.path_search.time_scaling import legs_of, progress, usable_speeds
from drake_rho.planning.time_limit import check_time
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_RAMP = 1.0 / 8.0
"""Part of the time in which speed rises, and falls, on ways in space and time."""

_SLOWEST = 50.0
"""How many times less fast against an axis than along it a vehicle may be and still go there."""

_SEARCH_BYTES, _MOVES_BYTES = 4.0, 280.0
"""What a search keeps for each point of its lattice, and what it takes for the moves of a layer."""

_BLOCKED = 0.2
"""Part of the memory that is left for the numbers of moves that something blocks."""


@dataclasses.dataclass(frozen=True)
class _TimedLeg:
    """A leg, and the layers that it lasts for."""

    search: Search
    first: int
    last: int


class FleetInTime:
    """Searches on one resolution; vehicles alike in radius, box and speeds share a lattice.

    Args:
        scenario: what is asked.
        resolution: of the lattices.
        most: bytes that all of it may take.

    Attributes:
        points: of the largest lattice, clear ones and others.

    Raises:
        TooLargeError: what moves blocks too many moves for that; `prioritised` raises it too.
    """

    def __init__(self, scenario: Scenario, resolution: Resolution, most: float = np.inf) -> None:
        self._scenario, self._resolution = scenario, resolution
        self._times, fleet = resolution.times, scenario.fleet
        self._radii, rasters, self._kinds = _kinds(scenario, resolution)
        spare = most - size_in_time(scenario, resolution).bytes
        self._most = max(spare, most * _BLOCKED) / (2.0 * len(rasters))
        still = [body for _, body in scenario.known if body.is_steady]
        self._lattices = [
            Lattice(raster, still, radius)
            for raster, radius in zip(rasters, self._radii, strict=True)
        ]
        self._speeds = usable_speeds(scenario)
        self.points = max(raster.count for raster in rasters)
        self._legs = [self._legs_of(number) for number in range(len(fleet.radii))]

    def _legs_of(self, number: int) -> list[_TimedLeg]:
        """The searches for a vehicle's legs that last for a layer at least."""
        lattice, legs, first = self._lattices[self._kinds[number]], list[_TimedLeg](), 0
        for leg in legs_of(self._scenario, number):
            last = int(np.argmin(np.abs(self._times - leg.end)))
            if last > first:
                search = Search(lattice, leg.start, leg.goal, self._slower(number))
                legs.append(_TimedLeg(search, first, last))
            first = last
        return legs

    def _slower(self, number: int) -> FloatArray:
        """How many times less fast than the lattice's moves a vehicle can go, (2, 3)."""
        speeds = self._speeds[number]
        moves = self._resolution.spacing[number] / (self._times[1] - self._times[0])
        moves = np.minimum(moves, speeds.max(axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            slower = np.maximum(moves / speeds, 1.0)
        return np.where(slower <= _SLOWEST, slower, np.where(moves > 0.0, np.inf, 1.0))

    @cached_property
    def _obstacles(self) -> list[Layers]:
        """Where obstacles that move block moves of each lattice."""
        bodies = [body for _, body in self._scenario.known if not body.is_steady]
        return [
            self._layers(
                kind, [MovingObstacle(body, self._radii[kind], self._times) for body in bodies]
            )
            for kind in range(len(self._lattices))
        ]

    def _layers(self, kind: int, moving: Sequence[Moving] = ()) -> Layers:
        """What blocks moves of a lattice where its vehicles can be."""
        return Layers(
            self._lattices[kind], len(self._times) - 1, moving, self._reaches[kind], self._most
        )

    @cached_property
    def _reaches(self) -> list[Bounds]:
        """Where the vehicles of each lattice can be between layers, all of them together."""
        reaches = list[Bounds]()
        for kind in range(len(self._lattices)):
            each = [self._reach(int(n), self._times) for n in np.flatnonzero(self._kinds == kind)]
            lowers, uppers = zip(*each, strict=True)
            reaches.append((np.min(lowers, axis=0), np.max(uppers, axis=0)))
        return reaches

    def _reach(self, number: int, times: FloatArray) -> Bounds:
        """Where a vehicle can be at times, a step of the lattice further than it can."""
        lower, upper = self._resolution.region.reach.of(number, times)
        spacing = self._resolution.spacing[number]
        return lower - spacing, upper + spacing

    def first_order(self) -> IntArray:
        """The vehicles, those with the longest ways first; none if one has no way at all."""
        lengths = np.array([sum(leg.search.length for leg in legs) for legs in self._legs])
        if not np.isfinite(lengths).all():
            return np.zeros(0, dtype=int)
        places = self._scenario.fleet.start_positions.T
        order: IntArray = np.lexsort((*places, -np.round(lengths, 6)))
        return order

    def prioritised(self, order: IntArray) -> tuple[list[TimedWay], int | None]:
        """The vehicles' ways, planned in some order, and the first that is not clear of others.

        There are no ways if an obstacle is in the way of a vehicle at all times.
        """
        separation = self._scenario.separation
        vehicles = [self._layers(kind) for kind in range(len(self._lattices))]
        ways: dict[int, TimedWay] = {}
        stuck: int | None = None
        for vehicle in map(int, order):
            check_time()
            way = self._way(vehicle, vehicles[self._kinds[vehicle]])
            if way is None:
                return [], vehicle
            if way.conflicts and stuck is None:
                stuck = vehicle
            ways[vehicle] = way
            if separation is not None and len(ways) < len(order):
                for layers in vehicles:
                    layers.add(MovingVehicle(way.positions, separation))
        return [ways[vehicle] for vehicle in range(len(order))], stuck

    def _way(self, number: int, vehicles: Layers) -> TimedWay | None:
        """A vehicle's way, leg by leg."""
        obstacles, ways = self._obstacles[self._kinds[number]], list[TimedWay]()
        for leg in self._legs[number]:
            times = self._times[leg.first : leg.last + 1]
            way = leg.search.way(
                obstacles.part(leg.first, leg.last),
                vehicles.part(leg.first, leg.last),
                progress(times, _RAMP),
                self._reach(number, times),
            )
            if way is None:
                return None
            ways.append(way)
        positions = [ways[0].positions, *(way.positions[1:] for way in ways[1:])]
        return TimedWay(np.concatenate(positions), conflicts_of(ways))


def size_in_time(scenario: Scenario, resolution: Resolution) -> Size:
    """What searches for all vehicles take."""
    _, rasters, kinds = _kinds(scenario, resolution)
    counts = np.array([float(raster.count) for raster in rasters])
    largest = float(counts.max())
    values = largest * len(resolution.times)
    legs = np.array([1 + len(vehicle.waypoints) for vehicle in scenario.vehicles])
    searches = _SEARCH_BYTES * float(np.sum(counts[kinds] * legs))
    finding = max((POINT_BYTES - KEPT_BYTES) * largest, 4.0 * values + _MOVES_BYTES * largest)
    taken = KEPT_BYTES * float(counts.sum()) + searches + finding
    return Size(taken / (1.0 - _BLOCKED), values)


def _kinds(scenario: Scenario, resolution: Resolution) -> tuple[FloatArray, list[Raster], IntArray]:
    """Radius and raster of each kind of vehicles, and of which kind each vehicle is, (N,)."""
    lower, upper = resolution.region.lower, resolution.region.upper
    keys = np.column_stack([scenario.fleet.radii, lower, upper, resolution.spacing])
    kinds, numbers = np.unique(keys, axis=0, return_inverse=True)
    rasters = [Raster.filling(*rest.reshape(3, 3)) for rest in kinds[:, 1:]]
    return kinds[:, 0], rasters, numbers


def conflicts_of(ways: list[TimedWay]) -> int:
    """Moves of all ways that come too close to other vehicles."""
    return sum(way.conflicts for way in ways)
