"""A scanned building in an OctoMap: one vehicle, and ten, between random free places."""

from __future__ import annotations

from pathlib import Path

import drake_rho as rho
from benchmarks.map_flights import COLUMNS, WORK, fly
from benchmarks.race import Skipped
from benchmarks.tables import Goal, Table

DRAWS = ((1, 10), (10, 3))
"""Numbers of vehicles, each with the number of draws."""

NAME = "geb079.bt"
"""File of the map, one of OctoMap's examples."""


def run(folder: Path | None = None) -> Table:
    """Plan flights through the building in a folder of public files.

    Raises:
        Skipped: there is no such file.
    """
    files = sorted(folder.rglob(NAME)) if folder else []
    if not files:
        raise Skipped(f"no {NAME} given; it is `octomap/share/data` of github.com/OctoMap/octomap")
    voxels = rho.Voxels.from_octomap(files[0], "free")
    alone, ten = fly(voxels, DRAWS)
    summary = f"{voxels}, joined to {len(voxels.cover)} boxes. {alone.words}; {ten.words}."
    return Table(
        name="map_building",
        title="Maps: a building",
        columns=COLUMNS,
        rows=alone.rows + ten.rows,
        notes=(summary, _WORK + WORK),
        goals=(
            Goal("draws of one vehicle without a plan", 0.0, float(DRAWS[0][1] - alone.planned)),
            Goal("draws of ten vehicles without a plan", 0.0, float(DRAWS[1][1] - ten.planned)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "octomap-python"),
    )


_WORK = f"`{NAME}` of OctoMap's examples, a floor of a university building. "
