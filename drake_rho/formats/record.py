"""Record of an export: the files written and their deviation from the motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from drake_rho.formats.clearance import Spare
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray


@dataclasses.dataclass(frozen=True, eq=False)
class Exported(metaclass=Described):
    """Files of an export; prints as a summary."""

    path: Path
    """path of the file or folder that was requested"""
    files: tuple[Path, ...]
    """files written: one file, or one file for each vehicle in a folder"""
    words: str
    """description of the files' contents"""
    names: tuple[str, ...]
    """names of the vehicles"""
    deviations: FloatArray
    """upper bound of the distance between the written and the given motion of each vehicle at any
    time [m], shape (N,); 0 if the motion itself, or states of it, are written"""
    spare: Spare | None = None
    """clearance with these deviations; None without deviations"""

    @property
    def deviation(self) -> float:
        """Largest of the deviations [m]."""
        return float(self.deviations.max())

    def __str__(self) -> str:
        lines = [f"{self.words} in {self.path}"]
        if self.spare is not None:
            who = self.names[int(np.argmax(self.deviations))]
            lines.append(f"up to {self.deviation:.3g} m from the motion ({who}), {self.spare}")
        return "\n".join(lines)
