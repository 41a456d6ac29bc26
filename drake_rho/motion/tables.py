"""CSV tables of states, with one row per vehicle and time."""

from __future__ import annotations

import codecs
import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import IO

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import COLUMNS, Samples, knots_among
from drake_rho.scenario.errors import shorten, shortened
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import Scenario

_BEGINNING = 1 << 20
"""Bytes of a file in which its first row is looked for."""
_SECONDS = dict.fromkeys(("s", "sec", "second", "seconds"), 1.0)
_SECONDS |= dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3)
_METRES = dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0)
_UNITS = {"time": _SECONDS, "x": _METRES, "y": _METRES, "z": _METRES}
"""Units in headers."""


def write_rows(file: IO[bytes], rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, with all digits of every number."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    text.detach()  # flushes the buffer and leaves the file open


def rows_of(text: str) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV text, with their line numbers and without spaces around cells.

    Columns are separated by commas, semicolons or tabs. Empty rows, and those that begin with #,
    are left out.

    Raises:
        csv.Error: a row is damaged.
    """
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_separator(text), strict=True)
    rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    return [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")]


def _separator(text: str) -> str:
    """Return the separator that the first row has most often."""
    first = next(filter(_is_row, io.StringIO(text)), "")
    return max(",;\t", key=first.count)


def _is_row(line: str) -> bool:
    """Return whether a line is a row, neither empty nor a comment."""
    return bool(line.strip()) and not line.lstrip().startswith("#")


def read_rows(content: bytes) -> list[tuple[int, list[str]]]:
    """Return the rows of a CSV file as `rows_of` does, without empty cells at their ends.

    Raises:
        ValueError: it is not a UTF-8 text, or a row is damaged.
    """
    try:
        rows = rows_of(content.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError("not a UTF-8 text file") from None
    except csv.Error as error:
        raise ValueError(f"not a table: {error}") from None
    for _, row in rows:
        while not row[-1]:
            row.pop()
    return rows


def first_row(content: bytes) -> list[str]:
    """Return the first row of a CSV file as `read_rows` does; no cell if it is another file."""
    lines = io.BytesIO(content[:_BEGINNING].removeprefix(codecs.BOM_UTF8))
    first = next((each for each in lines if each.strip() and each.lstrip()[:1] != b"#"), b"")
    with suppress(ValueError):
        return next((row for _, row in read_rows(first)), [])
    return []


def column_of(number: int, cell: str, names: Mapping[str, str]) -> tuple[str, float] | None:
    """Return the column that a cell of a header names, and its unit in s or m.

    Args:
        number: number of the column, from 1.
        cell: such as `time [ms]`, `x (m)` or `y`.
        names: columns by their names in small letters; time, x, y and z have units.

    Returns:
        The column and the size of its unit; None if it has none of the names.

    Raises:
        ValueError: the column is in another unit.
    """
    word, _, unit = cell.lower().replace("(", "[").partition("[")
    if (name := names.get(word.strip())) is None:
        return None
    units = _UNITS.get(name)
    if units is None or not (found := unit.strip(" ])")):
        return name, 1.0
    if found not in units:
        expected = "time [s] or time [ms]" if name == "time" else f"{name} [m]"
        raise ValueError(f"column {number}: got {shorten(cell)}, expected {expected}")
    return name, units[found]


def numbers_of_row(number: int, cells: Sequence[str], names: Sequence[str]) -> list[float]:
    """Return the numbers in cells of a row.

    Args:
        number: number of the row in its file, from 1.
        cells: the cells.
        names: name of each cell's column.

    Raises:
        ValueError: cells are missing, or one is not a number of a flight.
    """
    if len(cells) < len(names):
        raise ValueError(f"row {number}: got {len(cells)} cells, expected {', '.join(names)}")
    return [_number(number, *each) for each in zip(cells, names, strict=False)]


def _number(row: int, cell: str, column: str) -> float:
    try:
        found = float(cell)
    except ValueError:
        found = np.nan
    if not abs(found) <= LARGEST:  # also true for NaN
        expected = f"expected a number of at most {LARGEST:g}"
        raise ValueError(f"row {row}, column {column}: got {shortened(repr(cell))}, {expected}")
    return found


def write_table(file: IO[bytes], samples: Samples) -> None:
    """Write a header and all states, vehicle by vehicle."""
    columns = samples.columns()
    write_rows(file, [tuple(columns), *zip(*columns.values(), strict=True)])


def is_table(text: str) -> bool:
    """Return whether text begins with the header of such a table."""
    return text.startswith(",".join(COLUMNS))


def read_table(text: str, scenario: Scenario) -> Plan:
    """Return the plan whose states a table contains at every knot of its scenario.

    Raises:
        ValueError: the columns or vehicles differ, a vehicle or a knot is missing, or the scenario
            has a smoothing: a table holds averages, from which no plan follows.
    """
    if scenario.smoothing is not None:
        expected = "expected one without smoothing: a table holds averages, .json the plan"
        raise ValueError(f"{scenario.name} has a smoothing, {expected}")
    header, *lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    if tuple(header) != COLUMNS:
        raise ValueError(f"expected the columns {', '.join(COLUMNS)}")
    rows: dict[str, list[list[float]]] = {vehicle.name: [] for vehicle in scenario.vehicles}
    for number, line in enumerate(lines, start=1):
        if len(line) != len(COLUMNS) or line[0] not in rows:
            expected = f"a vehicle of {scenario.name} and {len(COLUMNS) - 1} numbers"
            raise ValueError(f"row {number} below the header: expected {expected}")
        rows[line[0]].append([float(cell) for cell in line[1:]])
    states = np.array([_at_knots(name, each, scenario) for name, each in rows.items()])
    p, v, a = np.split(states, 3, axis=-1)
    return Plan(scenario, p, v, a[:, :-1])


def _at_knots(name: str, rows: list[list[float]], scenario: Scenario) -> FloatArray:
    """Return the states of a vehicle at the knots, shape (K, 9)."""
    numbers = np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS) - 1)
    if not np.all(np.abs(numbers) <= LARGEST):  # also true for NaN
        raise ValueError(f"{name} has values that are not numbers up to {LARGEST:g}")
    numbers = numbers[np.argsort(numbers[:, 0], kind="stable")]
    try:
        found = knots_among(scenario.grid, numbers[:, 0])
    except ValueError as error:
        raise ValueError(f"{name} has {error}") from None
    return np.asarray(numbers[found, 1:])
