"""Global optima of single vehicles among obstacles of every kind, and attempts to beat bounds."""

from __future__ import annotations

import dataclasses
from contextlib import suppress

import numpy as np

import drake_rho as rho
from benchmarks.all_cores import on_all_cores
from benchmarks.bound_scenes import PACKAGES, Lap, among_shapes, bounded
from benchmarks.tables import Goal, Table

GAP, SECONDS = 0.001, 20.0
"""Gap that is asked for, and time for it [s]."""

STARTS, BEATEN = 5, 1e-6
"""Random motions of every scene from which plans are iterated, and relative fall below the bound
that beats it."""


@dataclasses.dataclass(frozen=True)
class Tried:
    """Bound of one scene, and what was tried against it."""

    lap: Lap
    """bound of the scene"""
    plans: int
    """number of plans that were found from random motions"""
    least: float
    """least cost of these over the bound; infinite without any"""


def run(seeds: int = 200) -> Table:
    """Bound as many scenes, and plan them from random motions, on all cores."""
    tried = on_all_cores(attempt, range(seeds), "single vehicles", at_once=1)
    laps = [each.lap for each in tried]
    open_ = [each for each in laps if each.gap > GAP]
    return Table(
        name="bound_shapes",
        title="Global optima among obstacles of every kind",
        columns=(
            *("scene", "gap", "cheaper than `plan`", "branches", "processor time [s]"),
            *("bound by the file's check, part", "plans tried", "least of them over the bound"),
        ),
        rows=tuple(
            (
                *(each.lap.name, each.lap.gap, each.lap.cheaper, each.lap.nodes, each.lap.seconds),
                *(each.lap.checked, each.plans, each.least),
            )
            for each in tried
        ),
        notes=(
            "One vehicle with a radius of 0.2 m, 12 m in 8 s, one to twelve spheres, boxes, "
            f"cylinders, ellipsoids and polytopes. A gap of {GAP:.1%} is asked for, in at most "
            f"{SECONDS:.0f} s. {sum(each.plans for each in tried)} plans were iterated from random "
            "motions and verified.",
        ),
        goals=(
            Goal(f"scenes above {GAP:.1%} of {seeds}", round(0.025 * seeds), len(open_)),
            Goal("plans that beat a bound", 0, sum(each.least < 1.0 - BEATEN for each in tried)),
        ),
        packages=PACKAGES,
    )


def attempt(seed: int) -> Tried:
    """Bound one scene, and iterate plans from random motions."""
    scenario, rng = among_shapes(seed), np.random.default_rng(seed)
    lap, plans, least = bounded(scenario, GAP, SECONDS), 0, np.inf
    if lap.cost is None:
        return Tried(lap, plans, least)
    bound = lap.cost * (1.0 - lap.gap)
    for _ in range(STARTS):
        around = rng.normal(size=(1, scenario.grid.knots - 1, 3)) * rng.uniform(0.3, 2.0)
        with suppress(rho.InfeasibleError, rho.SolverError):
            found = rho.plan_scp(scenario, reference=rho.Plan.from_accelerations(scenario, around))
            if rho.verify(found).ok:
                plans, least = plans + 1, min(least, found.cost / bound)
    return Tried(lap, plans, least)
