"""The results of a race as rows of a table, the fastest first."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmarks.race import SAME_INDEX, Result
from benchmarks.tables import Cell

THIS_PACKAGE = "this package"

COLUMNS = (
    "implementation",
    "median, processor [s]",
    "least, processor [s]",
    "median, wall [s]",
    "ratio",
    "index error",
    "note",
)
"""Columns; `rounds` explains them."""


def rows(results: Sequence[Result]) -> tuple[tuple[Cell, ...], ...]:
    """Return one row for each implementation, in the order of `COLUMNS`.

    Times of an implementation that did not do the work are left out, and the note says why.
    """
    ours = next(result for result in results if result.name == THIS_PACKAGE)
    ranked = sorted(results, key=lambda one: one.median.processor if one.counts else math.inf)
    return tuple(_row(result, ours) for result in ranked)


def rounds(repetitions: int) -> str:
    """Explain the columns of a race with so many rounds."""
    return (
        f"Times are of {repetitions} rounds. Processor times are sums over threads and processes, "
        "and wait for no other work. The ratio is that of their medians, to this package's; the "
        "error of the index is relative, the largest of all rounds."
    )


def ratio(results: Sequence[Result], *names: str, ours: str = THIS_PACKAGE) -> float | None:
    """Return the processor time of `ours` over the least of `names`; None if one is missing."""
    by_name = {result.name: result for result in results if result.counts}
    peers = [by_name[name].median.processor for name in names if name in by_name]
    if ours not in by_name or not peers:
        return None
    return by_name[ours].median.processor / min(peers)


def _row(result: Result, ours: Result) -> tuple[Cell, ...]:
    if not result.laps:
        return (result.name, None, None, None, None, None, result.failure)
    both_count, median = result.counts and ours.counts, result.median
    return (
        result.name,
        median.processor if result.counts else None,
        result.least if result.counts else None,
        median.wall if result.counts else None,
        median.processor / ours.median.processor if both_count else None,
        result.index_error,
        _note(result),
    )


def _note(result: Result) -> str:
    notes = []
    if not result.verified:
        notes.append("a constraint is violated: time does not count")
    if abs(result.index_error) > SAME_INDEX:
        notes.append("another index: time does not count")
    solver = sorted(lap.solver_seconds for lap in result.laps)[len(result.laps) // 2]
    if solver:
        notes.append(f"solver's own {solver:.2g} s")
    return "; ".join(notes)
