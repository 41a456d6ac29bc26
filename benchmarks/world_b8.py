"""Random fields: one vehicle among spheres and boxes, beside Drake's graphs of convex sets."""

from __future__ import annotations

import multiprocessing
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.progress import track
from threadpoolctl import threadpool_limits

import drake_rho as rho
from benchmarks import oracle
from benchmarks.convex_sets import GCS, Lap, fly
from benchmarks.fleets import THIS_PACKAGE, Trial, attempts, findings
from benchmarks.oracle import Answer
from benchmarks.stopwatch import median
from benchmarks.tables import Cell, Goal, Table
from benchmarks.worlds import CHECKED, certified, percent_above, plan_within

OBSTACLES = (5, 10, 20, 40, 60)
"""Numbers of spheres and boxes."""

LIMIT = 20.0
"""Time limit beyond which a plan counts as a failure [s]."""

CERTIFIED, PATIENCE = 20, 10.0
"""Number of draws of each size whose plans are certified, and the time limit of each [s]."""

COLUMNS = (
    "obstacles",
    "method",
    "draws",
    "with_a_way",
    "success_percent_of_these",
    "breaking_limits",
    "median_processor_s",
    "median_wall_s",
    "worst_wall_s",
    "median_index",
    "median_index_over_the_others",
    "median_percent_above_bound",
)


def scenario(obstacles: int, seed: int) -> rho.Scenario:
    """Return one draw."""
    name = f"{obstacles} obstacles, seed {seed}"
    return rho.random_field(obstacles, np.random.default_rng(seed), name=name)


def run(seeds: int = 50, stores: Path | None = None) -> Table:
    """Run the oracle, the planner and the peer for `seeds` draws of each number of obstacles.

    Plans are runs of a campaign; `stores` is that of `attempts`. The oracle and the peer are not:
    they return a verdict, and a curve that `verify` does not support.
    """
    rows: list[tuple[Cell, ...]] = []
    plans, laps, answers = list[Trial](), list[Lap](), list[Answer]()
    for count in OBSTACLES:
        draws = range(seeds)
        asked = _in_processes(partial(_ask, count), draws, f"{count}: is there a path", 2)
        planned = _planned(count, seeds, stores)
        flown = _in_processes(partial(_fly, count), draws, f"{count}: graphs of convex sets", 1)
        ways = [answer.verdict == "way" for answer in asked]
        rows += [_row(count, ways, planned, flown), _row_of_peer(count, ways, planned, flown)]
        plans, laps, answers = plans + planned, laps + flown, answers + asked
    ways = [answer.verdict == "way" for answer in answers]
    return Table(
        name="world_b8",
        title="B8: one vehicle in random fields of spheres and boxes",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_of_the_oracle(answers, plans), findings(plans), *_NOTES, CHECKED, _LIMITATIONS),
        goals=(
            Goal(
                "draws with a path, failures [%]",
                0.0,
                100.0 - _success(ways, [plan.counts for plan in plans]),
            ),
            Goal("index above that of GCS, draws [%]", 5.0, _costlier(plans, laps)),
            Goal("index / that of GCS, median", 1.0, _over(plans, laps)),
            Goal("processor time / that of GCS, medians", 1.0, _slower(plans, laps)),
        ),
    )


def _planned(count: int, seeds: int, stores: Path | None) -> list[Trial]:
    """Plan all draws, and certify the first ones."""
    makes = [partial(scenario, count, seed) for seed in range(seeds)]
    planner, bound = partial(plan_within, seconds=LIMIT), partial(certified, PATIENCE)
    first = attempts(makes[:CERTIFIED], f"B8, {count}: certified", planner, bound, stores)
    rest = makes[CERTIFIED:]
    return first + (attempts(rest, f"B8, {count}", planner, stores=stores) if rest else [])


Found = TypeVar("Found")


def _in_processes(
    work: Callable[[int], Found], seeds: Sequence[int], what: str, processes: int
) -> list[Found]:
    """Return the results of some work for every seed, computed in fresh processes."""
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, fresh, _first_calls, (work,)) as pool:
        return list(track(pool.map(work, seeds), what, total=len(seeds)))


def _first_calls(work: Callable[[int], object]) -> None:
    """Use one thread a process, and load and set up everything before times count."""
    threadpool_limits(1)
    work(0)


def _ask(count: int, seed: int) -> Answer:
    return oracle.ask(scenario(count, seed))


def _fly(count: int, seed: int) -> Lap:
    return fly(scenario(count, seed), seed)


def _row(
    count: int, ways: Sequence[bool], plans: Sequence[Trial], laps: Sequence[Lap]
) -> tuple[Cell, ...]:
    seconds = [plan.seconds for plan in plans]
    good = [plan for plan in plans if plan.counts]
    return (
        count,
        THIS_PACKAGE,
        len(plans),
        sum(ways),
        _success(ways, [plan.counts for plan in plans]),
        0,
        statistics.median(plan.processor for plan in plans),
        statistics.median(seconds),
        max(seconds),
        statistics.median(plan.index for plan in good) if good else None,
        _over(plans, laps),
        percent_above(good),
    )


def _row_of_peer(
    count: int, ways: Sequence[bool], plans: Sequence[Trial], laps: Sequence[Lap]
) -> tuple[Cell, ...]:
    times = [lap.taken for lap in laps]
    good = [lap.index for lap in laps if lap.counts]
    over = _over(plans, laps)
    return (
        count,
        GCS,
        len(laps),
        sum(ways),
        _success(ways, [lap.counts for lap in laps]),
        sum(lap.verdict == "breaks limits" for lap in laps),
        *median(times).both,
        max(each.wall for each in times),
        statistics.median(good) if good else None,
        None if over is None else 1.0 / over,
        None,
    )


def _success(ways: Sequence[bool], counts: Sequence[bool]) -> float:
    """Return the percentage that counts of the draws with a path."""
    counted = [each for way, each in zip(ways, counts, strict=True) if way]
    return 100.0 * sum(counted) / len(counted) if counted else 100.0


def _over(plans: Sequence[Trial], laps: Sequence[Lap]) -> float | None:
    """Return the median of the plans' indices over the peer's, of draws in which both count."""
    both = zip(plans, laps, strict=True)
    parts = [plan.index / lap.index for plan, lap in both if plan.counts and lap.counts]
    return statistics.median(parts) if parts else None


def _costlier(plans: Sequence[Trial], laps: Sequence[Lap]) -> float | None:
    """Return the percentage of draws in which both count and the plan's index is above the peer's.

    By more than a thousandth, which accelerations that are constant in steps may cost.
    """
    both = zip(plans, laps, strict=True)
    above = [plan.index > 1.001 * lap.index for plan, lap in both if plan.counts and lap.counts]
    return 100.0 * sum(above) / len(above) if above else None


def _slower(plans: Sequence[Trial], laps: Sequence[Lap]) -> float:
    """Return the median processor time of the plans over that of the peer."""
    ours = statistics.median(plan.processor for plan in plans)
    return ours / median(lap.taken for lap in laps).processor


def _of_the_oracle(answers: Sequence[Answer], plans: Sequence[Trial]) -> str:
    verdicts = [answer.verdict for answer in answers]
    both = zip(verdicts, plans, strict=True)
    beyond = sum(plan.counts for verdict, plan in both if verdict != "way")
    return (
        f"Of {len(verdicts)} draws the oracle finds a path in {verdicts.count('way')}, one that "
        f"is too slow in {verdicts.count('too slow')} and none in {verdicts.count('none')}; of the "
        f"latter two {beyond} are planned all the same."
    )


_NOTES = (
    f"""\
The fields of `random_field`, seeds from 0: 10 m by 10 m by 5 m, a vehicle of 0.15 m from one
wall to the opposite one in twice the bang-bang time, at most 3 m/s and 3 m/s² along each axis,
half the obstacles spheres of radius 0.4 to 1.2 m, half boxes of side 0.4 to 2 m. An oracle of
the benchmark's own decides whether a draw has a path: the shortest path on a grid between the
shapes grown by the radius, at 0.2 m and where that finds none at 0.1 m, pulled straight, and
timed optimally within the limits. Its yes is a collision-free motion; its no is no proof.
Success is of the draws with a path. A plan that takes longer than {LIMIT:g} s counts as a
failure. The bound is that of `certify`, of the first {CERTIFIED} draws of each size, if found
within {PATIENCE:g} s; it includes no obstacles but spheres, which is part of the gap.""",
    """\
The peer is Drake's `GcsTrajectoryOptimization` with Clarabel, in the same run: regions by IRIS
around start, goal, points of the straight line between them and random points outside the
regions so far, at least 15 and at most 30 until they connect the ends; the shortest path through
them, by the convex relaxation and rounding; then the curve of order 5 of least index in the
regions of the path, continuous with its velocity, a quadratic program for given durations of its
pieces, and these by Powell's method, together T. Its index is the integral of its squared
acceleration over h. It is verified at 5000 samples. Where no such curve satisfies the limits, it
is the one without limits, which counts as violating them and not as a success. Its time includes
the regions.""",
)

_LIMITATIONS = """\
Limitations. The peer's curves are smooth and this package's accelerations are constant from knot
to knot, which costs less than a thousandth of the index here; the results differ by the path and
the timing. With more regions, other seeds of them or MOSEK the peer may find better paths; with
forty regions and Clarabel it takes ten to a hundred times as long. Neither uses the oracle's
path."""
