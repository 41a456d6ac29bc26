"""RMADER's world: ten vehicles that swap on a circle among boxes on trefoil knots."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.fleets import attempts, findings, percent
from benchmarks.tables import Goal, Table
from benchmarks.worlds import CHECKED, COLUMNS, plan_within, published, row, unhindered

BOXES = (10, 20, 50)
"""Numbers of moving boxes."""

DURATION, STEP = 5.0, 0.1
"""T and h [s]."""

LIMIT = 60.0
"""Time limit beyond which a plan counts as a failure [s]."""


def scenario(boxes: int, seed: int) -> rho.Scenario:
    """Return one draw."""
    rng, name = np.random.default_rng(seed), f"{boxes} boxes, seed {seed}"
    return rho.trefoil_swap(boxes, rng, duration=DURATION, step=STEP, name=name)


def run(seeds: int = 20, stores: Path | None = None) -> Table:
    """Plan `seeds` draws for each number of boxes; `stores` is that of `attempts`."""
    planner = partial(plan_within, seconds=LIMIT)
    found = {
        boxes: attempts(
            [partial(scenario, boxes, seed) for seed in range(seeds)],
            f"B7, {boxes} boxes",
            planner,
            unhindered,
            stores,
        )
        for boxes in BOXES
    }
    every = [trial for trials in found.values() for trial in trials]
    return Table(
        name="world_b7",
        title="B7: ten vehicles swap on a circle of 10 m among moving boxes",
        columns=COLUMNS,
        rows=(
            *(row(f"{boxes} boxes", DURATION, trials) for boxes, trials in found.items()),
            published("10 boxes", "RMADER, published", None, 100.0),
            published("10 boxes", "next best, published", None, 83.0),
        ),
        notes=(findings(every), _WORK, CHECKED, _LIMITATIONS),
        goals=tuple(
            Goal(f"{boxes} boxes, failures [%]", 0.0, 100.0 - percent(trials))
            for boxes, trials in found.items()
        ),
    )


_WORK = f"""\
The world of mit-acl/rmader, by `trefoil_swap`, seeds from 0: antipodal goals on a circle of 10 m,
at most 10 m/s, 20 m/s² and 30 m/s³ along each axis, spheres of 0.25 m diameter, and boxes of 0.5 m
that move on trefoil knots. T = {DURATION:g} s in steps of {STEP:g} s. Boxes may be anywhere within
the bound of their tracks' deviation from the trefoil, half a millimetre, so a vehicle that clears
the tracks by that much clears the boxes. A plan that takes longer than {LIMIT:g} s counts as a
failure. The bound is the index of the same flight without boxes and other vehicles, which is a
convex program; no plan can be below it, and none may reach it."""

_LIMITATIONS = """\
Limitations. The published percentages are of planners that run during the flight, each vehicle for
itself, with delayed communication. Here the motions of the boxes are known and the whole flight is
planned at once, beforehand: the same world, and another problem."""
