"""Timing several implementations of one piece of work, in rounds that hit all alike."""

from __future__ import annotations

import dataclasses
import gc
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.progress import track

from drake_rho import Flight, Plan, Scenario, verify
from drake_rho.scenario.fields import FloatArray

SAME_INDEX = 1e-6
"""Relative difference of the index up to which two answers are the same."""


class Skipped(Exception):  # noqa: N818  # not an error: a peer that is not installed
    """An implementation cannot run here; the message says why."""


@dataclasses.dataclass(frozen=True)
class Entry:
    """One implementation."""

    name: str
    """as in the table"""
    run: Callable[[Scenario], Plan | Flight]
    """from the scenario to what is flown"""


@dataclasses.dataclass(frozen=True)
class Lap:
    """One run of one implementation."""

    seconds: float
    """from the scenario to the verified flight"""
    index: float
    """f (13) [m²/s⁴]"""
    verified: bool
    """whether every constraint of the scenario holds"""
    solver_seconds: float
    """what the solver reports for itself, summed over the programs; 0 if nothing was recorded"""


@dataclasses.dataclass(frozen=True)
class Result:
    """All laps of one implementation."""

    name: str
    """as in the table"""
    laps: tuple[Lap, ...]
    """empty if it could not run"""
    reference: float
    """the right index [m²/s⁴]"""
    failure: str = ""
    """why it could not run"""

    @property
    def index_error(self) -> float:
        """Largest relative difference from the right index, with its sign."""
        return max((lap.index / self.reference - 1.0 for lap in self.laps), key=abs)

    @property
    def verified(self) -> bool:
        """Whether every lap's flight was."""
        return bool(self.laps) and all(lap.verified for lap in self.laps)

    @property
    def counts(self) -> bool:
        """Whether it did the work: only then does its time mean anything."""
        return self.verified and abs(self.index_error) <= SAME_INDEX

    @property
    def median(self) -> float:
        """Median time [s]."""
        return statistics.median(lap.seconds for lap in self.laps)

    @property
    def least(self) -> float:
        """Least time [s]."""
        return min(lap.seconds for lap in self.laps)

    @property
    def outside_solver(self) -> float:
        """Median part of the time that is not the solver's own."""
        return statistics.median(1.0 - lap.solver_seconds / lap.seconds for lap in self.laps)


def peer(name: str, accelerations: Callable[[Scenario], FloatArray]) -> Entry:
    """An entry for a peer, which finds accelerations [m/s²], shape (N, K-1, 3)."""
    return Entry(name, lambda scenario: Plan.from_accelerations(scenario, accelerations(scenario)))


def race(
    entries: Sequence[Entry],
    make_scenario: Callable[[], Scenario],
    reference: float,
    repetitions: int,
) -> list[Result]:
    """Run every entry once a round, after one round that is not counted.

    Args:
        entries: the implementations.
        make_scenario: makes the scenario anew for each lap, so that nothing kept in it is reused.
        reference: the right index [m²/s⁴].
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
            except Exception as error:  # whatever a peer's tools raise is its result
                failures[entry.name] = f"failed: {error}"
            else:
                if number:
                    laps[entry.name].append(lap)
    return [
        Result(name, () if name in failures else tuple(done), reference, failures.get(name, ""))
        for name, done in laps.items()
    ]


def _lap(entry: Entry, scenario: Scenario) -> Lap:
    with _collected():
        began = time.perf_counter()
        flown = entry.run(scenario)
        report = verify(flown)
        seconds = time.perf_counter() - began
    return Lap(seconds, flown.cost, report.ok, flown.statistics.solver_seconds)


@contextmanager
def _collected() -> Iterator[None]:
    """No implementation clears up after another."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
