"""Time of `import drake_rho`, measured in separate processes."""

from __future__ import annotations

import subprocess
import sys
from statistics import median

from benchmarks.tables import Cell, Goal, Table

REPETITIONS = 9
"""Processes, of which the median counts."""

_CODE = "import time; began = time.perf_counter(); import {}; print(time.perf_counter() - began)"


def run() -> Table:
    """Measure this package, and the dependencies that take most of its time."""
    names = ("drake_rho", "pydrake.solvers", "pydantic", "numpy")
    rounds = [{name: _import(name) for name in names} for _ in range(REPETITIONS + 1)]
    # the first round fills caches
    found = {name: [each[name] for each in rounds[1:]] for name in names}
    rows: list[tuple[Cell, ...]] = [
        (name, median(seconds), min(seconds)) for name, seconds in found.items()
    ]
    return Table(
        name="import_time",
        title="Import time",
        columns=("import", "median_seconds", "min_seconds"),
        rows=tuple(rows),
        notes=("Each line is timed alone, so what several need counts for each of them.",),
        goals=(Goal("`import drake_rho` [s]", 0.5, median(found["drake_rho"])),),
    )


def _import(name: str) -> float:
    command = [sys.executable, "-c", _CODE.format(name)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    return float(done.stdout)
