"""Damaged files of other programs: each is read, or refused in one line that names it."""

from __future__ import annotations

from pathlib import Path

import drake_rho as rho
from benchmarks.damaged_files import table_of
from benchmarks.file_kinds import scenario
from benchmarks.format_kinds import Kind, format_kinds
from benchmarks.tables import Table


def run(files: int) -> Table:
    """Return a table of the answers to damaged files, a row for each kind."""
    return table_of(files, "clients_damaged", "Damaged files of other programs", _kinds)


def _kinds(folder: Path) -> list[Kind]:
    return format_kinds(folder, rho.plan(scenario(folder)))
