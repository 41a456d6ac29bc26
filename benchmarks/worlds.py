"""Common parts of the benchmarks of worlds: time limits, bounds, and rows of their tables."""

from __future__ import annotations

import math
import signal
import statistics
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import drake_rho as rho
from benchmarks.fleets import THIS_PACKAGE, Trial, percent
from benchmarks.tables import Cell

COLUMNS = (
    "world",
    "flight_seconds",
    "method",
    "draws",
    "success_percent",
    "median_processor_s",
    "median_wall_s",
    "worst_wall_s",
    "mean_index",
    "mean_distance_m",
    "median_percent_above_bound",
    "peak_megabytes",
)
"""Columns of tables with a row for each world and duration."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """End the block with a `TimeoutError` after a time [s]; only in a process's main thread.

    It is raised when the interpreter is next active, so after a call of a solver, not in it.
    """

    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"not done in {seconds:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def plan_within(scenario: rho.Scenario, seconds: float) -> rho.Plan:
    """Plan with the package and a time limit.

    Raises:
        InfeasibleError: there is no plan, or none was found.
        SolverError: the solvers failed.
        TimeoutError: planning takes longer.
    """
    with at_most(seconds):
        return rho.plan(scenario)


def certified(seconds: float, plan: rho.Plan) -> float:
    """Return the certificate's lower bound on the index; NaN if there is none in time."""
    try:
        with at_most(seconds):
            return rho.certify(plan).lower_bound
    except (rho.DrakeRhoError, TimeoutError):
        return math.nan


def unhindered(plan: rho.Plan) -> float:
    """Return the index of the best plan without obstacles and separation, a lower bound of all."""
    return rho.plan_convex(plan.scenario.without_obstacles().without_separation()).cost


def step_of(duration: float, longest: float) -> float:
    """Return the longest step up to a given one that divides a duration [s]."""
    return duration / math.ceil(duration / longest - 1e-9)


def row(world: str, duration: float, trials: Sequence[Trial]) -> tuple[Cell, ...]:
    """Return the row of all draws of one world; times are of all, the rest of those that count."""
    good = [trial for trial in trials if trial.counts]
    seconds = [trial.seconds for trial in trials]
    return (
        world,
        duration,
        THIS_PACKAGE,
        len(trials),
        percent(trials),
        statistics.median(trial.processor for trial in trials),
        statistics.median(seconds),
        max(seconds),
        statistics.fmean(trial.index for trial in good) if good else None,
        statistics.fmean(trial.metres for trial in good) if good else None,
        percent_above(good),
        max(trial.megabytes for trial in trials),
    )


def percent_above(trials: Sequence[Trial]) -> float | None:
    """Return the median gap of indices to their bounds, over the indices, where known [%]."""
    gaps = [trial.gap for trial in trials if math.isfinite(trial.gap)]
    return 100.0 * statistics.median(gaps) if gaps else None


def published(
    world: str,
    method: str,
    draws: int | None,
    success: float | None = None,
    flight: float | None = None,
    metres: float | None = None,
) -> tuple[Cell, ...]:
    """Return the row of quoted figures; None where a source has none."""
    return (world, flight, method, draws, success, *[None] * 4, metres, None, None)


CHECKED = """\
A plan counts if neither `verify` nor dense samples find a violation at any instant. There are 100
samples of each step, integrated anew from the accelerations alone by code that shares nothing with
the package's checks, for pairs, obstacles with the vehicles' radii, and the boxes of positions,
velocities, accelerations and jerks. Distances count in full: 1 µm less is a failure, as is an
exception. Fleets are planned one after another, in one process, after one fleet that does not
count. A wall time runs from the scenario record to the verified plan, or to the failure, a
processor time to the plan."""
