"""What the validation of a scenario from a file has to know beside its content."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationInfo


@dataclasses.dataclass(frozen=True)
class Context:
    """Circumstances in which a scenario is validated."""

    under_way: bool = False
    """true for the remainder of a flight, whose starts are given, not chosen"""
    folder: Path = Path()
    """folder to which the paths of maps are relative"""
    maps: Sequence[Any] = ()
    """maps that a file stores once, to which scenarios refer by their number"""


def context_of(info: ValidationInfo[Context | None]) -> Context:
    """Return the circumstances of a validation; those of a record made in Python if none."""
    return info.context or Context()
