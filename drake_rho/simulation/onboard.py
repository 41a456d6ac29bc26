"""`simulate_onboard`: a fleet whose vehicles plan for themselves, in one process.

Vehicles have no common planning instants. Messages are late, lost, and not heard far away, at
random, as a `Radio` tells.
"""

from __future__ import annotations

import dataclasses
import heapq
import time as wall
from typing import Any

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.planning.onboard.onboard_planner import Counts, OnboardPlanner
from drake_rho.scenario.fields import FloatArray, unchecked
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting


@dataclasses.dataclass(frozen=True)
class Radio:
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
class OnboardFlight:
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


class _Air:
    """Messages that are under way, and when they arrive."""

    def __init__(self, radio: Radio, rng: np.random.Generator) -> None:
        self._radio, self._rng = radio, rng
        self._lost_in_a_row = dict[tuple[int, int], int]()

    def delay(self, sender: int, receiver: int, distance: float) -> float | None:
        """Return how late a message arrives [s]; None if it does not."""
        radio, both = self._radio, (sender, receiver)
        late, luck = self._rng.uniform(0.0, radio.delay), self._rng.uniform()
        if radio.radius is not None and distance > radio.radius:
            return None
        lost = self._lost_in_a_row.get(both, 0)
        is_lost = luck < radio.loss and (radio.lost is None or lost < radio.lost)
        self._lost_in_a_row[both] = lost + 1 if is_lost else 0
        return None if is_lost else float(late)


def simulate_onboard(
    scenario: Scenario,
    radio: Radio | None = None,
    *,
    duration: float,
    rng: np.random.Generator,
    tick: float = 0.01,
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
        **settings: of every `OnboardPlanner`. `delay`, `lost` and `radius` are those of the radio
            unless they are given, and then what the vehicles believe.

    Raises:
        ScenarioError: vehicles of the scenario cannot plan for themselves.
        ValueError: a setting is not a possible one.
    """
    radio = radio or Radio()
    believed = {"delay": radio.delay, "lost": radio.lost or 0, "radius": radio.radius}
    planners = [OnboardPlanner(scenario, name, **(believed | settings)) for name in scenario.names]
    begin, air = scenario.grid.start, _Air(radio, rng)
    turns = rng.uniform(0.0, settings.get("replan_every", 0.1), len(planners))
    events: list[tuple[float, int, int, bytes]]
    events = [(begin + turn, i, i, b"") for i, turn in enumerate(turns.tolist())]
    seconds, count = [list[float]() for _ in planners], len(events)
    heapq.heapify(events)
    while events and events[0][0] <= begin + duration:
        now, _, index, data = heapq.heappop(events)
        planner = planners[index]
        if data:
            planner.hear(data, now)
            continue
        if all(each.has_arrived for each in planners):
            break
        windows, started = planner.counts.windows, wall.perf_counter()
        sent, later = planner.step(now), now + tick * rng.uniform(0.5, 1.5)
        if planner.counts.windows > windows:
            seconds[index].append(wall.perf_counter() - started)
            later += settings.get("latency", 0.0) * rng.uniform()
        heapq.heappush(events, (later, count, index, b""))
        count += 1
        for other in range(len(planners)) if sent else ():
            away = float(np.linalg.norm(_place(planner, now) - _place(planners[other], now)))
            delay = None if other == index else air.delay(index, other, away)
            if delay is not None:
                heapq.heappush(events, (now + delay, count, other, sent))
                count += 1
    return _flown(scenario, planners, seconds)


def _place(planner: OnboardPlanner, time: float) -> FloatArray:
    place: FloatArray = planner.at(time).positions[0]
    return place


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
    grid = scenario.grid.from_knot(
        0, max(steps, steps_lasting(scenario.grid.step, scenario.grid.step))
    )
    whole = scenario.derived(grid=grid, vehicles=vehicles)
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
