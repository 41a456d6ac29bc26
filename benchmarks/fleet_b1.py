"""Random transitions in 4 m³ in the published flight times of distributed MPC."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.fleets import COLUMNS, Trial, attempts, findings, percent, summary
from benchmarks.tables import Cell, Goal, Table

DURATIONS = {4: 3.6, 8: 4.6, 12: 6.6, 16: 8.6, 20: 9.8}
"""Published flight times of DMPC [s], rounded up to whole steps, by the number of vehicles."""

STEP = 0.2
"""Step h [s]."""

PUBLISHED = {
    "SCP, published": ((100, 100, 100, 100, 100), (0.13, 1.38, 16.5, 114.0, 345.0)),
    "decoupled iSCP, published": ((100, 92, 66, 42, 18), (0.07, 0.59, 4.36, 39.8, 67.0)),
    "DMPC, published": ((100, 100, 100, 96, 96), (0.63, 1.80, 3.64, 5.98, 9.57)),
}
"""Published success [%] and times [s], from 4 vehicles to 20."""


def scenario(vehicles: int, seed: int) -> rho.Scenario:
    """Return one draw."""
    rng, duration = np.random.default_rng(seed), DURATIONS[vehicles]
    name = f"{vehicles} vehicles, seed {seed}"
    return rho.random_transitions(vehicles, rng, duration=duration, step=STEP, name=name)


def run(seeds: int = 50, stores: Path | None = None) -> Table:
    """Plan `seeds` fleets of each size; `stores` is that of `attempts`."""
    found = {
        count: attempts(
            [partial(scenario, count, seed) for seed in range(seeds)], f"B1, {count}", stores=stores
        )
        for count in DURATIONS
    }
    rows: list[tuple[Cell, ...]] = []
    for count, trials in found.items():
        rows.append(summary(trials))
        rows += [_published(method, count) for method in PUBLISHED]
    every = [trial for trials in found.values() for trial in trials]
    return Table(
        name="fleet_b1",
        title="B1: random transitions in 4 m³, up to 20 vehicles",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(findings(every), _WORK, _LIMITATIONS),
        goals=_goals(found),
    )


def _published(method: str, count: int) -> tuple[Cell, ...]:
    success, seconds = (each[list(DURATIONS).index(count)] for each in PUBLISHED[method])
    return (count, method, 50, success, None, seconds, *[None] * (len(COLUMNS) - 6))


def _goals(found: dict[int, list[Trial]]) -> tuple[Goal, ...]:
    largest = found[max(found)]
    seconds = [trial.seconds for trial in largest]
    return (
        *(
            Goal(f"{count} vehicles, failures [%]", 0.0, 100.0 - percent(trials))
            for count, trials in found.items()
        ),
        Goal(f"{max(found)} vehicles, median [s]", 1.0, float(np.median(seconds))),
        Goal(f"{max(found)} vehicles, worst [s]", 5.0, max(seconds)),
    )


_WORK = """\
The benchmark of Luis and Schoellig (carlosluis/multiagent_planning, `comp_3approaches.m`): from
rest to rest between random places in a cube of 4 m³, 0.35 m apart side by side and twice that
above each other, accelerations up to 1 m/s² along each axis, steps of 0.2 s. The flight time,
which they leave open, is the one published for DMPC, rounded up to whole steps: 3.6, 4.6, 6.6, 8.6
and 9.8 s. A fleet of seed s is `random_transitions(N, default_rng(s))`. It counts if `verify`
finds no violation at any instant, and no two vehicles are closer than 0.35 m - 1 µm at any of 100
samples of each step, computed independently of the package. `plan_scp` plans it; a wall time runs
from the scenario record to the verified plan, without the samples, a processor time to the plan.
The fleets of a size are a campaign: planned one after another in a separate process, after a small
fleet that does not count. Index, distance and memory (the largest of the process, of which the
interpreter, Drake and the campaign take some 170 MB) are of this run."""

_LIMITATIONS = """\
Limitations. The published lines are quoted: their times are of MATLAB and quadprog on another
machine, with other draws of the same kind, and a fleet counted there if no two vehicles came
closer than 0.30 m; their flight times differed from fleet to fleet, here every fleet of a size has
the same. Joint SCP runs on this machine, on the same draws, in `fleet_joint`. The position box is
the cube in which starts and goals are drawn."""
