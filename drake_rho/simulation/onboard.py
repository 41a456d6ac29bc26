"""`simulate_onboard`: a fleet whose vehicles plan for themselves, in one process.

Vehicles have no common planning instants. Messages are late, lost, and not heard far away, at
random, as a `Radio` tells.
"""

from __future__ import annotations

import dataclasses
import heapq
import time as wall
from collections.abc import Callable
from typing import Any

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.onboard.onboard_planner import Counts, OnboardPlanner
from drake_rho.scenario.arguments import checked, passes_to
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.records import Scenario

Sees = Callable[[str, float, FloatArray], Scenario | None]
"""Function of a vehicle's name, the time [s] and its position [m], shape (3,), which returns the
scenario as the vehicle knows it now, or None for no news."""


@dataclasses.dataclass(frozen=True)
class Radio(metaclass=Described):
    """What happens to messages between vehicles.

    Raises:
        ValueError: a value is negative, or the loss is more than 1.
    """

    delay: float = 0.0
    """longest delay of a message [s]; delays are random, from 0 on"""
    loss: float = 0.0
    """probability with which a message is lost"""
    lost: int | None = 0
    """most messages in a row from one vehicle to another that are lost; None for any number"""
    radius: float | None = None
    """greatest distance at which vehicles hear each other [m]; any if not given"""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value, most = getattr(self, field.name), 1.0 if field.name == "loss" else np.inf
            if value is not None and not 0.0 <= value <= most:
                expected = f"a number from 0 to {most:g}"
                raise ValueError(f"{field.name}: got {value!r}, expected {expected}")


@dataclasses.dataclass(frozen=True, eq=False)
class OnboardFlight(metaclass=Described):
    """What a fleet flew whose vehicles planned for themselves."""

    plan: Plan
    """motions of all vehicles, which `verify`, figures and files take as any other plan; vehicles
    that did not arrive have no goal"""
    arrivals: FloatArray
    """times at which vehicles arrived at their goals [s], shape (N,); NaN for those that did not"""
    counts: tuple[Counts, ...]
    """what each vehicle did"""
    seconds: tuple[FloatArray, ...]
    """wall time of planning each window of each vehicle [s], shape (M,) each"""


class _Loops:
    """Loops of all vehicles, and the messages between them that are under way."""

    def __init__(
        self,
        planners: list[OnboardPlanner],
        radio: Radio,
        rng: np.random.Generator,
        tick: float,
        sees: Sees | None,
    ) -> None:
        self.planners, self._radio, self._rng, self._tick = planners, radio, rng, tick
        self._sees = sees
        self.seconds: list[list[float]] = [[] for _ in planners]
        self._lost_in_a_row = dict[tuple[int, int], int]()
        self._events: list[tuple[float, int, int, bytes]] = []
        self._count = 0

    def add(self, time: float, index: int, data: bytes = b"") -> None:
        """Add a turn of a vehicle's loop, or the arrival of a message, at a time [s]."""
        self._count += 1
        heapq.heappush(self._events, (time, self._count, index, data))

    def run(self, until: float) -> None:
        """Run all loops until all vehicles have arrived, or until a time [s]."""
        while self._events[0][0] <= until:
            now, _, index, data = heapq.heappop(self._events)
            if data:
                self.planners[index].hear(data, now)
            elif all(each.has_arrived for each in self.planners):
                break
            else:
                self._turn(index, now)

    def _turn(self, index: int, now: float) -> None:
        """Take one turn of a vehicle's loop; planning takes a part of the time allowed for it."""
        planner = self.planners[index]
        if self._sees is not None:
            news = self._sees(planner.name, now, planner.at(now).positions[0])
            if news is not None:
                planner.tell(news)
        started = wall.perf_counter()
        windows, later = planner.counts.windows, now + self._tick * self._rng.uniform(0.5, 1.5)
        sent = planner.step(now)
        if planner.counts.windows > windows:
            self.seconds[index].append(wall.perf_counter() - started)
            later += planner.latency * self._rng.uniform()
        self.add(float(later), index)
        if sent is not None:
            for other in range(len(self.planners)):
                if other != index and (delay := self._delay(index, other, now)) is not None:
                    self.add(now + delay, other, sent)

    def _delay(self, sender: int, receiver: int, now: float) -> float | None:
        """Return how late a message arrives [s]; None if it does not."""
        radio, both = self._radio, (sender, receiver)
        late, luck = self._rng.uniform(0.0, radio.delay), self._rng.uniform()
        places = [self.planners[each].at(now).positions[0] for each in both]
        if radio.radius is not None and np.linalg.norm(places[0] - places[1]) > radio.radius:
            return None
        lost = self._lost_in_a_row.get(both, 0)
        is_lost = luck < radio.loss and (radio.lost is None or lost < radio.lost)
        self._lost_in_a_row[both] = lost + 1 if is_lost else 0
        return None if is_lost else float(late)


@checked
@passes_to(OnboardPlanner)
def simulate_onboard(
    scenario: Scenario,
    radio: Radio | None = None,
    *,
    duration: float,
    rng: np.random.Generator,
    tick: float = 0.01,
    sees: Sees | None = None,
    **settings: Any,
) -> OnboardFlight:
    """Fly a fleet whose vehicles plan for themselves.

    Every vehicle runs the loop of an `OnboardPlanner` at random instants of its own, and flies the
    plans to which it commits itself exactly. The flight ends when all have arrived.

    Args:
        scenario: of all vehicles, at rest at their starts.
        radio: what happens to messages; all are heard at once if not given.
        duration: longest time to be simulated [s].
        rng: source of instants, delays and losses.
        tick: mean time from one turn of a vehicle's loop to the next [s].
        sees: function that tells what a vehicle sees in flight, given its name, the time [s] and
            its position [m]: the scenario as it is known then, for `OnboardPlanner.tell`, or None
            for no news. The plan returned has the obstacles known at first.
        **settings: of every `OnboardPlanner`. `delay`, `lost` and `radius` are those of the radio
            unless they are given, and then what the vehicles believe.

    Raises:
        ScenarioError: vehicles of the scenario cannot plan for themselves.
        ValueError: a setting is not a possible one.
    """
    radio = radio or Radio()
    believed = {"delay": radio.delay, "lost": radio.lost or 0, "radius": radio.radius}
    planners = [OnboardPlanner(scenario, name, **(believed | settings)) for name in scenario.names]
    loops, begin = _Loops(planners, radio, rng, tick, sees), scenario.grid.start
    for index, planner in enumerate(planners):
        loops.add(begin + float(rng.uniform(0.0, planner.replan_every)), index)
    loops.run(begin + duration)
    return _flown(scenario, planners, loops.seconds)


def _flown(
    scenario: Scenario, planners: list[OnboardPlanner], seconds: list[list[float]]
) -> OnboardFlight:
    """Return what a fleet flew, until all its plans have ended."""
    flights = [each.flight for each in planners]
    steps = max(each.accelerations.shape[1] for each in flights)
    accelerations = np.zeros((len(flights), steps, 3))
    for own, each in zip(accelerations, flights, strict=True):
        own[: each.accelerations.shape[1]] = each.accelerations[0]
    lengths = np.array([float(each.scenario.fleet.lengths[0]) for each in flights])
    vehicles = tuple(
        vehicle if planner.has_arrived else unchecked(vehicle, goal=Goal(None))
        for vehicle, planner in zip(scenario.vehicles, planners, strict=True)
    )
    whole = scenario.derived(grid=scenario.grid.from_knot(0, steps), vehicles=vehicles)
    plan = Plan.from_accelerations(
        whole.derived(fleet=whole.fleet.reaching(lengths)), accelerations
    )
    arrived = np.array([each.has_arrived for each in planners])
    return OnboardFlight(
        plan,
        np.where(arrived, plan.arrivals, np.nan),
        tuple(each.counts for each in planners),
        tuple(np.array(each) for each in seconds),
    )
