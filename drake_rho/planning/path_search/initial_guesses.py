"""Initial guesses along paths around obstacles and other vehicles, on successively finer grids.

If no obstacle moves and no separation is required, the paths are paths in space, on different sides
of obstacles. Otherwise space-time paths are planned for one vehicle after the other, each avoiding
the previous ones. A reference along paths need not respect limits: feasibility restoration finds a
feasible motion near it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import PathSearch
from drake_rho.planning.call.options import DEFAULTS
from drake_rho.planning.call.time_limit import check_time
from drake_rho.planning.call.work_limit import PATH_GRID, count_work
from drake_rho.planning.path_search.continuation import piecewise_linear
from drake_rho.planning.path_search.fleet_in_space import FleetSpaceSearch, space_size
from drake_rho.planning.path_search.prioritized import (
    FleetSpaceTimeSearch,
    conflicts_of,
    space_time_size,
)
from drake_rho.planning.path_search.resolution import resolutions
from drake_rho.planning.path_search.space_time import SpaceTimePath
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

_POINTS, _SPACE_TIME_POINTS = 3e4, 5e3
"""Points of the first grid, for searches in space and in space and time. Fewer are used if they
resolve the obstacles and the separation."""

_ORDERS = 5
"""Bound on the priority orders tried for a fleet on one grid."""


@dataclasses.dataclass(frozen=True, eq=False)
class InitialGuesses:
    """References along paths of all vehicles."""

    references: tuple[Plan, ...]
    """piecewise linear motions, which need not respect limits, beginning with the shortest paths;
    none if a vehicle has no path on the grids searched"""
    conflicts: int
    """number of moves with vehicles too close to each other, if no better paths were found"""
    searched: PathSearch
    """grid, and number of paths found"""


def find_paths(
    scenario: Scenario, most: int = 1, max_memory: float = DEFAULTS.max_memory
) -> InitialGuesses:
    """Return references clear of known obstacles and, if possible, with vehicles separated.

    The search is resolution-complete for a single vehicle. A fleet with a separation is planned by
    priority, in a few orders: a vehicle whose path conflicts with others comes first in the next
    order.

    Args:
        scenario: to be planned.
        most: bound on the number of references; a space-time search gives at most one.
        max_memory: bound on the memory of the grids and of the searches on them [bytes].
    """
    return next(paths_on_grids(scenario, most, max_memory))


def paths_on_grids(scenario: Scenario, most: int, max_memory: float) -> Iterator[InitialGuesses]:
    """Yield the references of `find_paths`, then those of further grids, one grid at a time.

    If the first ones are paths in space alone, the further ones are space-time paths, which respect
    the reachable speeds of vehicles.

    Args:
        scenario: to be planned.
        most: bound on the references of one grid.
        max_memory: bound on the memory of the grids and of the searches on them [bytes].
    """
    moving = not all(body.is_steady for _, body in scenario.avoided)
    space_time = _in_space_and_time(scenario, max_memory)
    required = any(each.of == "position" for each in scenario.required)
    if moving or required or (scenario.separation is not None and len(scenario.vehicles) > 1):
        yield from _from_first_found(space_time)
        return
    first = next(_from_first_found(_in_space(scenario, most, max_memory)))
    yield first
    if first.references:
        yield from _from_first_found(space_time)


def _from_first_found(grids: Iterator[InitialGuesses]) -> Iterator[InitialGuesses]:
    """Yield the guesses with references; if there are none, yield the last guess.

    If there are no grids, a guess without references is yielded.
    """
    last, found = InitialGuesses((), 0, PathSearch()), False
    for last in grids:
        if last.references:
            found = True
            yield last
    if not found:
        yield last


def _in_space(scenario: Scenario, most: int, max_memory: float) -> Iterator[InitialGuesses]:
    """Yield the references along paths in space on each grid, from coarse to fine."""
    for resolution in resolutions(scenario, _POINTS, partial(space_size, scenario), max_memory):
        count_work(PATH_GRID)
        search = FleetSpaceSearch(scenario, resolution, max_memory)
        vehicles = list[list[FloatArray]]()
        try:
            for number in range(len(scenario.vehicles)):
                check_time()
                vehicles.append(search.trajectories(number, most))
                if not vehicles[-1]:
                    break
        except MemoryError:
            return
        count = max(map(len, vehicles)) if all(vehicles) else 0
        references = [
            piecewise_linear(scenario, np.array([each[min(k, len(each) - 1)] for each in vehicles]))
            for k in range(count)
        ]
        searched = PathSearch(spacing=resolution.length, points=search.points, ways=count)
        yield InitialGuesses(tuple(references), 0, searched)


def _in_space_and_time(scenario: Scenario, max_memory: float) -> Iterator[InitialGuesses]:
    """Yield the references along space-time paths on each grid, from coarse to fine."""
    size, orders = partial(space_time_size, scenario), 0
    for resolution in resolutions(scenario, _SPACE_TIME_POINTS, size, max_memory):
        count_work(PATH_GRID)
        try:
            fleet = FleetSpaceTimeSearch(scenario, resolution, max_memory)
            best, tried = _in_a_few_orders(fleet)
        except MemoryError:
            return
        orders += tried
        searched = PathSearch(
            spacing=float(resolution.spacing.max()),
            points=fleet.points,
            layers=len(resolution.times) - 1,
            orders=orders,
            ways=int(len(best) > 0),
        )
        references = (_reference(scenario, best, resolution.times),) if best else ()
        yield InitialGuesses(references, conflicts_of(best), searched)


def _in_a_few_orders(fleet: FleetSpaceTimeSearch) -> tuple[list[SpaceTimePath], int]:
    """Return the paths with the fewest conflicts among a few orders, and the number of orders.

    There are no paths if a vehicle has none.
    """
    best, order = list[SpaceTimePath](), fleet.first_order()
    for number in range(_ORDERS):
        if len(order) == 0:
            return best, number
        paths, violating = fleet.prioritised(order)
        if paths and (not best or conflicts_of(paths) < conflicts_of(best)):
            best = paths
        if violating is None or violating == order[0]:
            return best, number + 1
        order = np.concatenate([[violating], order[order != violating]])
    return best, _ORDERS


def _reference(scenario: Scenario, paths: list[SpaceTimePath], times: FloatArray) -> Plan:
    """Return the motion along paths given by positions at the layer boundaries."""
    positions = np.array(
        [
            [np.interp(scenario.grid.elapsed, times, axis) for axis in path.positions.T]
            for path in paths
        ]
    )
    return piecewise_linear(scenario, positions.transpose(0, 2, 1))
