"""An office in an OctoMap: one vehicle, and ten, between random free places that have a way."""

from __future__ import annotations

from pathlib import Path

import drake_rho as rho
from benchmarks.map_flights import COLUMNS, WORK, fly
from benchmarks.race import Skipped
from benchmarks.tables import Goal, Table

DRAWS = ((1, 10), (10, 20))
"""Numbers of vehicles, each with the number of draws."""


def run(folder: Path | None = None) -> Table:
    """Plan flights through `office.bt` in `folder`.

    Raises:
        Skipped: there is no such file.
    """
    if folder is None or not (folder / "office.bt").is_file():
        raise Skipped("no OctoMaps given; they are those of github.com/qwerty35/lsc_planner")
    voxels = rho.Voxels.from_octomap(folder / "office.bt", "free")
    alone, ten = fly(voxels, DRAWS)
    summary = f"{voxels}, joined to {len(voxels.cover)} boxes. {alone.words}; {ten.words}."
    return Table(
        name="map_office",
        title="Maps: an office",
        columns=COLUMNS,
        rows=alone.rows + ten.rows,
        notes=(summary, _WORK + WORK),
        goals=(
            Goal("one vehicle, slowest [s]", 5.0, max(each.wall for each in alone.taken)),
            Goal("ten vehicles, draws without a plan", 0.0, float(DRAWS[1][1] - ten.planned)),
            Goal("ten vehicles, slowest [s]", 30.0, max(each.wall for each in ten.taken)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "octomap-python"),
    )


_WORK = "`office.bt` of qwerty35/lsc_planner. "
