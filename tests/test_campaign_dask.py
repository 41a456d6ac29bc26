"""Campaigns on Dask: a cluster of processes, and a scheduler and workers started by commands."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import drake_rho as rho
from tests.studies import small, table, text_of

distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, ...]]:
    """Return the rows of a campaign in this process."""
    path = tmp_path_factory.mktemp("undisturbed") / "runs.sqlite"
    rho.campaign(small(), path)
    return table(path)


@pytest.mark.slow
def test_a_cluster_of_processes_gives_the_same_rows_even_when_one_dies(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    killed = list[int]()
    with (
        distributed.LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):

        def kill(now: Any) -> None:
            if now.done and not killed:
                killed.extend(client.run(os.getpid).values())
                os.kill(killed[0], signal.SIGKILL)

        executor = client.get_executor()
        rho.campaign(small(), tmp_path / "runs.sqlite", executor=executor, progress=kill)
    assert len(killed) == 2
    assert table(tmp_path / "runs.sqlite") == expected


@pytest.mark.slow
def test_a_scheduler_and_workers_started_by_commands(
    expected: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    (tmp_path / "study.yaml").write_text(text_of(small()))
    with _scheduler() as (address, scheduler), _worker(address), _worker(address):
        done = _campaign(tmp_path, address)
        assert done.returncode == 0, done.stderr
        assert table(tmp_path / "runs.sqlite") == expected
        with distributed.Client(address) as client:

            def kill(now: Any) -> None:
                if now.done:
                    scheduler.kill()

            path = tmp_path / "ended.sqlite"
            with pytest.raises(rho.DrakeRhoError, match="executor"):
                rho.campaign(small(40), path, executor=client.get_executor(), progress=kill)
    rows = table(path)
    assert 0 < len(rows) < len(small(40))
    assert {row[5] for row in rows} <= {"solved", "infeasible"}
    done = _campaign(tmp_path, address)
    assert done.returncode == 2
    assert done.stderr.startswith(f"drake-rho: --scheduler: got '{address}', expected the address")
    assert done.stderr.count("\n") == 1


def _campaign(folder: Path, address: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "drake_rho", "campaign", str(folder / "study.yaml")]
    command += ["--store", str(folder / "runs.sqlite"), "--scheduler", address]
    return subprocess.run(command, capture_output=True, text=True)


@contextmanager
def _scheduler() -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    with _command(words) as process:
        yield f"tcp://127.0.0.1:{port}", process


@contextmanager
def _worker(address: str) -> Iterator[None]:
    with _command(["worker", address, "--nthreads", "1", "--no-dashboard"]):
        yield


@contextmanager
def _command(words: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
