"""RMADER's circle: ten vehicles that plan for themselves swap places while messages are late."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.sampling import sample
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

DELAYS = (0.0, 0.05, 0.1, 0.2, 0.3)
"""Longest delays of messages [s]."""

VEHICLES, RADIUS, SEPARATION = 10, 10.0, 0.25
"""Number of vehicles, radius of their circle [m], and the distance below which two collide [m]."""

LATENCY = 0.3
"""Time that vehicles allow for planning a window [s]."""

RATE = 1000.0
"""Samples by which distances are measured [Hz]."""

LONGEST_TRAVEL = 9.7
"""RMADER's shortest mean travel time, with the smallest delay [s]."""

COLUMNS = (
    "longest delay [s]",
    "flights",
    "without a collision",
    "least distance [m]",
    "arrived",
    "mean travel time [s]",
    "largest travel time [s]",
    "windows of a vehicle",
    "plans withdrawn",
    "median ms of a window",
    "99 % ms of a window",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One flight."""

    distance: float
    """least distance of two vehicles, by samples [m]"""
    travel: FloatArray
    """travel times [s], NaN for vehicles that did not arrive, shape (N,)"""
    windows: int
    """windows planned by all vehicles"""
    announced: int
    """plans announced by all vehicles"""
    withdrawn: int
    """plans withdrawn by all vehicles"""
    seconds: FloatArray
    """wall time of each window [s]"""


def circle() -> rho.Scenario:
    """Return vehicles on a circle, each with a goal on the opposite side."""
    angles = 2.0 * np.pi * np.arange(VEHICLES) / VEHICLES
    rows = [RADIUS * np.array([np.cos(each), np.sin(each), 0.0]) for each in angles]
    up = np.array([0.0, 0.0, 1.0])
    return rho.Scenario(
        "circle",
        rho.Grid(step=0.2, knots=16),
        [
            rho.Vehicle(f"q{i}", rho.State(row + up), rho.State(up - row), radius=0.1)
            for i, row in enumerate(rows)
        ],
        rho.Limits(max_speed=10.0, max_acceleration=20.0, max_jerk=30.0),
        separation=rho.Separation(SEPARATION),
    )


def run(seeds: int = 20) -> Table:
    """Fly the circle with every delay, as many times as given, on all cores."""
    laps = {
        delay: on_all_cores(partial(fly, delay), range(seeds), f"circle, {delay:g} s")
        for delay in DELAYS
    }
    every = [lap for each in laps.values() for lap in each]
    slowest = max(float(np.mean([np.mean(lap.travel) for lap in each])) for each in laps.values())
    return Table(
        name="online_circle",
        title="A circle of vehicles that plan for themselves",
        columns=COLUMNS,
        rows=tuple(_row(delay, each) for delay, each in laps.items()),
        notes=(_WORK,),
        goals=(
            Goal("flights with a collision", 0, sum(not _is_clear(lap) for lap in every)),
            Goal(
                "largest mean travel time of a delay [s]",
                LONGEST_TRAVEL,
                slowest if math.isfinite(slowest) else math.inf,
            ),
        ),
    )


def fly(delay: float, seed: int) -> Lap:
    """Return one flight of the circle."""
    rng = np.random.default_rng([99, round(1000 * delay), seed])
    radio = rho.Radio(delay=delay)
    options = rho.Options(time_limit=LATENCY)
    flown = rho.simulate_onboard(
        circle(), radio, duration=30.0, rng=rng, latency=LATENCY, options=options, solver="daqp"
    )
    return Lap(
        sample(flown.plan, round(RATE * flown.plan.scenario.grid.step)).least,
        flown.arrivals,
        sum(each.windows for each in flown.counts),
        sum(each.announced for each in flown.counts),
        sum(each.withdrawn for each in flown.counts),
        np.concatenate(flown.seconds),
    )


def _is_clear(lap: Lap) -> bool:
    return lap.distance >= SEPARATION * (1.0 - 1e-6)


def _row(delay: float, laps: list[Lap]) -> tuple[Cell, ...]:
    travel = np.concatenate([each.travel for each in laps])
    seconds = np.concatenate([each.seconds for each in laps])
    announced = sum(each.announced for each in laps)
    return (
        delay,
        len(laps),
        sum(map(_is_clear, laps)),
        min(each.distance for each in laps),
        f"{np.isfinite(travel).sum()} of {len(travel)}",
        float(np.nanmean(travel)),
        float(np.nanmax(travel)),
        sum(each.windows for each in laps) / len(travel),
        f"{100 * sum(each.withdrawn for each in laps) / max(announced, 1):.0f} %",
        1000.0 * float(np.median(seconds)),
        1000.0 * float(np.quantile(seconds, 0.99)),
    )


_WORK = f"""\
Each vehicle runs one `OnboardPlanner`, with a horizon of 3 s and steps of 0.2 s, at random
instants of its own; planning takes up to {LATENCY:g} s of the simulated time, and messages up to
the longest delay. Distances are of samples at {RATE:g} Hz. Limits are 10 m/s, 20 m/s² and 30 m/s³,
of norms. RMADER (arXiv:2303.06222) reports 10 vehicles on such a
circle without a collision, with mean travel times from {LONGEST_TRAVEL:g} s, and 83 % of flights
without a collision for MADER. A window has {1000 * LATENCY:g} ms of wall time, with the best
plan found so far or none afterwards: travel times depend on the computer. The time is looked at
between programs, so windows last longer than that (see their quantile), which the simulated time
does not count."""
