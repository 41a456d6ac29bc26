"""Bounds on counted work, which end a search at the same place however fast the machine is.

The unit is a round of row generation, which solves one program for each vehicle: 5 to 15 ms for a
vehicle or two. A bound is a context variable, visible to all functions within a call without an
argument, and `check_time` raises an error once it is reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

PATH_GRID = 10.0
"""Least work of a search for paths on one grid [rounds]."""

MOVE, MOVE_IN_MAP = 6e-5, 3e-4
"""Work of checking one move of a path among moving obstacles, shapes and maps [rounds]."""


class _Bound:
    """Work that may still be done [rounds]."""

    def __init__(self, left: float) -> None:
        self.left = left


_BOUND: ContextVar[_Bound | None] = ContextVar("_BOUND", default=None)


def work_left() -> float:
    """Return the work left [rounds]: zero or less at the bound, infinite without one."""
    bound = _BOUND.get()
    return math.inf if bound is None else bound.left


def count_work(rounds: float) -> None:
    """Count work as done, in the thread that set the bound."""
    if (bound := _BOUND.get()) is not None:
        bound.left -= rounds


@contextmanager
def within_work(rounds: float) -> Iterator[None]:
    """Bound the work of the block; a lower bound that is in force stays.

    Args:
        rounds: the bound; infinite for no further one.
    """
    outer, own = _BOUND.get(), _Bound(min(rounds, work_left()))
    first, before = own.left, _BOUND.set(own)
    try:
        yield
    finally:
        _BOUND.reset(before)
        if outer is not None and math.isfinite(first):
            outer.left -= first - own.left
