"""How rows of pairs are written: coupled, decoupled, or decoupled around grouped references."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class Coupling:
    """How the rows of pairs are written."""

    name: str
    """what it is called"""
    responsibility: float
    """of what a reference leaves between two vehicles, how much a row gives to one of them: 1, in
    one row about the difference of the two, or 1/2, in two rows, one for each"""
    in_groups: bool = False
    """whether references are looked for in which groups of vehicles are coupled"""

    @property
    def together(self) -> bool:
        """Whether rows couple vehicles into one program."""
        return self.responsibility == 1.0

    def __repr__(self) -> str:
        return f"drake_rho.{self.name}"


coupled = Coupling("coupled", 1.0)
"""One row for each pair, about the difference of the two, which thus share a program."""

decoupled = Coupling("decoupled", 0.5)
"""Two rows for each pair, one for each vehicle: every vehicle has a program of its own."""

grouped = Coupling("grouped", 0.5, in_groups=True)
"""As decoupled, around references in which those that press most on each other are coupled."""

CouplingName = Literal["coupled", "decoupled", "grouped"]
"""Couplings that a word stands for."""

COUPLINGS = {each.name: each for each in (coupled, decoupled, grouped)}
"""What each word stands for."""
