"""`simulate_onboard`: a fleet whose vehicles plan for themselves, in one process.

Vehicles have no common planning instants. Messages are late, lost, and not heard far away, at
random, as a `Radio` tells.
"""

from __future__ import annotations

import dataclasses
import heapq
import time as wall
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.onboard.onboard_planner import Counts, OnboardPlanner
from drake_rho.scenario.arguments import checked, passes_to
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_begun

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


class _Places:
    """Places of all vehicles, whose accelerations are constant in each step of a common grid."""

    def __init__(self, planners: list[OnboardPlanner], grid: Grid) -> None:
        self._planners, self._grid = planners, grid
        self._step, self._since, self._states = -1, grid.start, np.zeros((0, 3, 3))

    def at(self, time: float) -> FloatArray:
        """Return the places at a time that is not before the last one [m], shape (N, 3)."""
        step = int(steps_begun(time - self._grid.start, self._grid.step))
        if step != self._step:
            every = [each.at(time) for each in self._planners]
            states = [(each.positions, each.velocities, each.accelerations) for each in every]
            self._step, self._since, self._states = step, time, np.array(states)[:, :, 0]
        p, v, a = self._states.swapaxes(0, 1)
        elapsed = time - self._since
        places: FloatArray = p + elapsed * (v + elapsed / 2.0 * a)
        return places


class _Loops:
    """Loops of all vehicles, and the messages between them that are under way."""

    def __init__(
        self,
        planners: list[OnboardPlanner],
        radio: Radio,
        rng: np.random.Generator,
        tick: float,
        sees: Sees | None,
        grid: Grid,
    ) -> None:
        self.planners, self._radio, self._rng, self._tick = planners, radio, rng, tick
        self._sees, self._places = sees, _Places(planners, grid)
        self.seconds: list[list[float]] = [[] for _ in planners]
        # Kept up to date: to ask all planners in every turn takes long in a large fleet.
        self._travelling = {i for i, each in enumerate(planners) if not each.has_arrived}
        self._lost_in_a_row = np.zeros((len(planners), len(planners)), dtype=np.int64)
        self._events: list[tuple[float, int, int, bytes]] = []
        self._count = 0

    def add(self, time: float, index: int, data: bytes = b"") -> None:
        """Add a turn of a vehicle's loop, or the arrival of a message, at a time [s]."""
        self._count += 1
        heapq.heappush(self._events, (time, self._count, index, data))

    def run(self, until: float) -> None:
        """Run all loops until all vehicles fly to their goals, or rest there if they see.

        They end at a time [s] at the latest.
        """
        while self._events[0][0] <= until:
            now, _, index, data = heapq.heappop(self._events)
            if data:
                self.planners[index].hear(data, now)
            elif not self._travelling:
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
        if sent is not None or self._sees is not None:
            there = planner.has_arrived and self._may_stop_looking(planner, now)
            (self._travelling.discard if there else self._travelling.add)(index)
        if sent is not None:
            for other, delay in self._hearers(index, now):
                self.add(now + delay, other, sent)

    def _may_stop_looking(self, planner: OnboardPlanner, now: float) -> bool:
        """Return whether nothing is seen any more on the way to the goal."""
        return self._sees is None or not planner.at(now).velocities.any()

    def _hearers(self, sender: int, now: float) -> Iterator[tuple[int, float]]:
        """Yield who hears a message that is sent now, and how late [s]."""
        radio, row = self._radio, self._lost_in_a_row[sender]
        late, luck = self._rng.uniform(size=(2, len(row)))
        hears = np.arange(len(row)) != sender
        if radio.radius is not None:
            places = self._places.at(now)
            hears &= np.linalg.norm(places - places[sender], axis=1) <= radio.radius
        is_lost = (luck < radio.loss) & (row < (np.inf if radio.lost is None else radio.lost))
        row[hears] = np.where(is_lost, row + 1, 0)[hears]
        for other in np.flatnonzero(hears & ~is_lost).tolist():
            yield other, radio.delay * float(late[other])


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
    loops = _Loops(planners, radio, rng, tick, sees, scenario.grid)
    begin = scenario.grid.start
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
