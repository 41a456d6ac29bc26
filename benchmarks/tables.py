"""Results of a benchmark, the conditions it ran under, and their files."""

from __future__ import annotations

import csv
import dataclasses
import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_info

from benchmarks.apart import version

RESULTS = Path(__file__).parent / "results"
"""Folder of the tables."""

Cell = str | float | int | bool | None


@dataclasses.dataclass(frozen=True)
class Goal:
    """Goal for a measured value."""

    work: str
    """description of the value"""
    most: float
    """largest value that reaches the goal"""
    measured: float | None
    """measured value; None if not available"""

    @property
    def outcome(self) -> str:
        """Outcome in one to three words."""
        if self.measured is None:
            return "not measured"
        return "met" if self.measured <= self.most else "missed"


@dataclasses.dataclass(frozen=True)
class Table:
    """Result of one benchmark."""

    name: str
    """name of its files"""
    title: str
    """heading of the Markdown file"""
    columns: tuple[str, ...]
    """headings of the columns"""
    rows: tuple[tuple[Cell, ...], ...]
    """one cell a column; None for an empty one"""
    notes: tuple[str, ...] = ()
    """paragraphs of Markdown after the table: method and limitations"""
    goals: tuple[Goal, ...] = ()
    """goals, in a table of their own, if any"""
    packages: tuple[str, ...] = ("drake-rho", "drake", "numpy", "scipy")
    """packages whose versions matter"""


def write(table: Table, load_before: float, folder: Path = RESULTS) -> tuple[Path, Path]:
    """Write `<name>.md` and `<name>.csv` into `folder`, and return their paths.

    `load_before` is that of `to_markdown`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    markdown, values = folder / f"{table.name}.md", folder / f"{table.name}.csv"
    markdown.write_text(to_markdown(table, load_before), encoding="utf-8")
    with values.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.columns)
        writer.writerows(table.rows)
    return markdown, values


def load() -> float:
    """Return the load average of the last minute."""
    return os.getloadavg()[0]


def to_markdown(table: Table, load_before: float, width: int | None = None) -> str:
    """Return the whole Markdown file: conditions, results, goals, notes.

    Args:
        table: the result.
        load_before: load average of the last minute before the benchmark.
        width: columns of a terminal; the rows of a table that is wider even with one word a line
            become items of a list. Unlimited if not given.
    """
    grid = partial(_grid, width=width)
    parts = [f"# {table.title}", conditions(table.packages, load_before)]
    parts.append(grid(table.columns, table.rows))
    if table.goals:
        rows = [
            (goal.work, f"at most {goal.most:.3g}", goal.measured, goal.outcome)
            for goal in table.goals
        ]
        parts += ["## Goals", grid(("work", "goal", "measured", "outcome"), rows)]
    if table.notes:
        parts += ["## Notes", *table.notes]
    return "\n\n".join(parts) + "\n"


def conditions(packages: Sequence[str], load_before: float) -> str:
    """Return a paragraph on the commit, the machine, its load, the threads and the software."""
    threads = {str(each["num_threads"]) for each in threadpool_info() if each["user_api"] == "blas"}
    versions = ", ".join(f"{package} {_version(package)}" for package in packages)
    return (
        f"Commit {commit()}. {_processor()}, {os.cpu_count()} cores, {platform.system()} "
        f"{platform.machine()}; load average of a minute {load_before:.1f} before, {load():.1f} "
        f"after, this work included. Threads of BLAS: {' and '.join(sorted(threads)) or 'none'}, "
        f"for every implementation. Python {platform.python_version()}, {versions}."
    )


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return version(package)  # in an environment of its own, or not at all


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def commit() -> str:
    """Return the commit, and whether tracked files differ from it."""
    command = ["git", "describe", "--always", "--dirty=, with changes not committed"]
    try:
        done = subprocess.run(  # noqa: S603  # a fixed command
            command, capture_output=True, text=True, check=True, cwd=RESULTS.parent
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def _grid(columns: Sequence[str], rows: Sequence[Sequence[Cell]], width: int | None) -> str:
    texts = [[_text(cell) for cell in row] for row in rows]
    if width is not None and _narrowest([columns, *texts]) > width:
        named = (zip(columns, line, strict=True) for line in texts)
        return "\n".join(
            f"- {'; '.join(f'{head}: {text}' for head, text in line if text != '-')}"
            for line in named
        )
    lines = [columns, ["---"] * len(columns), *texts]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _narrowest(lines: Sequence[Sequence[str]]) -> int:
    """Return the least width of a table in a terminal: its longest words, and three between two."""
    columns = zip(*lines, strict=True)
    words = ((word for text in column for word in text.split()) for column in columns)
    return sum(max(map(len, column), default=0) + 3 for column in words)


def _text(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return f"{cell:.9g}" if abs(cell) >= 1000.0 else f"{cell:.3g}"
    return str(cell).replace("|", r"\|").replace("\n", " ")
