"""Times at which waypoints may be passed: where no obstacle and no requirement forbids the place."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import AllWaypoints

_SAMPLES = 16
"""Number of samples of each step among which intervals begin and end."""

_HALVINGS = 40
"""Number of bisections that find the ends of an interval, to rounding."""


def allowed_times(scenario: Scenario, waypoints: AllWaypoints) -> list[FloatArray]:
    """Return the intervals of time in which each waypoint may be passed, since the first knot [s].

    They are those at which a scenario with the waypoint would be valid: its place is outside of
    obstacles, and in the sets that requirements keep positions in.

    Args:
        scenario: the scenario without waypoints.
        waypoints: the waypoints of all vehicles.

    Returns:
        For each waypoint first and last times, shape (M, 2), in increasing order.
    """
    grid = scenario.grid
    corners = [body.corners for body in scenario.bodies]
    corners += [each.corners for each in scenario.requirements]
    knots = np.linspace(grid.start, grid.end, (grid.knots - 1) * _SAMPLES + 1)
    times = np.unique(np.concatenate([knots, *corners]))
    times = times[(times >= grid.start) & (times <= grid.end)]
    return [
        _intervals(scenario, waypoints, number, times) - grid.start
        for number in range(len(waypoints))
    ]


def _intervals(
    scenario: Scenario, waypoints: AllWaypoints, number: int, times: FloatArray
) -> FloatArray:
    """Return the intervals of one waypoint on the scenario's clock [s], shape (M, 2)."""
    allowed = _allowed(scenario, waypoints, number, times)
    padded = np.concatenate([[False], allowed, [False]])
    first, last = (
        np.flatnonzero(~padded[:-1] & padded[1:]),
        np.flatnonzero(padded[:-1] & ~padded[1:]) - 1,
    )

    def end(inner: FloatArray, outer: FloatArray) -> FloatArray:
        """Return allowed times next to forbidden ones, between an allowed and a forbidden one."""
        for _ in range(_HALVINGS):
            middle = (inner + outer) / 2.0
            good = _allowed(scenario, waypoints, number, middle)
            inner, outer = np.where(good, middle, inner), np.where(good, outer, middle)
        return inner

    begins = end(times[first], times[np.maximum(first - 1, 0)])
    ends = end(times[last], times[np.minimum(last + 1, len(times) - 1)])
    return np.stack([begins, ends], axis=1)


def _allowed(
    scenario: Scenario, waypoints: AllWaypoints, number: int, times: FloatArray
) -> BoolArray:
    """Return whether a waypoint may be passed at times on the scenario's clock [s], shape (M,)."""
    fleet, vehicle = scenario.fleet, int(waypoints.vehicles[number])
    places = np.tile(waypoints.positions[number], (len(times), 1))
    allowed = np.ones(len(times), dtype=bool)
    for body in scenario.bodies:
        required = fleet.radii[vehicle] + body.deviation
        tolerance = fleet.obstacle_tolerances(body.shape)[vehicle]
        allowed &= body.distances(places, times) >= required - tolerance
    for each in scenario.requirements:
        members, interval = each.members(scenario.names), each.interval(scenario.grid)
        if each.leader is not None or each.quantity != "position" or interval is None:
            continue
        if len(own := np.flatnonzero(members == vehicle)) == 0:
            continue
        tolerance = each.tolerances(fleet, scenario.names)[own[0]] + waypoints.within[number]
        due = scenario.grid.clock.within(times, interval)
        allowed &= ~due | (each.set.signed_distance(places - each.offset(times)) <= tolerance)
    return allowed
