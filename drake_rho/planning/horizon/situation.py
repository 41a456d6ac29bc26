"""Situation of a flight, from which its next window is planned.

It has the obstacles known now, the plan in force with its tube, and the times found for free
waypoints. A window that begins at a knot starts from `Situation.at`.

With a latency, windows are planned while the previous one is flown. With a smoothing, averages
depend on accelerations up to `Scenario.lead` later: a window that changes accelerations from a knot
on must be planned that much before the knot. Its averages change from then on. They also depend on
accelerations planned before, up to another `lead` back (`State.flown`). All windows together are
one plan, and the flight is its average: nothing jumps where a window begins. Such windows begin on
the plan of the window before, not at measured states, which would be a jump, and the error tube
continues from the start of the flight. A new window may accelerate up to the limits while averages
near its first knot still depend on positions planned before. All windows therefore keep the margin
for the largest accelerations.
"""

from __future__ import annotations

import dataclasses
from typing import Self

import numpy as np

from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.plan import Plan
from drake_rho.motion.scenario_tube import tracking_of
from drake_rho.planning.horizon.fallbacks import moved
from drake_rho.planning.horizon.known_now import Known
from drake_rho.planning.horizon.measured_states import Measured, continued, off_tube
from drake_rho.planning.horizon.waypoints_ahead import (
    Free,
    free_ahead,
    free_of,
    timed_as,
    with_guessed_times,
)
from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.parts import REACHED, Vehicle, Waypoint
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import (
    from_states,
    going_on,
    known_later,
    known_when_seen,
    with_obstacles,
    within_flight,
)
from drake_rho.scenario.times import Clock, steps_lasting

_CLOCK = 1e-4
"""Largest difference of a caller's time from a knot, in steps; allows for errors of its clock."""


@dataclasses.dataclass(frozen=True, eq=False)
class WindowStart:
    """Start of a window after the first: the rest of the flight and of the plan in force."""

    knot: int
    """knot of the whole flight at which the window begins, counted from 0"""
    scenario: Scenario
    """rest of the flight, from the measured states"""
    remaining: Plan
    """rest of the plan in force"""
    last: Window
    """window with that plan"""
    stop: Plan | None
    """rest of its contingency; None without one"""
    off: tuple[str, ...]
    """names of the vehicles off the tube of the plan in force"""
    free: Free
    """flags of waypoints ahead with free times"""
    has_news: bool = False
    """whether something was told in flight"""
    is_new: bool = False
    """whether it was told for this window"""
    own_reference: Plan | None = None
    """rest of the plan in force from the measured states, if it is not to be moved to the goals"""

    @property
    def reference(self) -> Plan:
        """Rest of the plan in force, moved to the measured states."""
        return self.own_reference or moved(self.remaining, self.scenario)

    @property
    def has_new_orders(self) -> bool:
        """Whether goals or waypoints are not those of the plan in force."""
        if not self.has_news:
            return False
        pairs = zip(self.scenario.vehicles, self.remaining.scenario.vehicles, strict=True)
        return any(
            one.goal != other.goal or _without_times(one) != _without_times(other)
            for one, other in pairs
        )

    @property
    def begins_as_planned(self) -> bool:
        """Whether the window begins exactly where the plan in force is."""
        if self.scenario is self.remaining.scenario:
            return True
        planned = self.remaining.scenario.fleet.start_states
        return np.array_equal(self.scenario.fleet.start_states, planned)

    @property
    def on_plan(self) -> bool:
        """Whether all vehicles are in the tube of the plan in force, so that it stays valid."""
        return bool(self.scenario.smoothing) or not self.off


@dataclasses.dataclass(frozen=True, eq=False)
class Situation:
    """Situation of a flight between two windows, without measured states."""

    given: Scenario
    """scenario as given"""
    known: Known
    """scenario of the whole flight as it is known now, with the times found for waypoints"""
    free: Free
    """flags of the waypoints with free times"""
    latency: int
    """number of samples of the feedback by which states are predicted"""
    last: Window | None = None
    """last window, with the plan in force; None before the first"""
    is_begun: bool = False
    """whether the last window is of the flight before, and continues in this one"""

    @classmethod
    def of(cls, given: Scenario, latency: int) -> Self:
        """Return the situation before a flight.

        Args:
            given: scenario to fly.
            latency: number of samples of the feedback that planning a window takes.
        """
        scenario = known_later(given, _time_ahead(given, latency))
        return cls(given, Known.of(given, scenario), free_of(scenario), latency)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the whole flight as it is known now, with the times found for waypoints."""
        return self.known.flight

    def with_news(self, now: Scenario, time: float) -> Self:
        """Return the situation with the scenario as it is known from a time on.

        Args:
            now: the scenario as it is known now.
            time: on the scenario's clock [s].

        Raises:
            ScenarioError: it differs in what stays the same in a flight.
        """
        known = self.known.with_news(now, time, _time_ahead(self.given, self.latency))
        free = tuple(
            flags
            if now.waypoints is before.waypoints
            else tuple(each.time is None for each in now.waypoints)
            for flags, before, now in zip(
                self.free, self.scenario.vehicles, known.flight.vehicles, strict=True
            )
        )
        return dataclasses.replace(self, known=known, free=free)

    def with_window(self, window: Window) -> Self:
        """Return the situation after a window was planned.

        A window that continues the plan before keeps the former sightings, which this plan avoids.
        """
        known = self.known.without_spare() if window.kept else self.known
        scenario = known.flight
        of_others = known.has_news and (window.kept or window.infeasible)  # of former orders
        if any(map(any, self.free)) and not of_others:
            scenario = timed_as(scenario, window.plan.scenario)
        known = known.with_flight(scenario)
        return unchecked(self, known=known, last=window, is_begun=False)

    @property
    def at_start(self) -> Scenario:
        """Scenario of the first window: at rest before, with margins for later windows."""
        scenario = self.scenario
        if not scenario.smoothing:
            return scenario
        return going_on(scenario, np.zeros((len(scenario.vehicles), REACHED, 3)))

    def knot_at(self, time: float) -> int:
        """Return the knot at which the next window begins, counted from 0.

        Args:
            time: on the scenario's clock [s].

        Raises:
            ValueError: the time is not that of a knot at which the next window can begin.
        """
        grid = self.scenario.grid
        knots = range(1)
        if self.last is not None:
            knots = range(self.last.first_knot + (not self.is_begun), grid.knots - 1)
        steps = (time - grid.start) / grid.step
        knot = round(steps) if np.isfinite(steps) else -1
        late = abs(steps - knot) > _CLOCK and not grid.clock.same(
            time, grid.start + knot * grid.step
        )
        if knot not in knots or late:
            first, last = (
                grid.times[min(k, grid.knots - 1)] for k in (knots.start, knots.stop - 1)
            )
            expected = f"the time of a knot from {clock_number(first)} to {clock_time(last)}"
            raise ValueError(f"time: got {time!r}, expected {expected}")
        return knot

    def planned(self, knot: int) -> FloatArray:
        """Return the planned states at which a window from a knot begins, shape (N, 6).

        Args:
            knot: of the whole flight, counted from 0, not before the start of the last window.
        """
        if self.last is None:
            return self.scenario.fleet.start_states
        return _states_at(self.last.plan, knot - self.last.first_knot)

    def at(self, knot: int, states: FloatArray) -> WindowStart:
        """Return the start of a window after the first.

        Args:
            knot: of the whole flight at which it begins, counted from 0.
            states: measured positions [m] and velocities [m/s], shape (N, 6), with NaN for vehicles
                that were not seen.

        Raises:
            ValueError: there is no window yet.
        """
        if (last := self.last) is None:
            raise ValueError("windows: got none, expected at least one planned window")
        remaining = self._rest(last.plan, knot - last.first_knot)
        planned = remaining.scenario
        measured = Measured.of(states, _states_at(remaining, 0))
        off = off_tube(planned, measured, self.latency).nonzero()[0]
        scenario = self._known_rest(planned)
        return WindowStart(
            knot,
            continued(scenario, measured, self.latency),
            remaining,
            last,
            stop=last.contingency and self._rest(last.contingency, knot - last.first_knot),
            off=tuple([scenario.names[i] for i in off]),
            free=free_ahead(self.free, self.scenario, scenario.grid),
            has_news=self.known.has_news,
            is_new=self.known.is_new,
        )

    def _known_rest(self, planned: Scenario) -> Scenario:
        """Return the rest of the flight as it is known now, from the states of the plan in force.

        Args:
            planned: scenario of the rest of that plan.
        """
        if not self.known.has_news:
            return with_obstacles(planned, self.scenario.obstacles)
        fleet, grid = planned.fleet, self.scenario.grid
        knot = round((planned.grid.start - grid.start) / grid.step)
        return from_states(
            self.scenario,
            grid.from_knot(knot, planned.grid.knots - 1),
            fleet.start_positions,
            fleet.start_velocities,
            fleet.accelerations_before,
            tracking_of(planned),
            fleet.flown,
            fleet.jerks_before,
        )

    def _rest(self, plan: Plan, knot: int) -> Plan:
        """Return the rest of a window's plan or contingency, with what it has to keep by now.

        Its goals and waypoints stay.
        """
        rest = plan.tail(knot)
        scenario = with_obstacles(rest.scenario, self.known.necessary[0])
        if self.known.has_news:
            scenario = scenario.derived(requirements=self.known.required_of(scenario.vehicles))
        return rest if scenario is rest.scenario else unchecked(rest, scenario=scenario)

    def flight(self, windows: list[Window]) -> Flight:
        """Return the flight composed of its windows, each flown until the next."""
        scenario = with_guessed_times(self.scenario)
        scenario = within_flight(known_when_seen(scenario, self.given))
        return Flight.composed(scenario, windows)


def _without_times(vehicle: Vehicle) -> list[Waypoint]:
    return [unchecked(each, time=None) for each in vehicle.waypoints]


def latency_in_samples(scenario: Scenario, latency: float, replan_every: int) -> int:
    """Return a latency in samples of the feedback, rounded up.

    Args:
        scenario: scenario to fly.
        latency: time that planning a window takes [s].
        replan_every: number of steps flown of each window.

    Raises:
        ValueError: the latency is negative, or too long.
    """
    period = replan_every * scenario.grid.step
    if not (latency >= 0.0 and Clock.of(period).within(latency, (0.0, period))):  # also for NaN
        expected = f"0 to {period:g} s, the time for which a window is flown"
        raise ValueError(f"latency: got {latency!r}, expected {expected}")
    return steps_lasting(latency, _sample(scenario))


def _time_ahead(scenario: Scenario, latency: int) -> float:
    """Return the time by which windows are planned ahead [s], with a smoothing by its lead too.

    Args:
        scenario: scenario to fly.
        latency: number of samples of the feedback.
    """
    return latency * _sample(scenario) + scenario.lead


def _sample(scenario: Scenario) -> float:
    """Return the time from one sample of the feedback to the next [s]."""
    return scenario.disturbance_or_calm.sample(scenario.grid)


def _states_at(plan: Plan, knot: int) -> FloatArray:
    """Return the states at a knot, or those of a smoothing's averages `lead` before it, (N, 6).

    After the end of a plan these are the states at its end.
    """
    if not plan.scenario.smoothing:
        return plan.states(min(knot, plan.scenario.grid.knots - 1))
    begin = plan.scenario.grid.elapsed[knot : knot + 1] - plan.scenario.lead
    positions, velocities, _ = plan.averaged().states(begin)
    return np.concatenate([positions[:, 0], velocities[:, 0]], axis=1)
