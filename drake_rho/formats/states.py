"""CSV and JSON formats: states of all vehicles, readable as a plan in JSON."""

from __future__ import annotations

from pathlib import Path

from drake_rho.formats.format import RATE, Format, exported
from drake_rho.formats.record import Exported
from drake_rho.motion.documents import write_document
from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.headings import Heading
from drake_rho.motion.samples import with_knots
from drake_rho.motion.tables import write_table
from drake_rho.system.files import atomic_write


class Csv(Format):
    """Table of states at a rate, and at every knot in addition."""

    name = "csv"
    endings = (".csv",)
    content = "states at a rate and at every knot"
    read = "rho.load(path, scenario=...)"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write one row for each vehicle and time."""
        times, _ = with_knots(flown.scenario.grid, rate or RATE, flown.scenario.lead)
        samples = sample(flown, times)
        with atomic_write(path) as file:
            write_table(file, samples)
        return exported(flown, path, [path], f"{len(times)} states of each vehicle")


class Json(Format):
    """Document with scenario, units and states at every knot, and at a rate if one is given.

    If the scenario has smoothing, the states are those of the plan before averaging.
    """

    name = "json"
    endings = (".json",)
    content = "scenario and states at every knot, and at a rate if one is given"
    read = "rho.load(path)"

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
