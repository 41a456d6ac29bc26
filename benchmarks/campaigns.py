"""Scenarios of a benchmark run as a campaign, by a planner that is a module's function."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.progress import Progress

import drake_rho as rho
from benchmarks.tables import commit
from drake_rho.campaigns.runs import SOLVED, Row


def planned(
    scenarios: Sequence[rho.Scenario],
    what: str,
    planner: Callable[[rho.Scenario], rho.Plan],
    stores: Path | None = None,
) -> Iterator[tuple[Row, rho.Plan | None]]:
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
        The row, and the plan or None.

    Raises:
        ValueError: the `partial` has arguments without names.
    """
    study = _study(scenarios, what, planner)
    with TemporaryDirectory() as gone:
        folder = stores or Path(gone)
        folder.mkdir(parents=True, exist_ok=True)
        results = _done(study, folder / f"{what}, {commit()}.sqlite")
        rows = {row.key: row for row in results.rows()}
        for row in (rows[run.key] for run in study.runs()):
            plan = results.plan(row.key) if row.status == SOLVED else None
            assert plan is None or isinstance(plan, rho.Plan)  # noqa: S101  # as planners give
            yield row, plan


def _study(
    scenarios: Sequence[rho.Scenario], what: str, planner: Callable[[rho.Scenario], rho.Plan]
) -> rho.Study:
    work = planner if isinstance(planner, partial) else partial(planner)
    if work.args:
        raise ValueError(f"planner: got {work}, expected one whose arguments have names")
    method = {"planner": "function", "function": work.func, "arguments": work.keywords}
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
