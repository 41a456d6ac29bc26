"""Common parts of the benchmarks of linked fleets: one plan, judged by dense samples as well."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Sequence

import numpy as np

import drake_rho as rho
from benchmarks.clearance import clearance
from benchmarks.kept import SAMPLES, dense_positions, outside
from benchmarks.sampling import least_distance
from benchmarks.tables import Cell
from drake_rho.scenario.fields import FloatArray

LIMIT = 60.0
"""Time limit of a plan [s]."""

KEPT = 1e-5
"""Goal: distance that a dense sample may be outside of a set, or nearer than asked [m]."""

COLUMNS = (
    "scenes",
    "planned",
    "cut",
    "excess_m",
    "too_near_obstacles_m",
    "too_near_each_other_m",
    "median_seconds",
    "slowest_seconds",
)
"""Columns of `row`."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """One plan, or its failure."""

    name: str
    """name of the scene"""
    vehicles: int
    """number of vehicles"""
    seconds: float
    """time from the scenario record to the verified plan, or to the failure [s]"""
    cost: float = math.nan
    """f (13) [m²/s⁴]; NaN without a plan"""
    cut: bool = False
    """true if the time limit ended planning before it converged"""
    excess: float = -math.inf
    """largest distance outside of a required set [m]; negative inside"""
    near: float = -math.inf
    """largest distance nearer to an obstacle than required [m]; negative beyond"""
    close: float = -math.inf
    """largest distance nearer to each other than required [m]; negative beyond"""
    fault: str = ""
    """reason for not counting"""

    @property
    def counts(self) -> bool:
        """True if a plan was found and verified."""
        return not self.fault


def attempt(scenario: rho.Scenario, limit: float = LIMIT) -> Trial:
    """Plan a scene, verify the plan and sample it."""
    count, began = len(scenario.vehicles), time.perf_counter()
    try:
        plan = rho.plan(scenario, options=rho.Options(time_limit=limit))
        report = rho.verify(plan)
    except rho.DrakeRhoError as error:
        fault = f"{type(error).__name__}: {str(error).splitlines()[0]}"
        return Trial(scenario.name, count, time.perf_counter() - began, fault=fault)
    seconds = time.perf_counter() - began
    positions = np.moveaxis(dense_positions(plan), 0, 1)
    grid = scenario.grid
    times: FloatArray = np.linspace(grid.start, grid.end, len(positions))
    asked = scenario.separation
    close = -np.inf if asked is None else asked.distance - least_distance(positions, asked)
    return Trial(
        scenario.name,
        count,
        seconds,
        plan.cost,
        plan.statistics.cut,
        outside(plan),
        -clearance(scenario, times, positions),
        close,
        "" if report.ok else f"{len(report.violations)} constraints violated",
    )


def row(trials: Sequence[Trial]) -> tuple[Cell, ...]:
    """Return what all scenes of a row have in common; empty where nothing was asked."""
    seconds = [each.seconds for each in trials]
    found: list[Cell] = [len(trials), sum(each.counts for each in trials)]
    found.append(sum(each.cut for each in trials))
    for worst in (excess(trials), near(trials), close(trials)):
        found.append(worst if math.isfinite(worst) else None)
    return (*found, statistics.median(seconds), max(seconds))


def excess(trials: Sequence[Trial]) -> float:
    """Return the largest distance outside of a required set [m]."""
    return max(each.excess for each in trials)


def near(trials: Sequence[Trial]) -> float:
    """Return the largest distance nearer to an obstacle than required [m]."""
    return max(each.near for each in trials)


def close(trials: Sequence[Trial]) -> float:
    """Return the largest distance nearer to each other than required [m]."""
    return max(each.close for each in trials)


def faults(trials: Sequence[Trial]) -> str:
    """Return what did not count, and the slowest scene."""
    slowest = max(trials, key=lambda each: each.seconds)
    lines = [f"{each.name}: {each.fault}." for each in trials if each.fault]
    said = "Not planned: " + " ".join(lines) if lines else "Every scene was planned and verified."
    return f"{said} The slowest: {slowest.name}, {slowest.seconds:.3g} s."


METHOD = f"""\
A plan counts if `verify` finds no violation at any instant. Distances in the table are of {SAMPLES}
samples of each step, integrated anew from the accelerations alone by code that shares nothing with
the package's checks: how far outside of a required set (a negative number is a margin), and how
much nearer than required, radii included. Times run from the scenario record to the verified plan,
in one process, one after the other."""
