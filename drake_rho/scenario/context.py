"""Context of a scenario's validation: its folder, stored maps, whether its flight has begun."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationInfo


@dataclasses.dataclass(frozen=True)
class Context:
    """Context in which a scenario is validated."""

    under_way: bool = False
    """true for the remainder of a flight, whose starts are given, not chosen"""
    folder: Path = Path()
    """base folder of the relative paths of maps"""
    maps: Sequence[Any] = ()
    """maps stored once in a file, to which scenarios refer by number"""


def context_of(info: ValidationInfo[Context | None]) -> Context:
    """Return the context of a validation; the default one for a record made in Python."""
    return info.context or Context()
