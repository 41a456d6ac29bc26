"""Fleets of 1000 to 4000 vehicles, and two processes against one that is held to one core.

`python -m benchmarks.fleet_growth VEHICLES PROCESSES` is one plan in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.fleet_b2 import LONGER, scenario
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table
from drake_rho.campaigns.memory import peak_memory

SIZES = (1000, 2000, 4000)
"""Numbers of vehicles."""

SHARED = 2000
"""Number of vehicles that two processes plan as well."""

_SMALL = 200
"""Number of vehicles of the plan that does not count."""


def run(repetitions: int = 3) -> Table:
    """Plan every size on one core, and one of them with two processes, in turn."""
    tasks = [*((size, 1) for size in SIZES), (SHARED, 2)]
    found: dict[tuple[int, int], list[tuple[Taken, float]]] = {task: [] for task in tasks}
    for number in track(range(repetitions * len(tasks)), "fleets"):
        task = tasks[number % len(tasks)]
        found[task].append(_in_process(*task))
    own = {task: median(taken for taken, _ in each) for task, each in found.items()}
    rows: list[tuple[Cell, ...]] = [
        (size, count, each.processor, each.wall, max(memory for _, memory in found[size, count]))
        for (size, count), each in own.items()
    ]
    seconds = [own[size, 1].processor for size in SIZES]
    exponent = float(np.polyfit(np.log(SIZES), np.log(seconds), 1)[0])
    return Table(
        name="fleet_growth",
        title="Growth of fleets, one vehicle in every cubic metre",
        columns=(
            "vehicles",
            "processes",
            "median, processor [s]",
            "median, wall [s]",
            "peak memory of the planning process [MB]",
        ),
        rows=tuple(rows),
        notes=(f"Times are of {repetitions} repetitions.", _ABOUT),
        goals=(
            Goal(f"exponent of processor time, {SIZES[0]} to {SIZES[-1]}", 1.15, exponent),
            Goal(
                f"{SHARED} vehicles, two processes / one on one core, wall",
                1.0 / 1.7,
                own[SHARED, 2].wall / own[SHARED, 1].wall,
            ),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "daqp"),
    )


_ABOUT = f"""\
Random transitions of `fleet_b2` in {LONGER:g} s, seed 0, by `rho.plan` with DAQP, each vehicle by
itself (`decoupled`); a time runs from the scenario record to the verified plan, after a fleet of
{_SMALL} that does not count. Every plan has a process of its own, all sizes in turn. With one
process it is held to one core. Two more processes (`executor=`) solve programs and search for paths
on all cores; processor times are sums over all three. Ratios on the wall mean little on a machine
that is busy with other work."""


def _in_process(vehicles: int, processes: int) -> tuple[Taken, float]:
    command = [sys.executable, "-m", "benchmarks.fleet_growth", str(vehicles), str(processes)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    wall, processor, memory = json.loads(done.stdout)
    return Taken(wall, processor), memory


def _main(vehicles: int, processes: int) -> None:
    """Plan one fleet in this process, and print wall time, processor time and memory."""
    if processes == 1:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        _planned(_SMALL)
        watch = Stopwatch()
        _planned(vehicles)
        taken = watch.taken()
    else:
        with ProcessPoolExecutor(processes, mp_context=get_context("forkserver")) as workers:
            _planned(_SMALL, workers)
            before, watch = _worked(workers), Stopwatch()
            _planned(vehicles, workers)
            taken = watch.taken()
            taken = Taken(taken.wall, taken.processor + _worked(workers) - before)
    print(json.dumps([taken.wall, taken.processor, peak_memory()]))  # noqa: T201  # for the parent


def _worked(workers: ProcessPoolExecutor) -> float:
    """Return the sum of the processes' processor times so far [s]."""
    return sum(dict(workers.map(_own_time, range(20))).values())


def _own_time(_: int) -> tuple[int, float]:
    """Return this process and its processor time [s], after a while in which others answer too."""
    time.sleep(0.02)
    return os.getpid(), time.process_time()


def _planned(vehicles: int, workers: ProcessPoolExecutor | None = None) -> None:
    plan = rho.plan(
        scenario(vehicles, 0, LONGER), coupling="decoupled", solver="daqp", executor=workers
    )
    if not rho.verify(plan).ok:
        raise RuntimeError(f"{vehicles} vehicles: the plan does not hold")


if __name__ == "__main__":
    _main(int(sys.argv[1]), int(sys.argv[2]))
