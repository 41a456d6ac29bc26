"""Forests and mazes of the LSC-DR planner: ten vehicles among pillars."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import drake_rho as rho
from benchmarks.fleets import Trial, attempts, findings, percent
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table
from benchmarks.worlds import CHECKED, COLUMNS, plan_within, published, row, step_of, unhindered

KINDS = {
    "forest": ("forest10.json", (11.0, 10.0, 9.5)),
    "maze_sparse": ("maze10_sparse.json", (18.0,)),
    "maze_dense": ("maze10_dense.json", (18.0,)),
}
"""The mission flown in the worlds of each folder, and the durations of its flights [s]."""

STEP = 0.2
"""Longest step h [s]."""

LIMIT = 120.0
"""Time limit beyond which a plan counts as a failure [s]."""


def scenario(mission: Path, world: Path, duration: float) -> rho.Scenario:
    """Return one world."""
    grid = rho.Grid.lasting(duration, step=step_of(duration, STEP))
    loaded = rho.load_lsc_mission(mission, grid=grid, world=world)
    return dataclasses.replace(loaded, name=f"{world.parent.name} {world.stem}, {duration:g} s")


def run(folder: Path | None = None, stores: Path | None = None) -> Table:
    """Plan the mission of every world in `folder`, which has a folder of worlds for each kind.

    `stores` is that of `attempts`.

    Raises:
        Skipped: no folder is given; the worlds are not part of this project.
    """
    found = _planned(folder, stores) if folder else {}
    if not found:
        where = f"no worlds in {folder}" if folder else "no folder given"
        raise Skipped(f"{where}; they are `world` and `missions` of qwerty35/lsc_dr_planner")
    every = [trial for trials in found.values() for trial in trials]
    return Table(
        name="world_b6",
        title="B6: forests and mazes of the LSC-DR planner, ten vehicles",
        columns=COLUMNS,
        rows=(*(row(*key, trials) for key, trials in found.items()), *_PUBLISHED),
        notes=(findings(every), _WORK, CHECKED, _LIMITATIONS),
        goals=tuple(
            Goal(f"{kind}, {duration:g} s: failures [%]", 0.0, 100.0 - percent(trials))
            for (kind, duration), trials in found.items()
        ),
    )


def _planned(folder: Path, stores: Path | None) -> dict[tuple[str, float], list[Trial]]:
    """Plan the worlds of each kind, for each duration."""
    found: dict[tuple[str, float], list[Trial]] = {}
    planner = partial(plan_within, seconds=LIMIT)
    for kind, (mission, durations) in KINDS.items():
        worlds = sorted((folder / kind).glob("*.csv"), key=_number)
        for duration in durations if worlds else ():
            makes = [partial(scenario, folder / mission, world, duration) for world in worlds]
            what = f"B6, {kind}, {duration:g} s"
            found[kind, duration] = attempts(makes, what, planner, unhindered, stores)
    return found


def _number(path: Path) -> tuple[int, str]:
    """Return a key that sorts by the numbers in the names."""
    digits = "".join(sign for sign in path.stem if sign.isdigit())
    return int(digits or 0), path.stem


_PUBLISHED: tuple[tuple[Cell, ...], ...] = (
    published("forest", "LSC-DR, published (forest 10)", 1, 100.0, 15.8, 103.0),
    published("maze_dense", "LSC-DR, published (dense maze 1)", 1, 100.0, 51.2, 155.0),
)

_WORK = f"""\
The worlds of qwerty35/lsc_dr_planner, unchanged: ten vehicles of 0.15 m among pillars from floor
to ceiling, 0.3 m apart side by side and twice that above each other, at most 1 m/s and 2 m/s²
along each axis. A forest has 40 pillars in 10 m by 10 m, where a straight flight needs 8.5 s;
passages of the mazes are 0.5 m wide, which leaves 0.2 m to the centre of a vehicle. Missions have
no duration: here it is that of the table, in steps of at most {STEP:g} s. A plan that takes longer
than {LIMIT:g} s counts as a failure. The bound is the index of the same flight without pillars and
other vehicles, which is a convex program; no plan can be below it, and none may reach it."""

_LIMITATIONS = """\
Limitations. LSC-DR plans during the flight, each vehicle for itself, in the plane, and takes 8.3
ms in the forest and 5.3 ms in the maze a vehicle and replanning step; its times are durations of
flights in its own simulation. Here the whole flight of all vehicles is planned at once,
beforehand, in three dimensions, so that vehicles may pass above each other, and all arrive
together."""
