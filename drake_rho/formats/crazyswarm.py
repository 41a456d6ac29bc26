"""Crazyswarm2 format: piecewise polynomials, in a folder with a CSV file for each vehicle."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np

from drake_rho.formats.folders import check_folder, file_names, write_folder
from drake_rho.formats.format import Format, exported, planned
from drake_rho.formats.merged import merged
from drake_rho.formats.pieces import DEGREE, Pieces, as_pieces
from drake_rho.formats.record import Exported
from drake_rho.motion.dynamics import Motion
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading, directions_of
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.tables import first_row, numbers_of_row, read_rows, write_rows
from drake_rho.scenario.errors import shorten

MAX_PIECES = 31
"""Largest number of pieces of a vehicle: a Crazyflie has 4096 bytes for trajectories, and a piece
takes 33 numbers of 4 bytes."""
_ROUNDED_DIGITS = range(5, 10)
"""Numbers of digits after the point at which the coefficients of a file count as rounded: many
programs write six. With fewer they are exact, and with more pieces join as well as in plans."""
COLUMNS = ("duration", *(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(8)))


class Crazyswarm(Format):
    """Polynomials of degree 7 with their durations, and constant headings."""

    name = "crazyswarm"
    folder = True
    rated = False
    content = "polynomials of degree 7, constant headings"
    heading = "angles"
    read_by = "rho.load_trajectories(path)"
    reads = "polynomials of Crazyswarm (duration, x^0, …)"
    from_zero = True

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write a file for each vehicle, named after it."""
        plan = planned(flown, self.name)
        directions = directions_of(plan.scenario.names, heading)
        yaws = [each for each in directions if isinstance(each, float)]  # all of them, by `check`
        names = file_names(plan.scenario.names, ".csv")
        check_folder(path, names)
        if plan.scenario.smoothing is None:
            motion = _with_two_steps(plan.motion())
            steps, pieces = motion.accelerations.shape[1], as_pieces(motion, MAX_PIECES)
        else:
            whole = plan.polynomials()
            steps, pieces = len(whole.instants) - 1, merged(whole, MAX_PIECES)
        write_folder(path, dict(zip(names, _tables(pieces, yaws), strict=True)))
        count, kind = len(pieces.durations), "polynomials" if plan.scenario.smoothing else "steps"
        words = f"{steps} {kind} of each vehicle as {count} pieces"
        return exported(flown, path, [path / name for name in names], words, pieces.deviations)

    def recognises(self, content: bytes) -> bool:
        """Return whether the first row has the names of the columns, or numbers in each of them."""
        first = first_row(content)
        return len(first) == len(COLUMNS) or (len(first) > 0 and first[0].lower() == "duration")

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return the motion in a file of one vehicle; the heading is left out."""
        rows = read_rows(content)
        if rows[0][1][0].lower() == COLUMNS[0]:
            _check_header(*rows.pop(0))
        for number, row in rows:
            if len(row) > len(COLUMNS):
                expected = f"{len(COLUMNS)}, the last one {COLUMNS[-1]}"
                raise ValueError(f"row {number}: got {len(row)} cells, expected {expected}")
        table = np.array([numbers_of_row(*row, COLUMNS) for row in rows])
        if len(table) == 0:
            raise ValueError("got no piece, expected one in each row below the header")
        if (short := table[:, 0] <= 0.0).any():
            number = rows[int(np.argmax(short))][0]
            raise ValueError(f"row {number}, column duration: expected a positive number")
        axes = table[:, 1:].reshape(len(table), 4, DEGREE + 1)
        digits = max(_digits(cell) for _, row in rows for cell in row)
        resolution = 0.5 * 10.0**-digits if digits in _ROUNDED_DIGITS else 0.0
        return {name: Polynomials.lasting(table[:, 0], axes[:, :3], resolution)}


def _digits(cell: str) -> float:
    """Return the number of digits after the point; infinite with an exponent."""
    return np.inf if "e" in cell.lower() else len(cell.partition(".")[2])


def _check_header(number: int, header: Sequence[str]) -> None:
    """Check that a header names the first columns, in their order; it may leave out the others.

    Args:
        number: number of its row.
        header: its cells.

    Raises:
        ValueError: a column is another one.
    """
    for k, (cell, column) in enumerate(zip_longest(header, COLUMNS[: len(header)]), start=1):
        if cell.lower() != column:
            expected = f"expected {column or f'none after {COLUMNS[-1]}'}"
            raise ValueError(f"row {number}, column {k}: got {shorten(cell)}, {expected}")


def _with_two_steps(motion: Motion) -> Motion:
    """Cut a single step in two: Crazyswarm2 reads no file with a single row."""
    if motion.accelerations.shape[1] > 1:
        return motion
    times = motion.step * np.array([0.0, 0.5, 1.0])
    return Motion(
        motion.step / 2.0,
        motion.at("position", times),
        motion.at("velocity", times),
        np.repeat(motion.accelerations, 2, axis=1),
        motion.before,
        motion.after,
    )


def _tables(pieces: Pieces, yaws: list[float]) -> list[bytes]:
    """Return the contents of each vehicle's file, with its heading [rad]."""
    durations, tables = pieces.durations.tolist(), []
    numbers = pieces.coefficients.reshape(len(pieces.coefficients), len(durations), -1).tolist()
    for each, yaw in zip(numbers, yaws, strict=True):
        constant = [yaw] + [0.0] * DEGREE
        rows = [[time, *row, *constant] for time, row in zip(durations, each, strict=True)]
        write_rows(file := io.BytesIO(), [COLUMNS, *rows])
        tables.append(file.getvalue())
    return tables
