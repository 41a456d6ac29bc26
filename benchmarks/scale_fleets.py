"""Time of large fleets with each of two solvers, and on several processes."""

from __future__ import annotations

import statistics
import time
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np

import drake_rho as rho
from benchmarks import fleet_b1
from benchmarks.fleet_b2 import LARGEST, LONGER, scenario
from benchmarks.fleets import COLUMNS, Planner, Trial, attempt, attempts, summary
from benchmarks.tables import Cell, Goal, Table
from drake_rho.campaigns.memory import peak_memory

SMALL, DOUBLE, TEN_THOUSAND, LONGEST = 200, 2000, 10_000, 30.0
"""Sizes planned on several processes, and the flight time of the smallest and the largest [s]."""

PATIENCE = 900.0
"""Time limit of a fleet on several processes [s]."""

WORKERS = 2
"""Number of processes for the largest."""

CROWD, SEEDS = 20, 50
"""Number of vehicles of each fleet of B1, and number of fleets."""


def run() -> Table:
    """Plan a thousand vehicles with each solver, ten thousand on several processes, and B1."""
    planners: dict[str, Planner] = {"Clarabel": rho.plan, "Daqp": with_daqp}
    alone = {
        name: attempts([partial(scenario, LARGEST, 0, LONGER)], f"{LARGEST}, {name}", planner)
        for name, planner in planners.items()
    }
    crowded = {
        name: attempts(
            [partial(fleet_b1.scenario, CROWD, seed) for seed in range(SEEDS)],
            f"B1, {name}",
            planner,
        )
        for name, planner in planners.items()
    }
    one, two = (_on_processes(DOUBLE, LONGER, count) for count in (1, WORKERS))
    small, large = (_on_processes(size, LONGEST, WORKERS) for size in (SMALL, TEN_THOUSAND))
    rows: list[tuple[Cell, ...]] = []
    for found, what in ((alone, f"{LONGER:g} s"), (crowded, "B1")):
        rows += [summary(trials, f"{name}, {what}") for name, trials in found.items()]
    rows.append(summary([one], f"Daqp, one process, {LONGER:g} s"))
    rows.append(summary([two], f"Daqp, {WORKERS} processes, {LONGER:g} s"))
    rows += [
        summary([each], f"Daqp, {WORKERS} processes, {LONGEST:g} s") for each in (small, large)
    ]
    every = [*alone.values(), *crowded.values(), [one, two, small, large]]
    medians = {
        name: statistics.median(trial.seconds for trial in trials)
        for name, trials in crowded.items()
    }
    slowest = max(trial.seconds for trials in crowded.values() for trial in trials)
    return Table(
        name="scale_fleets",
        title="Large fleets, one vehicle in every cubic metre",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_ABOUT,),
        goals=(
            Goal("fleets without a plan that holds", 0.0, _faults(every)),
            Goal(f"{LARGEST} vehicles with Clarabel [s]", 25.0, alone["Clarabel"][0].seconds),
            Goal(f"{LARGEST} vehicles with Daqp [s]", 10.0, alone["Daqp"][0].seconds),
            Goal(f"{TEN_THOUSAND} vehicles, {WORKERS} processes [s]", 300.0, large.seconds),
            Goal(f"{TEN_THOUSAND} vehicles, all processes [MB]", 12_000.0, large.megabytes),
            Goal(
                f"exponent from {SMALL} to {TEN_THOUSAND} vehicles", 1.15, _exponent(small, large)
            ),
            Goal(
                f"{DOUBLE} vehicles, {WORKERS} processes / one",
                1.0 / 1.7,
                two.seconds / one.seconds,
            ),
            Goal("B1, 20 vehicles, median with Clarabel [s]", 0.4, medians["Clarabel"]),
            Goal("B1, 20 vehicles, median with Daqp [s]", 0.4, medians["Daqp"]),
            Goal("B1, 20 vehicles, slowest [s]", 3.0, slowest),
        ),
    )


def with_daqp(scenario: rho.Scenario) -> rho.Plan:
    """Plan with `rho.plan` and DAQP for its programs."""
    return rho.plan(scenario, solver=rho.Daqp())


def _decoupled(scenario: rho.Scenario, executor: Executor | None = None) -> rho.Plan:
    """Plan like all sizes beyond 500; give up after `PATIENCE`."""
    began = time.perf_counter()

    def watch(words: str) -> None:
        if time.perf_counter() - began > PATIENCE:
            raise TimeoutError(f"no plan in {PATIENCE:g} s, {words}")

    return rho.plan(
        scenario,
        coupling=rho.decoupled,
        solver=rho.Daqp(),
        executor=executor,
        progress=watch,
    )


def _on_processes(vehicles: int, duration: float, count: int) -> Trial:
    """Plan one fleet, its programs solved by processes that have planned before."""
    fresh = get_context("forkserver")
    with ProcessPoolExecutor(count, mp_context=fresh) as workers:
        list(workers.map(_decoupled, [scenario(SMALL, 1, LONGEST)] * count))

        def memory() -> float:
            return peak_memory() + sum(workers.map(_peak_of_one, range(count)))

        planner = partial(_decoupled, executor=workers)
        return attempt(scenario(vehicles, 0, duration), planner, memory=memory)


def _peak_of_one(_: int) -> float:
    return peak_memory()


def _exponent(small: Trial, large: Trial) -> float:
    """Return the power of the number of vehicles by which the time grows."""
    more = np.log(large.vehicles / small.vehicles)
    return float(np.log(large.seconds / small.seconds) / more)


def _faults(every: list[list[Trial]]) -> float:
    """Count the fleets that do not count as planned."""
    return float(sum(not trial.counts for trials in every for trial in trials))


_ABOUT = f"""\
Random transitions by `rho.plan`: in a cube with a cubic metre for each vehicle, and those of B1,
20 vehicles in 4 m³, of {SEEDS} seeds. Times are from the scenario to the verified plan; memory is
the largest so far of the process and its planning processes. Plans are verified by dense samples
as well. Processes are started, and have planned a fleet of {SMALL}, before the time begins; they
plan decoupled, whatever the size."""
