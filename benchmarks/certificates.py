"""Certificates of fleets: time and gap of `certify`."""

from __future__ import annotations

from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b1 import scenario
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table

GOALS = {8: 2.4, 12: 4.2}
"""Numbers of vehicles, and goals for the median time [s]."""

SEEDS = range(5)
"""Seeds of the fleets."""


def run(repetitions: int = 3) -> Table:
    """Certify fleets of each size."""
    rows, goals = list[tuple[Cell, ...]](), list[Goal]()
    for count, most in GOALS.items():
        fleets = [
            _certified(count, seed, repetitions) for seed in track(SEEDS, f"{count} vehicles")
        ]
        rows += [row for row, _ in fleets]
        goals.append(
            Goal(
                f"{count} vehicles, median of fleets, processor [s]",
                most,
                median(own for _, own in fleets).processor,
            )
        )
    return Table(
        name="certificates",
        title="Certificates of fleets",
        columns=(
            "vehicles",
            "seed",
            "median, processor [s]",
            "least, processor [s]",
            "median, wall [s]",
            "cost [m²/s⁴]",
            "bound [m²/s⁴]",
            "gap [%]",
        ),
        rows=tuple(rows),
        notes=(f"Times are of {repetitions} repetitions.", _ABOUT),
        goals=tuple(goals),
    )


def _certified(count: int, seed: int, repetitions: int) -> tuple[tuple[Cell, ...], Taken]:
    """Return the row of a fleet, and its median time."""
    plan, times, bound = rho.plan(scenario(count, seed)), list[Taken](), 0.0
    for _ in range(repetitions):
        watch = Stopwatch()
        bound = rho.certify(plan).lower_bound
        times.append(watch.taken())
    own, least = median(times), min(each.processor for each in times)
    gap = 100.0 * (1.0 - bound / plan.cost)
    costs = f"{plan.cost:.6f}", f"{bound:.6f}", gap
    return (count, seed, own.processor, least, own.wall, *costs), own


_ABOUT = """\
Fleets are those of `fleet_b1`, planned by `rho.plan` before; a time is that of `rho.certify(plan)`
with its defaults."""
