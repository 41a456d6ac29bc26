"""More time never hurts: random scenes at rest, each planned again with longer durations.

A plan for a duration gives one for any longer one: it is slowed down on as many knots, or extended
by hovering at the goals for more knots. So a longer flight without a plan is a fault wherever the
shortest one has a plan.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.tables import Cell, Goal, Table
from benchmarks.worlds import plan_within
from drake_rho.scenario.shapes.base import Shape

LONGER = (1.25, 1.6, 2.5)
"""Durations over that of the shortest flight."""

LIMIT = 60.0
"""Time limit beyond which a plan counts as none [s]."""

_ROOM = rho.Box([-5.0, -3.0, -2.0], [5.0, 3.0, 2.0])

_LIMITS: dict[str, Callable[[float], rho.Limits]] = {
    "max_acceleration": lambda a: rho.Limits(_ROOM, max_acceleration=a),
    "acceleration box": lambda a: rho.Limits(_ROOM, acceleration=rho.Box([-a] * 3, [a] * 3)),
    "max_acceleration, max_speed": lambda a: rho.Limits(_ROOM, max_acceleration=a, max_speed=2.5),
    "boxes": lambda a: rho.Limits(
        _ROOM, rho.Box([-2.0] * 3, [2.0] * 3), acceleration=rho.Box([-a] * 3, [a] * 3)
    ),
}
"""Limits of one kind each, for an acceleration."""


class Trial(NamedTuple):
    """Result of one scene."""

    planned: bool
    """true if its shortest flight has a plan"""
    longer: int
    """number of longer flights planned"""
    violations: int
    """number of them without a plan although the shortest flight has one"""
    seconds: float
    """wall time of the slowest of all these plans [s]"""


def run(seeds: int = 200) -> Table:
    """Plan scenes; kinds of limits alternate."""
    found: dict[str, list[Trial]] = {kind: [] for kind in _LIMITS}
    kinds = list(_LIMITS)
    for seed in track(range(seeds), description="longer flights"):
        kind = kinds[seed % len(kinds)]
        found[kind].append(_trial(scene(seed, kind)))
    every = [each for trials in found.values() for each in trials]
    return Table(
        "world_longer",
        "Longer flights of the same scenes",
        (
            "limits",
            "scenes",
            "planned",
            "longer flights",
            "violations",
            "median [s]",
            "slowest [s]",
        ),
        tuple(_row(kind, trials) for kind, trials in found.items()),
        notes=(
            "One to five vehicles from rest to rest in a box with one to six boxes and spheres at "
            "rest. Longer flights last "
            + ", ".join(f"{each:g}" for each in LONGER)
            + " times as long, on as many knots and on the same step. The seconds are those of "
            f"the slowest plan of a scene; a plan that takes more than {LIMIT:g} s counts as none.",
        ),
        goals=(Goal("violations", 0, sum(each.violations for each in every)),),
    )


def scene(seed: int, kind: str) -> rho.Scenario:
    """Return one of the random scenes; many have no plan for their duration."""
    rng = np.random.default_rng([24, seed])
    while True:
        try:
            return _drawn(rng, f"{kind}, seed {seed}", kind)
        except rho.ScenarioError:  # a vehicle begins too close to an obstacle or another
            continue


def _drawn(rng: np.random.Generator, name: str, kind: str) -> rho.Scenario:
    count, knots = int(rng.integers(1, 6)), int(rng.integers(12, 32))
    ends = (
        rng.uniform([-5, -3, -2], [-3, 3, 2], (count, 3)),
        rng.uniform([3, -3, -2], [5, 3, 2], (count, 3)),
    )
    both_ways = rng.random() < 0.3
    vehicles = [
        rho.Vehicle(f"v{i}", rho.State(goal), rho.State(start), radius=0.1)
        if both_ways and i % 2
        else rho.Vehicle(f"v{i}", rho.State(start), rho.State(goal), radius=0.1)
        for i, (start, goal) in enumerate(zip(*ends, strict=True))
    ]
    shapes = [_shape(rng) for _ in range(rng.integers(1, 7))]
    acceleration = float(rng.uniform(0.5, 3.0))
    duration = rng.uniform(1.0, 1.6) * 2.0 * np.sqrt(9.0 / acceleration)
    separation = rho.Separation(0.5, downwash=2.0) if count > 1 else None
    grid = rho.Grid(duration / (knots - 1), knots)
    return rho.Scenario(name, grid, vehicles, _LIMITS[kind](acceleration), shapes, separation)


def _shape(rng: np.random.Generator) -> Shape:
    centre = rng.uniform([-2.5, -3, -2], [2.5, 3, 2])
    if rng.random() < 0.4:
        return rho.Sphere(centre, float(rng.uniform(0.4, 1.4)))
    half = rng.uniform(0.2, 1.6, 3)
    return rho.Box(centre - half, centre + half)


def _trial(scenario: rho.Scenario) -> Trial:
    """Plan one scene and its longer flights."""
    planned, slowest = _planned(scenario)
    grids = [
        grid
        for factor in LONGER
        for grid in (
            rho.Grid(factor * scenario.grid.step, scenario.grid.knots),
            rho.Grid(scenario.grid.step, 1 + int(np.ceil(factor * (scenario.grid.knots - 1)))),
        )
    ]
    violations = 0
    for grid in grids if planned else ():
        found, seconds = _planned(scenario.on_grid(grid))
        violations, slowest = violations + (not found), max(slowest, seconds)
    return Trial(planned, len(grids) if planned else 0, violations, slowest)


def _planned(scenario: rho.Scenario) -> tuple[bool, float]:
    """Return whether there is a plan that holds, and how long it took [s]."""
    began = time.perf_counter()
    try:
        found = rho.verify(plan_within(scenario, LIMIT)).ok
    except (rho.DrakeRhoError, TimeoutError):
        found = False
    return found, time.perf_counter() - began


def _row(kind: str, trials: list[Trial]) -> tuple[Cell, ...]:
    seconds = [each.seconds for each in trials]
    return (
        kind,
        len(trials),
        sum(each.planned for each in trials),
        sum(each.longer for each in trials),
        sum(each.violations for each in trials),
        float(np.median(seconds)),
        max(seconds),
    )
