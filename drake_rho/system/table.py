"""Tables: records of equally long arrays, whose rows are selected and joined."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt


class Table:
    """Base class of dataclasses whose arrays are the columns of one table.

    Columns are the fields with an array type, or an array or None. Other fields belong to the whole
    table; joined tables have those of the last one.
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    @classmethod
    @cache
    def _fields(cls) -> tuple[tuple[str, bool], ...]:
        """Return the names of the fields, and whether each is a column."""
        return tuple((each.name, "Array" in str(each.type)) for each in dataclasses.fields(cls))

    @classmethod
    @cache
    def _first_column(cls) -> str:
        return next(name for name, is_column in cls._fields() if is_column)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(getattr(self, self._first_column()))

    def select(self, rows: npt.NDArray[Any] | slice) -> Self:
        """Return some of the rows, by a mask, indices or a slice."""
        which = rows.nonzero()[0] if isinstance(rows, np.ndarray) and rows.dtype == bool else rows
        values = list[Any]()
        for name, is_column in self._fields():
            own = getattr(self, name)
            if is_column and own is not None:  # `take` is several times as fast for vectors
                own = own[which] if isinstance(which, slice) else own.take(which, axis=0)
            values.append(own)
        return type(self)(*values)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of all parts, in their order."""
        values = list[Any]()
        for name, is_column in cls._fields():
            own = [getattr(part, name) for part in parts]
            values.append(np.concatenate(own) if is_column and own[-1] is not None else own[-1])
        return cls(*values)

    def union(self, more: Self) -> Self:
        """Return these rows followed by more."""
        return self.joined([self, more])
