"""OctoMaps of the LSC planner: forests with twenty vehicles, and sixteen across a small one."""

from __future__ import annotations

import statistics
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.map_scenes import Tried, beyond_radius, tried
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table

STEP = 0.25
"""h of every mission [s]."""

DURATIONS = (14.0, 16.0, 20.0, 24.0)
"""T of the forests [s]."""

FORESTS = range(1, 11)
"""Numbers of the forests."""

_SHORTER = np.arange(10.0, 1.9, -0.5)
"""T of the small forest, from that of the goal down to the shortest that is planned [s]."""


def run(folder: Path | None = None) -> Table:
    """Plan the missions in `folder`.

    Raises:
        Skipped: no folder is given, or it lacks a mission.
    """
    if folder is None or not (folder / "forest1.bt").is_file():
        raise Skipped("no OctoMaps given; they are those of github.com/qwerty35/lsc_planner")
    rows, seconds = list[tuple[Cell, ...]](), dict[float, list[float]]()
    failures = 0
    for duration in DURATIONS:
        for number in FORESTS:
            row, found = _row(folder, f"forest{number}", f"forest{number}_20agents", duration)
            rows.append(row)
            failures += not found.ok
            seconds.setdefault(duration, []).append(found.taken.wall)
    row, small = _row(folder, "simple_forest", "square16", 10.0)
    rows.append(row)
    shortest = 10.0
    for duration in _SHORTER[1:]:
        row, found = _row(folder, "simple_forest", "square16", float(duration))
        rows.append(row)
        if not found.ok:
            break
        shortest = float(duration)
    return Table(
        name="map_forests",
        title="Maps: forests of the LSC planner",
        columns=(
            "map",
            "cells",
            "parts",
            "vehicles",
            "T [s]",
            "planned and verified",
            "plan, processor [s]",
            "plan, wall [s]",
            "index f",
            "nearest cell less the radius [m]",
        ),
        rows=tuple(rows),
        notes=(f"Shortest T of the small forest that is planned: {shortest:g} s.", _WORK),
        goals=(
            Goal("forests, failures", 0.0, float(failures)),
            Goal("forests at 14 s, median [s]", 10.0, statistics.median(seconds[14.0])),
            Goal("sixteen vehicles at 10 s [s]", 15.0, small.taken.wall if small.ok else None),
        ),
    )


def _row(folder: Path, name: str, mission: str, duration: float) -> tuple[tuple[Cell, ...], Tried]:
    """Return the row of one mission, and its plan."""
    grid = rho.Grid.lasting(duration, step=STEP)
    world = folder / f"{name}.bt"
    scenario = rho.load_lsc_mission(folder / f"{mission}.json", grid=grid, world=world)
    voxels = next(each for each in scenario.obstacles if isinstance(each, rho.Voxels))
    found = tried(scenario)
    some = found.plan is not None
    row = (
        name,
        len(voxels.occupied),
        len(voxels.cover),
        len(scenario.vehicles),
        duration,
        found.ok,
        round(found.taken.processor, 2),
        round(found.taken.wall, 2),
        round(found.plan.cost, 4) if found.plan is not None else None,
        float(f"{beyond_radius(found, voxels):.2g}") if some else None,
    )
    return row, found


_WORK = f"""\
The missions and OctoMaps of qwerty35/lsc_planner, unchanged, with unknown cells free and steps of
{STEP:g} s. Distances are measured at 4001 instants from every cell near a vehicle, by code of the
benchmark's own; a distance within the tolerance may be below zero. The published planner is online
and decentralised, with flights of 21.8 and 22.8 s across the small forest: another time."""
