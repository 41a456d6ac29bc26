"""CSV tables of states, with one row per vehicle and time."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import IO

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import COLUMNS, Samples, knots_among
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import Scenario


def write_rows(file: IO[bytes], rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, with all digits of every number."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    text.detach()  # flushes the buffer and leaves the file open


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
