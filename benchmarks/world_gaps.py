"""Fleets through a gap in a wall: random scenes, each built around a known plan."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

import drake_rho as rho
from benchmarks.gap_scenes import KINDS, GapScene, gap_scene
from benchmarks.tables import Cell, Goal, Table

_FEWEST, _MOST = 4, 24
"""Numbers of vehicles of a scene."""

_MISSED, _SLOWEST = 1.0 / 60.0, 15.0
"""Goals: fraction of scenes without a plan, and processor time of one [s]."""


class Outcome(NamedTuple):
    """Result of one scene."""

    planned: bool
    """true if there is a plan that holds"""
    seconds: float
    """processor time [s]"""
    cheaper: float
    """cost of the known plan over that of the plan found; 0 without one"""


def scene(number: int) -> GapScene:
    """Return one of the random scenes; kinds alternate."""
    rng = np.random.default_rng([24, number])
    count = int(rng.integers(_FEWEST, _MOST + 1))
    return gap_scene(KINDS[number % len(KINDS)], count, rng)


def outcome(drawn: GapScene) -> Outcome:
    """Plan a scene."""
    began = time.process_time()
    try:
        plan = rho.plan(drawn.scenario)
    except (rho.InfeasibleError, rho.SolverError):
        return Outcome(planned=False, seconds=time.process_time() - began, cheaper=0.0)
    seconds = time.process_time() - began
    return Outcome(rho.verify(plan).ok, seconds, drawn.known.cost / plan.cost)


def run(seeds: int = 20) -> Table:
    """Plan scenes of each kind."""
    found: dict[str, list[Outcome]] = {kind: [] for kind in KINDS}
    for number in range(seeds * len(KINDS)):
        drawn = scene(number)
        found[drawn.kind].append(outcome(drawn))
    every = [each for outcomes in found.values() for each in outcomes]
    missed = sum(not each.planned for each in every) / len(every)
    slowest = max(each.seconds for each in every)
    return Table(
        "world_gaps",
        f"Fleets of {_FEWEST} to {_MOST} through a gap, each with a known plan",
        ("gap", "scenes", "planned", "median time [s]", "slowest [s]", "known cost / found"),
        tuple(_row(kind, outcomes) for kind, outcomes in found.items()),
        notes=("Times are of the processor, on one core. Costs are compared by their median.",),
        goals=(
            Goal("part of the scenes that is missed", _MISSED, missed),
            Goal("slowest scene [s]", _SLOWEST, slowest),
        ),
    )


def _row(kind: str, outcomes: list[Outcome]) -> tuple[Cell, ...]:
    seconds = [each.seconds for each in outcomes]
    return (
        kind,
        len(outcomes),
        sum(each.planned for each in outcomes),
        float(np.median(seconds)),
        max(seconds),
        float(np.median([each.cheaper for each in outcomes if each.planned] or [np.nan])),
    )
