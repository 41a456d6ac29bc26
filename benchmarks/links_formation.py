"""A formation through a forest: offsets are kept before and behind it, and given up in between."""

from __future__ import annotations

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.linked import (
    COLUMNS,
    KEPT,
    METHOD,
    Trial,
    attempt,
    close,
    excess,
    faults,
    near,
    row,
)
from benchmarks.tables import Goal, Table

ROWS, COLUMNS_OF_FORMATION, SPACING = 3, 4, 3.0
"""Rows and columns of vehicles, and the distance of neighbours [m]."""

WITHIN, HELD, DURATION = 0.2, 5.0, 24.0
"""Distance from the offset [m], how long it is kept at both ends, and the whole flight [s]."""

SEPARATION, TREES = 1.0, 24
"""Distance of vehicles from each other [m], and number of trees."""

LIMIT = 150.0
"""Time limit of a plan [s]."""


def scene(seed: int) -> rho.Scenario:
    """Return one forest, with the formation in front of it."""
    offsets = np.array(
        [
            [-SPACING * i, SPACING * (j - (COLUMNS_OF_FORMATION - 1) / 2.0), 0.0]
            for i in range(ROWS)
            for j in range(COLUMNS_OF_FORMATION)
        ]
    )
    start, goal = np.array([0.0, 0.0, 5.0]), np.array([80.0, 0.0, 5.0])
    vehicles = [
        rho.Vehicle(f"d{i}", rho.State(start + each), rho.State(goal + each), radius=0.3)
        for i, each in enumerate(offsets)
    ]
    slots = [
        rho.KeepIn(
            rho.Ball(offsets[i] - offsets[0], WITHIN),
            vehicles=f"d{i}",
            relative_to="d0",
            active=active,
        )
        for i in range(1, len(offsets))
        for active in ((0.0, HELD), (DURATION - HELD, DURATION))
    ]
    return rho.Scenario(
        f"forest {seed}",
        rho.Grid.lasting(DURATION, step=0.5),
        vehicles,
        rho.Limits(max_speed=8.0, max_acceleration=5.0),
        _forest(np.random.default_rng(seed)),
        rho.Separation(SEPARATION),
        requirements=slots,
    )


def _forest(rng: np.random.Generator) -> list[rho.Cylinder]:
    """Return trees with at least 1.6 m between any two."""
    found = list[rho.Cylinder]()
    while len(found) < TREES:
        center = np.array([rng.uniform(22.0, 58.0), rng.uniform(-12.0, 12.0), 0.0])
        radius = float(rng.uniform(0.3, 0.8))
        gaps = [np.linalg.norm(each.center - center) - each.radius - radius for each in found]
        if all(gap > 1.6 for gap in gaps):
            found.append(rho.Cylinder(center, radius))
    return found


def run(seeds: int = 5) -> Table:
    """Plan `seeds` forests."""
    trials: list[Trial] = [attempt(scene(seed), LIMIT) for seed in track(range(seeds), "forests")]
    forests = tuple((each.name, *row([each])) for each in trials)
    return Table(
        name="links_formation",
        title="A formation of twelve through a forest, and in formation again behind it",
        columns=("forest", *COLUMNS),
        rows=(*forests, ("all", *row(trials))),
        notes=(faults(trials), _WORK, METHOD, _LIMITATIONS),
        goals=(
            Goal("forests not planned", 0, sum(not each.counts for each in trials)),
            Goal("farther than 0.2 m from an offset [m]", KEPT, excess(trials)),
            Goal("nearer to a tree than required [m]", KEPT, near(trials)),
            Goal("nearer to each other than required [m]", KEPT, close(trials)),
        ),
    )


_WORK = f"""\
Twelve vehicles of 0.3 m in {ROWS} rows, {SPACING:g} m apart, fly 80 m from rest to rest in
{DURATION:g} s, at most 8 m/s and 5 m/s², at least {SEPARATION:g} m from each other. For the first
and the last {HELD:g} s the position of each relative to the first vehicle is within {WITHIN:g} m of
its offset. In between stand {TREES} trees, endless cylinders of 0.3 to 0.8 m with at least 1.6 m
between them, and the formation may come apart. The planner has {LIMIT:g} s; `cut` counts the plans
that had not converged then."""

_LIMITATIONS = """\
Limitations. Five forests of one kind. That trees may be passed was not shown otherwise; they leave
room for a vehicle between any two of them."""
