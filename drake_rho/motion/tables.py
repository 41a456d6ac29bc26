"""CSV tables of states, with one row per vehicle and time."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import IO

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import COLUMNS, Samples, knots_among
from drake_rho.scenario.errors import shortened
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import Scenario


def write_rows(file: IO[bytes], rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, with all digits of every number."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    text.detach()  # flushes the buffer and leaves the file open


def read_rows(content: bytes) -> list[list[str]]:
    """Return the rows of a CSV file without spaces around cells and empty cells at the ends.

    Raises:
        ValueError: it is not a UTF-8 text, or a row is damaged.
    """
    try:
        text = io.StringIO(content.decode("utf-8-sig"), newline="")
        rows = [[cell.strip() for cell in row] for row in csv.reader(text, strict=True)]
    except UnicodeDecodeError:
        raise ValueError("not a UTF-8 text file") from None
    except csv.Error as error:
        raise ValueError(f"not a table: {error}") from None
    for row in rows:
        while row and not row[-1]:
            row.pop()
    return rows


def first_row(content: bytes) -> list[str]:
    """Return the first row of a CSV file as `read_rows` does; no cell if it is another file."""
    with suppress(ValueError):
        return next(iter(read_rows(content.partition(b"\n")[0])), [])
    return []


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
