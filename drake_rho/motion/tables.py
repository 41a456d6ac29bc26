"""States as a table in CSV: one row for a vehicle at a time."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import IO

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import Samples, knots_among
from drake_rho.scenario.fields import LARGEST, FloatArray
from drake_rho.scenario.records import Scenario

COLUMNS = (
    "vehicle",
    "time [s]",
    *("x [m]", "y [m]", "z [m]"),
    *("vx [m/s]", "vy [m/s]", "vz [m/s]"),
    *("ax [m/s^2]", "ay [m/s^2]", "az [m/s^2]"),
)
"""In plain ASCII: not every program that reads tables guesses the encoding."""


def write_rows(file: IO[bytes], rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, every number with all of its digits."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    text.detach()  # writes what is left, and leaves the file open


def write_table(file: IO[bytes], samples: Samples) -> None:
    """Write a header and all states, vehicle after vehicle."""
    write_rows(file, [COLUMNS])
    times = samples.times.tolist()
    for name, states in samples.by_vehicle():
        rows = zip(times, states.tolist(), strict=True)
        write_rows(file, ([name, time, *numbers] for time, numbers in rows))


def is_table(text: str) -> bool:
    """Whether text begins like such a table."""
    return text.startswith(",".join(COLUMNS))


def read_table(text: str, scenario: Scenario) -> Plan:
    """The plan whose states a table holds, at every knot of its scenario.

    Raises:
        ValueError: the table is another one, or a vehicle or a knot is missing in it.
    """
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
    """States of a vehicle at the knots, shape (K, 9)."""
    numbers = np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS) - 1)
    if not np.all(np.abs(numbers) <= LARGEST):  # never with a NaN
        raise ValueError(f"{name} has values that are no numbers up to {LARGEST:g}")
    numbers = numbers[np.argsort(numbers[:, 0], kind="stable")]
    try:
        found = knots_among(scenario.grid, numbers[:, 0])
    except ValueError as error:
        raise ValueError(f"{name} has {error}") from None
    return np.asarray(numbers[found, 1:])
