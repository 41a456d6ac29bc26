"""Cost of smoothing in the fleets of benchmark B1: margins beside plans without."""

from __future__ import annotations

import dataclasses
from collections import defaultdict

import numpy as np

import drake_rho as rho
from benchmarks.fleet_b1 import DURATIONS, STEP, scenario
from benchmarks.stopwatch import Stopwatch, Taken
from benchmarks.tables import Cell, Goal, Table

WIDTHS = (0.5, 1.0)
"""Widths of the averages, as parts of a step."""


def run(seeds: int = 6) -> Table:
    """Plan fleets of every size with and without smoothing; a third as many of the largest."""
    rows: list[tuple[Cell, ...]] = []
    worst, violated = 0.0, 0
    for count in DURATIONS:
        found = defaultdict[tuple[float, int], list[tuple[float, float, float, bool]]](list)
        for seed in range(seeds if count <= 12 else max(1, seeds // 3)):
            plain, taken = _planned(scenario(count, seed))
            for part in WIDTHS:
                for times in (1, 2, 3):
                    smoothing = rho.Smoothing(part * STEP, times)
                    found[part, times].append(_beside(plain, taken, smoothing))
        for (part, times), each in found.items():
            ratios, processor, wall, holds = map(np.array, zip(*each, strict=True))
            worst, violated = max(worst, float(ratios.max())), violated + int(np.sum(~holds))
            ratio = [float(of(ratios)) for of in (np.mean, np.median, np.max)]
            slower = float(np.median(processor)), float(np.median(wall))
            rows.append((count, part, times, len(each), *ratio, *slower))
    return Table(
        name="smoothing_b1",
        title="Smoothing in the fleets of B1",
        columns=(
            "vehicles",
            "width [steps]",
            "averages",
            "fleets",
            "cost ratio, mean",
            "median",
            "largest",
            "processor time ratio, median",
            "wall time ratio, median",
        ),
        rows=tuple(rows),
        notes=(_WORK,),
        goals=(
            Goal("largest cost ratio", 1.02, worst),
            Goal("plans that violate a constraint", 0.0, float(violated)),
        ),
    )


def _planned(scenario: rho.Scenario) -> tuple[rho.Plan, Taken]:
    watch = Stopwatch()
    return rho.plan(scenario), watch.taken()


def _beside(
    plain: rho.Plan, before: Taken, smoothing: rho.Smoothing
) -> tuple[float, float, float, bool]:
    """Return ratios of cost, processor and wall time to those without, and whether all holds."""
    plan, taken = _planned(dataclasses.replace(plain.scenario, smoothing=smoothing))
    slower = taken.processor / before.processor, taken.wall / before.wall
    return plan.cost / plain.cost, *slower, rho.verify(plan).ok


_WORK = """\
Fleets of `fleet_b1`, planned with `rho.plan` without smoothing and with averages over a half and a
whole step of 0.2 s. Costs are those of the plans that are averaged; times are of planning, each
run once. A ratio below 1 means that the second search found a better plan. Every smooth motion was
verified."""
