"""Missions of 60 to 300 s whose goals change and whose obstacles are seen in flight."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.all_cores import on_all_cores
from benchmarks.online_scenes import HORIZON, SEEN, Lap, mission
from benchmarks.tables import Cell, Goal, Table

_TOLERANCE, _PERIOD, _MEDIAN = 1e-6, 0.05, 0.015
"""Largest violation that counts as none, in SI units; period and median of windows [s]."""

COLUMNS = (
    "missions",
    "number",
    "broken",
    "not verified",
    "arrived",
    "arrival / straight line, median",
    "largest",
    "windows",
    "without a plan",
    "median ms",
    "99 % ms",
    "above 50 ms",
    "flights a mission",
)


def run(seeds: int = 300) -> Table:
    """Fly as many missions as given, on all cores."""
    laps = on_all_cores(mission, range(seeds), "missions")
    pillars, maps = laps[::2], laps[1::2]
    late = [each.arrived / each.least for each in laps]
    times = _times(pillars)
    return Table(
        name="online_missions",
        title="Missions without an end",
        columns=COLUMNS,
        rows=(_row("pillars, three of which appear", pillars), _row("the same as a map", maps)),
        notes=(_WORK,),
        goals=(
            Goal("missions with a violation", 0, sum(map(_broken, laps))),
            Goal("missions with a report that is not clean", 0, sum(not x.verified for x in laps)),
            Goal("missions that do not arrive", 0, sum(math.isinf(x.arrived) for x in laps)),
            Goal("largest arrival over the straight line's least time", 3.0, max(late)),
            Goal("median of windows among pillars [s]", _MEDIAN, float(np.median(times))),
            Goal(
                "part of all windows that take more than 50 ms",
                0.01,
                float(np.mean(_times(laps) > _PERIOD)),
            ),
        ),
    )


def _broken(lap: Lap) -> bool:
    return lap.clearance < -_TOLERANCE or lap.beyond > _TOLERANCE


def _times(laps: list[Lap]) -> np.ndarray:
    return np.concatenate([each.seconds for each in laps])


def _row(kind: str, laps: list[Lap]) -> tuple[Cell, ...]:
    times, late = _times(laps), [each.arrived / each.least for each in laps]
    return (
        kind,
        len(laps),
        sum(map(_broken, laps)),
        sum(not each.verified for each in laps),
        sum(math.isfinite(each.arrived) for each in laps),
        float(np.median(late)),
        max(late),
        len(times),
        sum(each.without_plan for each in laps),
        1e3 * float(np.median(times)),
        1e3 * float(np.quantile(times, 0.99)),
        float(np.mean(times > _PERIOD)),
        float(np.mean([each.flights for each in laps])),
    )


_WORK = f"""\
One vehicle with at most 3 m/s and 6 m/s² flies for 60 to 300 s in a volume of 24 m by 24 m with 40
pillars. Windows plan {HORIZON:g} s ahead, five times a second. Pillars are told once they are
within {SEEN:g} m, or columns of cells of a map; three pillars appear at least 3 m from the vehicle.
Goals change every 5 to 30 s. Broken: by an integration of the accelerations of its own, sampled
1000 times a second, a vehicle is closer to a pillar than its radius, or beyond a limit, by more
than 1e-6 in SI units. The arrival counts from the last change of the goal; it is compared with
a lower bound, the time of a straight line at the greatest speed with braking. Times are processor
times."""
