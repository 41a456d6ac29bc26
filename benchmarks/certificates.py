"""Certificates of fleets: time and gap of `certify`."""

from __future__ import annotations

from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b1 import scenario
from benchmarks.stopwatch import Stopwatch, median
from benchmarks.tables import Cell, Goal, Table

GOALS = {8: 2.4, 12: 4.2}
"""Numbers of vehicles, and goals for the time [s]."""

SEED = 0
"""Seed of the fleets."""


def run(repetitions: int = 5) -> Table:
    """Certify a fleet of each size."""
    rows, goals = list[tuple[Cell, ...]](), list[Goal]()
    for count, most in GOALS.items():
        plan, times = rho.plan(scenario(count, SEED)), []
        for _ in track(range(repetitions), f"{count} vehicles"):
            watch = Stopwatch()
            found = rho.certify(plan)
            times.append(watch.taken())
        own = median(times)
        least = min(each.processor for each in times)
        gap = 100.0 * (1.0 - found.lower_bound / plan.cost)
        rows.append((count, own.processor, least, own.wall, plan.cost, found.lower_bound, gap))
        goals.append(Goal(f"{count} vehicles, processor [s]", most, own.processor))
    return Table(
        name="certificates",
        title="Certificates of fleets",
        columns=(
            "vehicles",
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


_ABOUT = f"""\
Fleets are those of `fleet_b1` with seed {SEED}, planned by `rho.plan` before; a time is that of
`rho.certify(plan)` with its defaults. Limitations: one draw of each size."""
