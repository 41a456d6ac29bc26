"""Shows of two and five thousand vehicles, whose transitions two processes plan side by side."""

from __future__ import annotations

import resource

from benchmarks.show_large import SAMPLES, WITHIN, judged, show
from benchmarks.show_random import PACKAGES
from benchmarks.show_scenes import APART
from benchmarks.tables import Cell, Goal, Table

SIDES = 45, 71
"""Vehicles along a side of the pads."""


def run() -> Table:
    """Plan each show in two processes, and judge it by `rho.verify` and dense samples."""
    rows, violated, nearest = list[tuple[Cell, ...]](), 0, float("inf")
    for side in SIDES:
        found = judged(show(side))
        transitions, gap = found.certificate.transitions, found.certificate.gap
        longer = max(each.duration / each.bound - 1.0 for each in transitions)
        violated, nearest = violated + found.violated, min(nearest, found.least)
        rows.append(
            (
                *(side**2, found.plan.scenario.grid.duration, longer, gap, found.least),
                *(found.planning.wall, found.planning.processor, found.verifying.processor),
                _memory(),
            )
        )
    return Table(
        name="show_thousands",
        title="Shows of thousands",
        columns=(
            *("vehicles", "show [s]", "longer than its bound", "assignment above its bound"),
            *("least distance, samples [m]", "planning, wall [s]", "planning, processors [s]"),
            *("`rho.verify` [s]", "memory of the largest process so far [GB]"),
        ),
        rows=tuple(rows),
        notes=(
            "Five formations and own pads, as in the show of 1024. Memory includes what judged the "
            "shows before. Ways are longest where the fleet is: the longest flight grows with its "
            f"width. Samples: {SAMPLES // 10} a step.",
        ),
        goals=(
            Goal("checks violated", 0, violated),
            Goal(
                "separation less the least sampled distance [m]", WITHIN, APART.distance - nearest
            ),
        ),
        packages=PACKAGES,
    )


def _memory() -> float:
    """Return the largest memory of a process so far [GB]."""
    used = (resource.getrusage(each) for each in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(each.ru_maxrss for each in used) * 1024.0 / 1e9
