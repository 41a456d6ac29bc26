"""Which vehicles of a large fleet are planned together."""

from __future__ import annotations

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray

_ALIKE = 1e-3
"""Relative difference up to which two pressures count as the same, so that rounding does not decide
which of two pairs comes first where a fleet is symmetric."""


def groups_with_multipliers(
    vehicles: int, one: IntArray, other: IntArray, pressures: FloatArray, most: int
) -> IntArray:
    """Return a partition of vehicles in groups with the largest sums of multipliers.

    Pairs are gone through once, those of the largest pressure first, and the groups of the two
    become one where they are not too large for it together.

    Args:
        vehicles: N.
        one: a vehicle of each pair, shape (P,).
        other: the other, shape (P,).
        pressures: how much a pair would gain by being in a group, above 0, shape (P,).
        most: bound on the vehicles of a group.

    Returns:
        For each vehicle the number of its group, which is one of its vehicles', shape (N,).
    """
    groups = list(range(vehicles))
    members = [[vehicle] for vehicle in groups]
    alike = np.rint(np.log(pressures) / _ALIKE)
    order = np.lexsort((other, one, -alike))
    for first, second in zip(one[order].tolist(), other[order].tolist(), strict=True):
        into, out = groups[first], groups[second]
        if into != out and len(members[into]) + len(members[out]) <= most:
            if len(members[into]) < len(members[out]):
                into, out = out, into
            for vehicle in members[out]:
                groups[vehicle] = into
            members[into] += members[out]
    return np.array(groups)
