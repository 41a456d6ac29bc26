"""The package beside an earlier version: the same works in turn, each in a fresh process.

`python -m benchmarks against --against COMMIT` runs all works of `against_works`.
"""

from __future__ import annotations

import io
import json
import os
import statistics
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from rich.progress import track

from benchmarks.against_works import FOLDER, WORKS, Work
from benchmarks.tables import Cell, Table

COMMIT = "48057a9"
"""Earlier version, if no other is given."""

_ROOT = Path(__file__).parents[1]

COLUMNS = (
    "work",
    "pairs",
    "ratio, processor",
    "least",
    "largest",
    "ratio, wall",
    "before, processor [s]",
    "now, processor [s]",
    "result, relative difference",
)


def run(repetitions: int = 31, commit: str = COMMIT, folder: Path | None = None) -> Table:
    """Run every work by this version and by that of a commit, in turn."""
    given = folder is not None and (folder / "forest1.bt").is_file()
    works = [name for name in WORKS if given or name != "forest"]
    rows = list[tuple[Cell, ...]]()
    with tempfile.TemporaryDirectory() as earlier:
        _extract(commit, earlier)
        for name in track(works, "works"):
            rows.append(_row(WORKS[name], _pairs(name, earlier, repetitions, folder)))
    return Table(
        name="against",
        title=f"This version beside {commit}",
        columns=COLUMNS,
        rows=tuple(rows),
        notes=(_ABOUT, *(() if given else ("LSC's forest was not given (`--missions`).",))),
        packages=("drake-rho", "drake", "numpy", "scipy", "daqp"),
    )


def _extract(commit: str, folder: str) -> None:
    """Write the package of a commit into a folder."""
    command = ["git", "archive", "--format=tar", commit, "drake_rho"]
    done = subprocess.run(command, cwd=_ROOT, check=True, capture_output=True)  # noqa: S603
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")


def _pairs(
    name: str, earlier: str, repetitions: int, folder: Path | None
) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Return answers of both versions, which begin in turn, after a pair that does not count."""
    found = []
    for number in range(min(repetitions, WORKS[name].pairs) + 1):
        order = (earlier, str(_ROOT))[:: 1 if number % 2 else -1]
        answers = {tree: _in_process(name, tree, folder) for tree in order}
        found.append((answers[earlier], answers[str(_ROOT)]))
    return found[1:]


def _in_process(name: str, tree: str, folder: Path | None) -> dict[str, float]:
    paths = {"PYTHONPATH": os.pathsep.join([tree, str(_ROOT)]), FOLDER: str(folder)}
    # Without compiled modules, which the first pair writes, imports would take most of the time.
    paths["PYTHONDONTWRITEBYTECODE"] = ""
    command = [sys.executable, "-P", "-m", "benchmarks.against_works", name, tree]
    done = subprocess.run(  # noqa: S603  # a module of this folder
        command, capture_output=True, text=True, check=False, env=os.environ | paths
    )
    if done.returncode != 0:
        raise RuntimeError(f"{name}, {tree}: {done.stderr.strip().splitlines()[-1]}")
    answer: dict[str, float] = json.loads(done.stdout)
    return answer


def _row(work: Work, pairs: list[tuple[dict[str, float], dict[str, float]]]) -> tuple[Cell, ...]:
    ratios = [now["processor"] / before["processor"] for before, now in pairs]
    walls = [now["wall"] / before["wall"] for before, now in pairs]
    before, now = pairs[0]
    return (
        work.name,
        len(pairs),
        statistics.median(ratios),
        min(ratios),
        max(ratios),
        statistics.median(walls),
        statistics.median(each["processor"] for each, _ in pairs),
        statistics.median(each["processor"] for _, each in pairs),
        float(f"{now['result'] / before['result'] - 1.0:.2g}"),
    )


_ABOUT = """\
Both versions do each work in turn, in fresh processes, the second one first in every other pair. A
ratio is the time now over the time before: its median over the pairs, and the least and the largest
of processor times. A process runs a work once before it counts (not forests, the thousand vehicles
and the first plan), and small works some times, of which the median counts. Plans are verified
within the time. Results are costs, of the last window for MPC, and the bound of `certify`; their
relative difference is that of now from before. The benchmarks' own code and all other packages are
those of this version."""
