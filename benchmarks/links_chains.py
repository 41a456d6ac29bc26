"""Chains of relays that follow a leader among obstacles: random scenes around known motions."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

from rich.progress import track

import drake_rho as rho
from benchmarks.chain_scenes import DURATION, STEPS, chain_scene
from benchmarks.linked import (
    COLUMNS,
    KEPT,
    LIMIT,
    METHOD,
    Trial,
    attempt,
    excess,
    faults,
    near,
    row,
)
from benchmarks.tables import Cell, Goal, Table

_SIZES = ((2, 4), (5, 7), (8, 10), (2, 10))
"""Fewest and most vehicles of each row."""


def run(seeds: int = 50) -> Table:
    """Plan `seeds` scenes."""
    attempt(chain_scene(0).scenario)  # loading and set-up do not count
    trials, known = list[Trial](), dict[str, float]()
    for seed in track(range(seeds), "chains"):
        scene = chain_scene(seed)
        if not rho.verify(scene.known).ok:
            raise RuntimeError(f"{scene.scenario.name}: the known motion does not hold")
        trials.append(attempt(scene.scenario))
        known[scene.scenario.name] = scene.known.cost
    rows = [_row(size, trials, known) for size in _SIZES]
    return Table(
        name="links_chains",
        title="Chains of relays among obstacles, each with a known motion",
        columns=("vehicles", *COLUMNS, "median_known_cost_over_found"),
        rows=tuple(each for each in rows if each is not None),
        notes=(faults(trials), _WORK, METHOD, _LIMITATIONS),
        goals=(
            Goal("scenes not planned", 0, sum(not each.counts for each in trials)),
            Goal("link longer than its limit [m]", KEPT, excess(trials)),
            Goal("nearer to an obstacle than required [m]", KEPT, near(trials)),
        ),
    )


def _row(
    size: tuple[int, int], trials: Sequence[Trial], known: dict[str, float]
) -> tuple[Cell, ...] | None:
    some = [each for each in trials if size[0] <= each.vehicles <= size[1]]
    over = [known[each.name] / each.cost for each in some if each.counts]
    if not some:
        return None
    return (f"{size[0]} to {size[1]}", *row(some), statistics.median(over) if over else None)


_WORK = f"""\
A leader flies 72 m along a winding path from rest to rest in {DURATION:g} s on {STEPS} steps,
relays of 0.3 m behind it. Each is linked to the one before it: their positions are within 2.5 to
9 m of each other at every instant. 12 to 34 obstacles, spheres or endless upright cylinders of 1
to 4 m, are at least 0.5 m from the known motion, in which relays follow along the leader's path at
0.75 or 0.92 of the link, or nearer where the path behind the leader is too short for that. Limits
are 1.3 times its highest speed and 1.5 times its highest acceleration; half of the scenes have
three waypoints of the leader, to be passed within 0.5 m. The known motion itself passes `verify`.
The planner does not know it, and has {LIMIT:g} s for a scene; `cut` counts the plans that had not
converged then."""

_LIMITATIONS = """\
Limitations. The planner was tried on these scenes while it was written. The known motion was not
made to be cheap, so its cost says only that the plan found is no detour. Relays may be as near to
each other as they like: there is no separation."""
