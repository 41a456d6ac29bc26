"""One vehicle through corridors of overlapping boxes at given times, beside CVXPY's program."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence

from rich.progress import track

import drake_rho as rho
from benchmarks.corridor_scenes import FEWEST, LEAST_STEPS, MOST, STEP, corridor
from benchmarks.kept import outside
from benchmarks.linked import KEPT
from benchmarks.peers import cvxpy_links
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table

EQUAL = 1e-5
"""Goal: largest relative difference of costs at the knots."""

COLUMNS = (
    "space",
    "required",
    "corridors",
    "planned",
    "median_difference",
    "largest_difference",
    "excess_m",
    "median_cost_above_knots",
    "largest_cost_above_knots",
    "median_processor_s",
    "median_wall_s",
    "slowest_processor_s",
    "median_processor_s_cvxpy",
    "median_wall_s_cvxpy",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One corridor at the knots or at every instant."""

    name: str
    """name of the corridor"""
    flat: bool
    """true in two dimensions"""
    every_instant: bool
    """true if boxes are kept between knots as well"""
    cost: float
    """f (13) [m²/s⁴]; NaN without a plan that holds"""
    peer: float
    """cost of the program at the knots [m²/s⁴]"""
    excess: float
    """largest distance outside of a box, at the knots or at dense samples [m]"""
    taken: Taken
    """time from the scenario record to the verified plan, or to the failure"""
    peer_taken: Taken
    """time from the scenario record to the solution"""

    @property
    def difference(self) -> float:
        """Relative difference of the costs; infinite without a plan."""
        return abs(self.cost / self.peer - 1.0) if math.isfinite(self.cost) else math.inf


def run(seeds: int = 20) -> Table:
    """Plan `seeds` corridors at the knots and at every instant, and solve the peer's program."""
    for first in range(2):  # loading and set-up do not count
        laps_of(first)
    laps = [each for seed in track(range(seeds), "corridors") for each in laps_of(seed)]
    at_knots = [each for each in laps if not each.every_instant]
    worst = max(at_knots, key=lambda each: each.difference)
    rows = [
        _row(laps, flat=flat, every_instant=every_instant)
        for flat in (True, False)
        for every_instant in (False, True)
        if any(each.flat == flat for each in laps)
    ]
    return Table(
        name="links_corridors",
        title="Corridors of overlapping boxes at given times, beside a program written with CVXPY",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(f"The largest difference at the knots is that of: {worst.name}.", _WORK, _LIMITS),
        goals=(
            Goal("relative difference of costs at the knots, largest", EQUAL, worst.difference),
            Goal("corridors not planned", 0, sum(math.isnan(each.cost) for each in laps)),
            Goal("outside of a box [m]", KEPT, max(each.excess for each in laps)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel"),
    )


def laps_of(seed: int) -> list[Lap]:
    """Plan one corridor at the knots and at every instant, beside the peer's program."""
    at_knots = corridor(seed)
    watch = Stopwatch()
    peer = cvxpy_links.solve(at_knots).cost
    peer_taken = watch.taken()
    return [
        _lap(each, peer, peer_taken, flat=seed % 2 == 0)
        for each in (at_knots, corridor(seed, every_instant=True))
    ]


def _lap(scenario: rho.Scenario, peer: float, peer_taken: Taken, *, flat: bool) -> Lap:
    cost, excess, watch = math.nan, -math.inf, Stopwatch()
    try:
        plan = rho.plan(scenario)
        if rho.verify(plan).ok:
            cost = plan.cost
        taken = watch.taken()
        excess = outside(plan)
    except rho.DrakeRhoError:
        taken = watch.taken()
    return Lap(scenario.name, flat, scenario.between_knots, cost, peer, excess, taken, peer_taken)


def _row(laps: Sequence[Lap], *, flat: bool, every_instant: bool) -> tuple[Cell, ...]:
    some = [each for each in laps if (each.flat, each.every_instant) == (flat, every_instant)]
    differences = [each.difference for each in some]
    above = [each.cost / each.peer - 1.0 for each in some]
    times, peer = [each.taken for each in some], median(each.peer_taken for each in some)
    return (
        "flat" if flat else "three dimensions",
        "every instant" if every_instant else "knots",
        len(some),
        sum(math.isfinite(each.cost) for each in some),
        None if every_instant else statistics.median(differences),
        None if every_instant else max(differences),
        max(each.excess for each in some),
        statistics.median(above) if every_instant else None,
        max(above) if every_instant else None,
        *median(times).both,
        max(each.processor for each in times),
        *((None, None) if every_instant else peer.both),
    )


_WORK = f"""\
One vehicle from rest to rest through {FEWEST} to {MOST} boxes, each in its interval of time, the
ends of which it shares with its neighbours: then the vehicle is in both. Boxes hold the pieces of a
random polyline of 2 to 10 m, with 0.2 to 1.5 m to spare on each side; flat ones have no height.
Times follow the lengths at 2 to 5 m/s, on steps of {STEP:g} s, at least {LEAST_STEPS} of them in a
box. There are no other limits; the cost is the sum of squared accelerations. The peer is one
quadratic program with positions, velocities and accelerations as variables, by Clarabel with
tolerances of {cvxpy_links.TOLERANCE:g}, at the knots. Both run in turn in one process, after two
corridors that do not count. Times run from the scenario record to the verified plan, or to the
peer's solution; the peer's include those of CVXPY. The excess is computed from the accelerations
alone, at the knots or at 100 samples of each step. Costs at every instant are relative to those of
the peer's program at the knots."""

_LIMITS = """\
Limitations. Corridors of this kind are the last part of the planner fastpathplanning of Marcucci
and others, which also finds the boxes and the times, and whose curves are Bézier curves; here boxes
and times are given, and that planner is not run."""
