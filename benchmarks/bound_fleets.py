"""Global optima of fleets: gaps, times, and plans found on the way."""

from __future__ import annotations

from functools import partial

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.bound_scenes import PACKAGES, Lap, bounded, median_gap, six_among_two
from benchmarks.fleet_b1 import scenario as in_a_cube
from benchmarks.tables import Cell, Goal, Table

GAP = 0.01
"""Relative gap that is asked for."""

SERIES = {"B1, 4 vehicles": 60.0, "B1, 8 vehicles": 240.0, "B1, 12 vehicles": 240.0}
"""Series of random fleets, and the time for each of them [s]."""

SIX = "six, a box and a sphere"
"""Name of the series among obstacles."""


def run(seeds: int = 12) -> Table:
    """Bound as many fleets of each series, on all cores."""
    works: list[partial[Lap]] = [
        *(partial(_of_b1, name, seed) for name in SERIES for seed in range(seeds)),
        *(partial(_of_six, seed) for seed in range(10)),
        partial(_of_the_paper),
    ]
    laps = on_all_cores(_called, works, "fleets", at_once=1)
    found = {name: laps[i * seeds : (i + 1) * seeds] for i, name in enumerate(SERIES)} | {
        SIX: laps[len(SERIES) * seeds : -1],
        "the paper's": laps[-1:],
    }
    four, eight, twelve = (found[name] for name in SERIES)
    return Table(
        name="bound_fleets",
        title="Global optima of fleets",
        columns=(
            *("series", "fleets", f"gap at most {GAP:.0%}", "median gap", "largest gap"),
            *("cheaper than `plan`, at most", "branches, median", "processor time, median [s]"),
            *("processor time, largest [s]", "bound by the file's check, least part"),
        ),
        rows=tuple(_row(name, laps) for name, laps in found.items()),
        notes=(
            "B1 are random transitions in 4 m³ (`fleet_b1`), for which at most "
            + ", ".join(f"{limit:.0f} s ({name})" for name, limit in SERIES.items())
            + " are allowed; the six vehicles exchange sides past a box and a sphere, in at most "
            "10 s. Fleets have a core each. Every best plan is verified, and every bound is "
            "computed again from its file.",
        ),
        goals=(
            Goal("B1 with 4, fleets above 1 %", 0, _open(four)),
            Goal("B1 with 8, fleets above 1 % of 12", 2, _open(eight)),
            Goal("B1 with 12, median gap", 0.03, median_gap(twelve)),
            Goal("six among obstacles, fleets above 1 %", 0, _open(found[SIX])),
            Goal("the paper's, processor time [s]", 1.0, laps[-1].seconds),
        ),
        packages=PACKAGES,
    )


def _called(work: partial[Lap]) -> Lap:
    return work()


def _of_b1(name: str, seed: int) -> Lap:
    vehicles = int(name.split()[1])
    return bounded(in_a_cube(vehicles, seed), GAP, SERIES[name])


def _of_six(seed: int) -> Lap:
    return bounded(six_among_two(seed), GAP, 10.0)


def _of_the_paper() -> Lap:
    return bounded(rho.load_scenario("paper"), GAP, 10.0)


def _open(laps: list[Lap]) -> int:
    return sum(each.gap > GAP for each in laps)


def _row(name: str, laps: list[Lap]) -> tuple[Cell, ...]:
    checked = [each.checked for each in laps if each.checked is not None]
    seconds = [each.seconds for each in laps]
    return (
        *(name, len(laps), len(laps) - _open(laps), median_gap(laps)),
        *(max(each.gap for each in laps), max(each.cheaper for each in laps)),
        *(float(np.median([each.nodes for each in laps])), float(np.median(seconds))),
        *(max(seconds), min(checked, default=None)),
    )
