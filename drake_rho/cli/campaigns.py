"""The commands `campaign` and `results`."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

from drake_rho.cli.checks import check_outputs, check_writable, requested_drawing
from drake_rho.cli.console import answer, bar, err, remark, say, tell, working, write
from drake_rho.cli.failures import InterruptedByUserError
from drake_rho.cli.options import FormatOption, WidthOption, WorkersOption
from drake_rho.cli.sources import refuse_empty_file
from drake_rho.scenario.errors import ScenarioError

if TYPE_CHECKING:
    from drake_rho.campaigns.campaign import SoFar

_SCHEDULER_TIMEOUT = 10.0
"""Time to wait for a scheduler to answer [s]."""


def campaign(
    study: Annotated[
        str | None, typer.Argument(metavar="STUDY", help="A study (YAML file); see --example.")
    ] = None,
    store: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Store of the runs, one row per run (SQLite)."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a Dask scheduler, such as tcp://host:8786, whose workers do the runs "
            "(extra dask).",
        ),
    ] = None,
    example: Annotated[
        bool, typer.Option("--example", help="Print a complete study and exit.")
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of studies and exit.")
    ] = False,
) -> int:
    """Run a study, skipping the runs that its store already holds.

    The same command resumes a campaign that was interrupted in any way.
    """
    from drake_rho.campaigns.campaign import campaign as run_campaign
    from drake_rho.campaigns.study import example_study, load_study, study_schema

    if schema:
        write(json.dumps(study_schema(), indent=2))
        return 0
    if example:
        return answer({"content": example_study()}, example_study().rstrip("\n"))
    if study is None or store is None:
        missing = "STUDY" if study is None else "--store"
        raise ValueError(f"campaign: got no {missing}, expected STUDY and --store FILE")
    if workers is not None and scheduler is not None:
        raise ValueError("--scheduler: got it beside --workers, expected one of them")
    try:
        loaded = load_study(study)
    except ScenarioError as error:
        refuse_empty_file(study, error, "study", "drake-rho campaign --schema")
        raise
    began = time.monotonic()
    try:
        with _progress_bar() as advance, _executor(workers, scheduler) as executor:
            results = run_campaign(loaded, store, executor=executor, progress=advance)
    except KeyboardInterrupt:
        message = f"interrupted: finished runs are in {store}, and the same command resumes"
        raise InterruptedByUserError(message) from None
    failed, seconds = sum(each.runs for each in results.failures), time.monotonic() - began
    summary = f"{len(results)} runs in {store}, {failed} failed; {seconds:.1f} s"
    document = {"store": store, "runs": len(results), "failed": failed, "seconds": seconds}
    return tell(document, summary)


def results(
    store: Annotated[str, typer.Argument(metavar="FILE", help="The store of a campaign.")],
    figures: Annotated[
        str | None,
        typer.Option(metavar="FOLDER", help="Folder for figures, created if it does not exist."),
    ] = None,
    file_format: FormatOption = None,
    width: WidthOption = None,
    export: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Write all rows to this file (.csv or .parquet)."),
    ] = None,
) -> int:
    """Print the results of a campaign and compare its methods."""
    from drake_rho.campaigns.results import ENDINGS, Results

    drawing = requested_drawing(figures, file_format, width)
    check_outputs(None, drawing)
    check_writable(export, ENDINGS, "--export")
    found = Results(store)
    if export is not None:
        _write_rows(found.export, export)
    drawn = list[Path]()
    if drawing is not None:
        # importing matplotlib takes longer than making the tables
        from drake_rho.display.plots.campaigns import write_campaign_figures

        with working("drawing"):
            drawn = write_campaign_figures(
                found, drawing.folder, file_format=drawing.file_format, width=drawing.width
            )
    answer({**found.to_json(), "export": export, "figures": drawn}, str(found))
    if export is not None:
        remark(f"{len(found)} rows in {export}")
    if drawing is not None:
        remark(f"{', '.join(path.name for path in drawn)} in {drawing.folder}")
    return 0


@contextmanager
def _progress_bar() -> Iterator[Callable[[SoFar], None]]:
    """Show runs done, runs failed, rate and time left on standard error if it is a terminal."""
    counts = TextColumn(
        "{task.completed:.0f} of {task.total:.0f} done, {task.fields[failed]} failed, "
        "{task.fields[rate]:.1f} runs/s, left"
    )
    columns = (BarColumn(), counts, TimeRemainingColumn())
    with bar(*columns) as progress:
        task = progress.add_task("", total=1, failed=0, rate=0.0)
        began, before = time.monotonic(), None

        def advance(now: SoFar) -> None:
            nonlocal before
            before = now.done if before is None else before
            rate = (now.done - before) / max(time.monotonic() - began, 1e-9)
            progress.update(task, total=now.total, completed=now.done, failed=now.failed, rate=rate)

        yield advance


@contextmanager
def _executor(workers: int | None, scheduler: str | None) -> Iterator[Executor | None]:
    """Provide the executor of the runs; None runs them in this process.

    If the block ends with an error, runs that have not begun are cancelled.
    """
    if scheduler is not None:
        with _dask_executor(scheduler) as executor:
            yield executor
    else:
        with worker_pool(workers) as pool:
            yield pool


@contextmanager
def worker_pool(workers: int | None) -> Iterator[Executor | None]:
    """Provide a number of worker processes on this machine; None without a number.

    If the block ends with an error, work that has not begun is cancelled.
    """
    from drake_rho.campaigns.workers import Workers

    if workers is None:
        yield None
        return
    pool = Workers(workers)
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


@contextmanager
def _dask_executor(address: str) -> Iterator[Executor]:
    """Provide the workers of a Dask scheduler as an executor.

    Raises:
        ValueError: Dask is not installed, or no scheduler answers at the address.
    """
    try:
        from distributed import Client
    except ImportError:
        expected = "the extra dask: pip install 'drake-rho[dask]'"
        raise ValueError(f"--scheduler: got no Dask here, expected {expected}") from None
    for name in [each for each in logging.root.manager.loggerDict if "distributed" in each]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are printed in one line below
    try:
        client = Client(address, timeout=_SCHEDULER_TIMEOUT)
    except (OSError, ValueError, TypeError) as error:
        reason = _first_line(error)
        expected = f"the address of a Dask scheduler, such as tcp://host:8786 ({reason})"
        raise ValueError(f"--scheduler: got {address!r}, expected {expected}") from None
    with client:
        if not client.scheduler_info()["workers"]:
            say("the scheduler has no workers yet: waiting for them", err)
        yield client.get_executor()


def _write_rows(export: Callable[[str], None], path: str) -> None:
    """Write all rows to a file.

    Raises:
        ValueError: a package that the format needs is not installed.
    """
    try:
        export(path)
    except ImportError as error:
        expected = f"the extra results: pip install 'drake-rho[results]' ({_first_line(error)})"
        raise ValueError(f"--export: got {path!r}, expected {expected}") from None


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
