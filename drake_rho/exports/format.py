"""`Format`: what a format of files says of itself, and how it writes."""

from __future__ import annotations

import errno
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import numpy as np

from drake_rho.exports.clearance import spare
from drake_rho.exports.folders import check_folder
from drake_rho.exports.record import Exported
from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.samples import check_rate
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.files import check_replaceable

_OF_FILES = {".csv", ".json", ".npz", ".yaml", ".zip"}
"""Endings that no folder of an export has: who gives one has taken another format for it."""


class Format(ABC):
    """One format of files."""

    name: ClassVar[str]
    """by which it is asked for"""
    endings: ClassVar[tuple[str, ...]] = ()
    """of files"""
    folder: ClassVar[bool] = False
    """whether it can be a folder, of any other ending"""
    rated: ClassVar[bool] = True
    """whether it holds samples"""

    def check(self, path: Path, rate: float | None) -> None:
        """See before any work that it can be written so.

        Raises:
            ValueError: the ending or the rate is not one of this format, or there is no place to
                write to.
        """
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
        except (OSError, ValueError) as error:  # the latter of a NUL
            reason = getattr(error, "strerror", error)
            raise ValueError(
                f"path: got {str(path)!r}, expected {self._kinds} ({reason})"
            ) from None

    @property
    def _kinds(self) -> str:
        """What can be written, in words."""
        kinds = [f"a file to write, ending in {' or '.join(self.endings)}"] if self.endings else []
        kinds += ["a folder, new or of the same files"] if self.folder else []
        return ", or ".join(kinds)

    @abstractmethod
    def write(self, flown: Plan | Flight | Simulation, path: Path, rate: float | None) -> Exported:
        """Write it, whole or not at all; `rate` [1/s] is the format's own if it is None."""


def planned(flown: Plan | Flight | Simulation, format: str) -> Plan:
    """The plan of a format that is for what is to be flown.

    Raises:
        ValueError: it is a simulation, whose true motion is not.
    """
    if isinstance(flown, Simulation):
        expected = f"a plan or a flight with {format}, as what is to be flown"
        raise ValueError(f"flown: got a simulation, expected {expected}")
    return flown.plan if isinstance(flown, Flight) else flown


def exported(
    flown: Plan | Flight | Simulation,
    path: Path,
    files: Iterable[Path],
    words: str,
    deviations: FloatArray | None = None,
) -> Exported:
    """The record of an export; without deviations it is exact."""
    names = tuple(vehicle.name for vehicle in flown.scenario.vehicles)
    if deviations is None or not np.any(deviations):
        return Exported(path, tuple(files), words, names, np.zeros(len(names)))
    return Exported(path, tuple(files), words, names, deviations, spare(flown, deviations))
