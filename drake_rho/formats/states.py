"""CSV and JSON formats: states of all vehicles, readable as a plan in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from drake_rho.formats.format import RATE, Format, exported
from drake_rho.formats.record import Exported
from drake_rho.motion.documents import write_document
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.samples import with_knots
from drake_rho.motion.tables import column_of, first_row, numbers_of_row, read_rows, write_table
from drake_rho.motion.trajectories import sampled
from drake_rho.system.files import atomic_write

_NAMES = dict.fromkeys(("vehicle", "name", "id"), "vehicle")
_NAMES |= {"time": "time", "t": "time", "x": "x", "y": "y", "z": "z"}
"""Columns by their names, without units."""
_NUMBERS = ("time", "x", "y", "z")


class Csv(Format):
    """Table of states at a rate, and at every knot in addition."""

    name = "csv"
    endings = (".csv",)
    content = "states at a rate and at every knot"
    any_motion = True
    read_by = "rho.load(path, scenario=...), rho.load_trajectories(path)"
    reads = "a table with columns time, x, y and z"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write one row for each vehicle and time."""
        times, _ = with_knots(flown.scenario.grid, rate or RATE, flown.scenario.lead)
        samples = sample(flown, times)
        with atomic_write(path) as file:
            write_table(file, samples)
        return exported(flown, path, [path], f"{len(times)} states of each vehicle")

    def recognises(self, content: bytes) -> bool:
        """Return whether the first row names the columns, or has four numbers and no names."""
        first = first_row(content)
        with suppress(ValueError):  # a unit is refused by `read`
            return _columns(first).keys() >= {*_NUMBERS}
        return True

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return straight lines between the positions of each vehicle; other states are left out.

        The vehicle is the one of the file if no column names it. Times are in seconds, or in ms if
        the column's name says so.
        """
        rows = read_rows(content)
        line, first = rows[0]
        try:
            columns = _columns(first)
        except ValueError as error:
            raise ValueError(f"row {line}, {error}") from None
        numbers = [columns[each][0] for each in _NUMBERS]
        named = columns["vehicle"][0] if "vehicle" in columns else None
        tables = dict[str, list[list[float]]]()
        for number, row in rows if _is_number(first[numbers[0]]) else rows[1:]:
            if len(row) <= max([*numbers, -1 if named is None else named]):
                raise ValueError(f"row {number}: got {len(row)} cells, expected {len(first)}")
            found = numbers_of_row(number, [row[k] for k in numbers], _NUMBERS)
            found[0] *= columns["time"][1]
            table = tables.setdefault(name if named is None else row[named], [])
            if table and not found[0] > table[-1][0]:
                expected = f"expected a time after {table[-1][0]:.12g} s"
                raise ValueError(f"row {number}: got {found[0]:.12g} s, {expected}")
            table.append(found)
        if not tables:
            raise ValueError("got no rows, expected times and positions below the header")
        return {each: sampled(each, np.array(table)) for each, table in tables.items()}


def _columns(first: Sequence[str]) -> dict[str, tuple[int, float]]:
    """Return the numbers and units of the columns of times, positions and vehicles.

    Args:
        first: first row, of names or of numbers.

    Raises:
        ValueError: a column is in another unit.
    """
    if len(first) == len(_NUMBERS) and all(map(_is_number, first)):
        return {name: (k, 1.0) for k, name in enumerate(_NUMBERS)}
    found = dict[str, tuple[int, float]]()
    for k, cell in enumerate(first):
        if (column := column_of(k + 1, cell, _NAMES)) is not None:
            found.setdefault(column[0], (k, column[1]))
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


class Json(Format):
    """Document with scenario, units and states at every knot, and at a rate if one is given.

    If the scenario has smoothing, the states are those of the plan before averaging.
    """

    name = "json"
    endings = (".json",)
    content = "scenario and states at every knot, and at a rate if one is given"
    read_by = "rho.load(path)"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write one document that `load` reads as the same plan."""
        if rate is not None and flown.scenario.smoothing is not None:
            expected = f"none with {self.name} and smoothing: it holds the plan that is averaged"
            raise ValueError(f"rate: got {rate:g}, expected {expected}")
        with atomic_write(path) as file:
            write_document(file, flown, rate)
        return exported(flown, path, [path], "scenario and states")
