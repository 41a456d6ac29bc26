"""Times of waypoints without one, for a given final time."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from functools import cached_property

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.scp.least_time import LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import AllWaypoints

GAP = 0.05
"""Least time between waypoints of a vehicle, and from its start and goal, in steps."""

_LEAST_LEG = 1e-2
"""Least part of the longest leg's time that a leg has at first, as to a waypoint at the start."""

_ROUGHLY = 1e-2
"""Relative fall of the final time that ends the search for first times."""


def passing_of(waypoints: AllWaypoints, scenario: Scenario, grid: Grid) -> Passing:
    """Return waypoints with their times; those that are free grow with the roots of distances.

    Those between given times do so between these.

    Args:
        waypoints: the waypoints of all vehicles.
        scenario: the scenario with these vehicles.
        grid: grid of the flight.
    """
    fleet, times = scenario.fleet, waypoints.times - grid.start
    for i in np.unique(waypoints.vehicles):
        own = np.flatnonzero(waypoints.vehicles == i)
        places = [fleet.start_positions[i], *waypoints.positions[own], fleet.goal_positions[i]]
        legs = np.sqrt(np.linalg.norm(np.diff(places, axis=0), axis=1))
        legs = np.maximum(legs, _LEAST_LEG * max(legs.max(), 1e-300))
        guess = grid.duration * np.cumsum(legs)[:-1] / legs.sum()
        given = waypoints.given[own]
        if given.any() and not given.all():
            ends = [0.0, *guess[given], grid.duration], [0.0, *times[own][given], grid.duration]
            guess = np.interp(guess, *ends)
        times[own] = np.where(given, times[own], guess)
    return Passing(
        waypoints.vehicles,
        times,
        waypoints.positions,
        waypoints.within,
        waypoints.given,
        GAP * grid.step,
    )


def in_least_time(start: Timed, backend: Backend, progress: Progress | None) -> tuple[Timed, float]:
    """Return a motion with waypoints where a flight in the least time has them, if it can.

    In that flight given times are as early in proportion. So if its final time is at most that of
    the motion, the same motion flown slower meets every limit, and passes waypoints at given times.

    Args:
        start: motion in a final time, to linearise around first.
        backend: the solver and its settings.
        progress: called with the final time after each iteration.

    Returns:
        The motion in the final time of `start`, which is returned if none is found, and the final
        time of that flight, infinite then [s].
    """
    passing = start.passing
    none = np.zeros(len(passing), dtype=bool)
    scaled = dataclasses.replace(passing, given=none, in_proportion=passing.given)
    fast = None
    with suppress(ScenarioError):  # nothing bounds the time
        search = LeastTime(backend, progress)
        fast = search.around(dataclasses.replace(start, passing=scaled), _ROUGHLY)
    if fast is None:
        return start, np.inf
    slower = start.duration / fast.duration
    times = np.where(passing.given, passing.times, fast.passing.times * slower)
    motion = dataclasses.replace(
        start,
        accelerations=fast.accelerations / slower**2,
        passing=dataclasses.replace(passing, times=times),
    )
    return motion, fast.duration


class WaypointTimes:
    """Search for the times of a scenario's free waypoints at which the cost is least.

    Args:
        scenario: the scenario.
        backend: the solver and its settings.
        progress: called with a short description of the current step.
    """

    def __init__(self, scenario: Scenario, backend: Backend, progress: Progress | None) -> None:
        self._given, self._backend, self._progress = scenario, backend, progress
        self._waypoints = AllWaypoints.of(scenario.vehicles)

    @cached_property
    def _without(self) -> Scenario:
        """The scenario without waypoints."""
        vehicles = self._waypoints.placed(self._given.vehicles, None)
        return dataclasses.replace(self._given, vehicles=vehicles)

    @property
    def any_free(self) -> bool:
        """Whether any waypoint has no time."""
        return not bool(self._waypoints.given.all())

    def alone(self) -> Scenario:
        """Return the scenario with the times that are best without obstacles and other vehicles."""
        tell(self._progress, "looking for the times of waypoints")
        scenario = dataclasses.replace(
            self._without,
            obstacles=(),
            separation=None,
            disturbance=None,
            requirements=(),
            smoothing=None,
        )
        effort, grid = Problem.of(scenario).effort, scenario.grid
        passing = passing_of(self._waypoints, scenario, grid)
        start = Timed(scenario, grid.step, effort.motion.accelerations, passing)
        fast, _ = in_least_time(start, self._backend, self._progress)
        return self._timed(self._best(fast))

    def _best(self, start: Timed) -> Timed:
        search = LeastTime(self._backend, self._progress, final_time=False)
        return search.around(start) or start

    def near(self, plan: Plan) -> Scenario:
        """Return the scenario with the times that are best near a plan of it with other times."""
        times = AllWaypoints.of(plan.scenario.vehicles).times - plan.scenario.grid.start
        passing = passing_of(self._waypoints, self._without, self._without.grid)
        passing = dataclasses.replace(passing, times=times)
        start = Timed(self._without, plan.scenario.grid.step, plan.accelerations, passing)
        return self._timed(self._best(start))

    def _timed(self, timed: Timed) -> Scenario:
        times = self._given.grid.start + timed.passing.times
        vehicles = self._waypoints.placed(self._given.vehicles, times)
        return dataclasses.replace(self._given, vehicles=vehicles)
