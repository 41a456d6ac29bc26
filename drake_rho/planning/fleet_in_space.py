"""Ways of a fleet's vehicles in space, each by itself, where nothing moves."""

from __future__ import annotations

import numpy as np

from drake_rho.planning.lattice import Lattice, Raster
from drake_rho.planning.pace import Leg, legs_of, paced, usable_speeds
from drake_rho.planning.resolution import region
from drake_rho.planning.space_ways import SpaceWay, SpaceWays
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario


class FleetInSpace:
    """Searches for all vehicles on grids of one resolution; vehicles alike share a lattice.

    Attributes:
        points: of the largest lattice so far, clear ones and others.
    """

    def __init__(self, scenario: Scenario, length: float) -> None:
        self._scenario, self._length, self.points = scenario, length, 0
        self._bodies = [body for _, body in scenario.known]
        self._boxes, self._speeds = region(scenario), usable_speeds(scenario)
        self._lattices: dict[bytes, Lattice] = {}

    def timed(self, number: int, most: int) -> list[FloatArray]:
        """Positions of a vehicle at the knots [m], (K, 3), along each of its ways."""
        radius = float(self._scenario.fleet.radii[number])
        legs = legs_of(self._scenario, number)
        lattice, each = self._lattice(number, radius), list[list[SpaceWay]]()
        for leg in legs:
            search = SpaceWays(lattice, self._bodies, radius, leg.start, leg.goal)
            each.append(search.ways(most))
            if not each[-1]:
                return []
        return [
            self._along(number, legs, [ways[min(k, len(ways) - 1)] for ways in each])
            for k in range(max(map(len, each)))
        ]

    def _along(self, number: int, legs: list[Leg], ways: list[SpaceWay]) -> FloatArray:
        """Positions at the knots along one way for each leg, (K, 3)."""
        elapsed = self._scenario.grid.elapsed
        positions = np.empty((len(elapsed), 3))
        for leg, way in zip(legs, ways, strict=True):
            during = (elapsed >= leg.begin) & (elapsed <= leg.end)
            times = np.concatenate([[leg.begin], elapsed[during], [leg.end]])
            positions[during] = paced(way.positions, times, self._speeds[number])[1:-1]
        return positions

    def _lattice(self, number: int, radius: float) -> Lattice:
        """The lattice of a vehicle, shared by all alike."""
        lower, upper = (corner[number] for corner in self._boxes)
        kind = np.array([radius, *lower, *upper]).tobytes()
        if kind not in self._lattices:
            raster = Raster.filling(lower, upper, np.full(3, self._length))
            self._lattices[kind] = Lattice(raster, self._bodies, radius)
            self.points = max(self.points, raster.count)
        return self._lattices[kind]
