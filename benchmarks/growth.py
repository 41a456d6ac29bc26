"""Growth of time and memory with the knots and with the vehicles, each size in its own process.

`python -m benchmarks.growth WORK SIZE CORES` is that process: it prints time and memory of a size.
`python -m benchmarks.growth` redraws the figure from the table.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from rich.progress import track

import drake_rho as rho
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import RESULTS, Cell, Goal, Table
from drake_rho.campaigns.memory import peak_memory
from drake_rho.display.common.style import COLOURS, MARKERS
from drake_rho.display.plots.formats import DOUBLE_COLUMN
from drake_rho.display.plots.publish import save_figure, styled

KNOTS, VEHICLES = (50, 500, 5000), (4, 40, 400, 4000)
"""Numbers of vehicles."""

REPETITIONS = 5
"""Processes for each size, of which the median counts."""

PICTURE = Path(__file__).parents[1] / "figures" / "growth.png"


def finer(knots: int) -> rho.Scenario:
    """Return the paper's UAV-1 on `knots` knots in 49 s, avoiding the sphere at every instant."""
    paper = rho.load_scenario("paper")
    grid = rho.Grid(paper.grid.duration / (knots - 1), knots)
    return rho.Scenario(f"{knots} knots", grid, paper.vehicles[:1], paper.limits, paper.obstacles)


def larger(vehicles: int) -> rho.Scenario:
    """Return copies of the paper's vehicles, starts and goals shifted by up to 50 m."""
    paper = rho.load_scenario("paper")
    rng = np.random.default_rng(0)
    fleet = []
    for number in range(vehicles):
        like = paper.vehicles[number % len(paper.vehicles)]
        shifts = rng.uniform(-50.0, 50.0, (2, 3))
        start = rho.State(like.start.position + shifts[0], like.start.velocity)
        goal = rho.State(like.goal.position + shifts[1], like.goal.velocity)
        fleet.append(rho.Vehicle(f"v{number}", start, goal))
    name = f"{vehicles} vehicles"
    return rho.Scenario(name, paper.grid, fleet, paper.limits, paper.obstacles, between_knots=False)


def measure(work: str, size: int) -> dict[str, float]:
    """Return times [s] and peak memory [MB] of one plan, from the scenario to the verified plan."""
    rho.plan_rho(larger(4))  # first calls do not count
    scenario = finer(size) if work == "knots" else larger(size)
    watch = Stopwatch()
    plan = rho.plan_convex(scenario) if work == "knots" else rho.plan_rho(scenario).plan
    if not rho.verify(plan).ok:
        raise RuntimeError(f"{scenario.name}: the plan does not hold")
    taken = watch.taken()
    return {
        "processor": taken.processor,
        "seconds": taken.wall,
        "megabytes": peak_memory(),
        "solver": plan.statistics.solver_seconds,
    }


def run() -> Table:
    """Measure every size, on all cores; and the largest fleet on one core and on two."""
    cores = os.cpu_count() or 1
    tasks = [("knots", size, cores) for size in KNOTS]
    tasks += [("vehicles", size, cores) for size in VEHICLES]
    tasks += [("vehicles", VEHICLES[-1], 1)]
    found = {}
    for task in track(tasks, description="sizes"):
        runs = [_in_process(*task) for _ in range(REPETITIONS)]
        found[task] = {key: median(each[key] for each in runs) for key in runs[0]}
    knots = [found["knots", size, cores] for size in KNOTS]
    vehicles = [found["vehicles", size, cores] for size in VEHICLES]
    save_figure(draw(knots, vehicles), PICTURE)
    rows: list[tuple[Cell, ...]] = [
        (
            work,
            size,
            used,
            each["processor"],
            each["seconds"],
            each["megabytes"],
            each["solver"],
        )
        for (work, size, used), each in found.items()
    ]
    alone = found["vehicles", VEHICLES[-1], 1]["seconds"]
    return Table(
        name="growth",
        title="Growth with the knots and with the vehicles",
        columns=(
            "work",
            "size",
            "cores",
            "median_processor_s",
            "median_wall_s",
            "peak_megabytes",
            "solver_seconds",
        ),
        rows=tuple(rows),
        notes=(_ABOUT,),
        goals=(
            Goal("exponent of processor time in K, 50 to 5000 knots", 1.3, _exponent(KNOTS, knots)),
            Goal("memory at 5000 knots [MB]", 500.0, knots[-1]["megabytes"]),
            Goal(
                "exponent of processor time in N, 40 to 4000 vehicles",
                1.02,
                _exponent(VEHICLES[1:], vehicles[1:]),
            ),
            Goal("memory with 4000 vehicles [MB]", 1000.0, vehicles[-1]["megabytes"]),
            Goal(
                "4000 vehicles: wall time on all cores / on one (goal: 1.6 times as fast)",
                1 / 1.6,
                vehicles[-1]["seconds"] / alone,
            ),
        ),
    )


_ABOUT = """\
Knots: UAV-1 of the paper around the sphere by `plan_convex`, at every instant, its 49 s divided
into ever finer steps. Vehicles: Example 4's work (ten windows) for fleets like the paper's, starts
and goals shifted at random, without coupling. Each size runs in a separate process, five times; a
time runs from the scenario record to the verified plan, after one small flight that does not
count. Memory is the largest of the process, of which the interpreter and Drake take some 125 MB.
The exponent is the slope of a straight line fitted to the logarithms; with few vehicles the calls
cost more than the arithmetic, so the fit in N begins at 40. One core means that the process is
confined to one."""


def _in_process(work: str, size: int, cores: int) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.growth", work, str(size), str(cores)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


def _exponent(sizes: tuple[int, ...], found: list[dict[str, float]]) -> float:
    seconds = [each["processor"] for each in found]
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


@styled
def draw(knots: Sequence[Mapping[str, float]], vehicles: Sequence[Mapping[str, float]]) -> Figure:
    """Draw time above and memory below, against knots on the left and vehicles on the right.

    Args:
        knots: time and memory of each size of `KNOTS`.
        vehicles: time and memory of each size of `VEHICLES`.
    """
    figure = Figure(figsize=(DOUBLE_COLUMN, 3.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    works = (("knots K of one vehicle", KNOTS, knots), ("vehicles N", VEHICLES, vehicles))
    for column, (work, sizes, found), colour, mark in zip(
        axes.T, works, COLOURS, MARKERS, strict=False
    ):
        for ax, key in zip(column, ("seconds", "megabytes"), strict=True):
            values = [each[key] for each in found]
            ax.loglog(sizes, values, color=colour, marker=mark)
            ax.grid(visible=True, which="minor", alpha=0.4)
        column[0].set_title(f"growth with the {work.split()[0]}")
        column[1].set_xlabel(work)
        column[1].set_xticks(sizes, labels=[f"{size}" for size in sizes])
        column[1].minorticks_on()
    axes[0, 0].set_ylabel("time to a verified\nplan [s]")
    axes[0, 0].yaxis.set_major_formatter("{x:g}")
    axes[1, 0].set_ylabel("peak memory [MB]")
    axes[1, 0].set_yticks([100, 200, 500, 1000], labels=["100", "200", "500", "1000"])
    axes[1, 0].yaxis.set_minor_formatter(NullFormatter())
    return figure


def redraw() -> None:
    """Redraw `figures/growth.png` from the last stored table."""
    with (RESULTS / "growth.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    cores = max(int(row["cores"]) for row in rows)
    found = {
        (row["work"], int(row["size"])): {
            "seconds": float(row["median_wall_s"]),
            "megabytes": float(row["peak_megabytes"]),
        }
        for row in rows
        if int(row["cores"]) == cores
    }
    knots = [found["knots", size] for size in KNOTS]
    save_figure(draw(knots, [found["vehicles", size] for size in VEHICLES]), PICTURE)


def _main(words: list[str]) -> None:
    """Measure one size or, without arguments, redraw the figure."""
    if not words:
        return redraw()
    work, size, cores = words[0], int(words[1]), int(words[2])
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, range(cores))
    print(json.dumps(measure(work, size)))  # noqa: T201  # read by the parent process
    return None


if __name__ == "__main__":
    _main(sys.argv[1:])
