"""First plans: timed ways among obstacles and vehicles, on grids that become finer.

Where nothing moves and nobody has to be kept apart from, they are ways in space, several that pass
obstacles on different sides. Else one vehicle after the other finds its way in space and time,
those before being in its way. A reference made of ways need not obey limits: feasibility
restoration brings the motion to it. Vehicles that have waypoints get ways in space from one to the
next; what moves, and vehicles in each other's way, are then left to restoration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from drake_rho.motion.plan import Plan, Searched
from drake_rho.planning.lattice import Lattice, Raster
from drake_rho.planning.pace import paced, paced_through, progress, usable_speeds
from drake_rho.planning.resolution import Resolution, region, resolutions
from drake_rho.planning.space_ways import SpaceWay, SpaceWays
from drake_rho.planning.timed_ways import Layers, Search, TimedWay
from drake_rho.planning.towards import straight_between
from drake_rho.planning.traffic import MovingObstacle, MovingVehicle
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_POINTS, _TIMED_POINTS = 3e4, 5e3
"""Points of the first grid in space, and in space and time, unless fewer resolve what there is."""

_ORDERS = 5
"""Orders in which a fleet is tried on one grid."""

_RAMP = 1.0 / 8.0
"""Part of the time in which speed rises, and falls, on ways in space and time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ways:
    """References along ways of all vehicles."""

    references: tuple[Plan, ...]
    """motions straight from knot to knot, which need not obey limits, that along the shortest ways
    first; none if a vehicle has no way on the grids that were searched"""
    conflicts: int
    """moves in which vehicles come too close to each other, for lack of better ways"""
    searched: Searched


def find_ways(scenario: Scenario, most: int = 1) -> Ways:
    """References that keep clear of known obstacles and, if one was found, vehicles apart.

    Where a vehicle has waypoints, they keep clear of obstacles at rest only.
    Complete at its resolution for a single vehicle. Vehicles that keep apart are planned one after
    the other, in a few orders: who finds no way clear of the others is first in the next.

    Args:
        scenario: what is asked.
        most: bound on the references; where time matters there is one at most.
    """
    fleet = scenario.fleet
    together = scenario.separation is not None and len(scenario.vehicles) > 1
    moving = any(body.moves for _, body in scenario.known)
    if (moving or together) and not fleet.waypoints:
        return _in_space_and_time(scenario)
    return _in_space(scenario, most)


def _in_space(scenario: Scenario, most: int) -> Ways:
    fleet, bodies = scenario.fleet, [body for _, body in scenario.known if not body.moves]
    lower, upper = region(scenario)
    for resolution in resolutions(scenario, _POINTS):
        ways, lattices = list[list[list[SpaceWay]]](), dict[bytes, Lattice]()
        for n, radius in enumerate(fleet.radii):
            kind = np.array([radius, *lower[n], *upper[n]]).tobytes()
            if kind not in lattices:
                raster = Raster.filling(lower[n], upper[n], np.full(3, resolution.length))
                lattices[kind] = Lattice(raster, bodies, radius)
            legs = pairwise(fleet.stops(n).positions)
            lattice = lattices[kind]
            ways.append([SpaceWays(lattice, bodies, radius, *leg).ways(most) for leg in legs])
            if not all(ways[-1]):
                break
        if all(ways[-1]):
            break
    points = max(lattice.raster.count for lattice in lattices.values())
    count = max(len(leg) for legs in ways for leg in legs) if all(ways[-1]) else 0
    searched = Searched(spacing=resolution.length, points=points, ways=count)
    if count == 0:
        return Ways((), 0, searched)
    references = [
        straight_between(
            scenario,
            np.array(
                [
                    _timed(scenario, n, [leg[min(k, len(leg) - 1)] for leg in legs])
                    for n, legs in enumerate(ways)
                ]
            ),
        )
        for k in range(count)
    ]
    return Ways(tuple(references), 0, searched)


def _timed(scenario: Scenario, vehicle: int, legs: Sequence[SpaceWay]) -> FloatArray:
    """Positions of a vehicle along ways to its waypoints and its goal, shape (K, 3)."""
    elapsed, ways = scenario.grid.elapsed, [leg.positions for leg in legs]
    if len(ways) == 1:
        return paced(ways[0], elapsed, usable_speeds(scenario)[vehicle])
    return paced_through(ways, scenario.fleet.stops(vehicle).times, elapsed)


def _in_space_and_time(scenario: Scenario) -> Ways:
    best, orders = list[TimedWay](), 0
    for resolution in resolutions(scenario, _TIMED_POINTS):
        fleet = _Fleet(scenario, resolution)
        order = fleet.first_order()
        for _ in range(_ORDERS):
            if len(order) == 0:
                break
            orders += 1
            ways, stuck = fleet.prioritised(order)
            if ways and (not best or _conflicts(ways) < _conflicts(best)):
                best, times = ways, resolution.times
            if stuck is None or stuck == order[0]:
                break
            order = np.concatenate([[stuck], order[order != stuck]])
        if best:
            break
    searched = Searched(
        spacing=float(resolution.spacing.max()),
        points=fleet.points,
        layers=len(resolution.times) - 1,
        orders=orders,
        ways=int(len(best) > 0),
    )
    if not best:
        return Ways((), 0, searched)
    positions = np.array(
        [
            [np.interp(scenario.grid.elapsed, times, axis) for axis in way.positions.T]
            for way in best
        ]
    )
    reference = straight_between(scenario, positions.transpose(0, 2, 1))
    return Ways((reference,), _conflicts(best), searched)


def _conflicts(ways: list[TimedWay]) -> int:
    return sum(way.conflicts for way in ways)


class _Fleet:
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
        ends = zip(self._kinds, fleet.start_positions, fleet.goal_positions, strict=True)
        self._searches = [Search(self._lattices[kind], *places) for kind, *places in ends]

    @cached_property
    def _obstacles(self) -> list[Layers]:
        """Where obstacles that move block moves of each lattice."""
        bodies = [body for _, body in self._scenario.known if body.moves]
        times = self._scenario.grid.start + self._times
        return [
            Layers(
                lattice, len(times) - 1, [MovingObstacle(body, radius, times) for body in bodies]
            )
            for lattice, radius in zip(self._lattices, self._radii, strict=True)
        ]

    def first_order(self) -> IntArray:
        """The vehicles, those with the longest ways first; none if one has no way at all."""
        lengths = np.array([search.length for search in self._searches])
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
        done = progress(self._times, _RAMP)
        for vehicle in map(int, order):
            kind = self._kinds[vehicle]
            way = self._searches[vehicle].way(self._obstacles[kind], vehicles[kind], done)
            if way is None:
                return [], vehicle
            if way.conflicts and stuck is None:
                stuck = vehicle
            ways[vehicle] = way
            if separation is not None and len(ways) < len(order):
                for layers in vehicles:
                    layers.add(MovingVehicle(way.positions, separation))
        return [ways[vehicle] for vehicle in range(len(order))], stuck
