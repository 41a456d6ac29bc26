"""Ways of a fleet's vehicles in space, each by itself, where nothing moves."""

from __future__ import annotations

import numpy as np

from drake_rho.planning.path_search.homotopy_paths import SpaceWay, SpaceWays
from drake_rho.planning.path_search.lattice import KEPT_BYTES, POINT_BYTES, Lattice, Raster
from drake_rho.planning.path_search.resolution import Resolution, Size
from drake_rho.planning.path_search.time_scaling import Leg, legs_of, paced, usable_speeds
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario


class FleetInSpace:
    """Searches for all vehicles on grids of one resolution; vehicles alike share a lattice.

    Args:
        scenario: what is asked.
        resolution: of the lattices.
        most: bytes that they may take.

    Attributes:
        points: of the largest lattice so far, clear ones and others.
    """

    def __init__(self, scenario: Scenario, resolution: Resolution, most: float = np.inf) -> None:
        self._scenario, self._resolution, self.points = scenario, resolution, 0
        self._bodies = [body for _, body in scenario.known]
        self._speeds, self._most = usable_speeds(scenario), most
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
        """The lattice of a vehicle, shared by all alike; others make room for it if need be."""
        raster = _raster(self._resolution, number)
        kind = np.array([radius, *raster.lower, *raster.spacing, *raster.shape]).tobytes()
        if kind not in self._lattices:
            kept = sum(lattice.raster.count for lattice in self._lattices.values())
            if KEPT_BYTES * kept + POINT_BYTES * raster.count > self._most:
                self._lattices.clear()
            self._lattices[kind] = Lattice(raster, self._bodies, radius)
            self.points = max(self.points, raster.count)
        return self._lattices[kind]


def size_in_space(scenario: Scenario, resolution: Resolution) -> Size:
    """What a search for the vehicle with the largest lattice takes."""
    numbers = range(len(scenario.vehicles))
    return Size(POINT_BYTES * max(_raster(resolution, number).count for number in numbers))


def _raster(resolution: Resolution, number: int) -> Raster:
    """The points for a vehicle."""
    lower, upper = resolution.region.lower[number], resolution.region.upper[number]
    return Raster.filling(lower, upper, np.full(3, resolution.length))
