"""Skybrush format: a CSV file for each vehicle, in a folder or a zip archive."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from drake_rho.formats.folders import file_names, write_archive, write_folder
from drake_rho.formats.format import RATE, Format, exported
from drake_rho.formats.lights import lights_of
from drake_rho.formats.milliseconds import milliseconds
from drake_rho.formats.record import Exported
from drake_rho.formats.states import Csv
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading
from drake_rho.motion.jumps import jump_sizes
from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.tables import first_row, write_rows
from drake_rho.scenario.fields import FloatArray, IntArray

COLUMNS = ("Time [msec]", "x [m]", "y [m]", "z [m]", "Red", "Green", "Blue")
_POSITIONS = tuple(each.lower() for each in COLUMNS[:4])


class Skybrush(Format):
    """Positions at a rate, with lights."""

    name = "skybrush"
    endings = (".zip",)
    content = "positions at a rate, with lights"
    folder = True
    read_by = "rho.load_trajectories(path)"
    reads = "positions of Skybrush (Time [msec], x [m], …)"
    from_zero = True
    tick = 1e-3

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write a file for each vehicle, named after it."""
        ticks = milliseconds(flown.scenario, rate or RATE)
        samples = sample(flown, ticks / 1000.0 - flown.scenario.lead)
        names = file_names(samples.names, ".csv")
        contents = {
            name: _table(ticks, positions, lights.at(ticks / 1000.0))
            for name, positions, lights in zip(
                names, samples.positions, lights_of(flown.scenario), strict=True
            )
        }
        archive = path.suffix.lower() in self.endings
        (write_archive if archive else write_folder)(path, contents)
        files = [path] if archive else [path / name for name in names]
        words = f"{len(ticks)} positions of each vehicle, joined by straight lines,"
        return exported(flown, path, files, words, _chord_deviations(flown, ticks))

    def recognises(self, content: bytes) -> bool:
        """Return whether the first columns are times in milliseconds and positions."""
        return tuple(each.lower() for each in first_row(content)[:4]) == _POSITIONS

    def read(self, content: bytes, name: str) -> dict[str, Polynomials]:
        """Return straight lines between the positions of one vehicle; lights are left out."""
        return Csv().read(content, name)


def _table(ticks: IntArray, positions: FloatArray, colours: FloatArray) -> bytes:
    """Return the contents of one vehicle's file."""
    numbers = colours.astype(np.int64)
    file = io.BytesIO()
    rows = zip(ticks.tolist(), positions.tolist(), numbers.tolist(), strict=True)
    write_rows(file, [COLUMNS, *([tick, *position, *colour] for tick, position, colour in rows)])
    return file.getvalue()


def _chord_deviations(flown: Flown, ticks: IntArray) -> FloatArray:
    """Return upper bounds of the distance between motions and straight lines between samples [m].

    A motion with acceleration at most a is within a w²/8 of the line between two of its points a
    time w apart, and so is an average of it. A jump between them adds at most its size, and w/4
    times that of its velocity. The shape is (N,).
    """
    accelerations = flown.plan.accelerations
    if flown.simulation is not None:
        accelerations = np.moveaxis(flown.simulation.accelerations, 0, 1)
    longest = float(np.diff(ticks).max(initial=0)) / 1000.0
    most = np.linalg.norm(accelerations, axis=-1).max(axis=-1)
    return np.asarray(most * longest**2 / 8.0 + _jumped(flown, ticks, longest))


def _jumped(flown: Flown, ticks: IntArray, longest: float) -> FloatArray:
    """Return upper bounds of the deviations due to jumps between two samples [m], shape (N,).

    Args:
        flown: the motion.
        ticks: times of the samples [ms], shape (M,).
        longest: time between two samples [s].
    """
    plan = flown.plan
    if flown.simulation is not None or not plan.jumps:
        return np.zeros(len(plan.positions))
    positions, velocities = jump_sizes(plan)
    after = np.searchsorted(ticks / 1000.0, plan.scenario.grid.elapsed[list(plan.jumps)])
    added = positions + velocities * longest / 4.0
    between = np.array([np.bincount(after, each, len(ticks)) for each in added])
    return np.asarray((between[:, 1:] + between[:, :-1]).max(axis=1, initial=0.0))
