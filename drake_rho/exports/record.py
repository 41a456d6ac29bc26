"""What was written, and how far it is from the motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from drake_rho.exports.clearance import Spare
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class Exported(metaclass=Described):
    """The files of an export; prints as what there is to know of it."""

    path: Path
    """what was asked for: a file or a folder"""
    files: tuple[Path, ...]
    """all that was written: the one file, or those of a folder, vehicle by vehicle"""
    words: str
    """what is in them"""
    names: tuple[str, ...]
    """of the vehicles"""
    deviations: FloatArray
    """how far what is written may be from the motion of each vehicle, at most, at any time [m],
    shape (N,); 0 where it is the motion, or states of it"""
    spare: Spare | None = None
    """whether vehicles keep clear with these deviations; None where there are none"""

    @property
    def deviation(self) -> float:
        """The largest of the deviations [m]."""
        return float(self.deviations.max())

    def __str__(self) -> str:
        lines = [f"{self.words} in {self.path}"]
        if self.spare is not None:
            who = self.names[int(np.argmax(self.deviations))]
            lines.append(f"up to {self.deviation:.3g} m from the motion ({who}), {self.spare}")
        return "\n".join(lines)
