"""Timing of several implementations of one task, in rounds with equal conditions."""

from __future__ import annotations

import dataclasses
import gc
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.progress import track

from benchmarks.stopwatch import Stopwatch, Taken, median
from drake_rho import Flight, Plan, Scenario, verify
from drake_rho.scenario.fields import FloatArray

SAME_INDEX = 1e-6
"""Relative difference of the index up to which two answers are equal."""


class Skipped(Exception):  # noqa: N818  # not an error: a peer that is not installed
    """Signal that an implementation cannot run here; the message says why."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One implementation."""

    name: str
    """name in the table"""
    run: Callable[[Scenario], Plan | Flight]
    """function from the scenario to the flight"""


@dataclasses.dataclass(frozen=True)
class Lap:
    """One run of one implementation."""

    taken: Taken
    """time from the scenario to the verified flight"""
    index: float
    """f (13) [m²/s⁴]"""
    verified: bool
    """true if every constraint of the scenario holds"""
    solver_seconds: float
    """wall time reported by the solver [s], summed over the programs; 0 if not recorded"""


@dataclasses.dataclass(frozen=True)
class Result:
    """All runs of one implementation."""

    name: str
    """name in the table"""
    laps: tuple[Lap, ...]
    """runs; empty if it could not run"""
    reference: float | None
    """reference index [m²/s⁴]; None if implementations may differ"""
    failure: str = ""
    """reason why it could not run"""

    @property
    def index_error(self) -> float:
        """Largest relative difference from the reference index, with its sign."""
        reference = self.laps[0].index if self.reference is None else self.reference
        return max((lap.index / reference - 1.0 for lap in self.laps), key=abs)

    @property
    def verified(self) -> bool:
        """True if every run's flight satisfies the constraints."""
        return bool(self.laps) and all(lap.verified for lap in self.laps)

    @property
    def counts(self) -> bool:
        """True if it did the work: only then does its time count."""
        return self.verified and abs(self.index_error) <= SAME_INDEX

    @property
    def median(self) -> Taken:
        """Median times."""
        return median(lap.taken for lap in self.laps)

    @property
    def least(self) -> float:
        """Least processor time [s]."""
        return min(lap.taken.processor for lap in self.laps)

    @property
    def outside_solver(self) -> float:
        """Median fraction of the wall time outside the solver."""
        return statistics.median(1.0 - lap.solver_seconds / lap.taken.wall for lap in self.laps)


def peer(name: str, accelerations: Callable[[Scenario], FloatArray]) -> Entry:
    """Return an entry for a peer that computes accelerations [m/s²], shape (N, K-1, 3)."""
    return Entry(name, lambda scenario: Plan.from_accelerations(scenario, accelerations(scenario)))


def race(
    entries: Sequence[Entry],
    make_scenario: Callable[[], Scenario],
    reference: float | None,
    repetitions: int,
) -> list[Result]:
    """Run every entry once a round, after one round that does not count.

    Args:
        entries: the implementations.
        make_scenario: creates the scenario anew for each run, so that no cached value is reused.
        reference: the reference index [m²/s⁴]; None if implementations may differ.
        repetitions: number of rounds.
    """
    failures: dict[str, str] = {}
    laps: dict[str, list[Lap]] = {entry.name: [] for entry in entries}
    for number in track(range(repetitions + 1), "rounds"):
        for entry in entries:
            if entry.name in failures:
                continue
            try:
                lap = _lap(entry, make_scenario())
            except Skipped as reason:
                failures[entry.name] = f"skipped: {reason}"
            except Exception as error:  # errors of a peer's tools are its result
                failures[entry.name] = f"failed: {error}"
            else:
                if number:
                    laps[entry.name].append(lap)
    return [
        Result(name, () if name in failures else tuple(done), reference, failures.get(name, ""))
        for name, done in laps.items()
    ]


def _lap(entry: Entry, scenario: Scenario) -> Lap:
    with collected():
        watch = Stopwatch()
        flown = entry.run(scenario)
        report = verify(flown)
        taken = watch.taken()
    return Lap(taken, flown.cost, report.ok, flown.statistics.solver_seconds)


@contextmanager
def collected() -> Iterator[None]:
    """Collect garbage first, so that no implementation collects another's."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
