"""First plans: timed ways among obstacles and vehicles, on grids that become finer.

Where nothing moves and nobody has to be kept apart from, they are ways in space, several that pass
obstacles on different sides. Else one vehicle after the other finds its way in space and time,
those before being in its way. A reference made of ways need not obey limits: feasibility
restoration brings the motion to it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Searched
from drake_rho.planning.options import DEFAULTS
from drake_rho.planning.path_search.continuation import straight_between
from drake_rho.planning.path_search.fleet_in_space import FleetInSpace, size_in_space
from drake_rho.planning.path_search.prioritized import FleetInTime, conflicts_of, size_in_time
from drake_rho.planning.path_search.resolution import resolutions
from drake_rho.planning.path_search.space_time import TimedWay
from drake_rho.planning.time_limit import check_time
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario

_POINTS, _TIMED_POINTS = 3e4, 5e3
"""Points of the first grid in space, and in space and time, unless fewer resolve what there is."""

_ORDERS = 5
"""Orders in which a fleet is tried on one grid."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ways:
    """References along ways of all vehicles."""

    references: tuple[Plan, ...]
    """motions straight from knot to knot, which need not obey limits, that along the shortest ways
    first; none if a vehicle has no way on the grids that were searched"""
    conflicts: int
    """moves in which vehicles come too close to each other, for lack of better ways"""
    searched: Searched
    """where they were looked for"""


def find_ways(scenario: Scenario, most: int = 1, max_memory: float = DEFAULTS.max_memory) -> Ways:
    """References that keep clear of known obstacles and, if one was found, vehicles apart.

    Complete at its resolution for a single vehicle. Vehicles that keep apart are planned one after
    the other, in a few orders: who finds no way clear of the others is first in the next.

    Args:
        scenario: what is asked.
        most: bound on the references; where time matters there is one at most.
        max_memory: bytes that the grids and what is computed on them may take.
    """
    return next(ways_on_grids(scenario, most, max_memory))


def ways_on_grids(scenario: Scenario, most: int, max_memory: float) -> Iterator[Ways]:
    """Those of `find_ways`, and others for which another grid is looked at each time.

    Where only space matters others are in time too, which knows how fast a vehicle can go where.

    Args:
        scenario: as for `find_ways`, as the next two.
        most: bound on the references of one grid.
        max_memory: in bytes.
    """
    moving = not all(body.is_steady for _, body in scenario.known)
    timed = _in_space_and_time(scenario, max_memory)
    if moving or (scenario.separation is not None and len(scenario.vehicles) > 1):
        yield from _from_first_found(timed)
        return
    first = next(_from_first_found(_in_space(scenario, most, max_memory)))
    yield first
    if first.references:
        yield from _from_first_found(timed)


def _from_first_found(grids: Iterator[Ways]) -> Iterator[Ways]:
    """Those with references, or the last if none has any; one without if there are no grids."""
    last, found = Ways((), 0, Searched()), False
    for last in grids:
        if last.references:
            found = True
            yield last
    if not found:
        yield last


def _in_space(scenario: Scenario, most: int, max_memory: float) -> Iterator[Ways]:
    """Those on each grid, from coarse to fine."""
    for resolution in resolutions(scenario, _POINTS, partial(size_in_space, scenario), max_memory):
        flight, vehicles = FleetInSpace(scenario, resolution, max_memory), list[list[FloatArray]]()
        try:
            for number in range(len(scenario.vehicles)):
                check_time()
                vehicles.append(flight.timed(number, most))
                if not vehicles[-1]:
                    break
        except MemoryError:
            return
        count = max(map(len, vehicles)) if all(vehicles) else 0
        references = [
            straight_between(scenario, np.array([each[min(k, len(each) - 1)] for each in vehicles]))
            for k in range(count)
        ]
        searched = Searched(spacing=resolution.length, points=flight.points, ways=count)
        yield Ways(tuple(references), 0, searched)


def _in_space_and_time(scenario: Scenario, max_memory: float) -> Iterator[Ways]:
    """Those on each grid, from coarse to fine."""
    size, orders = partial(size_in_time, scenario), 0
    for resolution in resolutions(scenario, _TIMED_POINTS, size, max_memory):
        try:
            fleet = FleetInTime(scenario, resolution, max_memory)
            best, tried = _in_a_few_orders(fleet)
        except MemoryError:
            return
        orders += tried
        searched = Searched(
            spacing=float(resolution.spacing.max()),
            points=fleet.points,
            layers=len(resolution.times) - 1,
            orders=orders,
            ways=int(len(best) > 0),
        )
        references = (_reference(scenario, best, resolution.times),) if best else ()
        yield Ways(references, conflicts_of(best), searched)


def _in_a_few_orders(fleet: FleetInTime) -> tuple[list[TimedWay], int]:
    """The ways of all vehicles with the fewest conflicts, none if one has none; orders tried."""
    best, order = list[TimedWay](), fleet.first_order()
    for number in range(_ORDERS):
        if len(order) == 0:
            return best, number
        ways, stuck = fleet.prioritised(order)
        if ways and (not best or conflicts_of(ways) < conflicts_of(best)):
            best = ways
        if stuck is None or stuck == order[0]:
            return best, number + 1
        order = np.concatenate([[stuck], order[order != stuck]])
    return best, _ORDERS


def _reference(scenario: Scenario, ways: list[TimedWay], times: FloatArray) -> Plan:
    """The motion along ways, whose positions are told between layers."""
    positions = np.array(
        [
            [np.interp(scenario.grid.elapsed, times, axis) for axis in way.positions.T]
            for way in ways
        ]
    )
    return straight_between(scenario, positions.transpose(0, 2, 1))
