"""Independent paths in space for each vehicle of a fleet, around obstacles at rest."""

from __future__ import annotations

import numpy as np

from drake_rho.planning.path_search.homotopy_paths import SpacePath, SpacePathSearch
from drake_rho.planning.path_search.lattice import PEAK_BYTES, STEADY_BYTES, Lattice, Raster
from drake_rho.planning.path_search.resolution import Resolution, Size
from drake_rho.planning.path_search.speed_profiles import Leg, legs_of, time_scaled, usable_speeds
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario


class FleetSpaceSearch:
    """Searches in space for all vehicles of a scenario at one resolution.

    Vehicles with the same radius and the same grid points share a lattice.

    Args:
        scenario: to be planned.
        resolution: of the lattices.
        most: bound on the memory of the lattices [bytes].

    Attributes:
        points: number of points of the largest lattice so far, including those in collision.
    """

    def __init__(self, scenario: Scenario, resolution: Resolution, most: float = np.inf) -> None:
        self._scenario, self._resolution, self.points = scenario, resolution, 0
        self._bodies = [body for _, body in scenario.avoided]
        self._speeds, self._most = usable_speeds(scenario), most
        self._lattices: dict[bytes, Lattice] = {}

    def trajectories(self, number: int, most: int) -> list[FloatArray]:
        """Return the positions of a vehicle at the knots [m], (K, 3), along each of its paths.

        Args:
            number: of the vehicle, from 0.
            most: bound on the paths of each leg.

        Returns:
            One array for each path, the shortest first; none if a leg has no path.
        """
        radius = float(self._scenario.fleet.radii[number])
        legs = legs_of(self._scenario, number)
        lattice, each = self._lattice(number, radius), list[list[SpacePath]]()
        for leg in legs:
            search = SpacePathSearch(lattice, self._bodies, radius, leg.start, leg.goal)
            each.append(search.paths(most))
            if not each[-1]:
                return []
        return [
            self._along(number, legs, [paths[min(k, len(paths) - 1)] for paths in each])
            for k in range(max(map(len, each)))
        ]

    def _along(self, number: int, legs: list[Leg], paths: list[SpacePath]) -> FloatArray:
        """Return the positions at the knots along one path for each leg, (K, 3)."""
        elapsed = self._scenario.grid.elapsed
        positions = np.empty((len(elapsed), 3))
        for leg, path in zip(legs, paths, strict=True):
            during = (elapsed >= leg.begin) & (elapsed <= leg.end)
            times = np.concatenate([[leg.begin], elapsed[during], [leg.end]])
            positions[during] = time_scaled(path.positions, times, self._speeds[number])[1:-1]
        return positions

    def _lattice(self, number: int, radius: float) -> Lattice:
        """Return the lattice of a vehicle; other lattices are dropped if memory is short."""
        raster = _raster(self._resolution, number)
        kind = np.array([radius, *raster.lower, *raster.spacing, *raster.shape]).tobytes()
        if kind not in self._lattices:
            occupied = sum(lattice.raster.count for lattice in self._lattices.values())
            if STEADY_BYTES * occupied + PEAK_BYTES * raster.count > self._most:
                self._lattices.clear()
            self._lattices[kind] = Lattice(raster, self._bodies, radius)
            self.points = max(self.points, raster.count)
        return self._lattices[kind]


def space_size(scenario: Scenario, resolution: Resolution) -> Size:
    """Return the memory that the search for the vehicle with the largest lattice needs."""
    numbers = range(len(scenario.vehicles))
    return Size(PEAK_BYTES * max(_raster(resolution, number).count for number in numbers))


def _raster(resolution: Resolution, number: int) -> Raster:
    """Return the raster of a vehicle."""
    lower, upper = resolution.region.lower[number], resolution.region.upper[number]
    return Raster.filling(lower, upper, np.full(3, resolution.length))
