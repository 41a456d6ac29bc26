"""Cases of benchmarks on all cores, in fresh processes, with a progress bar."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from rich.progress import track

Case = TypeVar("Case")
Result = TypeVar("Result")

_AT_ONCE = 10
"""Number of cases that a process takes at a time."""


def on_all_cores(
    function: Callable[[Case], Result], cases: Sequence[Case], words: str, at_once: int = _AT_ONCE
) -> list[Result]:
    """Return a function's results for all cases, in their order."""
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), mp_context=fresh) as processes:
        done = processes.map(function, cases, chunksize=at_once)
        return list(track(done, words, total=len(cases)))
