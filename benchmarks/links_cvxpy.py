"""Two linked vehicles without obstacles, beside the cone program that is written with CVXPY."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Sequence

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.kept import outside
from benchmarks.peers import cvxpy_links
from benchmarks.stopwatch import Stopwatch, Taken, median
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

EQUAL = 1e-4
"""Goal: largest relative difference of costs."""

REACHED = 1e-3
"""Part of the link's limit within which its longest length counts as having reached it."""

COLUMNS = (
    "draws_with",
    "draws",
    "with_a_solution",
    "same_verdict",
    "median_difference",
    "largest_difference",
    "largest_excess_of_link_m",
    "median_processor_s",
    "median_wall_s",
    "slowest_processor_s",
    "median_processor_s_cvxpy",
    "median_wall_s_cvxpy",
    "slowest_processor_s_cvxpy",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One draw by both."""

    name: str
    """name of the draw"""
    limited: bool
    """true with limits on speed and acceleration"""
    cost: float
    """cost of the plan; infinite if there is none [m²/s⁴]"""
    peer: float
    """cost of the cone program; infinite without a solution [m²/s⁴]"""
    excess: float
    """largest length of the link at a knot beyond its limit [m]; -inf if there is no plan"""
    reached: bool
    """true if the link is at its limit at a knot"""
    taken: Taken
    """time from the scenario record to the plan, or to the failure"""
    peer_taken: Taken
    """time from the scenario record to the solution, or to the verdict that there is none"""

    @property
    def difference(self) -> float:
        """Relative difference of the costs; infinite if only one has a solution."""
        if math.isinf(self.cost) and math.isinf(self.peer):
            return 0.0
        return abs(self.cost / self.peer - 1.0) if math.isfinite(self.peer) else math.inf


def scene(seed: int) -> rho.Scenario:
    """Return one draw; those of odd seeds have limits on speed and acceleration.

    Limits are parts of what the plan without them needs, so some draws have no solution.
    """
    rng = np.random.default_rng([27, seed])
    radius, duration = float(rng.uniform(0.5, 8.0)), float(rng.uniform(5.0, 20.0))
    size, speed = 10.0 ** rng.uniform(0.5, 2.0), 10.0 ** rng.uniform(-1.0, 0.7)
    ends = _pair(rng, np.zeros(3), radius, speed), _pair(rng, _away(rng, size), radius, speed)
    vehicles = [rho.Vehicle(f"v{i}", *each) for i, each in enumerate(zip(*ends, strict=True))]
    link = rho.KeepIn(rho.Ball([0.0, 0.0, 0.0], radius), vehicles="v1", relative_to="v0")
    grid = rho.Grid.lasting(duration, step=duration / int(rng.integers(15, 61)))
    drawn = rho.Scenario(
        f"two linked, seed {seed}", grid, vehicles, requirements=[link], between_knots=False
    )
    return _limited(rng, drawn) if seed % 2 else drawn


def _pair(
    rng: np.random.Generator, around: FloatArray, radius: float, speed: float
) -> list[rho.State]:
    """Return states of both vehicles near a place, as far apart as 0.95 of the link."""
    second = around + _away(rng, radius * rng.uniform(0.1, 0.95))
    return [rho.State(each, rng.normal(0.0, speed, 3)) for each in (around, second)]


def _away(rng: np.random.Generator, length: float) -> FloatArray:
    """Return a vector of a length in a random direction."""
    way = rng.normal(size=3)
    return np.asarray(length * way / np.linalg.norm(way))


def _limited(rng: np.random.Generator, drawn: rho.Scenario) -> rho.Scenario:
    free = rho.plan(drawn)
    fleet = drawn.fleet
    slowest = np.linalg.norm([fleet.start_velocities, fleet.goal_velocities], axis=-1).max()
    fastest = np.linalg.norm(free.velocities, axis=-1).max()
    strongest = np.linalg.norm(free.accelerations, axis=-1).max()
    limits = rho.Limits(
        max_speed=float(max(rng.uniform(0.8, 1.1) * fastest, 1.01 * slowest)),
        max_acceleration=float(rng.uniform(0.6, 1.2) * strongest),
    )
    return dataclasses.replace(drawn, limits=limits)


def run(seeds: int = 50) -> Table:
    """Plan `seeds` draws by both, one after the other."""
    for first in range(2):  # loading and set-up do not count
        lap(scene(first))
    laps = [lap(scene(seed)) for seed in track(range(seeds), "two linked")]
    kinds = {
        "no limits": [each for each in laps if not each.limited],
        "limits on speed and acceleration": [each for each in laps if each.limited],
        "a link at its limit": [each for each in laps if each.reached],
        "any": laps,
    }
    worst = max(laps, key=lambda each: each.difference)
    return Table(
        name="links_cvxpy",
        title="Two linked vehicles, beside a cone program written with CVXPY",
        columns=COLUMNS,
        rows=tuple(_row(kind, some) for kind, some in kinds.items() if some),
        notes=(f"The largest difference is that of: {worst.name}.", _WORK, _LIMITATIONS),
        goals=(
            Goal("relative difference of costs, largest", EQUAL, worst.difference),
            Goal("draws on which verdicts differ", 0, len(laps) - _same(laps)),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "cvxpy", "clarabel"),
    )


def lap(scenario: rho.Scenario) -> Lap:
    """Plan one draw by both."""
    watch = Stopwatch()
    try:
        plan = rho.plan(scenario)
    except rho.InfeasibleError:
        plan = None
    taken, watch = watch.taken(), Stopwatch()
    answer = cvxpy_links.solve(scenario)
    peer_taken = watch.taken()
    excess = -math.inf if plan is None else outside(plan)
    link = scenario.requirements[0].set.support(np.array([1.0, 0.0, 0.0]))
    return Lap(
        name=scenario.name,
        limited=scenario.limits.max_speed is not None,
        cost=math.inf if plan is None else plan.cost,
        peer=answer.cost,
        excess=excess,
        reached=excess > -REACHED * float(link),
        taken=taken,
        peer_taken=peer_taken,
    )


def _same(laps: Sequence[Lap]) -> int:
    """Return the number of draws on which both have a solution, or neither has."""
    return sum(math.isinf(each.cost) == math.isinf(each.peer) for each in laps)


def _row(kind: str, laps: Sequence[Lap]) -> tuple[Cell, ...]:
    differences = [each.difference for each in laps]
    times, peers = [each.taken for each in laps], [each.peer_taken for each in laps]
    return (
        kind,
        len(laps),
        sum(math.isfinite(each.peer) for each in laps),
        _same(laps),
        statistics.median(differences),
        max(differences),
        max(each.excess for each in laps),
        *median(times).both,
        max(each.processor for each in times),
        *median(peers).both,
        max(each.processor for each in peers),
    )


_WORK = f"""\
Two vehicles from random states to random states, 3 to 100 m away, in 5 to 20 s on 15 to 60 steps;
their difference is kept in a ball of 0.5 to 8 m around zero at the knots. Draws of odd seeds limit
the norms of velocity and acceleration, to 0.8 to 1.1 and 0.6 to 1.2 of what the plan without them
needs; some of these have no solution, and both are to say so. The peer is one second-order cone
program with positions, velocities and accelerations as variables, by Clarabel with tolerances of
{cvxpy_links.TOLERANCE:g}. Both run in turn in one process, after two draws that do not count. Times
run from the scenario record to the plan or solution; the peer's include those of CVXPY. The excess
of the link is computed from the accelerations alone."""

_LIMITATIONS = """\
Limitations. A parametrised program of CVXPY that is solved several times would save a part of its
time. A draw without a solution counts with its time, and with a difference of 0 if both say so."""
