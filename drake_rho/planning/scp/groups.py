"""Groups of vehicles of a large fleet that are planned together."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray

_EQUAL = 1e-3
"""Relative difference up to which two multiplier sums count as equal. Without it, rounding would
decide the order of pairs in a symmetric fleet."""


def groups_with_multipliers(
    vehicles: int, one: IntArray, other: IntArray, sums: FloatArray, most: int
) -> IntArray:
    """Return a partition of the vehicles that groups pairs with large multiplier sums.

    The algorithm visits each pair once, in descending order of multiplier sums. It merges the
    groups of the two vehicles unless the merged group would be too large.

    Args:
        vehicles: the number of vehicles, N.
        one: the first vehicle of each pair, shape (P,).
        other: the second vehicle of each pair, shape (P,).
        sums: a positive estimate of the gain from grouping each pair, shape (P,).
        most: the largest number of vehicles in a group.

    Returns:
        The number of each vehicle's group, which is the index of one of its members, shape (N,).
    """
    groups = list(range(vehicles))
    members = [[vehicle] for vehicle in groups]
    rounded = np.rint(np.log(sums) / _EQUAL)
    order = np.lexsort((other, one, -rounded))
    for first, second in zip(one[order].tolist(), other[order].tolist(), strict=True):
        into, out = groups[first], groups[second]
        if into != out and len(members[into]) + len(members[out]) <= most:
            if len(members[into]) < len(members[out]):
                into, out = out, into
            for vehicle in members[out]:
                groups[vehicle] = into
            members[into] += members[out]
    return np.array(groups)
