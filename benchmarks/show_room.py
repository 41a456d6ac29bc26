"""Shows of 24 Crazyflies in a room of 6 m, with downwash, judged by dense samples."""

from __future__ import annotations

import numpy as np

from benchmarks.all_cores import on_all_cores
from benchmarks.show_random import Lap, judged
from benchmarks.show_scenes import room
from benchmarks.tables import Goal, Table

_APART, _WITHIN = 0.4, 1e-6
"""Required distance [m], and the violation of it that counts as rounding, relative to it."""


def run(seeds: int = 20) -> Table:
    """Plan and judge as many shows, on all cores."""
    laps = on_all_cores(lap, range(seeds), "shows in a room", at_once=1)
    planned = [each for each in laps if each.planned]
    wrong = sum(not each.ok or each.least < _APART * (1.0 - _WITHIN) for each in planned)
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
        goals=(
            Goal("shows without a plan", 0, len(laps) - len(planned)),
            Goal("violated, by `rho.verify` or by samples", 0, wrong),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "daqp"),
    )


def lap(seed: int) -> Lap:
    """Plan and judge one show."""
    return judged(room(np.random.default_rng(seed)))
