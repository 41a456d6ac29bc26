"""Tables: records of equally long arrays, whose rows are selected and joined."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter
from typing import Any, Self

import numpy as np
import numpy.typing as npt


class Table:
    """Base class of dataclasses whose arrays are the columns of one table.

    Columns are the fields with an array type, or an array or None. Other fields belong to the whole
    table; joined tables have those of the last one.
    """

    def __len__(self) -> int:
        """Return the number of rows."""
        values, is_column = _fields_of(type(self))
        return len(values(self)[is_column.index(True)])

    def select(self, rows: npt.NDArray[Any] | slice) -> Self:
        """Return some of the rows, by a mask, indices or a slice."""
        values, is_column = _fields_of(type(self))
        pairs = zip(values(self), is_column, strict=True)
        if isinstance(rows, slice):
            return type(self)(
                *[each[rows] if is_one and each is not None else each for each, is_one in pairs]
            )
        which = rows.nonzero()[0] if rows.dtype == bool else rows
        # `take` is several times as fast as an index for vectors
        return type(self)(
            *[
                each.take(which, 0) if is_one and each is not None else each
                for each, is_one in pairs
            ]
        )

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of all parts, in their order; a single part itself."""
        if len(parts) == 1:
            return parts[0]
        values, is_column = _fields_of(cls)
        every = zip(*map(values, parts), strict=True)
        pairs = zip(every, is_column, strict=True)
        return cls(
            *[
                np.concatenate(own) if is_one and own[-1] is not None else own[-1]
                for own, is_one in pairs
            ]
        )

    def union(self, more: Self) -> Self:
        """Return these rows followed by more."""
        return self.joined([self, more])


def _read(table: Any) -> tuple[Callable[[Table], tuple[Any, ...]], list[bool]]:
    """Return a function that reads all fields of a table, and whether each is a column."""
    fields = dataclasses.fields(table)
    return attrgetter(*(each.name for each in fields)), [
        "Array" in str(each.type) for each in fields
    ]


_fields_of: Callable[[Any], tuple[Callable[[Table], tuple[Any, ...]], list[bool]]] = cache(_read)
"""The same, computed once for each type of table."""
