"""Search for the times of free waypoints, for a given final time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.planning.planners.allowed_times import AllowedTimes
from drake_rho.planning.planners.convex import linearised_once
from drake_rho.planning.planners.passing_search import PassingSearch
from drake_rho.planning.planners.related import changes_with_time
from drake_rho.planning.problem import Problem
from drake_rho.planning.programs.backend import Backend
from drake_rho.planning.programs.free_times import Passing
from drake_rho.planning.scp.least_time import LeastTime
from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.gates import Gates
from drake_rho.scenario.objective import Objective
from drake_rho.scenario.records import Grid, Scenario
from drake_rho.scenario.waypoints import AllWaypoints

GAP = 0.002
"""Least time between waypoints of a vehicle, and from its start and goal, in steps: at equal times,
two waypoints would have equal rows."""

_LEAST_LEG = 1e-2
"""Least time of a leg in the first guess, as a fraction of the longest leg's. It matters for a
waypoint at the start."""

_MOST_AT_REST = 0.9
"""Largest part of the flight for dwells in the first guess."""

_ROUGHLY = 1e-2
"""Relative fall of the final time that ends the search for first times."""

_POWERS = 0.5, 2.0
"""Exponents on times as fractions of the final time, for further guesses."""

_PASSED = 1e-3
"""Largest miss of waypoints at which a guess is tried, as a fraction of a motion's length."""

_BESIDE = 0.25, 2.5, 25.0
"""Offsets of times close to a guess, in least times between waypoints."""

_SAMPLES = 8
"""Number of samples of each step among which the instant nearest to a waypoint is sought."""

_ALIKE = 1e-3
"""Least difference between the times of two guesses, as a fraction of the final time."""


def passing_of(
    waypoints: AllWaypoints, scenario: Scenario, grid: Grid, gates: Gates | None
) -> Passing:
    """Return waypoints with given times, and with guesses for free ones.

    The guessed time of a leg is proportional to the square root of its length, between given times
    too, in the time that is left by dwells.

    Args:
        waypoints: the waypoints of all vehicles.
        scenario: the scenario with these vehicles.
        grid: grid of the flight.
        gates: requirements at the waypoints; None for none.
    """
    fleet, times = scenario.fleet, waypoints.times - grid.start
    for i in np.unique(waypoints.vehicles):
        own = np.flatnonzero(waypoints.vehicles == i)
        places = [fleet.start_positions[i], *waypoints.positions[own], fleet.goal_positions[i]]
        legs = np.sqrt(np.linalg.norm(np.diff(places, axis=0), axis=1))
        legs = np.maximum(legs, _LEAST_LEG * max(legs.max(), 1e-300))
        rests = waypoints.dwells[own]
        rests *= min(1.0, _MOST_AT_REST * grid.duration / max(rests.sum(), 1e-300))
        flown = grid.duration - rests.sum()
        guess = flown * np.cumsum(legs)[:-1] / legs.sum() + np.cumsum(rests) - rests
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
        gates=gates,
    )


def in_least_time(start: Timed, backend: Backend, progress: Progress | None) -> tuple[Timed, float]:
    """Return the minimum-time motion through the waypoints, scaled in time to the final time.

    Given times and stops are scaled in proportion to the minimum time. If that is at most the
    required final time, the slower motion meets every limit and passes waypoints at given times.

    Args:
        start: motion in a final time, to linearise around first.
        backend: the solver and its settings.
        progress: called with the final time after each iteration.

    Returns:
        The motion in the final time of `start`, and the minimum time [s]; `start` and infinity if
        none is found.
    """
    passing = start.with_stops_at_knots().passing
    none, stops = np.zeros((2, len(passing)), dtype=bool)
    stops[passing.stops] = True
    scaled = dataclasses.replace(passing, given=none, in_proportion=passing.given | stops)
    fast = None
    with suppress(ScenarioError, SolverError):  # where nothing bounds the time
        search = LeastTime(backend, progress, steady=passing.is_scale_free)
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
    """Search for the times of a scenario's free waypoints that minimise the effort.

    With another objective they are not those of the least cost, which is minimised at these times.

    Args:
        scenario: the scenario.
        backend: the solver and its settings.
        progress: called with a short description of the current step.

    Attributes:
        scenario: the scenario.
    """

    def __init__(self, scenario: Scenario, backend: Backend, progress: Progress | None) -> None:
        self.scenario, self._backend, self._progress = scenario, backend, progress
        self._waypoints = AllWaypoints.of(scenario.vehicles)
        self._search = PassingSearch(backend, progress)

    @property
    def any_free(self) -> bool:
        """Whether any waypoint is free, without a given time."""
        return not bool(self._waypoints.given.all())

    def check(self) -> None:
        """Check that every free waypoint can be passed at some time of the flight.

        Raises:
            InfeasibleError: an obstacle or a requirement forbids its position at all times, or the
                dwells of a vehicle take as long as the flight.
        """
        self._check_dwells()
        forbidden = dict[str, list[str]]()
        for w in np.flatnonzero(~self._waypoints.given).tolist():
            if len(self._allowed.intervals[w]) == 0:
                name = self.scenario.names[self._waypoints.vehicles[w]]
                forbidden.setdefault(name, []).append(f"waypoint {self._waypoints.numbers[w] + 1}")
        if forbidden:
            conflicts = {name: tuple(which) for name, which in forbidden.items()}
            because = "obstacles or requirements forbid these places at all times"
            because += ", or for a dwell" if self._waypoints.dwells.any() else ""
            raise InfeasibleError(conflicts, scenario=self.scenario, because=because)

    def _check_dwells(self) -> None:
        """Check that dwells take less than the flight; successive ones at one place may overlap."""
        all_of, grid = self._waypoints, self.scenario.grid
        away = np.linalg.norm(np.diff(all_of.positions, axis=0), axis=1)
        new = np.diff(all_of.vehicles) != 0
        new |= away > all_of.within[1:] + all_of.within[:-1]
        counted = np.concatenate([[True], new]) * all_of.dwells
        at_rest = np.bincount(all_of.vehicles, counted)
        for i in np.flatnonzero(~grid.clock.before(at_rest, grid.duration)).tolist():
            dwells = {self.scenario.names[i]: ("dwells at its waypoints",)}
            because = f"these take {at_rest[i]:.4g} s of the flight's {grid.duration:.4g} s"
            raise InfeasibleError(dwells, scenario=self.scenario, because=because)

    def without_free(self) -> Scenario:
        """Return the scenario without free waypoints, a relaxation."""
        vehicles = tuple(
            dataclasses.replace(
                each, waypoints=tuple(own for own in each.waypoints if own.time is not None)
            )
            for each in self.scenario.vehicles
        )
        return self.scenario.with_vehicles(vehicles)

    def guesses(self) -> Iterator[FloatArray]:
        """Yield times of all waypoints that are optimal without obstacles and other vehicles.

        They are since the first knot [s], shape (W,). The first are found from the minimum-time
        motion, the others from other guesses.
        """
        tell(self._progress, "looking for the times of waypoints")
        known = list[FloatArray]()
        for start in self._starts():
            best = self._search.best(start, self._allowed)
            if self._more_than_limits:
                passing = self._allowed.nearest(best.passing)
                best = dataclasses.replace(best, scenario=self._convex, passing=passing)
                best = self._search.best(best, self._allowed)
            times, near = best.passing.times, _ALIKE * best.duration
            alike = any(np.allclose(times, each, rtol=0.0, atol=near) for each in known)
            if not known or (best.missed <= _PASSED and not alike):
                known.append(times)
                yield times
                if best.missed <= _PASSED and (inner := self._within_reach(times)) is not None:
                    yield inner

    def _within_reach(self, times: FloatArray) -> FloatArray | None:
        """Return feasible times close to some on the edge of feasibility.

        There a motion of the search may be infeasible to the tolerance of a plan. None is returned
        if the times are feasible as they are, or no times close to them are.
        """
        moved = np.eye(len(times))[~self._first.given] * self._first.least
        steps = [0.0 * moved[0], *(far * each for far in _BESIDE for each in (*moved, *-moved))]
        for number, step in enumerate(steps):
            with suppress(InfeasibleError, SolverError, ScenarioError):
                convex = self._at(times + step, self._convex)
                linearised_once(Problem.of(convex), None, self._backend)
                return times + step if number else None
        return None

    def near(self, plan: Plan) -> FloatArray:
        """Return waypoint times optimised from those of one of the scenario's plans."""
        times = AllWaypoints.of(plan.scenario.vehicles).times - plan.scenario.grid.start
        return self._search.best(self._from_plan(plan, times), self._allowed).passing.times

    def towards(self, plan: Plan) -> Iterator[FloatArray]:
        """Yield waypoint times found from a plan without the free waypoints.

        That plan satisfies all other constraints; it is bent to the waypoints.
        """
        for times in (self._nearest(plan), self._first.times):
            best = self._search.best(self._from_plan(plan, times), self._allowed)
            if best.missed <= _PASSED:
                yield best.passing.times

    def scenario_at(self, times: FloatArray) -> Scenario:
        """Return the scenario with all waypoints at times since the first knot [s], (W,).

        Raises:
            ScenarioError: a place is not allowed then, or a dwell ends too late.
        """
        return self._at(times, self.scenario)

    @cached_property
    def _without(self) -> Scenario:
        """The scenario without waypoints, with the cost of which times are found: the effort."""
        return self.scenario.without_waypoints().derived(objective=Objective())

    @cached_property
    def _convex(self) -> Scenario:
        """The scenario without waypoints, obstacles and separation: its convex constraints."""
        return self._without.derived(obstacles=(), separation=None)

    @cached_property
    def _first(self) -> Passing:
        """Waypoints at guesses of their times."""
        return passing_of(self._waypoints, self._without, self._without.grid, self._gates)

    @cached_property
    def _gates(self) -> Gates | None:
        return Gates.of(self.scenario.requirements, self.scenario.vehicles)

    @cached_property
    def _allowed(self) -> AllowedTimes:
        return AllowedTimes.of(self._without, self._waypoints)

    @property
    def _more_than_limits(self) -> bool:
        """Whether anything besides limits, obstacles at rest and separation affects the times."""
        own = self._without
        required = own.requirements or own.disturbance is not None or own.smoothing is not None
        return bool(required) or changes_with_time(own)

    def _starts(self) -> Iterator[Timed]:
        """Yield guesses of motions and times, possibly infeasible, subject to limits alone."""
        scenario = self._convex.derived(disturbance=None, requirements=(), smoothing=None)
        accelerations = Problem.of(scenario).effort.motion.accelerations
        start = Timed(scenario, scenario.grid.step, accelerations, self._first)
        yield in_least_time(start, self._backend, self._progress)[0]
        yield start
        parts = self._first.times / start.duration
        for power in _POWERS:
            times = np.where(self._first.given, self._first.times, start.duration * parts**power)
            yield dataclasses.replace(start, passing=dataclasses.replace(self._first, times=times))

    def _from_plan(self, plan: Plan, times: FloatArray) -> Timed:
        """Return the motion of a plan as a guess, with times at which to pass waypoints."""
        passing = self._allowed.nearest(dataclasses.replace(self._first, times=times))
        return Timed(self._without, plan.scenario.grid.step, plan.accelerations, passing)

    def _nearest(self, plan: Plan) -> FloatArray:
        """Return the times at which a plan's vehicles are nearest to free waypoints, in order."""
        first, duration = self._first, self._without.grid.duration
        samples = np.linspace(0.0, duration, _SAMPLES * plan.accelerations.shape[1] + 1)[1:-1]
        x, times = plan.motion().at("position", samples), np.array(first.times)
        numbers = np.arange(len(first))
        for w in np.flatnonzero(~first.given):
            own = first.vehicles == first.vehicles[w]
            before = times[own & (numbers < w)].max(initial=0.0)
            after = times[own & first.given & (numbers > w)].min(initial=duration)
            far = np.linalg.norm(x[first.vehicles[w]] - first.positions[w], axis=1)
            far[(samples <= before) | (samples >= after)] = np.inf
            times[w] = samples[np.argmin(far)]
        return times

    def _at(self, times: FloatArray, scenario: Scenario) -> Scenario:
        """Return a scenario with all waypoints at times since the first knot [s], (W,).

        In flight it is not checked again.
        """
        times = self.scenario.grid.start + times
        vehicles = self._waypoints.placed(self.scenario.vehicles, times)
        if self.scenario.under_way:
            return scenario.derived(vehicles=vehicles)
        return dataclasses.replace(scenario, vehicles=vehicles)


def at_times_tried(failures: Sequence[Exception], scenario: Scenario) -> Exception:
    """Return the error of a scenario with waypoint times that were tried, without proof.

    Args:
        failures: errors at these times, of which the first conflict is told.
        scenario: the scenario.
    """
    for error in failures:
        if isinstance(error, InfeasibleError):
            premise = f" {error.premise}" if error.premise else ""
            return error.replaced(
                because=error.because
                or "at none of the times of waypoints that were tried; at the first of these, "
                f"these cannot be met together{premise}"
            )
    if isinstance(failures[0], ScenarioError):  # a place that is not allowed then
        because = f"at none of the times of waypoints that were tried; at the first, {failures[0]}"
        return InfeasibleError({}, scenario=scenario, because=because)
    return failures[0]
