"""Campaigns: overhead of a run, two workers versus one, kills, a store of 100 000 runs."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.tables import Goal, Table
from drake_rho.campaigns.runs import MEASURED, Done, Run, do_all, row_of
from drake_rho.campaigns.store import COLUMNS, Store, StoreError
from drake_rho.campaigns.study import study_to_json
from drake_rho.campaigns.workers import Workers

RUNS, ROUNDS = 5000, 10
"""Runs of some 15 ms by one worker and by two, and the number of rounds in turn."""

ALONE = 100
"""Runs of each round that one process and two do without a campaign."""

SHORT = 2000
"""Runs of a few milliseconds, for the overhead of a campaign."""

KILLS = 20
"""Campaigns killed at a random moment."""

STORED = 100_000
"""Rows of the store that is summarised."""


def run() -> Table:
    """Measure everything in a temporary folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        added = _added(folder)
        one, two, own, faster = _one_and_two(folder)
        wrong, killed = _killed(folder)
        seconds, megabytes = _summarised(folder)
    rows = (
        (f"added to each of {SHORT} runs by one worker [ms]", 1e3 * added),
        (f"{RUNS} runs, one worker [s]", one),
        (f"{RUNS} runs, two workers [s]", two),
        ("how many times as fast two workers are", one / two),
        ("how many times as fast two processes are that run no campaign", faster),
        ("processor time of the process that sends them, each run [ms]", 1e3 * own),
        (f"rows lost, doubled or other than undisturbed, after {killed} kills", wrong),
        (f"drake-rho results, {STORED} rows [s]", seconds),
        (f"drake-rho results, {STORED} rows, largest memory [MB]", megabytes),
    )
    return Table(
        name="scale_campaigns",
        title="Campaigns: many runs",
        columns=("what", "measured"),
        rows=rows,
        notes=(_WORK,),
        goals=(
            Goal("added to each run [ms]", 5.0, 1e3 * added),
            Goal("time of two workers / that of one", 1.0 / 1.8, two / one),
            Goal("rows wrong after kills", 0.0, float(wrong)),
            Goal(f"results of {STORED} rows [s]", 5.0, seconds),
            Goal(f"results of {STORED} rows [MB]", 1000.0, megabytes),
        ),
    )


def shaken(repetitions: int, seed: int = 0, planner: str = "plan") -> rho.Study:
    """Return a study of the paper's scenario with another start and obstacle in each run."""
    vary = {
        "vehicles[0].start.position": {"normal": [[0, 0, 0], [50, 50, 50]]},
        "obstacles[0].radius": {"uniform": [800, 1100]},
    }
    return rho.Study(
        "shaken",
        [{"name": "paper", "file": "paper", "vary": vary}],
        [{"name": planner, "planner": planner}],
        repetitions=repetitions,
        seed=seed,
    )


def _added(folder: Path) -> float:
    """Return the overhead of a campaign for each run [s]."""
    store = folder / "short.sqlite"
    with Workers(1) as workers:
        rho.campaign(shaken(20, planner="plan_convex"), folder / "first", executor=workers)
        began = time.perf_counter()
        rho.campaign(shaken(SHORT, planner="plan_convex"), store, executor=workers)
        elapsed = time.perf_counter() - began
    connection = sqlite3.connect(store)
    (itself,) = connection.execute("SELECT sum(run_seconds) FROM runs").fetchone()
    connection.close()
    return (elapsed - float(itself)) / SHORT


def _one_and_two(folder: Path) -> tuple[float, float, float, float]:
    """Return times [s] of the same runs by one worker and by two, and measures to compare them.

    The runs are done in turn, since other work disturbs. The third value is the processor time [s]
    that this process needs to send a run to two workers and to store its row. The fourth is the
    speed of two processes that share some of the runs without a campaign, over that of one: no
    larger speed-up is possible on this machine.
    """
    seconds, alone, own = {1: 0.0, 2: 0.0}, {1: 0.0, 2: 0.0}, 0.0
    with Workers(1) as one, Workers(2) as two:
        pools = {1: one, 2: two}
        for count, pool in pools.items():
            rho.campaign(shaken(20), folder / f"warm-{count}", executor=pool)
        for number in track(range(ROUNDS), "one worker and two"):
            study = shaken(RUNS // ROUNDS, seed=number)
            runs = list(study.resolved().runs())[:ALONE]
            for count, pool in pools.items():
                began, worked = time.perf_counter(), time.process_time()
                rho.campaign(study, folder / f"{number}-{count}", executor=pool)
                seconds[count] += time.perf_counter() - began
                own += (time.process_time() - worked) if count == 2 else 0.0
                began = time.perf_counter()
                shares = [pool.submit(do_all, runs[first::count]) for first in range(count)]
                for share in shares:
                    share.result()
                alone[count] += time.perf_counter() - began
    return seconds[1], seconds[2], own / RUNS, alone[1] / alone[2]


def _killed(folder: Path) -> tuple[int, int]:
    """Return the number of rows that are wrong in the end, and the number of kills."""
    study, store = shaken(400), folder / "killed.sqlite"
    (folder / "study.yaml").write_text(study_to_json(study.resolved()), encoding="utf-8")
    rho.campaign(study, folder / "whole.sqlite")
    command = [sys.executable, "-m", "drake_rho", "campaign", str(folder / "study.yaml")]
    command += ["--store", str(store), "--workers", "2"]
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603  # our own
    lasting = time.perf_counter() - began
    whole, wrong = set(_rows(folder / "whole.sqlite")), 0
    chance = random.Random(0)  # noqa: S311  # not a secret
    for number in track(range(KILLS), "kills"):
        if len(_rows(store)) == len(whole):
            for path in folder.glob("killed.sqlite*"):
                path.unlink()
        with _begun(command) as process:
            time.sleep(chance.uniform(0.0, lasting))
            for victim in _victims(process.pid, ("worker", "client", "all")[number % 3], chance):
                os.kill(victim, signal.SIGKILL)
        found = _rows(store)
        wrong += len(found) - len(set(found) & whole)
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603
    return wrong + len(set(_rows(store)) ^ whole), KILLS


def _begun(command: list[str]) -> subprocess.Popen[bytes]:
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=nowhere, stderr=nowhere)  # noqa: S603  # our own


def _victims(client: int, kind: str, chance: random.Random) -> list[int]:
    """Return the processes to be killed; none if the campaign has ended."""
    listed = subprocess.run(  # noqa: S603  # a fixed command
        ["ps", "-o", "pid=,args=", "--ppid", str(client)],  # noqa: S607
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    workers = [int(pid) for pid, words in lines if "spawn_main" in words]
    alive = Path(f"/proc/{client}/cmdline").read_bytes() != b""
    if kind == "worker":
        return [chance.choice(workers)] if workers else []
    return [*workers, client][-1 if kind == "client" else 0 :] if alive else []


def _rows(store: Path) -> list[tuple[object, ...]]:
    """Return all rows without the columns of times; none if there is no store yet."""
    names = ", ".join(name for name in COLUMNS if name not in MEASURED)
    try:
        rho.Results(store)
    except (StoreError, TypeError):  # killed before its tables were created
        return []
    connection = sqlite3.connect(store)
    rows = connection.execute(f"SELECT {names} FROM runs").fetchall()  # noqa: S608
    connection.close()
    return rows


def _summarised(folder: Path) -> tuple[float, float]:
    """Return time [s] and memory [MB] of `drake-rho results` for a large store."""
    rng, store = np.random.default_rng(0), folder / "large.sqlite"
    study = dataclasses.replace(
        shaken(STORED // 2).resolved(),
        methods=(*shaken(1).methods, *shaken(1, planner="plan_convex").methods),
    )
    with Store(store, study) as kept:
        kept.write([_made_up(one, rng) for one in study.runs()])
    program = (
        "import json, resource, sys, time; began = time.perf_counter()\n"
        "from drake_rho.cli import main\n"
        f"sys.argv = ['drake-rho', 'results', {str(store)!r}]\n"
        "try: main()\n"
        "finally: print(json.dumps([time.perf_counter() - began, "
        "resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))\n"
    )
    words = [sys.executable, "-c", program]
    done = subprocess.run(words, check=True, capture_output=True, text=True)  # noqa: S603
    seconds, megabytes = json.loads(done.stdout.splitlines()[-1])
    return seconds, megabytes


def _made_up(one: Run, rng: np.random.Generator) -> Done:
    """Return a plausible row."""
    solved = rng.random() < 0.9
    return Done(
        row_of(
            one,
            status="solved" if solved else "infeasible",
            reason="" if solved else f"no plan: reason {rng.integers(1000)} of some length" * 4,
            verified=solved,
            vehicles=4,
            cost=rng.random() if solved else None,
            obstacle_clearance=rng.random() if solved else None,
            programs=9,
            plan_seconds=rng.random(),
            run_seconds=rng.random(),
        )
    )


_WORK = f"""\
A run is the paper's scenario with a drawn start and obstacle. Added is the time of a campaign by
one worker less that of its runs, including the creation and verification of their scenarios, over
their number; they are planned by `plan_convex`, in a few milliseconds. One worker and two plan the
same {RUNS} scenarios by `plan`, in {ROUNDS} rounds in turn, with processes started before; after
each, {ALONE} of its runs are done by one process and by two that receive their share at once. In
turn, a worker, the process that runs the campaign, or all processes are killed, at a time drawn
from the length of the campaign of 400 runs; the next command resumes it, and begins anew where all
is done. A row is wrong if it is not in an undisturbed campaign with the same values in all columns
but times, or is missing in the end. The last two lines are a whole process, from its start to its
end, for a store with synthetic values. Limitations: two workers and the process that sends to them
need two idle cores; on a busy machine they are hardly faster than one, which shares it as well."""
