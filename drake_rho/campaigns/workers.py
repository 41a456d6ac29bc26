"""Local worker processes for a campaign, replaced when one of them dies."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from drake_rho.scenario.errors import DrakeRhoError

_Result = TypeVar("_Result")


_STARTS = 3
"""Number of attempts to start the first processes."""


class Workers(Executor):
    """A `ProcessPoolExecutor` of spawned processes that is replaced when one of them has died.

    Running tasks then fail with `BrokenProcessPool` and may be submitted again. Each process uses
    one core, leaves Ctrl-C to its parent, and ends when its parent has ended.

    Args:
        count: number of processes.

    Raises:
        ValueError: the count is below 1.
        DrakeRhoError: the processes do not start.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise ValueError(f"workers: got {count}, expected at least 1")
        self.at_once = 2 * count  # so that no process waits for its next task
        self._count = count
        self._pool = self._started()
        for _ in range(_STARTS):
            try:
                self.submit(_load).result()
                break
            except BrokenProcessPool:
                continue
        else:
            raise DrakeRhoError(
                "workers: got processes that end at once, expected ones that start; in a script, "
                'start them under: if __name__ == "__main__"'
            )

    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """Submit a task as `Executor.submit` does, with new processes if the pool is broken."""
        with _interrupts_blocked():
            try:
                return self._pool.submit(fn, *args, **kwargs)
            except BrokenProcessPool:
                self._pool.shutdown(wait=False)
                self._pool = self._started()
                return self._pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Shut down as `Executor.shutdown` does; `cancel_futures` ends running tasks as well."""
        processes = list((getattr(self._pool, "_processes", None) or {}).values())
        self._pool.shutdown(wait=wait and not cancel_futures, cancel_futures=cancel_futures)
        if cancel_futures:
            for process in processes:
                process.kill()

    def _started(self) -> ProcessPoolExecutor:
        # A fork copies the locks that threads of its parent hold, but not these threads.
        fresh = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._count, fresh, initializer=_begin)


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C in processes started within, until they ignore it by themselves."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Initialise a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _load()


def _load() -> None:
    """Load the modules that runs need; loading takes longer than many runs."""
    import drake_rho.campaigns.runs  # noqa: F401


def _end_with_parent() -> None:
    """End this process when its parent ends; it would wait for work for ever otherwise."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
