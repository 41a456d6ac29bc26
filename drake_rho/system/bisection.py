"""Bisection of monotone conditions, over numbers and over integers."""

from __future__ import annotations

from collections.abc import Callable


def bisected(
    holds: Callable[[float], bool],
    good: float,
    bad: float,
    are_close: Callable[[float, float], bool],
) -> tuple[float, float]:
    """Return two close numbers: one that satisfies a condition, and one that does not.

    Args:
        holds: the condition; it is not evaluated at the given numbers.
        good: number that satisfies it.
        bad: number that does not; it may be larger or smaller.
        are_close: whether two such numbers are close enough.
    """
    while not are_close(good, bad):
        middle = (good + bad) / 2.0
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good, bad


def least_count(
    holds: Callable[[int], bool], none: int, known: int, *, gallop: bool = False
) -> int:
    """Return the least integer that satisfies a condition.

    Args:
        holds: the condition; it is not evaluated at the given integers.
        none: integer below those that may satisfy it.
        known: integer that satisfies it.
        gallop: whether the search begins near `known`, with 1, 2, 4, ... less, until one fails.
    """
    less = 1
    while known - none > 1:
        count = max(known - less, none + 1) if gallop else (known + none + 1) // 2
        if holds(count):
            known, less = count, 2 * less
        else:
            none, gallop = count, False
    return known
