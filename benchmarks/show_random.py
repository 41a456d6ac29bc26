"""Random shows of fifty to three hundred vehicles, judged by dense samples."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.sampling import sample
from benchmarks.show_scenes import APART, random_show
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import Goal, Table

PACKAGES = ("drake-rho", "drake", "numpy", "scipy", "daqp")
"""Packages that a show is planned with."""

_WITHIN = 1e-6
"""Violation of the separation that counts as rounding, relative to it."""


@dataclasses.dataclass(frozen=True)
class Lap:
    """One show."""

    vehicles: int
    scenes: int
    planned: bool
    ok: bool
    """whether `rho.verify` finds no violation"""
    least: float
    """least distance of two vehicles by dense samples, with downwash [m]"""
    duration: float
    """of the whole show [s]"""
    longer: float
    """largest time of a transition beyond the least of its longest flight, relative"""
    gap: float
    """of the assignment's sum of squares from its bound"""
    seconds: float
    """processor time of planning [s]"""


def run(seeds: int = 20) -> Table:
    """Plan and judge as many random shows, on all cores."""
    laps = on_all_cores(lap, range(seeds), "random shows", at_once=1)
    return Table(
        name="show_random",
        title="Random shows",
        columns=(
            *("vehicles", "scenes", "planned", "verified", "least distance, samples [m]"),
            *("show [s]", "longer than its bound", "assignment above its bound"),
            "processor time [s]",
        ),
        rows=tuple(
            (
                *(each.vehicles, each.scenes, each.planned, each.ok, each.least),
                *(each.duration, each.longer, each.gap, each.seconds),
            )
            for each in laps
        ),
        notes=(
            "Pads, two to four formations of half to all vehicles (rings, spheres, cubes, upright "
            "grids, random points), limits, holds, steps, take-offs and landings are drawn. The "
            "separation is 1 m, twice as much vertically. Samples integrate the accelerations, 100 "
            "a step. The bound of a transition is the least time of its longest flight.",
        ),
        goals=goals_of(laps, APART.distance),
        packages=PACKAGES,
    )


def goals_of(laps: Sequence[Lap], apart: float) -> tuple[Goal, ...]:
    """Return the goals of shows: all planned, none closer than a distance [m]."""
    planned = [each for each in laps if each.planned]
    wrong = sum(not each.ok or each.least < apart * (1.0 - _WITHIN) for each in planned)
    return (
        Goal("shows without a plan", 0, len(laps) - len(planned)),
        Goal("violated, by `rho.verify` or by samples", 0, wrong),
    )


def lap(seed: int) -> Lap:
    """Plan and judge one random show."""
    return judged(random_show(np.random.default_rng(seed)))


def judged(show: rho.Show) -> Lap:
    """Plan and judge a show."""
    sizes = len(show.pads.positions), len(show.scenes)
    watch = Stopwatch()
    try:
        plan = rho.plan_show(show, solver=rho.Daqp())
    except rho.DrakeRhoError:
        return Lap(*sizes, False, False, np.nan, np.nan, np.nan, np.nan, watch.taken().processor)
    seconds = watch.taken().processor
    certificate = rho.certify_show(show, plan)
    return Lap(
        *sizes,
        planned=True,
        ok=rho.verify(plan).ok,
        least=sample(plan).least,
        duration=plan.scenario.grid.duration,
        longer=max(each.duration / each.bound - 1.0 for each in certificate.transitions),
        gap=certificate.gap,
        seconds=seconds,
    )
