"""Coupling of pairs of vehicles: coupled, decoupled, or decoupled around grouped references."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class Coupling:
    """Form of the rows for pairs of vehicles."""

    name: str
    """name of the coupling, for options and messages"""
    responsibility: float
    """responsibility of one row for the distance between the vehicles of a reference: 1 for a
    single row about their difference, 1/2 for two rows, one for each vehicle"""
    in_groups: bool = False
    """true if references are planned with groups of coupled vehicles"""

    @property
    def together(self) -> bool:
        """True if rows couple vehicles into one program."""
        return self.responsibility == 1.0

    def __repr__(self) -> str:
        return f"drake_rho.{self.name}"


coupled = Coupling("coupled", 1.0)
"""One row for each pair, about the difference of its vehicles, which thus share a program."""

decoupled = Coupling("decoupled", 0.5)
"""Two rows for each pair, one for each vehicle, so that every vehicle has its own program."""

grouped = Coupling("grouped", 0.5, in_groups=True)
"""Decoupled rows around references whose groups with the largest multiplier sums are coupled."""

CouplingName = Literal["coupled", "decoupled", "grouped"]
"""Names of the couplings."""

COUPLINGS = {each.name: each for each in (coupled, decoupled, grouped)}
"""Couplings by name."""
