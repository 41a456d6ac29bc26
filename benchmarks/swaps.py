"""The shortest time in which a fleet on a circle swaps sides."""

from __future__ import annotations

import dataclasses
import time

import drake_rho as rho
from benchmarks.fleets import SAMPLED, THIS_PACKAGE
from benchmarks.sampling import sample
from benchmarks.tables import Cell

COLUMNS = (
    "method",
    "flight_seconds",
    "collision_free_percent",
    "least_distance_m",
    "index",
    "distance_m",
    "seconds",
)

ALONE = f"{THIS_PACKAGE}, nobody in the way"


@dataclasses.dataclass(frozen=True)
class Swap:
    """Shortest flight found."""

    duration: float
    """duration T [s]"""
    kept: bool
    """true if it satisfies every constraint"""
    least: float
    """least distance of any pair, by dense samples [m]"""
    metres: float
    """total distance of all vehicles [m]"""
    index: float
    """f (13) [m²/s⁴]"""
    seconds: float
    """time to find and verify it [s]"""

    def row(self, method: str) -> tuple[Cell, ...]:
        """Return the values in the order of `COLUMNS`."""
        free = 100.0 if self.kept else 0.0
        return (method, self.duration, free, self.least, self.index, self.metres, self.seconds)


def box(most: float) -> rho.Box:
    """Return the box of up to `most` in both directions of every axis."""
    return rho.Box([-most] * 3, [most] * 3)


def shortest(scenario: rho.Scenario) -> Swap:
    """Find the least duration on as many knots, and verify the plan.

    Raises:
        InfeasibleError: there is no plan.
    """
    began = time.perf_counter()
    plan = rho.shortest_plan(scenario)
    report = rho.verify(plan)
    seconds = time.perf_counter() - began
    found, separation = sample(plan), scenario.separation
    apart = separation is None or found.least >= separation.distance - SAMPLED
    return Swap(
        duration=plan.scenario.grid.duration,
        kept=report.ok and apart,
        least=found.least,
        metres=found.metres,
        index=plan.cost,
        seconds=seconds,
    )


def published(method: str, duration: str, free: str) -> tuple[Cell, ...]:
    """Return the row of a quoted figure."""
    return (method, duration, free, None, None, None, None)


METHOD = """\
The duration is that of `shortest_plan`: bisection to 1e-4 of it, with the same knots, without a
proof that none is shorter, as the planner may miss a plan. The line with nobody in the way is the
same fleet without separation: the time that its slowest vehicle needs alone, a lower bound for any
fleet on these knots. A flight counts if `verify` finds no violation at any instant, and no two
vehicles are closer than the separation less 1 µm at any of 100 samples of each step, computed
independently of the package; the line with nobody in the way has no separation to satisfy, and its
least distance shows how demanding the separation is. Seconds are of the whole search with the
verification."""
