"""Random scenes that mix costs, goals, gates and soft limits with every other requirement.

Each scene is drawn around a motion that is known to hold (`tests/mixed_costs.py`). Plans are judged
by `verify` and by dense samples with formulas of their own (`tests/judged.py`).
"""

from __future__ import annotations

from benchmarks.all_cores import on_all_cores
from benchmarks.mixed_scenes import Outcome, outcomes_of, table_of
from benchmarks.tables import Table
from tests.mixed_costs import quiet

_FIRST = 10_000
"""First seed: earlier scenes were used to improve the planners."""


def run(seeds: int) -> Table:
    """Plan scenes, as many as given, on all cores."""
    found = on_all_cores(outcomes, range(_FIRST, _FIRST + seeds), "scenes")
    return table_of(
        [each for some in found for each in some],
        "objective_mixed",
        "Random scenes that mix costs, goals, gates and soft limits with every requirement",
    )


def outcomes(seed: int) -> list[Outcome]:
    """Return what the planners made of a scene."""
    return outcomes_of(quiet(seed), seed)
