"""Least times of single vehicles beside lower bounds that no plan on as many knots can beat."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.least_times import found
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import Cell, Goal, Table
from benchmarks.time_bisection import FOREST, forest

DRAWS = 20
"""Number of random scenes, each with one to six obstacles beside the straight path."""

LENGTH, KNOTS = 10.0, 31

LIMIT = 20.0
"""Time limit of a bound [s]."""

GAP = 0.01
"""Goal: largest gap of a bound."""

COLUMNS = (
    "scene",
    "obstacles",
    "T [s]",
    "bound [s]",
    "gap",
    "gap without obstacles",
    "verified",
    "plan, processor [s]",
    "plan, wall [s]",
    "bound, processor [s of work]",
    "bound, wall [s of work]",
)


def run(folder: Path | None = None) -> Table:
    """Bound the least times of vehicles past random obstacles, and of those of a forest."""
    scenes = [*map(_past, range(DRAWS)), *([] if folder is None else _in_forest(folder))]
    rows, gaps = list[tuple[Cell, ...]](), list[float]()
    for scenario in track(scenes, "bounds of least times"):
        own = found(scenario)
        if own.plan is None:
            gaps.append(1.0)
            rows.append(
                (scenario.name, len(scenario.obstacles), *[None] * 4, own.holds, *[None] * 4)
            )
            continue
        watch = Stopwatch()
        proved = rho.certify_time(own.plan, time_limit=LIMIT)
        taken = watch.taken()
        least = own.plan.statistics.time_bound or 0.0
        gaps.append(proved.gap)
        rows.append(
            (
                scenario.name,
                len(scenario.obstacles),
                f"{proved.duration:.5f}",
                f"{proved.bound:.5f}",
                f"{proved.gap:.2e}",
                f"{1.0 - least / proved.duration:.2e}",
                own.holds,
                *own.taken.both,
                *taken.both,
            )
        )
    return Table(
        name="time_bounds",
        title="Least times of single vehicles, beside proved bounds",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_WORK, *([] if len(scenes) > DRAWS else ["The forest was not given."])),
        goals=(
            Goal("gap, largest", GAP, max(gaps)),
            Goal("scenes with a larger gap, part", 0.0, float(np.mean(np.array(gaps) > GAP))),
        ),
    )


def _past(seed: int) -> rho.Scenario:
    """Return a vehicle that flies past one to six spheres and boxes beside its straight path."""
    rng = np.random.default_rng(seed)
    obstacles = list[rho.Sphere | rho.Box]()
    for _ in range(int(rng.integers(1, 7))):
        size = rng.uniform(0.3, 0.9)
        angle, away = rng.uniform(0.0, 2.0 * np.pi), size * rng.uniform(0.2, 1.2)
        center = np.array(
            [rng.uniform(2.0, LENGTH - 2.0), away * np.cos(angle), away * np.sin(angle)]
        )
        if rng.uniform() < 0.5:
            obstacles.append(rho.Sphere(center, size))
        else:
            half = size * rng.uniform(0.4, 1.0, 3)
            obstacles.append(rho.Box(center - half, center + half))
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([LENGTH, 0, 0]), radius=0.15)
    limits = rho.Limits(max_acceleration=rng.uniform(1.0, 4.0), max_speed=rng.uniform(2.0, 6.0))
    grid = rho.Grid(LENGTH / 30.0, KNOTS)
    return rho.Scenario(f"past {seed}", grid, [vehicle], limits, obstacles)


def _in_forest(folder: Path) -> Iterator[rho.Scenario]:
    """Yield each vehicle of a mission in a forest by itself."""
    if not (folder / f"{FOREST}.bt").is_file():
        return
    mission = forest(folder)
    for number in range(len(mission.vehicles)):
        alone = mission.of_vehicles([number]).without_separation()
        yield alone.derived(name=f"{FOREST}, {mission.vehicles[number].name} alone")


_WORK = f"""\
Random scenes: {LENGTH:g} m from rest to rest on {KNOTS} knots, obstacles of 0.3 to 0.9 m around or
beside the straight path, clear of both ends by 2 m and at every instant. The forest is that of
`time_bisection`, each of its vehicles by itself. The bound is that of `rho.certify_time` with a
time limit of {LIMIT:g} s, and the gap is 1 - bound / T. The gap without obstacles is that of
`statistics.time_bound`."""
