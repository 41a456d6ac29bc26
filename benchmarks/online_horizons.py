"""The same missions of about 50 s by windows that roll and by windows that shrink."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.all_cores import on_all_cores
from benchmarks.online_scenes import Lap, either_way
from benchmarks.tables import Cell, Goal, Table

COLUMNS = (
    "windows",
    "missions",
    "arrived",
    "verified",
    "median arrival [s]",
    "median cost [m²/s⁴]",
    "windows a mission",
    "median ms a window",
    "largest ms a window",
    "median s in all",
)


def run(seeds: int = 2) -> Table:
    """Fly as many missions as given in both ways, on all cores."""
    both = on_all_cores(either_way, range(seeds), "missions", at_once=1)
    rolling, shrinking = ([each[k] for each in both] for k in range(2))
    late = [one.arrived / other.arrived for one, other in both if math.isfinite(other.arrived)]
    return Table(
        name="online_horizons",
        title="Horizons that roll and horizons that shrink",
        columns=COLUMNS,
        rows=(_row("roll, 3 s", rolling), _row("shrink, free final time", shrinking)),
        notes=(_WORK,),
        goals=(
            Goal("not verified", 0, sum(not each.verified for each in (*rolling, *shrinking))),
            Goal("rolling arrival over shrinking arrival, median", 1.1, float(np.median(late))),
            Goal("the same, largest", 1.1, max(late)),
        ),
    )


def _row(kind: str, laps: list[Lap]) -> tuple[Cell, ...]:
    times = np.concatenate([each.seconds for each in laps])
    return (
        kind,
        len(laps),
        sum(math.isfinite(each.arrived) for each in laps),
        sum(each.verified for each in laps),
        float(np.median([each.arrived for each in laps])),
        float(np.median([each.cost for each in laps])),
        float(np.mean([len(each.seconds) for each in laps])),
        1e3 * float(np.median(times)),
        1e3 * float(times.max()),
        float(np.median([sum(each.seconds) for each in laps])),
    )


_WORK = """\
A known world of 140 m by 10 m with 60 pillars, flown from one end to the other with at most 3 m/s.
Windows that roll plan 3 s ahead, five times a second; windows that shrink arrive at the earliest
knot for which they find a plan, and plan once a second. Times are of processors. Costs are sums of
squared accelerations: motions in the least time are at their limits."""
