"""CSV and JSON formats: states of all vehicles, readable as a plan in JSON."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drake_rho.formats.format import RATE, Format, exported
from drake_rho.formats.record import Exported
from drake_rho.motion.documents import write_document
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.samples import with_knots
from drake_rho.motion.tables import first_row, numbers_of_row, read_rows, write_table
from drake_rho.motion.trajectories import sampled
from drake_rho.system.files import atomic_write

_NAMES = {"vehicle": ("vehicle", "name", "id"), "time": ("time", "t")}
_NAMES |= {axis: (axis,) for axis in "xyz"}
"""Names of columns, without units, for times and positions."""
_UNIT, _UNIT_MS = re.compile(r"\s*[\[(].*"), re.compile(r"\[m(illi)?se?c?\]", re.IGNORECASE)


class Csv(Format):
    """Table of states at a rate, and at every knot in addition."""

    name = "csv"
    endings = (".csv",)
    content = "states at a rate and at every knot"
    any_motion = True
    read_by = "rho.load(path, scenario=...)"
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
        return _columns(first_row(content)) is not None

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return straight lines between the positions of each vehicle; other states are left out.

        The vehicle is the one of the file if no column names it. Times are in seconds unless the
        column's name has the unit ms or msec.
        """
        rows = read_rows(content)
        columns = _columns(rows[0]) or {}
        named, numbers = columns.pop("vehicle", None), [*columns.values()]
        first = 0 if _is_number(rows[0][numbers[0]]) else 1
        unit = 1.0 if first == 0 or _UNIT_MS.search(rows[0][numbers[0]]) is None else 1e-3
        tables = dict[str, list[list[float]]]()
        for number, row in enumerate(rows[first:], start=first + 1):
            if not row:
                continue
            if len(row) <= max([*numbers, -1 if named is None else named]):
                raise ValueError(f"row {number}: got {len(row)} cells, expected {len(rows[0])}")
            found = numbers_of_row(number, [row[k] for k in numbers], [*columns])
            found[0] *= unit
            table = tables.setdefault(name if named is None else row[named], [])
            if table and not found[0] > table[-1][0]:
                expected = f"expected a time after {table[-1][0]:.12g} s"
                raise ValueError(f"row {number}: got {found[0]:.12g} s, {expected}")
            table.append(found)
        return {each: sampled(each, np.array(table)) for each, table in tables.items()}


def _columns(first: Sequence[str]) -> dict[str, int] | None:
    """Return the numbers of the columns of times and positions, and of vehicles if there are any.

    Args:
        first: first row, of names or of numbers.
    """
    if len(first) == len(_NAMES) - 1 and all(map(_is_number, first)):
        return {"time": 0, "x": 1, "y": 2, "z": 3}
    plain = [_UNIT.sub("", cell).lower() for cell in first]
    found = {
        name: next((k for k, cell in enumerate(plain) if cell in words), None)
        for name, words in _NAMES.items()
    }
    known = {name: k for name, k in found.items() if k is not None}
    return known if known.keys() >= {"time", "x", "y", "z"} else None


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
