"""`campaign`: do the runs of a study that are not in its store yet.

Runs are sent to an executor in chunks of a tenth of a second, so that sending costs little;
what comes back is written at once. Whenever it is ended, by whatever, the next call goes on.
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
"""How long the runs of a chunk take together, as far as runs of their kind tell [s]."""

_MOST_IN_A_CHUNK = 100
"""Runs."""

_AT_ONCE = 256
"""Chunks that are submitted at a time to an executor that does not say how many it takes."""

_DEATHS_TOGETHER, _DEATHS = 2, 4
"""Processes that a run may outlive: after so many it is done with no other under way, so that it
is known whose fault it is, and after so many it is not tried again."""


class CampaignError(DrakeRhoError):
    """The executor failed, not a run; what was done before is kept."""


@dataclasses.dataclass(frozen=True)
class SoFar:
    """How far a campaign is."""

    done: int
    """runs in the store"""
    failed: int
    """runs among them that were not solved, or break a constraint"""
    total: int
    """runs of the study"""

    def __str__(self) -> str:
        """As in '12 of 100 runs done, 1 failed'."""
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
    """Do the runs of a study that are not in its store yet.

    Args:
        study: scenarios, methods, repetitions and seed.
        store: path of an SQLite file, made if it is not there. A study that has grown goes on in
            the store that it has.
        executor: where runs are done: any of PEP 3148 whose workers can import this package,
            `drake_rho.campaigns.workers.Workers`, Dask's by `Client.get_executor()`. If
            not given, here, one after another.
        progress: called with how far it is whenever runs were written; `print` will do.

    Returns:
        What the store holds.

    Raises:
        ScenarioError: a scenario of the study is in a file that cannot be read, or nothing that is
            drawn of one of its sources is a scenario; nothing is planned then.
        StoreError: the store is another study's or version's, or cannot be written.
        CampaignError: the executor failed. What was done before is kept, as it is when the call is
            interrupted: the same call goes on.

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
    with Store(store, study) as kept:
        already = kept.keys()
        missing = (run for run in study.runs() if run.key not in already)
        before = SoFar(len(already), kept.failures(), max(len(study), len(already)))
        _Campaign(kept, executor or _Here(), progress, before).do(missing)
    return Results(store)


class _Here(Executor):
    """Does what is submitted at once, in this thread."""

    at_once = 1

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]  # as its base
        future: Future[object] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


Chunk = Sequence[Run]
Returned = tuple[Chunk, "Future[list[Done]]"]


class _Campaign:
    """Runs under way, and those that have to be done again."""

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
        """Do some runs, and those again whose process died."""
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
        """Send chunks as long as more can be under way; whether any was."""
        sent = False
        while len(self.under_way) < self.at_once:
            chunk = next(chunks)
            if not chunk:
                break
            self._send(chunk)
            sent = True
        if not self.under_way and self.suspects:  # by itself
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
        """Write what has come back, or see to what has not."""
        self.under_way.discard(future)
        if future.cancelled():
            expected = "results: has it ended? What was done before is kept"
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
        """How long runs of this kind take: the mean, the latest counting most."""
        row = done.row
        if f"drake-rho {package_version()}," not in row.versions:
            expected = f"drake_rho {package_version()}, as here"
            raise CampaignError(f"a worker: got {row.versions}, expected {expected}")
        before = self.seconds.get((row.scenario, row.method), row.run_seconds or 0.0)
        self.seconds[row.scenario, row.method] = 0.9 * before + 0.1 * (row.run_seconds or 0.0)

    def _died(self, chunk: Chunk) -> None:
        """The process that had a chunk is gone, through one of its runs or through none of them."""
        for run in chunk:
            self.deaths[run.key] += 1
            if self.deaths[run.key] >= _DEATHS:
                reason = f"its process died, {_DEATHS} times"
                row = row_of(run, status=ERROR, reason=reason, verified=False)
                self._write([Done(row)])
            elif self.deaths[run.key] >= _DEATHS_TOGETHER:
                self.suspects.append(run)
            else:
                self.again.append(run)

    def _chunks(self, runs: Iterator[Run]) -> Iterator[Chunk]:
        """Runs that take about `CHUNK` together, and by itself what is done again; then empty."""
        chunk, seconds = list[Run](), 0.0
        for run in runs:
            while self.again:
                yield [self.again.popleft()]
            expected = self.seconds.get((run.scenario, run.method), CHUNK)
            if chunk and (seconds + expected > CHUNK or len(chunk) == _MOST_IN_A_CHUNK):
                yield chunk
                chunk, seconds = [], 0.0
            chunk.append(run)
            seconds += expected
        if chunk:
            yield chunk
        while True:
            yield [self.again.popleft()] if self.again else []

    def _keep_returned(self) -> None:
        """Write what has come back but not been looked at, as far as that is possible."""
        while not self.returned.empty():
            _, future = self.returned.get()
            if not future.cancelled() and future.exception() is None:
                self.store.write(future.result())

    def _watched(self) -> None:
        if self.watch is not None:
            self.watch(self.progress)


def _has_died(error: BaseException) -> bool:
    """Whether a worker process has died, rather than the executor's own machinery.

    Dask is not loaded for its name of it.
    """
    return isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker"


def _failure(error: BaseException) -> CampaignError:
    words = " ".join(f"{type(error).__name__}: {error}".split())
    return CampaignError(f"the executor: {words}; what was done before is kept")
