"""`OnboardPlanner`: one vehicle of a fleet plans for itself, and shares its plans.

It announces a plan, waits for as long as messages may take, and commits itself to the plan if none
that it has heard by then conflicts. docs/flight.md proves that all vehicles then stay separated.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import Samples
from drake_rho.planning.call.options import Options
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.horizon.places_of_rest import largest_radius
from drake_rho.planning.horizon.receding_horizon import Proposal
from drake_rho.planning.horizon.told_goals import is_at
from drake_rho.planning.onboard.message import Message
from drake_rho.planning.onboard.others import Others, obstacle_around, obstacle_of
from drake_rho.planning.onboard.own_windows import OwnWindows
from drake_rho.planning.onboard.passing import plan_past
from drake_rho.planning.onboard.radius import greatest_speeds, least_radius, may_be_met
from drake_rho.planning.onboard.shared_plan import SharedPlan, conflicting
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import BoolArray, FloatArray, unchecked
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import TOLERANCE, Scenario
from drake_rho.scenario.times import steps_begun, steps_lasting


@dataclasses.dataclass(frozen=True)
class Counts:
    """What a vehicle that plans for itself has done so far."""

    windows: int = 0
    """windows planned"""
    announced: int = 0
    """plans announced"""
    committed: int = 0
    """announced plans to which it committed itself"""
    withdrawn: int = 0
    """announced plans that it withdrew, because they conflicted or their time was over"""


class OnboardPlanner:
    """Planner of one vehicle of a fleet, which knows of the others what they share.

    In a loop, give every message that has arrived to `hear`, call `step`, and send what it returns
    to all other vehicles. The vehicle flies `at`: the plan to which it has committed itself, which
    ends at rest and is safe for ever. Times are those of the vehicle's clock. There are no sockets
    and no threads in it, and it may stay in a loop of any rate.

    Args:
        scenario: of all vehicles, at rest at their starts, with a separation. The grid only gives
            the step.
        name: of the vehicle.
        horizon: time that every window plans ahead [s]; it ends at rest.
        period: time after which the newest message is repeated at the latest [s]: `step` has to be
            called twice as often.
        delay: longest time from the `step` that returns a message to the `hear` of others [s].
        lost: most messages in a row that another vehicle does not hear.
        clock_error: largest difference of two vehicles' clocks [s].
        latency: time allowed for planning a window [s]. What takes longer is not announced.
        replan_every: shortest time from one window's planning to the next [s].
        radius: radius of communication, at least `least_radius` [m]: vehicles that are not heard
            are further away. Without one all vehicles hear each other.
        planner: planner of one window.
        fallback: planner of a window if `planner` has no solution; None to go on as committed.
        solver: as for `RecedingHorizon`.
        options: as for `RecedingHorizon`.

    Attributes:
        name: of the vehicle.
        check: time from the announcement of a plan to its commitment [s].
        latency: as given.
        replan_every: as given.
        counts: of windows and plans.

    Raises:
        ScenarioError: the scenario has no separation, a requirement between vehicles, a vehicle
            that starts in motion, or what a rolling horizon does not plan for.
        ValueError: there is no such vehicle, or a setting is not possible.
    """

    @checked
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
        planner: Planner = plan_past,
        fallback: Planner | None = None,
        solver: Solver | SolverName | None = None,
        options: Options | None = None,
    ) -> None:
        index = scenario.index_of(name)
        _check_settings(
            period=period,
            delay=delay,
            lost=lost,
            clock_error=clock_error,
            latency=latency,
            replan_every=replan_every,
        )
        self._separation = _separation_of(scenario)
        self.name, self.counts = name, Counts()
        self._period, self._clock_error, self.latency = period, clock_error, latency
        self.replan_every, self.check = replan_every, delay + lost * period + clock_error
        self._grid = scenario.grid
        self._around = obstacle_around(self._separation, float(scenario.fleet.radii[index]))
        self._scenario = scenario.of_vehicles([index]).derived(separation=None)
        own = OwnWindows(self._scenario, horizon, planner, fallback, solver=solver, options=options)
        self._windows, step = own, scenario.grid.step
        window = scenario.derived(grid=own.last.plan.scenario.grid)
        error, gap = largest_radius(window), self.check + period + latency
        self._reach = float(greatest_speeds(window)[index]) * window.grid.duration
        self._plans = window.grid.duration + self.check + latency + 2.0 * step
        self._for_radius = scenario, self._plans, gap, error
        if radius is not None and not radius >= self.least_radius:
            raise ValueError(f"radius: got {radius!r}, expected {self.least_radius:g} m or more")
        forgets = np.inf if radius is None else gap
        self._others = Others(window, name, clock_error, forgets, error)
        place, start = scenario.vehicles[index].start.position, scenario.grid.start
        self._committed = SharedPlan.at_rest(place, start, step, error)
        self._announced: tuple[SharedPlan, Proposal] | None = None
        self._planned: Proposal | None = None
        self._first, self._flown = 0, np.zeros((0, 3))
        self._planned_among = self._flown_among = self._scenario
        self._number, self._sent, self._begun = 0, -np.inf, -np.inf

    @property
    def least_radius(self) -> float:
        """Least radius of communication [m]: vehicles further apart cannot come into conflict.

        Raises:
            ScenarioError: a vehicle has no limit on its speed.
        """
        return least_radius(*self._for_radius)

    @property
    def has_arrived(self) -> bool:
        """Whether the plan in force ends at the goal or, if it is a set, in it.

        No window is planned then, until more is told. A vehicle without a goal never arrives.
        """
        goal = self._scenario.vehicles[0].goal
        if goal.position is None:
            return False
        tolerance = TOLERANCE * float(self._windows.scenario.fleet.scale("position")[0])
        return is_at(goal, self._committed.knots[0][-1], self._committed.radius, tolerance)

    @property
    def flight(self) -> Plan:
        """Motion of the vehicle from the scenario's start to the end of the plan in force."""
        knot = self._first + len(self._committed.accelerations)
        scenario = self._windows.scenario.derived(
            grid=self._grid.from_knot(0, knot), obstacles=self._scenario.obstacles
        )
        scenario = scenario.derived(fleet=scenario.fleet.reaching(scenario.fleet.lengths))
        return Plan.from_accelerations(scenario, self._flown_until(knot)[None])

    def at(self, times: npt.ArrayLike) -> Samples:
        """Return what to fly: the states on the plan in force at times, arrays of shape (T, 3).

        Args:
            times: now or later [s], shape (T,), or a single one.

        Raises:
            ValueError: a time is before the plan in force.
        """
        at = np.atleast_1d(np.asarray(times, dtype=np.float64))
        begin = self._committed.start
        if not (at >= begin).all():
            raise ValueError(f"times: got {at.min():g}, expected {begin:g} s or later")
        return Samples((self.name,), at, *self._committed.states(at))

    def tell(self, scenario: Scenario) -> None:
        """Tell the scenario as it is known now: obstacles, requirements, and the vehicle's goal.

        What is new counts from the next window on. All else stays as it was given.

        Args:
            scenario: with the same vehicles.

        Raises:
            ScenarioError: a requirement is between vehicles.
            ValueError: the vehicle is not in it.
        """
        (own,) = self._scenario.vehicles
        now = scenario.of_vehicles([scenario.index_of(self.name)])
        _check_requirements(scenario)
        vehicle = unchecked(own, goal=now.vehicles[0].goal)
        changes = {"obstacles": now.obstacles, "requirements": now.requirements}
        self._scenario = self._scenario.derived(vehicles=(vehicle,), **changes)

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
        """Decide on the announced plan, announce the planned one, or plan the next.

        Planning takes long, the others do not. A plan is announced by the call after the one that
        planned it, so that messages heard in between count, and its check begins when it is sent.
        Every message that has arrived before the call has to be heard first.

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
        elif not changed and self._is_due(time):
            self._begun, self._planned = time, self._window(time)
        if not changed and time < self._sent + self._period / 2.0:
            return None
        self._number, self._sent = self._number + changed, time
        announced = self._announced and self._announced[0]
        return Message(self.name, self._number, self._committed, announced).encoded()

    def _is_due(self, time: float) -> bool:
        """Return whether the next window is to be planned: at once after news, one a step."""
        has_news = self._flown_among is not self._scenario
        if self._announced is not None or (self.has_arrived and not has_news):
            return False
        waits = 0.0 if has_news else self.replan_every
        is_flown = self._ready_knot(time) >= self._windows.last.first_knot
        return is_flown and time >= self._begun + waits

    def _window(self, time: float) -> Proposal | None:
        """Plan a window against everything that others may fly; return it if it is a new one."""
        begin = self._time_of(max(self._ready_knot(time), self._windows.last.first_knot + 1))
        obstacles = (*self._scenario.obstacles, *self._obstacles(time, begin))
        self._planned_among = self._scenario
        proposal = self._windows.among(self._scenario.derived(obstacles=obstacles), begin)
        self._count("windows")
        window = proposal.window
        return None if window.infeasible and not window.stopping else proposal

    def _ready_knot(self, time: float) -> int:
        """Return the first knot from which a window that is planned now can be flown."""
        ready = time + self.latency + self.check - self._grid.start
        return steps_lasting(ready, self._grid.step)

    def _obstacles(self, time: float, begin: float) -> list[Obstacle]:
        """Return the plans of others as obstacles of a window that begins at a time [s].

        Those that the window cannot reach do not count, nor do announced plans that conflict with
        the plan in force and will be withdrawn. The check counts the largest radius of the
        vehicle's own tube at all times, so that windows keep it as well.
        """
        found, place = list[Obstacle](), self._committed.states(np.array([begin]))[0][0]
        size = float(self._separation.shape.semi_axes.max())
        for name, message in self._others.near(time):
            for kind, plan in zip(("committed", "announced"), message.plans, strict=False):
                error = plan.radius + self._clock_error * plan.speed + self._committed.radius
                within = self._reach + size + error
                if not may_be_met(plan, begin, place, within):
                    continue
                if kind == "announced" and self._conflicts(self._committed, [plan]).any():
                    continue
                found.append(obstacle_of(f"{name} {kind}", plan, self._around, begin, error))
        return found

    def _announce(self, proposal: Proposal, time: float) -> bool:
        """Announce a window, unless it is late or conflicts by now; return whether it is.

        What others would refuse, because rounding adds up, is not announced either.
        """
        if self._time_of(proposal.window.first_knot) < time + self.check:
            return False
        own = self._shared(proposal, time)
        if self._others.violation(self.name, own) is not None:
            return False
        heard = (each for _, message in self._others.near(time) for each in message.plans)
        if self._conflicts(own, heard).any():
            return False
        self._announced = own, proposal
        self._count("announced")
        return True

    def _shared(self, proposal: Proposal, time: float) -> SharedPlan:
        """Return what is flown from now on if a window is: the plan in force, then the window."""
        now, knot, plan = self._knot_of(time), proposal.window.first_knot, proposal.window.plan
        start, before = self._time_of(now), self._committed
        state = np.concatenate(
            [each[min(now - self._first, len(each) - 1)] for each in before.knots]
        )
        accelerations = before.then(knot - self._first, plan.accelerations[0])[now - self._first :]
        radius = max(largest_radius(plan.scenario), before.radius)
        flown = SharedPlan(time, start, self._grid.step, state, accelerations, radius)
        # a window begins at its limits where the plan before exceeds them by rounding
        return flown.ending_at_rest(plan.positions[0, -1], plan.accelerations.shape[1])

    def _decide(self, own: SharedPlan, proposal: Proposal, time: float) -> None:
        """Commit to the announced plan, or withdraw it.

        It has to be clear of every plan that others have committed to, and of every one that they
        announced earlier; names decide between equal times.
        """
        self._announced, mine = None, (own.announced, self.name)
        heard = list[SharedPlan]()
        for name, message in self._others.near(time):
            heard.append(message.committed)
            other = message.announced
            if other is not None and (other.announced, name) < mine:
                heard.append(other)
        knot = proposal.window.first_knot
        if time > self._time_of(knot) or self._conflicts(own, heard).any():
            self._count("withdrawn")
            return
        self._windows.accept(proposal)
        self._flown_among = self._planned_among
        self._flown = self._flown_until(self._knot_of(own.start))
        self._first, self._committed = self._knot_of(own.start), own
        self._count("committed")

    def _conflicts(self, own: SharedPlan, others: Iterable[SharedPlan]) -> BoolArray:
        return conflicting(own, tuple(others), self._separation, self._clock_error)

    def _flown_until(self, knot: int) -> FloatArray:
        """Return the accelerations committed to until a knot [m/s²], shape (knot, 3)."""
        later = self._committed.then(max(knot - self._first, 0), np.zeros((0, 3)))
        return np.concatenate([self._flown[: self._first], later])[:knot]

    def _time_of(self, knot: int) -> float:
        """Return the time of a knot of the flight, counted from 0 [s]."""
        return self._grid.start + knot * self._grid.step

    def _knot_of(self, time: float) -> int:
        """Return the last knot that is not after a time [s]."""
        knot = int(steps_begun(time - self._grid.start, self._grid.step)) + 1
        while self._time_of(knot) > time:  # far from 0 the clock rounds differences
            knot -= 1
        return knot

    def _count(self, what: str) -> None:
        self.counts = dataclasses.replace(self.counts, **{what: getattr(self.counts, what) + 1})


def _check_settings(**settings: float) -> None:
    """Check that times and numbers are not negative, and the period is positive.

    Raises:
        ValueError: one is not.
    """
    for name, value in settings.items():
        least = "more than 0" if name == "period" else "at least 0"
        if not 0.0 <= value < np.inf or (name == "period" and value == 0.0):  # also for NaN
            raise ValueError(f"{name}: got {value!r}, expected a finite number of {least}")


def _separation_of(scenario: Scenario) -> Separation:
    """Return the separation of a scenario whose vehicles can plan for themselves.

    Raises:
        ScenarioError: they cannot.
    """
    if scenario.separation is None:
        expected = "one, which vehicles that plan for themselves keep"
        raise ScenarioError("separation", Description("none"), expected)
    _check_requirements(scenario)
    for i, vehicle in enumerate(scenario.vehicles):
        if vehicle.start.velocity.any():
            got = Description(f"{vehicle.start.velocity.tolist()} of {vehicle.name}")
            raise ScenarioError(f"vehicles[{i}].start.velocity", got, "0: vehicles begin at rest")
    return scenario.separation


def _check_requirements(scenario: Scenario) -> None:
    """Check that no requirement is between vehicles.

    Raises:
        ScenarioError: one is.
    """
    for i, each in enumerate(scenario.requirements):
        if isinstance(each.relative_to, str):
            expected = "none to another vehicle, which plans for itself"
            raise ScenarioError(f"requirements[{i}].relative_to", each.relative_to, expected)
