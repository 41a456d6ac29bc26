"""Allowed times of waypoints: when no obstacle and no requirement forbids their positions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from drake_rho.planning.planners.related import changes_with_time
from drake_rho.planning.programs.free_times import Passing
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.waypoints import AllWaypoints

_SAMPLES = 16
"""Number of samples of each step among which intervals begin and end."""

_HALVINGS = 40
"""Number of bisections that find the ends of an interval, to rounding."""

_TRIES = 15
"""Number of times of a waypoint that are compared."""


@dataclasses.dataclass(frozen=True)
class AllowedTimes:
    """Intervals of time in which each waypoint may be passed, or rest there may begin.

    Its position is then outside of all obstacles, and inside the sets of all requirements, for the
    whole of a dwell.
    """

    intervals: Sequence[FloatArray]
    """first and last times of each waypoint since the first knot [s], shape (M, 2) each"""
    duration: float
    """final time [s]"""

    @classmethod
    def of(cls, scenario: Scenario, waypoints: AllWaypoints) -> AllowedTimes:
        """Return the intervals of all waypoints.

        Args:
            scenario: the scenario without waypoints.
            waypoints: the waypoints of all vehicles.
        """
        grid = scenario.grid
        if not changes_with_time(scenario):
            found = [np.array([[0.0, grid.duration - dwell]]) for dwell in waypoints.dwells]
            return cls([each[each[:, 0] <= each[:, 1]] for each in found], grid.duration)
        corners = [body.corners for body in scenario.bodies]
        corners += [each.corners for each in scenario.requirements]
        samples = np.linspace(grid.start, grid.end, (grid.knots - 1) * _SAMPLES + 1)
        times = np.unique(np.concatenate([samples, *corners]))
        times = times[(times >= grid.start) & (times <= grid.end)]
        numbers = range(len(waypoints))
        found = [_intervals(scenario, waypoints, w, times) - grid.start for w in numbers]
        return cls(found, grid.duration)

    def select(self, numbers: IntArray) -> AllowedTimes:
        """Return the intervals of some of the waypoints."""
        return AllowedTimes([self.intervals[int(w)] for w in numbers], self.duration)

    def nearest(self, passing: Passing) -> Passing:
        """Return waypoints at the nearest allowed times, with the intervals of these.

        A waypoint without an allowed time is unchanged.
        """
        times = np.array(passing.times)
        allowed = np.tile([0.0, self.duration], (len(passing), 1))
        for w in np.flatnonzero(~passing.given).tolist():
            if len(intervals := self.intervals[w]) > 0:
                within = np.clip(times[w], intervals[:, 0], intervals[:, 1])
                which = np.argmin(np.abs(within - times[w]))
                times[w], allowed[w] = within[which], intervals[which]
        return dataclasses.replace(passing, times=times, allowed=allowed)

    def samples(self, passing: Passing, w: int) -> FloatArray:
        """Return allowed times of a waypoint between those of its neighbours [s], shape (S,)."""
        own, numbers = passing.vehicles == passing.vehicles[w], np.arange(len(passing))
        low = passing.times[own & (numbers < w)].max(initial=0.0)
        high = passing.times[own & (numbers > w)].min(initial=self.duration)
        ends = np.clip(self.intervals[w], low + passing.least, high - passing.least)
        ends = ends[ends[:, 1] > ends[:, 0]]
        if len(ends) == 0:
            return np.zeros(0)
        lengths = np.concatenate([[0.0], np.cumsum(ends[:, 1] - ends[:, 0])])
        along = lengths[-1] * (np.arange(_TRIES) + 0.5) / _TRIES
        which = np.searchsorted(lengths, along, side="right") - 1
        samples: FloatArray = ends[which, 0] + along - lengths[which]
        return samples


def _intervals(
    scenario: Scenario, waypoints: AllWaypoints, number: int, times: FloatArray
) -> FloatArray:
    """Return the intervals of one waypoint on the scenario's clock [s], shape (M, 2)."""
    padded = np.pad(_allowed(scenario, waypoints, number, times), 1)
    first = np.flatnonzero(padded[1:] & ~padded[:-1])
    last = np.flatnonzero(padded[:-1] & ~padded[1:]) - 1

    def end(inner: FloatArray, outer: FloatArray) -> FloatArray:
        """Return the last allowed times between allowed and forbidden ones, by bisection."""
        for _ in range(_HALVINGS):
            middle = (inner + outer) / 2.0
            good = _allowed(scenario, waypoints, number, middle)
            inner, outer = np.where(good, middle, inner), np.where(good, outer, middle)
        return inner

    begins = end(times[first], times[np.maximum(first - 1, 0)])
    ends = end(times[last], times[np.minimum(last + 1, len(times) - 1)])
    tick = scenario.grid.clock.tick  # so that rounding does not leave the interval
    found = np.stack([begins + tick, ends - tick - waypoints.dwells[number]], axis=1)
    return found[found[:, 0] <= found[:, 1]]


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
    clock = scenario.grid.clock
    for each in scenario.requirements:
        members, interval = each.members(scenario.names), each.interval(scenario.grid)
        own = np.flatnonzero(members == vehicle)
        if each.leader is not None or each.quantity != "position" or len(own) == 0:
            continue
        if interval is not None:
            tolerance = each.tolerances(fleet, scenario.names)[own[0]] + waypoints.within[number]
            inside = each.set.signed_distance(places - each.offset(times)) <= tolerance
            allowed &= inside | ~clock.within(times, interval)
    return allowed
