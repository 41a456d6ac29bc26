"""First plans: timed ways among obstacles and vehicles, on grids that become finer.

One vehicle after the other finds its way in space and time, those before being in its way. A
reference made of ways need not obey limits: restoration brings the motion to it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.lattice import Lattice, Raster
from drake_rho.planning.timed_ways import Layers, Search, TimedWay
from drake_rho.planning.traffic import MovingObstacle, MovingVehicle
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Scenario

_POINTS, _MOST_POINTS = 3e4, 2e5
"""Points of the first grid, unless fewer resolve what there is, and of the finest."""

_FINER = 1.5
"""How much finer the next grid is."""

_VALUES = 5e7
"""Bound on points times layers, for the memory they take."""

_ORDERS = 5
"""Orders in which a fleet is tried on one grid."""

_WITHIN = 0.95
"""Part of a vehicle's limits of speed that a way uses."""

_FASTER = 2.5
"""How much faster than straight to its goal a vehicle may fly on its way where no limit binds."""


@dataclasses.dataclass(frozen=True)
class Searched:
    """Where ways were looked for."""

    spacing: float
    """greatest distance of neighbours along an axis of the finest grid [m]"""
    points: int
    """how many points it has, clear ones and others"""
    layers: int
    """in how many moves a way was to lead to its goal"""
    orders: int
    """in how many orders vehicles were tried, on all grids"""

    def __str__(self) -> str:
        """What it means that nothing was found."""
        return f"no way was found on a grid of {self.spacing:.2g} m"


@dataclasses.dataclass(frozen=True, eq=False)
class Ways:
    """Ways of all vehicles, as far as they were found."""

    reference: Plan | None
    """a motion along them, which need not obey limits; None if a vehicle has no way"""
    conflicts: int
    """moves in which vehicles come too close to each other, for lack of a better way"""
    searched: Searched


@dataclasses.dataclass(frozen=True, eq=False)
class _Resolution:
    """A grid in space and time."""

    spacing: FloatArray
    """of each vehicle's lattice [m], shape (N, 3)"""
    times: FloatArray
    """between layers, since the first knot [s], shape (M + 1,)"""


def timed_ways(scenario: Scenario) -> Ways:
    """Ways of all vehicles that keep clear of known obstacles and, if they can, of each other.

    Complete at its resolution for a single vehicle; vehicles of a fleet are planned one after the
    other, in a few orders: who finds no way is first in the next.
    """
    best: list[TimedWay] | None = None
    orders = 0
    for resolution in _resolutions(scenario):
        attempt = _Attempt(scenario, resolution)
        order = attempt.first_order()
        for _ in range(_ORDERS if order is not None else 0):
            assert order is not None
            orders += 1
            ways, stuck = attempt.prioritised(order)
            if ways is not None and (best is None or _conflicts(ways) < _conflicts(best)):
                best, times = ways, resolution.times
            if stuck is None or stuck == order[0]:
                break
            order = np.concatenate([[stuck], order[order != stuck]])
        if best is not None:
            break
    searched = Searched(
        float(resolution.spacing.max()),
        max(lattice.raster.count for lattice in attempt.lattices),
        len(resolution.times) - 1,
        orders,
    )
    if best is None:
        return Ways(None, 0, searched)
    return Ways(_reference(scenario, best, times), _conflicts(best), searched)


def _conflicts(ways: list[TimedWay]) -> int:
    return sum(way.conflicts for way in ways)


def _reference(scenario: Scenario, ways: list[TimedWay], times: FloatArray) -> Plan:
    """The motion that is at the ways' places at the knots, and straight between them."""
    elapsed, step = scenario.grid.elapsed, scenario.grid.step
    positions = np.array(
        [[np.interp(elapsed, times, axis) for axis in way.positions.T] for way in ways]
    ).transpose(0, 2, 1)
    velocities = np.diff(positions, axis=1) / step
    velocities = np.concatenate([velocities, velocities[:, -1:]], axis=1)
    count, knots = positions.shape[:2]
    return Plan(scenario, positions, velocities, np.zeros((count, knots - 1, 3)))


class _Attempt:
    """The search on one resolution; vehicles alike in radius, box and speed share a lattice."""

    def __init__(self, scenario: Scenario, resolution: _Resolution) -> None:
        self.scenario, self.times = scenario, resolution.times
        fleet, lower, upper = scenario.fleet, *_region(scenario)
        keys = np.column_stack([fleet.radii, lower, upper, resolution.spacing])
        kinds, self.kinds = np.unique(keys, axis=0, return_inverse=True)
        bodies = [obstacle for _, obstacle in scenario.known]
        still = [body for body in bodies if not body.moves]
        moving = [body for body in bodies if body.moves]
        absolute = scenario.grid.start + self.times
        self.lattices, self.obstacles = list[Lattice](), list[Layers]()
        for radius, *rest in kinds:
            low, high, spacing = np.array(rest).reshape(3, 3)
            lattice = Lattice(Raster.filling(low, high, spacing), still, radius)
            met = [MovingObstacle(body, radius, absolute) for body in moving]
            self.lattices.append(lattice)
            self.obstacles.append(Layers(lattice, len(absolute) - 1, met))
        self.searches = [
            Search(self.lattices[kind], start, goal)
            for kind, start, goal in zip(
                self.kinds, fleet.start_positions, fleet.goal_positions, strict=True
            )
        ]

    def first_order(self) -> IntArray | None:
        """The vehicles with the longest ways first; None if one has none at all."""
        lengths = np.array([search.length for search in self.searches])
        if not np.isfinite(lengths).all():
            return None
        places = self.scenario.fleet.start_positions
        order: IntArray = np.lexsort((*places.T, -np.round(lengths, 6)))
        return order

    def prioritised(self, order: IntArray) -> tuple[list[TimedWay] | None, int | None]:
        """The vehicles' ways, planned in some order, and who could not keep clear of the others.

        There are no ways if something else was in the way of a vehicle.
        """
        separation, count = self.scenario.separation, len(self.times) - 1
        vehicles = [Layers(lattice, count) for lattice in self.lattices]
        ways: dict[int, TimedWay] = {}
        stuck: int | None = None
        for vehicle in order:
            kind = self.kinds[vehicle]
            progress = _progress(self.times)
            way = self.searches[vehicle].way(self.obstacles[kind], vehicles[kind], progress)
            if way is None:
                return None, int(vehicle)
            if way.conflicts and stuck is None:
                stuck = int(vehicle)
            ways[int(vehicle)] = way
            if separation is not None and len(ways) < len(order):
                for layers in vehicles:
                    layers.add(MovingVehicle(way.positions, separation))
        return [ways[vehicle] for vehicle in range(len(order))], stuck


def _progress(times: FloatArray, ramp: float = 1.0 / 8.0) -> FloatArray:
    """Part of the way that is done at each time if speed rises and falls evenly, shape (M + 1,)."""
    s = (times - times[0]) / (times[-1] - times[0])
    s = np.minimum(s, 1.0)
    rising = np.minimum(s, ramp) ** 2 / (2.0 * ramp)
    steady = np.clip(s - ramp, 0.0, 1.0 - 2.0 * ramp)
    falling = np.clip(s - (1.0 - ramp), 0.0, ramp)
    progress: FloatArray = rising + steady + falling - falling**2 / (2.0 * ramp)
    return progress / (1.0 - ramp)


def _resolutions(scenario: Scenario) -> Iterator[_Resolution]:
    """From a coarse grid, on which a search is quick, to the finest that is looked at."""
    lower, upper = _region(scenario)
    scale = _scale(scenario)
    sides = np.maximum((upper - lower).max(axis=0), scale)
    volume, first = float(np.prod(sides)), True
    length = max(scale, (volume / _POINTS) ** (1.0 / 3.0))
    faster = _FASTER
    while first or volume / length**3 <= _MOST_POINTS:
        resolution = _resolution(scenario, length, _speeds(scenario, faster))
        count = np.prod(sides / resolution.spacing.min(axis=0) + 1.0) * len(resolution.times)
        if not first and count > _VALUES:
            break
        yield resolution
        first = False
        length, faster = length / _FINER, faster * 1.2


def _resolution(scenario: Scenario, length: float, speeds: FloatArray) -> _Resolution:
    """Lattices about `length` fine, and layers in which one move is made at some speed, (N, 3).

    Layers begin at knots where they are longer than a step, and divide the steps where they are
    shorter. Levels that are a fraction of the downwash apart let vehicles pass above each other.
    """
    step, steps = scenario.grid.step, scenario.grid.knots - 1
    layer = length / float(speeds.max())
    if layer > step:
        each = min(max(1, round(layer / step)), steps)
        rest = steps % each
        knots = rest // 2 + np.arange(0, steps - rest + 1, each)
        times = step * knots
        layer = step * each
    else:
        layer = step / max(1, round(step / layer))
        times = layer * np.arange(round(steps * step / layer) + 1)
    spacing = speeds * layer
    if scenario.separation is not None:
        above = scenario.separation.distance * scenario.separation.downwash
        lower, upper = _region(scenario)
        levels = above / np.ceil(above / (1.06 * spacing[:, 2]))
        height = upper[:, 2] - lower[:, 2]
        spacing[:, 2] = np.maximum(height / np.maximum(np.floor(height / levels), 1.0), levels)
    return _Resolution(spacing, times)


def _speeds(scenario: Scenario, faster: float) -> FloatArray:
    """Speeds along each axis at which ways are flown [m/s], shape (N, 3)."""
    fleet = scenario.fleet
    ways = np.linalg.norm(fleet.goal_positions - fleet.start_positions, axis=1)
    wanted = faster * max(float(ways.max()), _scale(scenario)) / scenario.grid.duration
    speeds = np.full((len(ways), 3), wanted)
    if (bounds := fleet.bounds("velocity")) is not None:
        speeds = np.minimum(speeds, _WITHIN * np.minimum(bounds.upper, -bounds.lower))
    if (norms := fleet.max_speeds()) is not None:
        speeds = np.minimum(speeds, _WITHIN * norms.most[:, None])
    return np.maximum(speeds, 1e-3 * wanted)


def _scale(scenario: Scenario) -> float:
    """The length that a grid should resolve [m]."""
    radius = float(scenario.fleet.radii.min())
    scales = [0.5 * (radius + float(body.shape.extent.min())) for _, body in scenario.known]
    if scenario.separation is not None:
        scales.append(scenario.separation.distance * 2.0 / 3.0)
    return max(min(scales, default=1.0), 1e-3 * float(scenario.fleet.lengths.max()))


def _region(scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Boxes in which ways are looked for, as lower and upper corners [m], each (N, 3).

    Each vehicle's position box, as far as starts, goals and obstacles reach, and what a way round
    them all takes.
    """
    fleet, grid = scenario.fleet, scenario.grid
    lows = [fleet.start_positions.min(axis=0), fleet.goal_positions.min(axis=0)]
    highs = [fleet.start_positions.max(axis=0), fleet.goal_positions.max(axis=0)]
    for _, body in scenario.known:
        centers, extent = body.centers(grid.times), body.shape.extent
        extent = np.where(np.isfinite(extent), extent, 0.0)
        lows.append((centers - extent).min(axis=0))
        highs.append((centers + extent).max(axis=0))
    around = 2.0 * float(fleet.radii.max()) + _scale(scenario) + np.zeros(3)
    if scenario.separation is not None:
        around += 2.0 * scenario.separation.shape.semi_axes
    lower, upper = np.min(lows, axis=0) - around, np.max(highs, axis=0) + around
    count = len(scenario.vehicles)
    lower, upper = np.tile(lower, (count, 1)), np.tile(upper, (count, 1))
    if (bounds := fleet.bounds("position")) is not None:
        lower, upper = np.maximum(lower, bounds.lower), np.minimum(upper, bounds.upper)
    return lower, upper
