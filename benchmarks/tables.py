"""What a benchmark returns, the conditions it ran under, and how both become files."""

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

RESULTS = Path(__file__).parent / "results"
"""Where the tables are written."""

Cell = str | float | int | bool | None


@dataclasses.dataclass(frozen=True)
class Goal:
    """Something to be reached, beside what was measured."""

    work: str
    """what is compared"""
    most: float
    """the goal: at most this"""
    measured: float | None
    """None if it could not be"""

    @property
    def outcome(self) -> str:
        """In one word, or in three."""
        if self.measured is None:
            return "not measured"
        return "met" if self.measured <= self.most else "missed"


@dataclasses.dataclass(frozen=True)
class Table:
    """The result of one benchmark."""

    name: str
    """of its files"""
    title: str
    """heading of the Markdown file"""
    columns: tuple[str, ...]
    """heads"""
    rows: tuple[tuple[Cell, ...], ...]
    """one cell a column; None where there is nothing to say"""
    notes: tuple[str, ...] = ()
    """paragraphs of Markdown after the table: what was done, and its limitations"""
    goals: tuple[Goal, ...] = ()
    """in their own table, if there are any"""
    packages: tuple[str, ...] = ("drake-rho", "drake", "numpy", "scipy")
    """whose versions matter"""


def write(table: Table, folder: Path = RESULTS) -> tuple[Path, Path]:
    """Write `<name>.md` and `<name>.csv` into `folder`, and say where."""
    folder.mkdir(parents=True, exist_ok=True)
    markdown, values = folder / f"{table.name}.md", folder / f"{table.name}.csv"
    markdown.write_text(to_markdown(table), encoding="utf-8")
    with values.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.columns)
        writer.writerows(table.rows)
    return markdown, values


def to_markdown(table: Table, width: int | None = None) -> str:
    """The whole Markdown file: results, goals, notes, conditions.

    Args:
        table: the result.
        width: columns of a terminal; where a table is wider even with a word a line, each of its
            rows becomes an item of a list. As wide as they are if not given.
    """
    grid = partial(_grid, width=width)
    parts = [f"# {table.title}", grid(table.columns, table.rows)]
    if table.goals:
        rows = [
            (goal.work, f"at most {goal.most:.3g}", goal.measured, goal.outcome)
            for goal in table.goals
        ]
        parts += ["## Goals", grid(("work", "goal", "measured", "outcome"), rows)]
    if table.notes:
        parts += ["## Notes", *table.notes]
    parts += ["## Conditions", grid(("what", "value"), list(conditions(table.packages).items()))]
    return "\n\n".join(parts) + "\n"


def conditions(packages: Sequence[str]) -> dict[str, str]:
    """The machine, the software and the commit that a measurement belongs to."""
    found = {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": f"{platform.system()} {platform.machine()}",
        "Python": platform.python_version(),
        "commit": commit(),
        "load average": f"{os.getloadavg()[1]:.1f} in the last five minutes, this work included",
    }
    for package in packages:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def commit() -> str:
    """The commit, and whether tracked files differ from it."""
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
    """How wide a table is in a terminal at the least: its longest words, and three between two."""
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
