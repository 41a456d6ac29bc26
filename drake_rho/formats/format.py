"""`Format`: base class of file formats."""

from __future__ import annotations

import errno
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from drake_rho.formats.clearance import spare_of
from drake_rho.formats.folders import check_folder
from drake_rho.formats.reader import Reader
from drake_rho.formats.record import Exported
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading, direction_of
from drake_rho.motion.jumps import check_continuous
from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import check_rate
from drake_rho.scenario.fields import FloatArray
from drake_rho.system.files import check_replaceable

RATE = 20.0
"""Samples per second if no rate is given; PX4 leaves the offboard mode below 2."""
_OF_FILES = {".csv", ".json", ".npz", ".yaml", ".zip"}
"""File endings that a folder must not have, because they suggest that another format was meant."""


class Format(Reader, ABC):
    """File format of exports, `export(..., format=name)`."""

    endings: ClassVar[tuple[str, ...]] = ()
    """endings of files in this format"""
    folder: ClassVar[bool] = False
    """whether the format can be written as a folder"""
    content: ClassVar[str]
    """description of what a file holds"""
    heading: ClassVar[Literal["none", "angles", "any"]] = "none"
    """headings that the format holds: none, constant angles, or any"""
    any_motion: ClassVar[bool] = False
    """whether the format holds trajectories of any planner, not only steps of plans"""

    def check(self, path: Path, rate: float | None, heading: Heading | None) -> None:
        """Check, before any work, that a path, a rate and a heading suit this format.

        Raises:
            ValueError: the format does not support the ending, the rate or the heading, or the path
                cannot be written to.
        """
        self._check_heading(heading)
        if rate is not None and not self.rated:
            expected = f"none with {self.name}, which holds no samples"
            raise ValueError(f"rate: got {rate:g}, expected {expected}")
        check_rate(rate)
        ending = path.suffix.lower()
        try:
            if ending in self.endings:
                check_replaceable(path)
            elif self.folder and ending not in _OF_FILES:
                check_folder(path)
            else:
                raise OSError(errno.EINVAL, "another ending")
        except (OSError, ValueError) as error:  # ValueError for a path with a NUL
            reason = getattr(error, "strerror", error)
            raise ValueError(
                f"path: got {str(path)!r}, expected {self._kinds} ({reason})"
            ) from None

    def _check_heading(self, heading: Heading | None) -> None:
        """Check that the format holds a heading.

        Raises:
            ValueError: it does not, or the heading is none of those allowed.
        """
        if heading is None:
            return
        if self.heading == "none":
            raise ValueError(f"heading: got one, expected none with {self.name}, which holds none")
        directions = heading.values() if isinstance(heading, Mapping) else [heading]
        for each in map(direction_of, directions):
            if self.heading == "angles" and not isinstance(each, float):
                expected = f"angles in rad with {self.name}, which holds no other headings"
                raise ValueError(f"heading: got {each!r}, expected {expected}")

    @property
    def _kinds(self) -> str:
        """Description of the paths that can be written."""
        kinds = [f"a file to write, ending in {' or '.join(self.endings)}"] if self.endings else []
        kinds += ["a folder, new or of the same files"] if self.folder else []
        return ", or ".join(kinds)

    @abstractmethod
    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write a motion, completely or not at all.

        Args:
            flown: the motion.
            path: as checked by `check`.
            rate: samples per second [1/s]; None for the default.
            heading: as checked by `check`; None for the x axis.

        Raises:
            ValueError: the format does not hold such a motion.
        """


def planned(flown: Flown, format: str) -> Plan:
    """Return the plan to write in a format for future motions.

    Raises:
        ValueError: the motion is none to be flown.
    """
    check_ahead(flown, format)
    return flown.plan


def check_ahead(flown: Flown, format: str) -> None:
    """Check that a motion can be written in a format for future motions.

    Raises:
        ValueError: a simulation was given, or a flight that jumps to measured states: their motions
            are in the past, and no vehicle can follow a jump.
    """
    expected = f"a plan or a flight with {format}, as what is to be flown"
    if flown.simulation is not None:
        raise ValueError(f"flown: got a simulation, expected {expected}")
    check_continuous(flown.plan, expected)


def exported(
    flown: Flown,
    path: Path,
    files: Iterable[Path],
    words: str,
    deviations: FloatArray | None = None,
) -> Exported:
    """Return the record of an export, which is exact if no deviations are given."""
    names = tuple(vehicle.name for vehicle in flown.scenario.vehicles)
    if deviations is None or not np.any(deviations):
        return Exported(path, tuple(files), words, names, np.zeros(len(names)))
    return Exported(path, tuple(files), words, names, deviations, spare_of(flown, deviations))
