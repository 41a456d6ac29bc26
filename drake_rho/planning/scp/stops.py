"""Stops at free times: vehicles rest at waypoints in whole steps, which are moved in turn."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np

from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.fields import FloatArray, IntArray

_TIGHT = 1e-6
"""Relative margin of a step over the shortest for its stops within which they bound it."""


def with_moved_stops(timed: Timed, by: int, *, shorter: bool) -> Iterator[Timed]:
    """Yield a motion with the first knots of successive stops of a vehicle later, or earlier.

    Together they pass steps from the leg after them to the one before them. Other waypoints keep
    their part of the time between stops.

    Args:
        timed: the motion to linearise around.
        by: number of steps.
        shorter: whether the final time is free. Where the dwell of a stop bounds the step from
            below, shorter steps are tried too, of which it takes as many more.
    """
    same = dataclasses.replace(timed.with_stops_at_knots(), rows=())
    motions = [same]
    if shorter and same.shortest_stop > 1.0 - _TIGHT:
        motions.append(_with_more_steps(same, by))
        yield motions[-1]
    for each in motions:
        for moved in _runs(each.passing):
            for steps in (by, -by):
                later = _moved(each, moved, steps)
                if later.is_in_order and _is_in_flight(later, each):
                    yield dataclasses.replace(each, passing=later)


def _with_more_steps(timed: Timed, by: int) -> Timed:
    """Return the motion in less time, so that the stop that bounds it takes more steps.

    Args:
        timed: the motion.
        by: number of steps more.
    """
    passing, stops = timed.passing, timed.passing.stops
    steps = passing.steps_at_rest(timed.step)[stops]
    longest = int(np.argmax(passing.dwells[stops] / steps))
    step = passing.dwells[stops[longest]] / (steps[longest] + by - 1)
    return timed.lasting((1.0 - 2.0 * _TIGHT) * timed.duration * step / timed.step)


def _runs(passing: Passing) -> Iterator[IntArray]:
    """Yield the indices of successive stops of a vehicle, one or more."""
    stops = passing.stops
    for vehicle in np.unique(passing.vehicles[stops]):
        own = stops[passing.vehicles[stops] == vehicle]
        for first, last in combinations_with_replacement(range(len(own)), 2):
            yield own[first : last + 1]


def _moved(timed: Timed, stops: IntArray, steps: int) -> Passing:
    """Return the waypoints with some stops of one vehicle later by a number of steps."""
    passing = timed.passing
    own = np.flatnonzero(passing.vehicles == passing.vehicles[stops[0]])
    fixed = own[passing.given[own] | np.isin(own, passing.stops)]
    times = passing.times.copy()
    times[stops] += steps * timed.step
    before, after = (
        _anchors(each, passing, fixed, timed.duration) for each in (passing.times, times)
    )
    others = np.setdiff1d(own, fixed)
    times[others] = np.interp(passing.times[others], before, after)
    return dataclasses.replace(passing, times=times)


def _anchors(times: FloatArray, passing: Passing, fixed: IntArray, duration: float) -> FloatArray:
    """Return the times between which others keep their parts: ends of the flight and of rests."""
    rests = np.stack([times[fixed], times[fixed] + passing.dwells[fixed]], axis=1)
    return np.concatenate([[0.0], rests.reshape(-1), [duration]])


def _is_in_flight(passing: Passing, timed: Timed) -> bool:
    """Return whether all stops are during the flight, at allowed times."""
    if not passing.stops_are_allowed(timed.step):
        return False
    stops = passing.stops
    last = passing.times[stops] + timed.step * passing.steps_at_rest(timed.step)[stops]
    return bool(np.all(passing.times[stops] > 0.0) and np.all(last < timed.duration))
