"""Tables of waypoints (CSV): a place in each row, with or without a header and a time."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drake_rho.formats.folders import write_each
from drake_rho.formats.format import Format, exported, planned
from drake_rho.formats.record import Exported
from drake_rho.formats.straight_legs import Legs, legs_of
from drake_rho.formats.texts import in_file, text_of
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.motion.tables import rows_of, write_rows
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.records import Waypoint

COLUMNS = ("time [s]", "x [m]", "y [m]", "z [m]")
_MOST_ROWS = 10_000
_TIMES, _PLACES = ("t", "time"), ("x", "y", "z")


@checked
def load_waypoints(path: str | Path) -> tuple[Waypoint, ...]:
    """Read a table of waypoints in CSV, one in each row.

    The columns are x, y, z [m], or a time [s] before them; a header may name them in any order,
    with units in brackets that have to be these (`time [s]`, `t`, `x [m]`, `x`). Columns may be
    separated by commas, semicolons or tabs. Empty lines, and those that begin with #, are skipped.

    Returns:
        Waypoints, without times if the table has none. The first and last row of a table that
        `export` wrote are start and goal: `start, *waypoints, goal = load_waypoints(path)`.

    Raises:
        ScenarioError: the file cannot be read, or a row is no waypoint; the error's field names
            file, line and column.
    """
    with in_file(Path(path)):
        return _parse(text_of(Path(path), "table (CSV)"))


def _parse(text: str) -> tuple[Waypoint, ...]:
    try:
        rows = rows_of(text)
    except csv.Error as error:
        raise ScenarioError("", Description("malformed CSV"), f"CSV; {error}") from None
    if not rows:
        raise ScenarioError("", Description("no row"), "at least one waypoint: x, y, z in metres")
    order = tuple(range(len(rows[0][1])))
    if not any(_is_number(cell) for cell in rows[0][1]):
        (line, header), *rows = rows
        order = _order(line, header)
        if not rows:
            expected = "at least one waypoint below the header"
            raise ScenarioError("", Description("no rows"), expected)
    elif len(order) not in (3, 4):
        expected = "3, x, y, z; or 4, a time before them"
        raise ScenarioError(f"line {rows[0][0]}", Description(f"{len(order)} columns"), expected)
    if len(rows) > _MOST_ROWS:
        raise ScenarioError("", Description(f"{len(rows)} rows"), f"at most {_MOST_ROWS}")
    return tuple(_waypoint(line, row, order) for line, row in rows)


def _order(line: int, header: Sequence[str]) -> tuple[int, ...]:
    """Return the columns of time, if there is one, and of x, y, z."""
    found = dict[str, int]()
    for column, cell in enumerate(header):
        word, _, unit = cell.lower().partition("[")
        name, where = word.strip(), f"line {line}, column {column + 1}"
        name = "time" if name in _TIMES else name
        right = "s]" if name == "time" else "m]"
        if name not in ("time", *_PLACES) or name in found:
            raise ScenarioError(where, cell, "time, x, y and z, each of them once")
        if unit.strip() not in ("", right):
            raise ScenarioError(where, cell, f"{name} [{right}")
        found[name] = column
    if missing := [name for name in _PLACES if name not in found]:
        raise ScenarioError(f"line {line}", list(header), f"a column {missing[0]}")
    return tuple(found[name] for name in ("time", *_PLACES) if name in found)


def _waypoint(line: int, row: Sequence[str], order: Sequence[int]) -> Waypoint:
    if len(row) != len(order):
        got = Description(f"{len(row)} columns")
        raise ScenarioError(f"line {line}", got, f"{len(order)}, as in the first row")
    for column, cell in enumerate(row, start=1):
        if not _is_number(cell):
            expected = f"a number of at most {LARGEST:g}"
            raise ScenarioError(f"line {line}, column {column}", cell, expected)
    numbers = [float(row[column]) for column in order]
    return Waypoint(None if len(numbers) == 3 else numbers[0], numbers[-3:])


def _is_number(cell: str) -> bool:
    try:
        return abs(float(cell)) <= LARGEST  # false for NaN
    except ValueError:
        return False


class WaypointTables(Format):
    """Table of times and places, joined by straight lines, for each vehicle."""

    name = "waypoints"
    endings = (".csv",)
    folder = True
    rated = False
    content = "times and places, joined by straight lines within 0.1 m of the plan"
    read_by = "rho.load_waypoints(path)"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write the table of the only vehicle, or a folder with one for each.

        Raises:
            ValueError: several vehicles are to be in one file, or a simulation was given.
        """
        plan = planned(flown, self.name)
        legs = legs_of(plan, timed=True)
        files = write_each(path, plan.scenario.names, ".csv", map(_table, legs))
        words = f"{max(len(each.times) for each in legs)} places, joined by straight lines,"
        deviations = np.array([each.deviation for each in legs])
        return exported(plan, path, files, words, deviations)


def _table(legs: Legs) -> bytes:
    """Return the content of a vehicle's table."""
    rows = np.column_stack([legs.times, legs.positions]).tolist()
    write_rows(file := io.BytesIO(), [COLUMNS, *rows])
    return file.getvalue()
