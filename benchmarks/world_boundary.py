"""One vehicle on both sides of the boundary of feasibility: time of an answer.

The duration is bisected until the scenes on both sides of the boundary differ by a ten thousandth.
Motions there have next to no freedom, and rounds of half-spaces, or steps of a restoration, could
continue for minutes.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.tables import Cell, Goal, Table

KINDS: dict[str, Callable[[float], rho.Limits]] = {
    "acceleration box": lambda a: rho.Limits(acceleration=rho.Box([-a] * 3, [a] * 3)),
    "max_acceleration": lambda a: rho.Limits(max_acceleration=a),
    "max_thrust": lambda a: rho.Limits(max_thrust=9.81 + a),
    "max_tilt": lambda a: rho.Limits(max_tilt=0.1 * a, max_thrust=14.0),
    "max_speed": lambda a: rho.Limits(max_speed=2.0 * a, max_acceleration=2.0 * a),
}
"""Limits of one kind each, for a magnitude."""

_UP = np.array([0.0, 0.0, 1.0])

_PRECISION = 1e-4
"""Relative difference of the durations on both sides."""

_ANSWER, _DIAGNOSIS = 5.0, 15.0
"""Goals: longest time of a plan, and of a diagnosis or a shortest plan [s]."""


_MENDED = "median to mend [s]", "slowest to mend [s]"


class Trial(NamedTuple):
    """Result of one scene."""

    planned: bool
    """true if there was a plan"""
    undecided: bool
    """true if there was neither a plan nor a reason"""
    seconds: float
    """processor time [s]"""


def scene(seed: int, kind: str, duration: float) -> rho.Scenario:
    """Return one of the random scenes: past one to three spheres, from rest to rest."""
    rng = np.random.default_rng([24, seed])
    knots, goal = int(rng.integers(15, 41)), rng.uniform([8, -4, -2], [25, 4, 4])
    size = float(rng.uniform(1, 4))
    spheres = [
        rho.Sphere(part * goal + rng.uniform(-1, 1, 3) + _UP, float(rng.uniform(0.5, 1.5)))
        for part in rng.uniform(0.3, 0.7, rng.integers(1, 4))
    ]
    return rho.Scenario(
        f"{kind} {seed}",
        rho.Grid(duration / (knots - 1), knots),
        [rho.Vehicle("a", rho.State(_UP), rho.State(goal + _UP), radius=0.2)],
        limits=KINDS[kind](size),
        obstacles=spheres,
    )


def trial(scenario: rho.Scenario) -> Trial:
    """Plan a scene."""
    began, planned, undecided = time.process_time(), False, False
    try:
        planned = rho.verify(rho.plan(scenario)).ok
    except rho.InfeasibleError:
        pass
    except rho.SolverError:
        undecided = True
    return Trial(planned, undecided, time.process_time() - began)


def boundary(seed: int, kind: str) -> list[Trial]:
    """Return the trials of a bisection; the last two of each outcome are next to the boundary."""
    trials, low, high = list[Trial](), 0.5, 1.0
    while not (last := trial(scene(seed, kind, high))).planned:
        low, high = high, 2.0 * high
        trials.append(last)
    trials.append(last)
    while high - low > _PRECISION * high:
        middle = (low + high) / 2.0
        trials.append(trial(scene(seed, kind, middle)))
        low, high = (low, middle) if trials[-1].planned else (middle, high)
    return trials


def mended(seed: int, kind: str) -> tuple[float, float]:
    """Return the processor time of `diagnose` and of `shortest_plan` for one small scene [s]."""
    scenario = scene(seed, kind, 4.0)
    began = time.process_time()
    rho.diagnose(scenario)
    diagnosed = time.process_time() - began
    rho.shortest_plan(scenario)
    return diagnosed, time.process_time() - began - diagnosed


def run(seeds: int = 20) -> Table:
    """Bisect scenes of each kind, and diagnose them."""
    rows, slowest, slowest_mended = list[tuple[Cell, ...]](), 0.0, 0.0
    for kind in KINDS:
        tried = [
            one for seed in track(range(seeds), description=kind) for one in boundary(seed, kind)
        ]
        looked = [each for seed in range(seeds) for each in mended(seed, kind)]
        seconds = [each.seconds for each in tried]
        slowest, slowest_mended = max(slowest, *seconds), max(slowest_mended, *looked)
        undecided = sum(each.undecided for each in tried)
        rows.append((kind, len(tried), undecided, float(np.median(seconds)), max(seconds)))
        rows[-1] += (float(np.median(looked)), max(looked))
    return Table(
        "world_boundary",
        "Both sides of the boundary of feasibility",
        ("limit", "scenes", "undecided", "median [s]", "slowest [s]", *_MENDED),
        tuple(rows),
        notes=(
            "One vehicle past one to three spheres on 15 to 40 knots; durations are bisected to "
            f"{_PRECISION:g}, all scenes of the bisections count. To mend: `diagnose` and "
            "`shortest_plan` of a scene that lasts 4 s. Times are of the processor, on one core.",
        ),
        goals=(
            Goal("slowest answer [s]", _ANSWER, slowest),
            Goal("slowest diagnosis or shortest plan [s]", _DIAGNOSIS, slowest_mended),
        ),
    )
