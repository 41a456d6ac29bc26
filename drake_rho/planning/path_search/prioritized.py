"""Prioritised planning: space-time paths of a fleet, one vehicle after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.path_search.lattice import PEAK_BYTES, STEADY_BYTES, Lattice, Raster
from drake_rho.planning.path_search.moving_obstacles import (
    Bounds,
    Moving,
    MovingObstacle,
    MovingVehicle,
)
from drake_rho.planning.path_search.required_sets import RequiredOfVehicle, RequiredSets
from drake_rho.planning.path_search.resolution import Resolution, Size
from drake_rho.planning.path_search.space_time import (
    SpaceTimePath,
    SpaceTimeSearch,
    TimeExpandedGraph,
)
from drake_rho.planning.path_search.speed_profiles import legs_of, progress, usable_speeds
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_RAMP = 1.0 / 8.0
"""Fraction of the duration for acceleration, and for deceleration, on space-time paths."""

_SLOWEST = 50.0
"""Largest ratio of a vehicle's speeds in the two directions of an axis. Beyond it, the slower
direction is not used."""

_SEARCH_BYTES, _MOVES_BYTES = 4.0, 280.0
"""Memory [bytes] per point of the lattice: of each search, and of the moves of one layer."""

_BLOCKED = 0.2
"""Fraction of the memory reserved for the numbers of blocked moves."""


@dataclasses.dataclass(frozen=True)
class _SpaceTimeLeg:
    """Leg of a flight, flown in the layers from `first` to before `last`."""

    search: SpaceTimeSearch
    first: int
    last: int


class FleetSpaceTimeSearch:
    """Space-time searches for all vehicles of a scenario at one resolution.

    Vehicles with the same radius, box and speeds share a lattice.

    Args:
        scenario: to be planned.
        resolution: of the lattices.
        most: bound on the memory of all searches together [bytes].

    Attributes:
        points: number of points of the largest lattice, including those in collision.

    Raises:
        TooLargeError: the numbers of blocked moves exceed their part of the memory; `prioritised`
            raises it too.
    """

    def __init__(self, scenario: Scenario, resolution: Resolution, most: float = np.inf) -> None:
        self._scenario, self._resolution = scenario, resolution
        self._times, fleet = resolution.times, scenario.fleet
        self._radii, rasters, self._kinds = _kinds(scenario, resolution)
        rest = most - space_time_size(scenario, resolution).bytes
        self._most = max(rest, most * _BLOCKED) / (2.0 * len(rasters))
        still = [body for _, body in scenario.avoided if body.is_steady]
        self._lattices = [
            Lattice(raster, still, radius)
            for raster, radius in zip(rasters, self._radii, strict=True)
        ]
        self._speeds = usable_speeds(scenario)
        self.points = max(raster.count for raster in rasters)
        self._legs = [self._legs_of(number) for number in range(len(fleet.radii))]
        self._required = RequiredSets(scenario, self._times)

    def _legs_of(self, number: int) -> list[_SpaceTimeLeg]:
        """Return the searches for those legs of a vehicle that last at least one layer."""
        lattice, legs, first = self._lattices[self._kinds[number]], list[_SpaceTimeLeg](), 0
        for leg in legs_of(self._scenario, number):
            last = int(np.argmin(np.abs(self._times - leg.end)))
            if last > first:
                search = SpaceTimeSearch(lattice, leg.start, leg.goal, self._slower(number))
                legs.append(_SpaceTimeLeg(search, first, last))
            first = last
        return legs

    def _slower(self, number: int) -> FloatArray:
        """Return the speed of the lattice's moves divided by that of a vehicle, shape (2, 3)."""
        speeds = self._speeds[number]
        moves = self._resolution.spacing[number] / (self._times[1] - self._times[0])
        moves = np.minimum(moves, speeds.max(axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            slower = np.maximum(moves / speeds, 1.0)
        return np.where(slower <= _SLOWEST, slower, np.where(moves > 0.0, np.inf, 1.0))

    @cached_property
    def _obstacles(self) -> list[TimeExpandedGraph]:
        """Time-expanded graph of each lattice with the moves that moving obstacles block."""
        bodies = [body for _, body in self._scenario.avoided if not body.is_steady]
        return [
            self._graph(
                kind, [MovingObstacle(body, self._radii[kind], self._times) for body in bodies]
            )
            for kind in range(len(self._lattices))
        ]

    def _graph(self, kind: int, moving: Sequence[Moving] = ()) -> TimeExpandedGraph:
        """Return the time-expanded graph of a lattice, within the bounds of its vehicles."""
        return TimeExpandedGraph(
            self._lattices[kind], len(self._times) - 1, moving, self._bounds[kind], self._most
        )

    @cached_property
    def _bounds(self) -> list[Bounds]:
        """Bounds on the positions of the vehicles of each lattice at the layer boundaries."""
        bounds = list[Bounds]()
        for kind in range(len(self._lattices)):
            each = [
                self._bounds_of(int(n), self._times) for n in np.flatnonzero(self._kinds == kind)
            ]
            lowers, uppers = zip(*each, strict=True)
            bounds.append((np.min(lowers, axis=0), np.max(uppers, axis=0)))
        return bounds

    def _bounds_of(self, number: int, times: FloatArray) -> Bounds:
        """Return bounds on a vehicle's positions, widened by one spacing of the lattice."""
        lower, upper = self._resolution.region.reachable.of(number, times)
        spacing = self._resolution.spacing[number]
        return lower - spacing, upper + spacing

    def first_order(self) -> IntArray:
        """Return the vehicles, longest path first; none if any vehicle has no path."""
        lengths = np.array([sum(leg.search.length for leg in legs) for legs in self._legs])
        if not np.isfinite(lengths).all():
            return np.zeros(0, dtype=int)
        places = self._scenario.fleet.start_positions.T
        order: IntArray = np.lexsort((*places, -np.round(lengths, 6)))
        return self._required.order(order, np.array([len(legs) for legs in self._legs]))

    def prioritised(self, order: IntArray) -> tuple[list[SpaceTimePath], int | None]:
        """Return the vehicles' paths, planned in a given order, and the first violating vehicle.

        Args:
            order: numbers of all vehicles. Each avoids those before it.

        Returns:
            The paths in the order of the scenario, and the number of the first vehicle whose path
            comes too close to others, None if there is none. If obstacles leave a vehicle without
            a path, there are no paths, and the number is that of this vehicle.
        """
        separation = self._scenario.separation
        vehicles = [self._graph(kind) for kind in range(len(self._lattices))]
        paths: dict[int, SpaceTimePath] = {}
        violating: int | None = None
        for vehicle in map(int, order):
            check_time()
            known = {i: path.positions for i, path in paths.items()}
            required = self._required.of(vehicle, known)
            path = self._path(vehicle, vehicles[self._kinds[vehicle]], required)
            if path is None:
                return [], vehicle
            if path.conflicts and violating is None:
                violating = vehicle
            paths[vehicle] = path
            if separation is not None and len(paths) < len(order):
                for graph in vehicles:
                    graph.add(MovingVehicle(path.positions, separation))
        return [paths[vehicle] for vehicle in range(len(order))], violating

    def _path(
        self, number: int, vehicles: TimeExpandedGraph, required: RequiredOfVehicle | None
    ) -> SpaceTimePath | None:
        """Return the path of a vehicle, planned leg by leg; None if a leg has none."""
        obstacles, paths = self._obstacles[self._kinds[number]], list[SpaceTimePath]()
        for leg in self._legs[number]:
            times = self._times[leg.first : leg.last + 1]
            path = leg.search.path(
                obstacles.part(leg.first, leg.last),
                vehicles.part(leg.first, leg.last),
                progress(times, _RAMP),
                self._bounds_of(number, times),
                required and required.part(leg.first, leg.last),
            )
            if path is None:
                return None
            paths.append(path)
        positions = [paths[0].positions, *(path.positions[1:] for path in paths[1:])]
        return SpaceTimePath(np.concatenate(positions), conflicts_of(paths))


def space_time_size(scenario: Scenario, resolution: Resolution) -> Size:
    """Return the memory and work that space-time searches for all vehicles need."""
    _, rasters, kinds = _kinds(scenario, resolution)
    counts = np.array([float(raster.count) for raster in rasters])
    largest = float(counts.max())
    values = largest * len(resolution.times)
    legs = np.array([1 + len(vehicle.waypoints) for vehicle in scenario.vehicles])
    searches = _SEARCH_BYTES * float(np.sum(counts[kinds] * legs))
    finding = max((PEAK_BYTES - STEADY_BYTES) * largest, 4.0 * values + _MOVES_BYTES * largest)
    taken = STEADY_BYTES * float(counts.sum()) + searches + finding
    return Size(taken / (1.0 - _BLOCKED), values)


def _kinds(scenario: Scenario, resolution: Resolution) -> tuple[FloatArray, list[Raster], IntArray]:
    """Return the radius and raster of each kind of vehicle, and the kind of each vehicle, (N,)."""
    lower, upper = resolution.region.lower, resolution.region.upper
    keys = np.column_stack([scenario.fleet.radii, lower, upper, resolution.spacing])
    kinds, numbers = np.unique(keys, axis=0, return_inverse=True)
    rasters = [Raster.filling(*rest.reshape(3, 3)) for rest in kinds[:, 1:]]
    return kinds[:, 0], rasters, numbers


def conflicts_of(paths: list[SpaceTimePath]) -> int:
    """Return the number of moves on all paths that come too close to other vehicles."""
    return sum(path.conflicts for path in paths)
