"""Damaged files of every kind that is read: what the command line says, and what it takes."""

from __future__ import annotations

import dataclasses
import os
import resource
import sqlite3
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.file_kinds import kinds, scenario
from benchmarks.format_kinds import BOUND, Kind
from benchmarks.tables import Goal, Table

SEED = 45
"""Seed of the damages."""

MEMORY, SECONDS = 2000.0, 10.0
"""Largest memory [MB] and processor time [s] for a file."""

_LOADED = (
    "drake_rho.campaigns.results",
    "drake_rho.cli.commands",
    "lz4.frame",
    "octomap",
    "pydrake.geometry",
    "pydrake.multibody.parsing",
    "pydrake.multibody.plant",
    "pymap3d",
    "pypcd4",
    "rosbags.rosbag2",
    "rosbags.typesys",
    "trimesh.exchange.load",
    "trimesh.exchange.ply",
    "yaml",
)
"""Modules that commands load when they need them."""

_SEEN = 1400
"""Longest line of an error."""


@dataclasses.dataclass(frozen=True)
class Read:
    """What reading a file came to."""

    kind: str
    """kind of the file"""
    status: int
    """exit status; negative for the number of a signal"""
    seconds: float
    """processor time [s]"""
    megabytes: float
    """largest memory of the process [MB]"""
    errors: str
    """what was on standard error"""
    output: str
    """what was on standard output"""

    @property
    def wrong(self) -> str:
        """What is wrong with the answer; empty if nothing is."""
        lines = [line for line in self.errors.splitlines() if "warning:" not in line]
        if self.seconds > SECONDS or self.status < 0:
            return f"status {self.status} after {self.seconds:.1f} s"
        if self.megabytes > MEMORY:
            return f"{self.megabytes:.0f} MB"
        if any(not each.isprintable() for each in (self.errors + self.output).replace("\n", "")):
            return "a character that controls a terminal"
        if self.status == 2 and (len(lines) != 1 or not lines[0].startswith("drake-rho: ")):
            return f"{len(lines)} lines: {self.errors[-200:]!r}"
        if self.status == 2 and len(lines[0]) > _SEEN:
            return f"a line of {len(lines[0])} characters"
        if self.status not in (0, 1, 2, 6) or (self.status != 2 and lines):
            return f"status {self.status}: {self.errors[-300:]!r}"
        return ""


def read_damaged(each: Kind, content: bytes, folder: Path) -> Read:
    """Read a file in a process of its own, a fork of this one, as the command line does."""
    path = folder / f"damaged{each.ending}"
    path.write_bytes(content)
    outputs = [folder / name for name in ("stdout", "stderr")]
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _run(each, path, outputs, folder)
    _, status, used = os.wait4(child, 0)
    errors, output = (text.read_text(errors="replace") for text in reversed(outputs))
    code = os.waitstatus_to_exitcode(status)
    seconds = used.ru_utime + used.ru_stime
    return Read(each.name, code, seconds, used.ru_maxrss / 1024.0, errors, output)


def _run(each: Kind, path: Path, outputs: Sequence[Path], folder: Path) -> None:
    """Run a command in a child that ends with its status, whatever happens."""
    status = 70
    try:
        for number, output in enumerate(outputs, start=1):
            os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), number)
        resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))
        resource.setrlimit(resource.RLIMIT_CPU, (2 * int(SECONDS), 2 * int(SECONDS)))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
        os.chdir(folder)
        command, *arguments = (text.format(path.name) for text in each.command)
        status = _status(command, arguments, path)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException as error:  # what a command line would print as a traceback
        os.write(2, f"Traceback: {type(error).__name__}: {error}\n".encode(errors="replace")[:2000])
        status = 71
    finally:
        os._exit(status)


def _status(command: str, arguments: list[str], path: Path) -> int:
    """Return the exit status of a command line, or of one that only reads a scenario."""
    from drake_rho.cli import commands, console, failures, sources
    from drake_rho.cli.streams import pipe_safe

    sys.stdout, sys.stderr = pipe_safe(sys.__stdout__), pipe_safe(sys.__stderr__)  # type: ignore[arg-type]
    calls = {
        "read": lambda: sources.read(path.name),
        "study": lambda: rho.load_study(path.name).check_draws(),
        "table": lambda: rho.load(path.name, scenario(path.parent)),
        "mission": lambda: rho.load_mission(path.name),
        "waypoints": lambda: rho.load_waypoints(path.name),
        "trajectories": lambda: rho.load_trajectories(path.name, max_acceleration=_bound(path)),
    }

    def run() -> int | None:
        if command in calls:
            calls[command]()  # type: ignore[no-untyped-call]
            return 0
        found: int | None = commands.app([command, *arguments], standalone_mode=False)
        return found

    with console.warnings_as_lines():
        return failures.status_of(run)


def _bound(path: Path) -> float | None:
    """Return the bound of samples; None for polynomials."""
    exact = path.suffix == ".skyc" or path.read_bytes().startswith(b"duration")
    return None if exact else BOUND


def damaged(
    count: int,
    folder: Path,
    seed: int = SEED,
    kinds_of: Callable[[Path], list[Kind]] = kinds,
) -> list[Read]:
    """Return what reading damaged files came to, kind by kind in turn.

    Args:
        count: number of files.
        folder: for them.
        seed: of the damages.
        kinds_of: a function that returns valid files of each kind, given a folder for files on the
            way.
    """
    for module in _LOADED:  # once, not in every fork
        import_module(module)
    rng = np.random.default_rng(seed)
    found, made = list[Read](), kinds_of(folder)
    for of_lsc in (each for each in made if "LSC)" in each.name):
        (folder / "mission.json").write_bytes(of_lsc.content)
    for each in made:
        whole = read_damaged(each, each.content, folder)
        if whole.status not in (0, 1, 6) or whole.wrong:
            raise RuntimeError(f"{each.name}: a whole file gives {whole}")
    for number in range(count):
        each = made[number % len(made)]
        content = each.content
        for _ in range(1 + int(rng.random() < 0.25)):
            chosen = each.damages[rng.integers(len(each.damages))]
            with suppress(zipfile.BadZipFile, zlib.error, sqlite3.Error, ValueError, RuntimeError):
                content = chosen(content or b"0", rng)
        read = read_damaged(each, content, folder)
        if read.wrong and (kept := os.environ.get("DAMAGED_FILES")):
            Path(kept, f"{number}{each.ending}").write_bytes(content)
        found.append(read)
    return found


def run(files: int) -> Table:
    """Return a table of the answers to damaged files, a row for each kind."""
    return table_of(files, "damaged_files", "Damaged files", kinds)


def table_of(files: int, table: str, title: str, kinds_of: Callable[[Path], list[Kind]]) -> Table:
    """Return a table of the answers to damaged files of some kinds, with its name and title."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        found = damaged(files, Path(folder), kinds_of=kinds_of)
    rows = []
    for name in dict.fromkeys(each.kind for each in found):
        here = [each for each in found if each.kind == name]
        refused = sum(each.status == 2 for each in here)
        failed = sum(bool(each.wrong) for each in here)
        rows.append(
            (
                name,
                len(here),
                refused,
                len(here) - refused - failed,
                failed,
                max(each.seconds for each in here),
                max(each.megabytes for each in here),
            )
        )
    wrong = [each for each in found if each.wrong]
    kept = tuple(f"Wrong: {each.kind}, {each.wrong}" for each in wrong[:20])
    return Table(
        name=table,
        title=title,
        columns=(
            "kind",
            "files",
            "refused in one line",
            "read all the same",
            "wrong",
            "processor time, most [s]",
            "memory, most [MB]",
        ),
        rows=tuple(rows),
        goals=(
            Goal("files without one line and a status", 0, len(wrong)),
            Goal("processor time for a file [s]", SECONDS, max(each.seconds for each in found)),
            Goal("memory for a file [MB]", MEMORY, max(each.megabytes for each in found)),
        ),
        notes=(
            _ABOUT.format(files=files, kinds=len(rows), minutes=(time.monotonic() - began) / 60.0),
            *kept,
        ),
        packages=("drake-rho", "drake", "numpy", "trimesh", "pypcd4", "octomap-python"),
    )


_ABOUT = """\
{files} files of {kinds} kinds, drawn with a fixed seed: small valid ones with flipped bits
(anywhere or in their first 256 bytes), cut off, with numbers replaced by nan, inf, huge, negative
or none at all, with words replaced by sequences for terminals, deep nesting, paths elsewhere and
tags, with lines exchanged, left out or repeated, in other encodings; archives with arrays that
claim much or are others; stores with other values and views. A quarter of them is damaged twice.
Each is read by the command line in a fork of one process, scenarios, missions and studies only as
far as they are read, not planned. Wrong is all but one line and status 2, or a file that is read
without a word on standard error; warnings are left out of account. Memory is the largest resident
size of the process, with the program and its libraries. It took {minutes:.0f} minutes."""
