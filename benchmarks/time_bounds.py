"""Least times of single vehicles beside lower bounds that no plan on as many knots can beat."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.progress import track

import drake_rho as rho
from benchmarks.least_times import found
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import Cell, Goal, Table
from benchmarks.time_bisection import FOREST, forest

DRAWS, TOURS = 20, 6
"""Numbers of random scenes with one to six obstacles, and of tours of three to five gates."""

LENGTH, KNOTS = 10.0, 31

SHORT, LONGER = 6.0, 41
"""Straight path past large obstacles [m], and knots of a tour."""

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
    """Bound the least times of vehicles past random obstacles, through gates, and in a forest."""
    random = [*map(_past, range(DRAWS)), *map(_past_large, range(DRAWS)), *map(_tour, range(TOURS))]
    scenes = [*random, *([] if folder is None else _in_forest(folder))]
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
    near, large, tours, others = np.split(np.array(gaps), np.cumsum([DRAWS, DRAWS, TOURS]))
    return Table(
        name="time_bounds",
        title="Least times of single vehicles, beside proved bounds",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_WORK, *([] if len(others) > 0 else ["The forest was not given."])),
        goals=(
            Goal("past obstacles beside the path, scenes above 1 %", 0, _open(near)),
            Goal(f"past large obstacles, scenes above 1 % of {DRAWS}", 2, _open(large)),
            Goal(f"tours above 1 % of {TOURS}", 1, _open(tours)),
            Goal("in the forest, vehicles above 1 %", 0, _open(others)),
        ),
    )


def _open(gaps: npt.NDArray[np.float64]) -> int:
    """Return the number of scenes that are not within the gap."""
    return int(np.sum(gaps > GAP))


def _past(seed: int) -> rho.Scenario:
    """Return a vehicle that flies past one to six spheres and boxes beside its straight path."""
    rng = np.random.default_rng(seed)
    obstacles = [
        _obstacle(rng, (0.3, 0.9), (0.2, 1.2), (2.0, LENGTH - 2.0))
        for _ in range(int(rng.integers(1, 7)))
    ]
    return _straight(f"past {seed}", LENGTH, rng, obstacles)


def _past_large(seed: int) -> rho.Scenario:
    """Return a vehicle that flies past one to six large spheres and boxes on its straight path."""
    rng = np.random.default_rng([77, seed])
    obstacles = [
        _obstacle(rng, (0.5, 1.0), (0.0, 0.5), (1.3, SHORT - 1.3))
        for _ in range(int(rng.integers(1, 7)))
    ]
    return _straight(f"past large {seed}", SHORT, rng, obstacles)


def _obstacle(
    rng: np.random.Generator,
    sizes: tuple[float, float],
    aways: tuple[float, float],
    along: tuple[float, float],
) -> rho.Sphere | rho.Box:
    """Return an obstacle of a size [m], so many of them from the path, so far along it [m]."""
    size = rng.uniform(*sizes)
    angle, away = rng.uniform(0.0, 2.0 * np.pi), size * rng.uniform(*aways)
    center = np.array([rng.uniform(*along), away * np.cos(angle), away * np.sin(angle)])
    if rng.uniform() < 0.5:
        return rho.Sphere(center, size)
    half = size * rng.uniform(0.4, 1.0, 3)
    return rho.Box(center - half, center + half)


def _straight(
    name: str, length: float, rng: np.random.Generator, obstacles: list[rho.Sphere | rho.Box]
) -> rho.Scenario:
    vehicle = rho.Vehicle("v", rho.State([0, 0, 0]), rho.State([length, 0, 0]), radius=0.15)
    return rho.Scenario(name, rho.Grid(length / 30.0, KNOTS), [vehicle], _limits(rng), obstacles)


def _tour(seed: int) -> rho.Scenario:
    """Return a vehicle that passes three to five gates, balls of 0.2 m, at any time."""
    rng, at, gates = np.random.default_rng([78, seed]), np.zeros(3), list[rho.Waypoint]()
    for _ in range(int(rng.integers(3, 6))):
        at += rng.uniform([1.0, -2.0, -1.0], [3.0, 2.0, 1.0])
        gates.append(rho.Waypoint(None, at.round(3), within=0.2))
    ends = rho.State([0, 0, 0]), rho.State(at + np.array([2.0, 0.0, 0.0]))
    vehicle = rho.Vehicle("v", *ends, waypoints=gates)
    return rho.Scenario(f"tour {seed}", rho.Grid(0.2, LONGER), [vehicle], _limits(rng))


def _limits(rng: np.random.Generator) -> rho.Limits:
    return rho.Limits(max_acceleration=rng.uniform(1.0, 4.0), max_speed=rng.uniform(2.0, 6.0))


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
beside the straight path, clear of both ends by 2 m and at every instant; {SHORT:g} m past obstacles
of 0.5 to 1 m on that path; tours of three to five gates, which are passed at any time, on {LONGER}
knots. The forest is that of
`time_bisection`, each of its vehicles by itself. The bound is that of `rho.certify_time` with a
time limit of {LIMIT:g} s, and the gap is 1 - bound / T. The gap without obstacles is that of
`statistics.time_bound`."""
