"""Ways of a fleet's vehicles in space and time, one after the other."""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from drake_rho.planning.lattice import Lattice, Raster
from drake_rho.planning.pace import legs_of, progress
from drake_rho.planning.resolution import Resolution, region
from drake_rho.planning.timed_ways import Layers, Search, TimedWay
from drake_rho.planning.traffic import MovingObstacle, MovingVehicle
from drake_rho.scenario.fields import IntArray
from drake_rho.scenario.records import Scenario

_RAMP = 1.0 / 8.0
"""Part of the time in which speed rises, and falls, on ways in space and time."""


@dataclasses.dataclass(frozen=True)
class _TimedLeg:
    """A leg, and the layers that it lasts for."""

    search: Search
    first: int
    last: int


class FleetInTime:
    """Searches on one resolution; vehicles alike in radius, box and speeds share a lattice.

    Attributes:
        points: of the largest lattice, clear ones and others.
    """

    def __init__(self, scenario: Scenario, resolution: Resolution) -> None:
        self._scenario, self._times = scenario, resolution.times
        fleet = scenario.fleet
        keys = np.column_stack([fleet.radii, *region(scenario), resolution.spacing])
        kinds, self._kinds = np.unique(keys, axis=0, return_inverse=True)
        still = [body for _, body in scenario.known if not body.moves]
        self._radii = kinds[:, 0]
        self._lattices = [
            Lattice(Raster.filling(*rest.reshape(3, 3)), still, radius)
            for radius, rest in zip(self._radii, kinds[:, 1:], strict=True)
        ]
        self.points = max(lattice.raster.count for lattice in self._lattices)
        self._legs = [self._legs_of(number) for number in range(len(scenario.vehicles))]

    def _legs_of(self, number: int) -> list[_TimedLeg]:
        """The searches for a vehicle's legs that last for a layer at least."""
        lattice, legs, first = self._lattices[self._kinds[number]], list[_TimedLeg](), 0
        for leg in legs_of(self._scenario, number):
            last = int(np.argmin(np.abs(self._times - leg.end)))
            if last > first:
                legs.append(_TimedLeg(Search(lattice, leg.start, leg.goal), first, last))
            first = last
        return legs

    @cached_property
    def _obstacles(self) -> list[Layers]:
        """Where obstacles that move block moves of each lattice."""
        bodies = [body for _, body in self._scenario.known if body.moves]
        times = self._times
        return [
            Layers(
                lattice, len(times) - 1, [MovingObstacle(body, radius, times) for body in bodies]
            )
            for lattice, radius in zip(self._lattices, self._radii, strict=True)
        ]

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
        separation, count = self._scenario.separation, len(self._times) - 1
        vehicles = [Layers(lattice, count) for lattice in self._lattices]
        ways: dict[int, TimedWay] = {}
        stuck: int | None = None
        for vehicle in map(int, order):
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
            way = leg.search.way(
                obstacles.part(leg.first, leg.last),
                vehicles.part(leg.first, leg.last),
                progress(self._times[leg.first : leg.last + 1], _RAMP),
            )
            if way is None:
                return None
            ways.append(way)
        positions = [ways[0].positions, *(way.positions[1:] for way in ways[1:])]
        return TimedWay(np.concatenate(positions), conflicts_of(ways))


def conflicts_of(ways: list[TimedWay]) -> int:
    """Moves of all ways that come too close to other vehicles."""
    return sum(way.conflicts for way in ways)
