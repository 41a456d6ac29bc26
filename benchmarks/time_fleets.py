"""Ten vehicles on tracks at once, beside the least time of the slowest one alone."""

from __future__ import annotations

import dataclasses
import math

from rich.progress import track

import drake_rho as rho
from benchmarks.least_times import Found, found, within
from benchmarks.sampling import sample
from benchmarks.stopwatch import median
from benchmarks.tables import Cell, Goal, Table
from benchmarks.time_fleet_scenes import APART, BESIDE, RADIUS, VEHICLES, alone, scene
from benchmarks.time_scenes import STEPS, THRUST

DRAWS = 12

LIMIT = 600.0
"""Time limit of one fleet [s]."""

MOST, MISSED = 1.05, 2.0 / 12.0
"""Goals: T over that of the slowest vehicle alone, and part of the draws that may take longer."""

COLUMNS = (
    "draw",
    "slowest vehicle alone, T [s]",
    "all at once, T [s]",
    "ratio",
    "verified",
    "least distance of two [m]",
    "nearest sphere less the radius [m]",
    "plan, processor [s]",
    "plan, wall [s]",
    "one vehicle alone, median, processor [s]",
    "one vehicle alone, median, wall [s]",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One fleet, and each of its vehicles alone."""

    name: str
    """name of the scenario"""
    fleet: Found
    """all at once"""
    each: tuple[Found, ...]
    """each vehicle alone"""

    @property
    def slowest(self) -> float | None:
        """Least time of the slowest vehicle alone [s]; None if one has no plan."""
        times = [one.duration for one in self.each]
        known = [time for time in times if time is not None]
        return max(known) if len(known) == len(times) else None

    @property
    def ratio(self) -> float:
        """T of all at once over that of the slowest alone; infinite if one is missing."""
        if self.slowest is None or self.fleet.duration is None:
            return math.inf
        return self.fleet.duration / self.slowest

    def row(self) -> tuple[Cell, ...]:
        """Return the values in the order of `COLUMNS`."""
        sampled = None if self.fleet.plan is None else sample(self.fleet.plan)
        return (
            self.name,
            _digits(self.slowest),
            _digits(self.fleet.duration),
            _digits(self.ratio if math.isfinite(self.ratio) else None),
            self.fleet.holds,
            None if sampled is None else f"{sampled.least:.6f}",
            None if sampled is None else f"{sampled.clearance:.6f}",
            *self.fleet.taken.both,
            *median(one.taken for one in self.each).both,
        )


def lap(scenario: rho.Scenario) -> Lap:
    """Plan a fleet, and each of its vehicles alone."""
    each = tuple(found(alone(scenario, i)) for i in range(len(scenario.vehicles)))
    return Lap(scenario.name, found(scenario, within(LIMIT)), each)


def run(seeds: int = DRAWS) -> Table:
    """Plan `seeds` draws."""
    laps = [lap(scene(seed)) for seed in track(range(seeds), "ten vehicles at once")]
    beyond = sum(each.ratio > MOST for each in laps)
    faults = [f"- {one.name}: {_fault(one)}" for one in laps if math.isinf(one.ratio)]
    return Table(
        name="time_fleets",
        title=f"{VEHICLES} vehicles on tracks at once in the least time",
        columns=COLUMNS,
        rows=tuple(each.row() for each in laps),
        notes=(
            *(["\n".join(["Draws without verified plans:", "", *faults])] if faults else []),
            _WORK,
        ),
        goals=(
            Goal(f"part of the draws above {MOST:g}", MISSED, beyond / len(laps)),
            Goal("draws without verified plans", 0.0, len(faults)),
        ),
    )


def _fault(one: Lap) -> str:
    """Describe why a draw has no ratio."""
    words = [each.words or "the plan is violated" for each in one.each if not each.holds]
    if words:
        return f"{len(words)} vehicles alone: {words[0]}"
    return one.fleet.words or "the plan is violated"


def _digits(value: float | None) -> str | None:
    return None if value is None else f"{value:.4f}"


_WORK = f"""\
Tracks of three or four legs of 8 to 14 m, from rest to rest, norm of a + g e_z at most {THRUST:g}
m/s², {STEPS} steps for each leg, vehicles {APART:g} m apart at every instant. At each place the
vehicles pass points in a line, {BESIDE:g} m from one to the next, at times of their own that are
free. In draws of even seeds lines have one direction and one order, so that all fly the same track,
shifted; in those of odd seeds both are random at every place, and tracks cross. Near the middle of
each leg is a sphere of 0.5 to 1.2 m, which vehicles keep {RADIUS:g} m clear of. All arrive
together; T alone is the package's own, with the same knots and spheres. Distances are of 100
samples of each step by code that shares nothing with the package's checks. Time limit of a fleet:
{LIMIT:g} s, after which the fastest plan so far counts."""
