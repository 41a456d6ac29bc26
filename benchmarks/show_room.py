"""Shows of 24 Crazyflies in a room of 6 m, with downwash, judged by dense samples."""

from __future__ import annotations

import numpy as np

from benchmarks.all_cores import on_all_cores
from benchmarks.show_random import PACKAGES, Lap, goals_of, judged
from benchmarks.show_scenes import room
from benchmarks.tables import Table

_APART = 0.4
"""Required distance [m]."""


def run(seeds: int = 20) -> Table:
    """Plan and judge as many shows, on all cores."""
    laps = on_all_cores(lap, range(seeds), "shows in a room", at_once=1)
    return Table(
        name="show_room",
        title="Shows in a room",
        columns=(
            *("planned", "verified", "least distance, samples [m]", "show [s]"),
            *("longer than its bound", "assignment above its bound", "processor time [s]"),
        ),
        rows=tuple(
            (
                *(each.planned, each.ok, each.least, each.duration),
                *(each.longer, each.gap, each.seconds),
            )
            for each in laps
        ),
        notes=(
            "24 vehicles, a room of 6 m x 6 m x 3 m as the position box, pads 0.5 m apart, three "
            "formations, own pads; a separation of 0.4 m, two to three times as much vertically, "
            "1.5 m/s and 3 m/s². Samples integrate the accelerations, 100 a step.",
        ),
        goals=goals_of(laps, _APART),
        packages=PACKAGES,
    )


def lap(seed: int) -> Lap:
    """Plan and judge one show."""
    return judged(room(np.random.default_rng(seed)))
