"""Documents that the commands print with `--json`; the names of the fields are the keys.

A name ends in its unit unless a field `unit` stands beside it: `_s` for seconds, `_m` for metres,
`_mps2` for metres per second squared. Costs are in m²/s⁴, `seconds` is wall time. Values that are
unknown or not finite are null.
"""

from __future__ import annotations

import dataclasses
from typing import TypeVar, dataclass_transform

from pydantic import TypeAdapter

T = TypeVar("T")


@dataclass_transform(kw_only_default=True, frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """Make the class a frozen dataclass: a document, or a part of one."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


@record
class Document:
    """Base of all documents."""

    status: int = 0
    """exit status of the command"""

    def to_json(self) -> str:
        """Return the document as JSON text; numbers that are not finite become null."""
        return TypeAdapter(type(self)).dump_json(self, indent=2).decode()


def read_off(kind: type[T], record: object, /, **others: object) -> T:
    """Return a document or a part of one with the attributes that a record has by its names.

    Args:
        kind: class of the document or part.
        record: record with attributes of the same names.
        others: further fields; those given here are not read.
    """
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    same = {name: getattr(record, name) for name in names if hasattr(record, name)}
    return kind(**(same | others))
