"""The least times of fleets beside those of bisection: B1 with eight vehicles, and a forest."""

from __future__ import annotations

import math
from pathlib import Path

from rich.progress import track

import drake_rho as rho
from benchmarks import fleet_b1
from benchmarks.bisection import PRECISION, bisected
from benchmarks.least_times import Found, found, within
from benchmarks.tables import Cell, Goal, Table

VEHICLES, DRAWS = 8, 10
"""Vehicles of B1 and the number of its draws."""

FOREST, DURATION, STEP = "forest1", 14.0, 0.25
"""OctoMap, and T and h of the grid that is given [s]."""

LIMIT = 600.0
"""Time limit of a call, and of a trial of bisection [s]."""

COLUMNS = (
    "mission",
    "vehicles",
    "knots",
    "T [s]",
    "T by bisection [s]",
    "ratio",
    "verified",
    "plan, processor [s]",
    "plan, wall [s]",
    "bisection, processor [s]",
    "bisection, wall [s]",
)


def run(folder: Path | None = None) -> Table:
    """Plan draws of B1 and, if the folder of its mission is given, a forest."""
    given = [fleet_b1.scenario(VEHICLES, seed) for seed in range(DRAWS)]
    if folder is not None and (folder / f"{FOREST}.bt").is_file():
        given.append(forest(folder))
    rows, ratios = list[tuple[Cell, ...]](), list[float]()
    for scenario in track(given, "least times and bisection"):
        mine = found(scenario, within(LIMIT))
        theirs = found(scenario, lambda each: bisected(each, LIMIT))
        ratios.append(_ratio(mine, theirs))
        rows.append(_row(scenario, mine, theirs, ratios[-1]))
    return Table(
        name="time_bisection",
        title="Least times of fleets, beside bisection",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_WORK, *([] if len(given) > DRAWS else ["The forest was not given."])),
        goals=(
            Goal("T / T by bisection - 1, largest", 0.0, max(ratios) - 1.0),
            Goal("missions without a verified plan", 0.0, sum(map(math.isinf, ratios))),
        ),
    )


def forest(folder: Path) -> rho.Scenario:
    """Return the mission in the forest, from the folder of the LSC planner."""
    grid, world = rho.Grid.lasting(DURATION, step=STEP), folder / f"{FOREST}.bt"
    return rho.load_lsc_mission(folder / f"{FOREST}_20agents.json", grid=grid, world=world)


def _ratio(mine: Found, theirs: Found) -> float:
    """Return the ratio of both T; infinite without ours, 0 without that of bisection."""
    if mine.duration is None:
        return math.inf
    return 0.0 if theirs.duration is None else mine.duration / theirs.duration


def _row(scenario: rho.Scenario, mine: Found, theirs: Found, ratio: float) -> tuple[Cell, ...]:
    return (
        scenario.name,
        len(scenario.vehicles),
        scenario.grid.knots,
        _digits(mine.duration),
        _digits(theirs.duration),
        _digits(ratio if 0.0 < ratio < math.inf else None),
        mine.holds,
        *mine.taken.both,
        *theirs.taken.both,
    )


def _digits(value: float | None) -> str | None:
    return None if value is None else f"{value:.4f}"


_WORK = f"""\
B1 as in `fleet_b1`, its knots and limits, and a forest of the LSC planner as in `map_forests`, with
unknown cells free and the knots of T = {DURATION:g} s. Bisection plans for given durations by
`rho.plan`: half as long until there is no plan, then between, to {PRECISION:g} of T, as
`shortest_plan` did for fleets. A plan counts if its scenario is the one given but for the step, and
`verify` finds no violation. Time limit of a call and of a trial: {LIMIT:g} s."""
