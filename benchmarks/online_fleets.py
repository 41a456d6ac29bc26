"""Fleets of 16 to 128 vehicles that plan for themselves and hear only those that are near."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.sampling import sample
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

SIZES = (16, 32, 64, 128)
"""Numbers of vehicles."""

SPEED, ACCELERATION, SEPARATION, RADIUS = 2.0, 4.0, 0.8, 0.3
"""Limits [m/s], [m/s²], distance below which two vehicles collide, and a vehicle's radius [m]."""

STEP, TICK, HORIZON, LATENCY, LONGEST = 0.2, 0.02, 2.0, 0.1, 40.0
"""Step of the grid, mean time between turns of a vehicle's loop, time that windows plan ahead, time
allowed for planning one, and longest flight [s]."""

DELAY, LOSS, LOST = 0.05, 0.05, 2
"""Longest delay of messages [s], share of them that is lost, and most in a row that are."""

SPACING, TRAVEL, PILLAR, AROUND, SEEN = 8.0, 20.0, 0.75, 2.5, 10.0
"""Side of the square that each vehicle has, usual distance of its goal, radius of a pillar, least
distance of starts and pillars from each other, and distance within which pillars are seen [m]."""

TOO_NEAR = 1.5, 1.0
"""Radii of communication of counterexamples, in longest ways of a plan."""

PER_STEP = round(1000 * STEP)
"""Samples of every step: 1 kHz."""

_TOLERANCE = 1e-6
"""Largest violation that counts as none, in SI units."""

COLUMNS = (
    "scene",
    "vehicles",
    "radius of communication [m]",
    "others within it",
    "flights",
    "without a collision",
    "least distance beyond the separation [m]",
    "nearest pillar beyond the radius [m]",
    "arrived",
    "mean travel time [s]",
    "windows of a vehicle",
    "plans withdrawn",
    "processor ms of a window, with all else",
    "median ms of a window",
    "99 % ms of a window",
    "processor time of a vehicle [s]",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One flight."""

    radius: float
    """radius of communication [m]"""
    others: float
    """mean number of others within it"""
    apart: float
    """least distance of two vehicles beyond the separation, by samples [m]"""
    clear: float
    """least distance from a pillar beyond a vehicle's radius, by samples [m]"""
    travel: FloatArray
    """travel times [s], NaN for vehicles that did not arrive, shape (N,)"""
    announced: int
    """plans announced by all vehicles"""
    withdrawn: int
    """plans withdrawn by all vehicles"""
    seconds: FloatArray
    """wall time of each window [s]"""
    processor: float
    """processor time of the whole flight [s]"""

    @property
    def holds(self) -> bool:
        """Whether nothing collides."""
        return min(self.apart, self.clear) >= -_TOLERANCE


@dataclasses.dataclass(frozen=True)
class Series:
    """Flights of one kind of scene."""

    scene: str
    """name of the scene"""
    vehicles: int
    """number of vehicles"""
    world: Callable[[int, np.random.Generator], rho.Scenario]
    """function that returns a random scene with a number of vehicles"""
    horizon: float = HORIZON
    """time that windows plan ahead [s]"""
    replan_every: float = 0.5
    """shortest time from one window's planning to the next [s]"""
    plans: float | None = None
    """radius of communication, in longest ways of a plan; the least safe one if not given"""


def forest(count: int, rng: np.random.Generator) -> rho.Scenario:
    """Return vehicles that take each other's places among pillars, as dense for every number."""
    side = SPACING * math.sqrt(count)
    places: list[FloatArray] = []
    while len(places) < count + count // 2:
        place = rng.uniform(0.0, side, 2)
        if all(np.linalg.norm(place - each) >= AROUND for each in places):
            places.append(place)
    starts = np.array(places[:count])
    distances = np.linalg.norm(starts[:, None] - starts, axis=2)
    goals = starts[linear_sum_assignment((distances - TRAVEL) ** 2)[1]]
    pillars = tuple(rho.Cylinder([*each, 0.0], PILLAR) for each in places[count:])
    return _scenario(starts, goals, pillars)


def head_on(count: int, _: np.random.Generator, apart: float = 9.8) -> rho.Scenario:
    """Return pairs that swap places, so many metres apart and far from all others."""
    lanes = 100.0 * np.arange(count // 2)
    ends = np.full(count // 2, apart / 2.0)
    starts = np.concatenate([np.stack([-ends, lanes], 1), np.stack([ends, lanes], 1)])
    return _scenario(starts, starts * [-1.0, 1.0])


def _scenario(
    starts: FloatArray, goals: FloatArray, obstacles: tuple[rho.Cylinder, ...] = ()
) -> rho.Scenario:
    """Return vehicles that fly between places on the ground, shape (N, 2), up to 2 m above it."""
    low, high = starts.min(axis=0) - SPACING, starts.max(axis=0) + SPACING
    vehicles = [
        rho.Vehicle(f"q{i}", rho.State([*start, 1.0]), rho.State([*goal, 1.0]), radius=RADIUS)
        for i, (start, goal) in enumerate(zip(starts, goals, strict=True))
    ]
    return rho.Scenario(
        "fleet",
        rho.Grid(STEP, 1 + round(HORIZON / STEP)),
        vehicles,
        rho.Limits(
            max_speed=SPEED,
            max_acceleration=ACCELERATION,
            position=rho.Box([*low, 0.0], [*high, 2.0]),
        ),
        obstacles=obstacles,
        separation=rho.Separation(SEPARATION),
    )


_PAIRS = partial(Series, "head-on", 32, horizon=4.0, replan_every=4.0)

FLOWN = (
    *(Series("forest", size, forest) for size in SIZES),
    Series("forest", 64, forest, plans=TOO_NEAR[0]),
    _PAIRS(world=head_on),
    _PAIRS(world=partial(head_on, apart=14.5), plans=TOO_NEAR[0]),
    _PAIRS(world=head_on, plans=TOO_NEAR[1]),
)
"""Series of the table."""


class Eyes:
    """Pillars of a scene that every vehicle has seen."""

    def __init__(self, scenario: rho.Scenario) -> None:
        self._scenario = scenario
        pillars = (each for each in scenario.obstacles if isinstance(each, rho.Cylinder))
        self._axes = np.array([each.center[:2] for each in pillars]).reshape(-1, 2)
        self._known = np.zeros((len(scenario.vehicles), len(self._axes)), dtype=bool)

    def look(self, name: str, time: float, place: FloatArray) -> rho.Scenario | None:
        """Return the scenario as a vehicle knows it; None without news."""
        known = self._known[self._scenario.index_of(name)]
        new = ~known & (np.linalg.norm(self._axes - place[:2], axis=1) < SEEN)
        known |= new
        if not new.any():
            return None
        obstacles = tuple(self._scenario.obstacles[i] for i in np.flatnonzero(known))
        return dataclasses.replace(self._scenario, obstacles=obstacles)


def run(seeds: int = 4) -> Table:
    """Fly every series, as many times as given, on all cores."""
    laps = [
        on_all_cores(partial(fly, each), range(seeds), f"{each.scene}, {each.vehicles}", at_once=1)
        for each in FLOWN
    ]
    rows = tuple(_row(each, found) for each, found in zip(FLOWN, laps, strict=True))
    safe = [
        lap for each, found in zip(FLOWN, laps, strict=True) if each.plans is None for lap in found
    ]
    few, many = (_processor(laps[i]) for i in (0, len(SIZES) - 1))
    return Table(
        name="online_fleets",
        title="Fleets whose vehicles hear only those that are near",
        columns=COLUMNS,
        rows=rows,
        notes=(_WORK,),
        goals=(
            Goal("flights with a collision, least radius", 0, sum(not lap.holds for lap in safe)),
            Goal("processor time of a window, 128 vehicles over 16", 1.2, many / few),
        ),
    )


def fly(series: Series, seed: int) -> Lap:
    """Return one flight of a series."""
    rng = np.random.default_rng([97, series.vehicles, seed])
    scenario = series.world(series.vehicles, rng)
    settings: dict[str, Any] = {
        "horizon": series.horizon,
        "latency": LATENCY,
        "replan_every": series.replan_every,
        "solver": "daqp",
    }
    planner = rho.OnboardPlanner(scenario, "q0", delay=DELAY, lost=LOST, **settings)
    radius = planner.least_radius
    settings["radius"] = radius  # what the vehicles believe, whatever the radio has
    if series.plans is not None:
        longest = series.horizon + planner.check + LATENCY + 2.0 * STEP
        radius = series.plans * SPEED * longest
    began = time.process_time()
    flown = rho.simulate_onboard(
        dataclasses.replace(scenario, obstacles=()),
        rho.Radio(DELAY, LOSS, LOST, radius),
        duration=LONGEST,
        tick=TICK,
        rng=rng,
        sees=Eyes(scenario).look,
        **settings,
    )
    processor = time.process_time() - began
    world = dataclasses.replace(flown.plan.scenario, obstacles=scenario.obstacles)
    found = sample(rho.Plan.from_accelerations(world, flown.plan.accelerations), PER_STEP)
    near = [
        (np.linalg.norm(each[:, None] - each, axis=2) <= radius).sum()
        for each in flown.plan.positions.swapaxes(0, 1)
    ]
    return Lap(
        radius,
        float(np.mean(near)) / series.vehicles - 1.0,
        found.least - SEPARATION,
        found.clearance,
        flown.arrivals,
        sum(each.announced for each in flown.counts),
        sum(each.withdrawn for each in flown.counts),
        np.concatenate(flown.seconds),
        processor,
    )


def _processor(laps: list[Lap]) -> float:
    """Return the processor time of flights over the number of windows [s]."""
    return sum(each.processor for each in laps) / sum(len(each.seconds) for each in laps)


def _row(series: Series, laps: list[Lap]) -> tuple[Cell, ...]:
    travel = np.concatenate([each.travel for each in laps])
    seconds = np.concatenate([each.seconds for each in laps])
    announced = sum(each.announced for each in laps)
    clear = min(each.clear for each in laps)
    return (
        series.scene,
        series.vehicles,
        float(f"{laps[0].radius:.3g}"),
        float(np.mean([each.others for each in laps])),
        len(laps),
        sum(each.holds for each in laps),
        float(f"{min(each.apart for each in laps):.2g}"),
        float(f"{clear:.2g}") if math.isfinite(clear) else None,
        f"{np.isfinite(travel).sum()} of {len(travel)}",
        float(np.nanmean(travel)),
        len(seconds) / len(travel),
        f"{100 * sum(each.withdrawn for each in laps) / max(announced, 1):.0f} %",
        1000.0 * _processor(laps),
        1000.0 * float(np.median(seconds)),
        1000.0 * float(np.quantile(seconds, 0.99)),
        sum(each.processor for each in laps) / len(travel),
    )


_WORK = f"""\
Worlds in the manner of R3R (arXiv:2510.06436). In a forest there is one vehicle for {SPACING:g} m
by {SPACING:g} m, and half as many pillars with a radius of {PILLAR:g} m, seen within {SEEN:g} m;
goals are starts of others, some {TRAVEL:g} m away. Each vehicle runs one `OnboardPlanner` with
steps of {STEP:g} s and a horizon of {HORIZON:g} s, and takes up to {LATENCY:g} s of the simulated
time for a window, whatever it takes in truth. Limits are {SPEED:g} m/s and {ACCELERATION:g} m/s²,
of norms. Messages are up to {DELAY:g} s late; {100 * LOSS:g} % are lost at random, at most {LOST}
in a row, and none is heard beyond the radius. It is `OnboardPlanner.least_radius` or, as
counterexamples, {" and ".join(f"{each:g}" for each in TOO_NEAR)} times the longest way of a plan,
its duration at the greatest speed, while vehicles believe in the least radius. Pairs that meet
head-on plan a window of 4 s every 4 s, so they fly plans to their ends, and begin a little further
apart than the shorter radius. Distances are of accelerations integrated anew, at 1 kHz. At the
edges of a world vehicles have fewer others around them, which matters for small fleets. The
processor time is that of the whole simulation, with all messages, over the number of windows or of
vehicles; other times of windows are wall times."""
