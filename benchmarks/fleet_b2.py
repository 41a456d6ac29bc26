"""One vehicle in every cubic metre, from twenty vehicles to two hundred, and a thousand."""

from __future__ import annotations

import statistics
from functools import partial
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.fleets import COLUMNS, attempts, findings, percent, summary
from benchmarks.tables import Cell, Goal, Table

VEHICLES, DURATION = tuple(range(20, 201, 20)), 15.0
"""Sizes, and the flight time of each [s]."""

LARGEST, LONGER = 1000, 20.0
"""Size that is planned once, and its flight time [s]."""

STEP = 0.2
"""Step h [s]."""

PUBLISHED = (100.0, 100.0, 100.0, 96.0, 94.0, 74.0, 66.0, 62.0, 40.0, 28.0)
"""Published success of DMPC [%]."""

SECONDS = {20: 6.0, 200: 178.0}
"""Published times of DMPC [s], as far as known."""


def scenario(vehicles: int, seed: int, duration: float) -> rho.Scenario:
    """Return one draw."""
    return rho.random_transitions(
        vehicles,
        np.random.default_rng(seed),
        volume=rho.flight_cube(float(vehicles)),
        duration=duration,
        step=STEP,
        name=f"{vehicles} vehicles, seed {seed}",
    )


def run(seeds: int = 10, stores: Path | None = None) -> Table:
    """Plan `seeds` fleets of each size, and one of a thousand.

    `stores` is that of `attempts`.
    """
    found = {
        count: attempts(
            [partial(scenario, count, seed, DURATION) for seed in range(seeds)],
            f"B2, {count}",
            stores=stores,
        )
        for count in VEHICLES
    }
    alone = [partial(scenario, LARGEST, 0, LONGER)]
    found[LARGEST] = attempts(alone, f"B2, {LARGEST}", stores=stores)
    rows: list[tuple[Cell, ...]] = []
    for count, trials in found.items():
        rows.append(summary(trials))
        if count in VEHICLES:
            rows.append(_published(count))
    dense, (largest,) = found[VEHICLES[-1]], found[LARGEST]
    median = statistics.median(trial.seconds for trial in dense)
    return Table(
        name="fleet_b2",
        title="B2: one vehicle in every cubic metre",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(
            findings([trial for trials in found.values() for trial in trials]),
            _WORK,
            _LIMITATIONS,
        ),
        goals=(
            Goal(f"{VEHICLES[-1]} vehicles, failures [%]", 0.0, 100.0 - percent(dense)),
            Goal(f"{VEHICLES[-1]} vehicles, median [s]", 10.0, median),
            Goal(f"{LARGEST} vehicles, failures", 0.0, float(not largest.counts)),
            Goal(f"{LARGEST} vehicles, time [s]", 60.0, largest.seconds),
            Goal(f"{LARGEST} vehicles, memory [MB]", 4000.0, largest.megabytes),
        ),
    )


def _published(count: int) -> tuple[Cell, ...]:
    success = PUBLISHED[VEHICLES.index(count)]
    nothing = [None] * (len(COLUMNS) - 6)
    return (count, "DMPC, published", 50, success, None, SECONDS.get(count), *nothing)


_WORK = """\
The second series of Luis and Schoellig (carlosluis/multiagent_planning, `failure_rate.m`): as B1
(see `fleet_b1` for the criteria, the times and the procedure), but in a cube of N m³, in which
every fleet of up to two hundred has 15 s and that of a thousand 20 s. A fleet of seed s is
`random_transitions(N, default_rng(s), volume=flight_cube(N), duration=T)`."""

_LIMITATIONS = """\
Limitations. DMPC's lines are quoted: flight times of up to 30 s, violations of 5 cm allowed,
MATLAB on another machine. A version of it in C++ is published to plan a hundred vehicles in 4.2 s
on eight clusters, and in 12.4 s on one. The thousand are one draw."""
