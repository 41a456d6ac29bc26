"""Search for motions through free waypoints, from motions that miss some of them."""

from __future__ import annotations

import dataclasses
from contextlib import suppress

import numpy as np

from drake_rho.motion.costs import cost_of
from drake_rho.planning.call.progress import Progress
from drake_rho.planning.errors import SolverError
from drake_rho.planning.planners.allowed_times import AllowedTimes
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.scp.least_time import CONVERGED, LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.fields import IntArray

_PRICES = 1e2, 1e5
"""Penalties for missing waypoints by a motion's length, in units of a motion's cost."""

_ROUGHLY = 1e-2
"""Relative fall of the cost, with the penalty for missed waypoints, that ends a search."""

_PASSED = 1e-9
"""Largest miss at which a waypoint counts as passed, as a fraction of a motion's length."""


@dataclasses.dataclass(frozen=True)
class PassingSearch:
    """Search for the motion of least cost that passes all waypoints, and for its times."""

    backend: Backend
    """solver of the programs"""
    progress: Progress | None
    """called with the cost after each iteration"""

    def best(self, start: Timed, allowed: AllowedTimes) -> Timed:
        """Return the motion of least cost near a guess; one that misses waypoints if none is found.

        If the times of the guess are infeasible, waypoints become soft: minimising the penalty
        leads to feasible times.

        Args:
            start: motion to linearise around first; it may violate any constraint.
            allowed: times at which its waypoints may be passed.
        """
        best = self._around(start)
        if best is None:
            start = self._passed(start, allowed)
            best = self._around(start)
        return best or start

    def _around(self, start: Timed, tolerance: float = CONVERGED) -> Timed | None:
        """Return the motion of least cost around another; None also if solvers fail."""
        with suppress(SolverError):
            return self._search().around(start, tolerance)
        return None

    def _search(self) -> LeastTime:
        return LeastTime(self.backend, self.progress, final_time=False)

    def _passed(self, start: Timed, allowed: AllowedTimes) -> Timed:
        """Return a motion that misses the waypoints least, found group by independent group.

        Args:
            start: motion to linearise around first.
            allowed: times at which its waypoints may be passed.
        """
        accelerations, times = np.array(start.accelerations), np.array(start.passing.times)
        for group in _independent(start):
            numbers = np.flatnonzero(np.isin(start.passing.vehicles, group))
            if not np.all(start.passing.given[numbers]):
                found = self._least_missed(_part(start, group), allowed.select(numbers))
                accelerations[group], times[numbers] = found.accelerations, found.passing.times
        passing = allowed.nearest(dataclasses.replace(start.passing, times=times))
        return dataclasses.replace(start, accelerations=accelerations, passing=passing, rows=())

    def _least_missed(self, start: Timed, allowed: AllowedTimes) -> Timed:
        """Return a motion that misses waypoints least, from a guess and from sampled times."""
        best = self._at_a_price(start, _PRICES[0])
        if best is None or best.missed > _PASSED:
            best = self._compared(best or start, allowed)
            for price in _PRICES:
                if best.missed > _PASSED or price == _PRICES[0]:
                    best = self._at_a_price(best, price) or best
        return best

    def _at_a_price(self, start: Timed, price: float) -> Timed | None:
        """Return a motion with soft waypoints at a penalty; None if there is none."""
        found = self._around(_priced(start, price), _ROUGHLY)
        return found and _exact(found)

    def _compared(self, start: Timed, allowed: AllowedTimes) -> Timed:
        """Return the motion with the best sampled time of each free waypoint in turn."""
        search, best = self._search(), _priced(start, _PRICES[0])
        known = search.at_same_times(best)
        for w in np.flatnonzero(~start.passing.given).tolist():
            best = known or best
            for time in allowed.samples(best.passing, w):
                times = np.array(best.passing.times)
                times[w] = time
                passing = allowed.nearest(dataclasses.replace(best.passing, times=times))
                found = search.at_same_times(dataclasses.replace(best, passing=passing))
                if found is not None and (known is None or found.cost < known.cost):
                    known = found
        return _exact(known or best)


def _independent(timed: Timed) -> list[IntArray]:
    """Return the indices of vehicles in independent groups."""
    count = len(timed.scenario.vehicles)
    if timed.scenario.separation is not None:
        return [np.arange(count)]
    labels = timed.problem.linked_groups
    return [np.flatnonzero(labels == label) for label in np.unique(labels)]


def _part(timed: Timed, group: IntArray) -> Timed:
    """Return the motion of some vehicles alone."""
    own = np.isin(timed.passing.vehicles, group)
    vehicles = np.searchsorted(group, timed.passing.vehicles[own])
    passing = dataclasses.replace(timed.passing.of(own), vehicles=vehicles)
    scenario = timed.scenario.of_vehicles(group.tolist())
    return Timed(scenario, timed.step, timed.accelerations[group], passing)


def _priced(timed: Timed, price: float) -> Timed:
    """Return a motion with soft free waypoints, at a penalty in units of costs and lengths."""
    fleet, steps = timed.scenario.fleet, timed.accelerations.shape[1]
    cost = float(np.sum(timed.problem.effort.changes.units**2)) * steps
    price *= (cost + cost_of(timed.scenario, timed.motion)) / float(fleet.lengths.max())
    return dataclasses.replace(timed, passing=dataclasses.replace(timed.passing, price=price))


def _exact(timed: Timed) -> Timed:
    """Return a motion as a guess with hard waypoints."""
    passing = dataclasses.replace(timed.passing, price=np.inf)
    return dataclasses.replace(timed, passing=passing, short=0.0)
