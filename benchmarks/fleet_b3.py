"""Missions of the LSC planner: ten to sixty vehicles in a small room."""

from __future__ import annotations

import statistics
from functools import partial
from pathlib import Path

import drake_rho as rho
from benchmarks.fleets import COLUMNS, Trial, attempts, findings, percent, summary
from benchmarks.race import Skipped
from benchmarks.tables import Goal, Table

DURATION, STEP = 10.0, 0.2
"""T and h of every mission [s]."""

TIMED = 60
"""Numbers of vehicles whose time is a goal."""


def run(folder: Path | None = None, stores: Path | None = None) -> Table:
    """Plan every mission in `folder`; `stores` is that of `attempts`.

    Raises:
        Skipped: no folder is given; the missions are not part of this project.
    """
    paths = sorted(folder.glob("*.json")) if folder else []
    if not paths:
        where = f"no missions in {folder}" if folder else "no folder given"
        raise Skipped(f"{where}; they are `missions/empty` of github.com/qwerty35/lsc_planner")
    grid = rho.Grid.lasting(DURATION, step=STEP)
    makes = [partial(rho.load_lsc_mission, path, grid=grid) for path in paths]
    found: dict[int, list[Trial]] = {}
    for trial in attempts(makes, "B3", stores=stores):
        found.setdefault(trial.vehicles, []).append(trial)
    every = [trial for trials in found.values() for trial in trials]
    timed = [trial.seconds for trial in found.get(TIMED, [])]
    return Table(
        name="fleet_b3",
        title="B3: missions of the LSC planner",
        columns=COLUMNS,
        rows=tuple(summary(trials) for _, trials in sorted(found.items())),
        notes=(findings(every), _WORK, _LIMITATIONS),
        goals=(
            Goal(f"{len(every)} missions, failures [%]", 0.0, 100.0 - percent(every)),
            Goal(f"{TIMED} vehicles, median [s]", 2.0, statistics.median(timed) if timed else None),
        ),
    )


_WORK = f"""\
The missions of qwerty35/lsc_planner, unchanged: up to sixty vehicles in 3 m by 3 m by 2 m, 0.3 m
apart side by side and twice that above each other, with its limits on velocity and acceleration. A
mission has no duration; here every vehicle has {DURATION:g} s, in steps of {STEP:g} s. Criteria,
times and procedure are those of `fleet_b1`; memory is the largest of the process up to then."""

_LIMITATIONS = """\
Limitations. The LSC planner replans during the flight, each vehicle for itself; it is published to
take 15.5 ms a vehicle and replanning step with sixty vehicles, with CPLEX. Here a time is that of
the whole flight of all vehicles at once, so the two are not directly comparable."""
