"""`OnboardPlanner`: one vehicle of a fleet plans for itself, and shares its plans.

It announces a plan, waits for as long as messages may take, and commits itself to the plan if none
that it has heard by then conflicts. docs/flight.md proves that all vehicles then stay separated.
"""

from __future__ import annotations

import dataclasses
from typing import Unpack

import numpy as np
import numpy.typing as npt

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import Samples
from drake_rho.planning.horizon.places_of_rest import largest_radius
from drake_rho.planning.horizon.receding_horizon import Proposal
from drake_rho.planning.horizon.settings import Windows
from drake_rho.planning.onboard.message import Message
from drake_rho.planning.onboard.others import Others, obstacle_of
from drake_rho.planning.onboard.own_windows import OwnWindows
from drake_rho.planning.onboard.shared_plan import SharedPlan, conflicting
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_begun, steps_lasting


@dataclasses.dataclass(frozen=True)
class Counts:
    """What a vehicle that plans for itself has done so far."""

    windows: int = 0
    """windows planned"""
    announced: int = 0
    """plans announced"""
    committed: int = 0
    """plans committed to"""
    withdrawn: int = 0
    """plans announced and withdrawn, because they conflicted or the vehicle was late"""


class OnboardPlanner:
    """Planner of one vehicle of a fleet, which knows of the others what they share.

    In a loop, give every message that has arrived to `hear`, call `step`, and send what it returns
    to all other vehicles. The vehicle flies `at`: the plan to which it has committed itself, which
    ends at rest and is safe for ever. Times are those of the vehicle's clock.

    Args:
        scenario: of all vehicles, at rest at their starts, with a separation.
        name: of the vehicle.
        horizon: time that every window plans ahead [s]; it ends at rest.
        period: time after which the newest message is repeated [s].
        delay: longest time from `step` to `hear` [s].
        lost: most messages in a row that another vehicle does not hear.
        clock_error: largest difference of two vehicles' clocks [s].
        latency: time allowed for planning a window [s]; a plan that comes later is not announced.
        replan_every: shortest time from the beginning of one window's planning to that of the next
            [s].
        radius: radius of communication, at least `least_radius` [m]; vehicles that are not heard
            are further away. Without one all vehicles hear each other.
        **windows: further settings of windows, as for `RecedingHorizon`.

    Attributes:
        name: of the vehicle.
        check: time for which an announced plan is not flown [s].
        counts: of windows and plans.

    Raises:
        ScenarioError: the scenario has no separation, requirements between vehicles, or a vehicle
            that starts in motion, or is not one for a rolling horizon.
        ValueError: there is no such vehicle, or a setting is not a possible one.
    """

    def __init__(
        self,
        scenario: Scenario,
        name: str,
        *,
        horizon: float = 3.0,
        period: float = 0.1,
        delay: float = 0.0,
        lost: int = 0,
        clock_error: float = 0.0,
        latency: float = 0.0,
        replan_every: float = 0.1,
        radius: float | None = None,
        **windows: Unpack[Windows],
    ) -> None:
        index, separation = scenario.index_of(name), scenario.separation
        if separation is None:
            expected = "one, which vehicles that plan for themselves keep"
            raise ScenarioError("separation", None, expected)
        _check(scenario)
        times = {"period": period, "delay": delay, "clock_error": clock_error, "latency": latency}
        for setting, value in (times | {"lost": lost, "replan_every": replan_every}).items():
            if not 0.0 <= value < np.inf or (setting == "period" and value == 0.0):
                raise ValueError(f"{setting}: got {value!r}, expected a time or number above 0")
        self.name, self._separation, self.counts = name, separation, Counts()
        self._clock_error, self._latency, self._period = clock_error, latency, period
        self.check = delay + lost * period + clock_error
        self._replan_every = replan_every
        alone = scenario.of_vehicles([index]).derived(separation=None)
        self._windows = OwnWindows(alone, horizon, **windows)
        self._grid, self._radius = scenario.grid, float(scenario.fleet.radii[index])
        window = scenario.derived(grid=scenario.grid.from_knot(0, steps_lasting(horizon, scenario.grid.step)))
        self._others = Others(_of_windows(window), name, clock_error, np.inf if radius is None else self.check + period)
        self._scenario = alone
        start = scenario.grid.start
        self._committed = SharedPlan.at_rest(scenario.vehicles[index].start.position, start, scenario.grid.step)
        self._first = 0
        self._flown = np.zeros((0, 3))
        self._planned: Proposal | None = None
        self._announced: tuple[SharedPlan, Proposal] | None = None
        self._number, self._sent, self._planned_at = 0, -np.inf, -np.inf
        self._farthest = _farthest(scenario, index, horizon + self.check + latency + scenario.grid.step)

    def hear(self, message: bytes, time: float) -> None:
        """Take in a message of another vehicle, in any order and any number of times.

        A loop should catch the error and go on: nothing has changed then.

        Args:
            message: that has arrived.
            time: now [s].

        Raises:
            MessageError: it is no message, is damaged, not of another vehicle of the scenario, from
                the future, or has a plan that does not end at rest or violates its vehicle's
                limits.
        """
        self._others.hear(message, time)

    def step(self, time: float) -> bytes | None:
        """Commit to or withdraw the announced plan, announce the planned one, or plan the next.

        The first two take no time. What is planned is announced by the next call, so call it again
        at once. Every message that has arrived before has to be heard first.

        Args:
            time: now, not before the last call [s].

        Returns:
            A message to be sent to all others at once; None if there is none.
        """
        changed = False
        if self._announced is not None and time >= self._announced[0].announced + self.check:
            self._decide(*self._announced, time)
            changed = True
        if self._planned is not None:
            changed |= self._announce(self._planned, time)
            self._planned = None
        elif self._announced is None and time >= self._planned_at + self._replan_every and not self.has_arrived:
            self._plan(time)
        if not changed and time < self._sent + self._period:
            return None
        self._number, self._sent = self._number + changed, time
        announced = self._announced and self._announced[0]
        return Message(self.name, self._number, self._committed, announced).encoded()

    def _decide(self, own: SharedPlan, proposal: Proposal, time: float) -> None:
        """Commit to the announced plan, or withdraw it.

        It has to be clear of every plan that others have committed to, and of every one that was
        announced earlier.
        """
        self._announced = None
        plans = list[SharedPlan]()
        for name, message in self._others.near(time):
            plans.append(message.committed)
            other = message.announced
            if other is not None and (other.announced, name) < (own.announced, self.name):
                plans.append(other)
        knot = proposal.window.first_knot
        begin = self._grid.start + knot * self._grid.step
        if time > begin or self._conflicts(own, plans).any():
            self.counts = dataclasses.replace(self.counts, withdrawn=self.counts.withdrawn + 1)
            return
        self._windows.accept(proposal)
        self._flown = self._flown_until(knot)
        self._first, self._committed = self._knot_of(own.start), own
        self.counts = dataclasses.replace(self.counts, committed=self.counts.committed + 1)

    def _announce(self, proposal: Proposal, time: float) -> bool:
        """Announce a planned window, unless it is late or conflicts; return whether it is."""
        window = proposal.window
        if self._grid.start + window.first_knot * self._grid.step < time + self.check:
            return False
        own = self._as_shared(proposal, time)
        plans = [each for _, message in self._others.near(time) for each in message.plans]
        if self._conflicts(own, plans).any():
            return False
        self._announced = own, proposal
        self.counts = dataclasses.replace(self.counts, announced=self.counts.announced + 1)
        return True

    def _conflicts(self, own: SharedPlan, plans: list[SharedPlan]) -> np.ndarray:
        return conflicting(own, plans, self._separation, self._clock_error)

    def _as_shared(self, proposal: Proposal, time: float) -> SharedPlan:
        """Return the plan in force from now on, and then a window."""
        now, plan = self._knot_of(time), proposal.window.plan
        first = now - self._first
        p, v, _ = self._committed.states(np.array([self._grid.start + now * self._grid.step]))
        until = proposal.window.first_knot - self._first
        accelerations = self._committed.starting_at(until, plan.accelerations[0])[first:]
        radius = max(largest_radius(plan.scenario), self._committed.radius)
        start = self._grid.start + now * self._grid.step
        return SharedPlan(time, start, self._grid.step, np.concatenate([p[0], v[0]]), accelerations, radius)

    def _knot_of(self, time: float) -> int:
        """Return the last knot that is not after a time [s]."""
        knot = int(steps_begun(time - self._grid.start, self._grid.step))
        return knot - (self._grid.start + knot * self._grid.step > time)

    def _plan(self, time: float) -> None:
        """Plan a window against everything that others may fly; keep it if it is a new one."""
        ready = time + self._latency + self.check - self._grid.start
        knot = max(steps_lasting(ready, self._grid.step), self._windows.last.first_knot + 1)
        begin = self._grid.start + knot * self._grid.step
        now = self._scenario.derived(obstacles=(*self._scenario.obstacles, *self._obstacles(time, begin)))
        proposal = self._windows.among(now, begin)
        self._planned_at = time
        self.counts = dataclasses.replace(self.counts, windows=self.counts.windows + 1)
        window = proposal.window
        if not window.infeasible or window.stopping:
            self._planned = proposal

    def _obstacles(self, time: float, begin: float) -> list[Obstacle]:
        """Return the plans of others as obstacles of a window that begins at a time [s].

        Announced plans that conflict with the plan in force will be withdrawn, and do not count.
        """
        found = list[Obstacle]()
        for name, message in self._others.near(time):
            for kind, plan in zip(("committed", "announced"), message.plans, strict=False):
                if kind == "announced" and self._conflicts(self._committed, [plan]).any():
                    continue
                error = plan.radius + self._clock_error * plan.speed
                found.append(
                    obstacle_of(f"{name} {kind}", plan, self._separation, self._radius, begin, error)
                )
        return found

    @property
    def has_arrived(self) -> bool:
        """Return whether the plan in force ends at the goal."""
        goal = self._scenario.vehicles[0].goal.position
        if not isinstance(goal, np.ndarray):
            return False
        away = float(np.linalg.norm(self._committed.knots[0][-1] - goal))
        return away <= 1e-6 * float(self._windows.scenario.fleet.scale("position")[0])

    def at(self, times: npt.ArrayLike) -> Samples:
        """Return what to fly: the states on the plan in force at times [s], arrays (T, 3).

        Args:
            times: since the announcement of that plan [s], shape (T,), or a single one.
        """
        at = np.atleast_1d(np.asarray(times, dtype=np.float64))
        return Samples((self.name,), at, *self._committed.states(at))

    def _flown_until(self, knot: int) -> FloatArray:
        """Return the accelerations committed to until a knot of the flight [m/s²], (knot, 3)."""
        known = self._committed.starting_at(max(knot - self._first, 0), np.zeros((0, 3)))
        return np.concatenate([self._flown[: self._first], known])[:knot]

    @property
    def flight(self) -> Plan:
        """Motion of the vehicle from the scenario's start to the end of the plan in force."""
        knot = self._first + len(self._committed.accelerations)
        grid = self._grid.from_knot(0, knot)
        scenario = self._windows.scenario.derived(grid=grid, obstacles=self._scenario.obstacles)
        return Plan.from_accelerations(scenario, self._flown_until(knot)[None])

    @property
    def least_radius(self) -> float:
        """Least radius of communication [m]."""
        return self._farthest


def _of_windows(scenario: Scenario) -> Scenario:
    """Return the scenario by which plans of others are checked: their limits alone."""
    return scenario.derived(
        obstacles=(), requirements=(), separation=None, disturbance=None, objective=type(scenario.objective)()
    )


def _farthest(scenario: Scenario, index: int, time: float) -> float:
    return time * 0.0


def _check(scenario: Scenario) -> None:
    """Check that vehicles of a scenario can plan for themselves.

    Raises:
        ScenarioError: a requirement is between vehicles, or a vehicle starts in motion.
    """
    for i, each in enumerate(scenario.requirements):
        if isinstance(each.relative_to, str):
            expected = "none to another vehicle, whose plans are its own"
            raise ScenarioError(f"requirements[{i}].relative_to", each.relative_to, expected)
    for i, vehicle in enumerate(scenario.vehicles):
        if vehicle.start.velocity.any():
            got = Description(f"{vehicle.start.velocity.tolist()} of {vehicle.name}")
            raise ScenarioError(f"vehicles[{i}].start.velocity", got, "0: vehicles begin at rest")
