"""Wall time and processor time of a piece of work, with its threads and its processes."""

from __future__ import annotations

import dataclasses
import resource
import statistics
import time
from collections.abc import Iterable

_elsewhere = [0.0]
"""Sum of the processor times that processes which keep running have reported [s]."""


@dataclasses.dataclass(frozen=True)
class Taken:
    """Time that a piece of work took."""

    wall: float
    """on the wall [s]: it includes waiting for other work on the machine"""
    processor: float
    """of processors [s], summed over threads and processes"""

    @property
    def both(self) -> tuple[float, float]:
        """Processor time and wall time, as columns of a table [s]."""
        return self.processor, self.wall

    def __add__(self, other: Taken) -> Taken:
        return Taken(self.wall + other.wall, self.processor + other.processor)


class Stopwatch:
    """Begin to measure.

    Processes count once they have ended, and those that keep running as far as they report.
    """

    def __init__(self) -> None:
        self._began = _now()

    def taken(self) -> Taken:
        """Return the time since the beginning."""
        now = _now()
        return Taken(now.wall - self._began.wall, now.processor - self._began.processor)


def reported(processor: float) -> None:
    """Count processor time [s] of a process that keeps running."""
    _elsewhere[0] += processor


def median(times: Iterable[Taken]) -> Taken:
    """Return the median wall time beside the median processor time."""
    both = list(times)
    return Taken(
        statistics.median(each.wall for each in both),
        statistics.median(each.processor for each in both),
    )


def _now() -> Taken:
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    children = ended.ru_utime + ended.ru_stime
    return Taken(time.perf_counter(), time.process_time() + children + _elsewhere[0])
