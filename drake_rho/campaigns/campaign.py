"""`campaign`: carry out the runs of a study that are not in its store yet.

Runs are sent to an executor in chunks of about a tenth of a second, which keeps the overhead small.
Results are written as soon as they come back, so that an interrupted campaign can be continued by
the next call.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from queue import SimpleQueue

from drake_rho.campaigns.results import Results
from drake_rho.campaigns.runs import ERROR, Done, Run, do_all, package_version, row_of
from drake_rho.campaigns.store import Store
from drake_rho.campaigns.study import Study
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import DrakeRhoError

CHUNK = 0.1
"""Expected total time of the runs of a chunk, from times of earlier runs of their kinds [s]."""

_MAX_CHUNK = 100
"""Largest number of runs in a chunk."""

_AT_ONCE = 256
"""Number of chunks submitted at a time to an executor without an attribute `at_once`."""

_DEATHS_TOGETHER, _DEATHS = 2, 4
"""Number of worker deaths after which a run that they were computing is tried alone, to see
whether it is the cause, and number of deaths after which it is given up."""


class CampaignError(DrakeRhoError):
    """Failure of the executor, not of a run; earlier results are kept."""


@dataclasses.dataclass(frozen=True)
class SoFar:
    """Progress of a campaign."""

    done: int
    """number of runs in the store"""
    failed: int
    """number of these runs that were not solved or violate a constraint"""
    total: int
    """number of runs of the study"""

    def __str__(self) -> str:
        """Return a text like '12 of 100 runs done, 1 failed'."""
        return f"{self.done} of {self.total} runs done, {self.failed} failed"


Watch = Callable[[SoFar], None]


@checked
def campaign(
    study: Study,
    store: str | Path,
    *,
    executor: Executor | None = None,
    progress: Watch | None = None,
) -> Results:
    """Carry out the runs of a study that are not in its store yet.

    Args:
        study: scenarios, methods, repetitions and seed.
        store: path of an SQLite file, created if it does not exist. An extended study continues in
            its store.
        executor: executor (PEP 3148) whose workers can import this package, such as
            `drake_rho.campaigns.workers.Workers`, or Dask's from `Client.get_executor()`. If not
            given, runs are carried out sequentially in this process.
        progress: called with the progress so far whenever runs were written; `print` will do.

    Returns:
        The results in the store.

    Raises:
        ScenarioError: a scenario file of the study cannot be read, or no draw of a source is a
            valid scenario; nothing is planned then.
        StoreError: the store belongs to another study or version, or cannot be written.
        CampaignError: the executor failed. Earlier results are kept, as when the call is
            interrupted, and the same call continues.

    Examples:
        >>> study = rho.Study(
        ...     name="thrice",
        ...     scenarios=[{"name": "paper", "file": "paper"}],
        ...     methods=[{"name": "best", "planner": "plan"}],
        ...     repetitions=3,
        ... )
        >>> results = rho.campaign(study, folder / "runs.sqlite")
        >>> len(results.frame())
        3
    """
    study = study.resolved()
    study.check_draws()
    with Store(store, study) as opened:
        already = opened.keys()
        missing = (run for run in study.runs() if run.key not in already)
        before = SoFar(len(already), opened.failures(), max(len(study), len(already)))
        _Campaign(opened, executor or _ThisThread(), progress, before).do(missing)
    return Results(store)


class _ThisThread(Executor):
    """Executor that runs tasks immediately, in this thread."""

    at_once = 1

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]  # as its base
        future: Future[object] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


Chunk = Sequence[Run]
Returned = tuple[Chunk, "Future[list[Done]]"]


class _Campaign:
    """State of a campaign: runs under way, and runs to repeat."""

    def __init__(
        self, store: Store, executor: Executor, watch: Watch | None, progress: SoFar
    ) -> None:
        self.store, self.executor, self.watch, self.progress = store, executor, watch, progress
        self.at_once = int(getattr(executor, "at_once", _AT_ONCE))
        self.under_way = set[Future[list[Done]]]()
        self.returned = SimpleQueue[Returned]()
        self.again, self.suspects = deque[Run](), deque[Run]()
        self.deaths = defaultdict[str, int](int)
        self.seconds = dict[tuple[str, str], float]()

    def do(self, runs: Iterator[Run]) -> None:
        """Carry out runs, repeating those whose worker process died."""
        self._watched()
        try:
            chunks = self._chunks(runs)
            while self._submit(chunks) or self.under_way:
                self._receive(*self.returned.get())
        except BaseException:
            for future in self.under_way:
                future.cancel()
            self._keep_returned()
            raise

    def _submit(self, chunks: Iterator[Chunk]) -> bool:
        """Send chunks until enough are under way; return whether any was sent."""
        sent = False
        while len(self.under_way) < self.at_once:
            chunk = next(chunks)
            if not chunk:
                break
            self._send(chunk)
            sent = True
        if not self.under_way and self.suspects:  # with no other run under way
            self._send([self.suspects.popleft()])
            sent = True
        return sent

    def _send(self, chunk: Chunk) -> None:
        try:
            future = self.executor.submit(do_all, chunk, self.deaths[chunk[0].key])
        except Exception as error:
            raise _failure(error) from error
        self.under_way.add(future)
        future.add_done_callback(lambda done: self.returned.put((chunk, done)))

    def _receive(self, chunk: Chunk, future: Future[list[Done]]) -> None:
        """Write the results of a chunk, or handle its failure."""
        self.under_way.discard(future)
        if future.cancelled():
            expected = "results: has it been shut down? Earlier results are kept"
            raise CampaignError(f"the executor: got cancelled tasks, expected {expected}")
        if (error := future.exception()) is not None:
            if not _has_died(error):
                raise _failure(error) from error
            self._died(chunk)
            return
        self._write(future.result())

    def _write(self, found: Sequence[Done]) -> None:
        for done in found:
            self._learn(done)
        self.store.write(found)
        failed = sum(not done.row.verified for done in found)
        self.progress = dataclasses.replace(
            self.progress,
            done=self.progress.done + len(found),
            failed=self.progress.failed + failed,
        )
        self._watched()

    def _learn(self, done: Done) -> None:
        """Update the mean time of runs of this kind, weighted towards the latest."""
        row = done.row
        if f"drake-rho {package_version()}," not in row.versions:
            expected = f"drake_rho {package_version()}, as in this process"
            raise CampaignError(f"a worker: got {row.versions}, expected {expected}")
        before = self.seconds.get((row.scenario, row.method), row.run_seconds or 0.0)
        self.seconds[row.scenario, row.method] = 0.9 * before + 0.1 * (row.run_seconds or 0.0)

    def _died(self, chunk: Chunk) -> None:
        """Handle the death of a chunk's worker process, possibly caused by one of its runs."""
        for run in chunk:
            self.deaths[run.key] += 1
            if self.deaths[run.key] >= _DEATHS:
                reason = f"its worker process died {_DEATHS} times"
                row = row_of(run, status=ERROR, reason=reason, verified=False)
                self._write([Done(row)])
            elif self.deaths[run.key] >= _DEATHS_TOGETHER:
                self.suspects.append(run)
            else:
                self.again.append(run)

    def _chunks(self, runs: Iterator[Run]) -> Iterator[Chunk]:
        """Yield chunks of about `CHUNK` seconds, repeated runs singly, then empty lists."""
        chunk, seconds = list[Run](), 0.0
        for run in runs:
            while self.again:
                yield [self.again.popleft()]
            expected = self.seconds.get((run.scenario, run.method), CHUNK)
            if chunk and (seconds + expected > CHUNK or len(chunk) == _MAX_CHUNK):
                yield chunk
                chunk, seconds = [], 0.0
            chunk.append(run)
            seconds += expected
        if chunk:
            yield chunk
        while True:
            yield [self.again.popleft()] if self.again else []

    def _keep_returned(self) -> None:
        """Write results that were returned but not handled yet, as far as possible."""
        while not self.returned.empty():
            _, future = self.returned.get()
            if not future.cancelled() and future.exception() is None:
                self.store.write(future.result())

    def _watched(self) -> None:
        if self.watch is not None:
            self.watch(self.progress)


def _has_died(error: BaseException) -> bool:
    """Return whether an error means that a worker process died, not that the executor failed.

    Dask's error is recognised by its name, so that Dask need not be imported.
    """
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def _failure(error: BaseException) -> CampaignError:
    words = " ".join(f"{type(error).__name__}: {error}".split())
    return CampaignError(f"the executor: {words}; earlier results are kept")
