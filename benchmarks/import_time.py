"""Time of `import drake_rho`, and until the first plan, measured in separate processes."""

from __future__ import annotations

import os
import subprocess
import sys

from benchmarks.stopwatch import Taken, median
from benchmarks.tables import Cell, Goal, Table

REPETITIONS = 31
"""Processes, of which the median counts."""

_FIRST_PLAN = "import drake_rho, first plan"

_WORKS = {
    "drake_rho": "import drake_rho",
    "pydrake.solvers": "import pydrake.solvers",
    "pydantic": "import pydantic",
    "numpy": "import numpy",
    _FIRST_PLAN: "import drake_rho as rho; rho.plan(rho.load_scenario('paper'))",
}
"""Statements of each process."""

_CODE = """
import time
wall, processor = time.perf_counter(), time.process_time()
{}
print(time.perf_counter() - wall, time.process_time() - processor)
"""


def run(repetitions: int = REPETITIONS) -> Table:
    """Measure this package, the dependencies that take most of its time, and the first plan."""
    rounds = [{name: _taken(code) for name, code in _WORKS.items()} for _ in range(repetitions + 1)]
    # the first round fills caches
    found = {name: [each[name] for each in rounds[1:]] for name in _WORKS}
    medians = {name: median(times) for name, times in found.items()}
    rows: list[tuple[Cell, ...]] = [
        (name, own.processor, min(each.processor for each in found[name]), own.wall)
        for name, own in medians.items()
    ]
    return Table(
        name="import_time",
        title="Import time, and the first plan of a process",
        columns=("work", "median, processor [s]", "least, processor [s]", "median, wall [s]"),
        rows=tuple(rows),
        notes=(_ABOUT.format(repetitions),),
        goals=(
            Goal("`import drake_rho` [s]", 0.5, medians["drake_rho"].processor),
            Goal("import and first plan [s]", 0.55, medians[_FIRST_PLAN].processor),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "pydantic"),
    )


_ABOUT = """\
Each work in {} fresh processes, in turn, from the first statement after the start of the
interpreter. Each line is timed alone, so what several need counts for each of them. Modules are
compiled by a round that does not count. The first plan is `rho.plan` of the paper's scenario: names
of the package are imported on first use."""


def _taken(code: str) -> Taken:
    command = [sys.executable, "-c", _CODE.format(code)]
    compiled = os.environ | {"PYTHONDONTWRITEBYTECODE": ""}
    done = subprocess.run(  # noqa: S603  # a fixed command
        command, capture_output=True, text=True, check=True, env=compiled
    )
    return Taken(*map(float, done.stdout.split()))
