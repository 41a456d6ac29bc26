"""Scenarios of a benchmark run as a campaign, by a planner that is a module's function."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.progress import Progress

import drake_rho as rho
from benchmarks.stopwatch import Stopwatch
from benchmarks.tables import commit
from drake_rho.campaigns.functions import name_of, named
from drake_rho.campaigns.runs import SOLVED, Row


def planned(
    scenarios: Sequence[rho.Scenario],
    what: str,
    planner: Callable[[rho.Scenario], rho.Plan],
    stores: Path | None = None,
) -> Iterator[tuple[Row, rho.Plan | None, float]]:
    """Plan scenarios one after another in a separate process, then yield the result of each.

    The recorded memory is therefore theirs alone, and no benchmark slows another down. The process
    may use all cores for a run, like a user's.

    Args:
        scenarios: the scenarios to be planned.
        what: their description, for the progress bar and as the name of the store.
        planner: function of a module, or a `partial` of one with keywords.
        stores: folder of stores, from which an interrupted campaign resumes if the commit is the
            same; a temporary folder if not given.

    Yields:
        The row, the plan or None, and the processor time of planning [s]. The row has wall times.

    Raises:
        ValueError: the `partial` has arguments without names.
    """
    with TemporaryDirectory() as gone:
        folder = stores or Path(gone)
        folder.mkdir(parents=True, exist_ok=True)
        store = folder / f"{what}, {commit()}.sqlite"
        times = store.with_suffix(".times")
        study = _study(scenarios, what, planner, times)
        results = _done(study, store)
        rows, processor = {row.key: row for row in results.rows()}, _times(times)
        for scenario, row in zip(scenarios, (rows[run.key] for run in study.runs()), strict=True):
            plan = results.plan(row.key) if row.status == SOLVED else None
            assert plan is None or isinstance(plan, rho.Plan)  # noqa: S101  # as planners give
            yield row, plan, processor.get(scenario.name, np.nan)


def timed(
    scenario: rho.Scenario, *, function: str, arguments: Mapping[str, Any], times: str
) -> rho.Plan:
    """Plan by a function with a name, and write the processor time of that into a file."""
    watch = Stopwatch()
    try:
        plan: rho.Plan = named(function)(scenario, **arguments)
    finally:
        with Path(times).open("a", encoding="utf-8") as file:
            file.write(f"{json.dumps([scenario.name, watch.taken().processor])}\n")
    return plan


def _times(path: Path) -> dict[str, float]:
    """Return the processor times by name of the scenario [s]."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return dict(map(json.loads, lines))


def _study(
    scenarios: Sequence[rho.Scenario],
    what: str,
    planner: Callable[[rho.Scenario], rho.Plan],
    times: Path,
) -> rho.Study:
    work = planner if isinstance(planner, partial) else partial(planner)
    if work.args:
        raise ValueError(f"planner: got {work}, expected one whose arguments have names")
    arguments = {"function": name_of(work.func), "arguments": work.keywords, "times": str(times)}
    method = {"planner": "function", "function": timed, "arguments": arguments}
    return rho.Study(
        what,
        [{"name": str(number), "scenario": each} for number, each in enumerate(scenarios)],
        [{"name": what, **method}],
        plans=True,
    )


def _done(study: rho.Study, store: Path) -> rho.Results:
    fresh = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(1, mp_context=fresh, initializer=_first_calls) as process,
        Progress() as bar,
    ):
        task = bar.add_task(study.name, total=len(study))
        return rho.campaign(
            study,
            store,
            executor=process,
            progress=lambda now: bar.update(task, completed=now.done),
        )


def _first_calls() -> None:
    """Load and set up what the first plan needs, so that its time does not count."""
    rho.verify(rho.plan_scp(rho.random_transitions(4, np.random.default_rng(0))))
