"""Cells of a regular grid: boxes that cover them, their open sides, the free cells around them."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import BoolArray, IntArray

_LARGEST_BOX = 2.0**62
"""Largest number of cells of a bounding box, so that an integer numbers each of them."""


def covering_boxes(cells: IntArray) -> tuple[IntArray, IntArray]:
    """Return boxes that cover exactly the given cells, without overlap.

    Cells are joined to rows along one axis, equal neighbouring rows to slabs along the next, and
    slabs to boxes along the last. The best of the six orders of axes is taken.

    Args:
        cells: distinct indices of cells, shape (M, 3), with M of at least 1.

    Returns:
        First cells, and cells past the last, of each box, shape (B, 3) each.
    """
    return min((joined(cells, order) for order in permutations(range(3))), key=lambda b: len(b[0]))


def joined(cells: IntArray, axes: tuple[int, ...]) -> tuple[IntArray, IntArray]:
    """Return boxes that cover cells, joined along one or more axes in the given order."""
    lower, upper = cells, cells + 1
    for axis in axes:
        across = [each for each in range(3) if each != axis]
        sides = [side for other in across for side in (lower[:, other], upper[:, other])]
        order = np.lexsort([lower[:, axis], *sides])
        lower, upper = lower[order], upper[order]
        joins = upper[:-1, axis] == lower[1:, axis]
        for other in across:
            joins &= lower[1:, other] == lower[:-1, other]
            joins &= upper[1:, other] == upper[:-1, other]
        ends = np.append(~joins, True)
        lower, upper = lower[np.append(True, ~joins)], upper[ends]
    return lower, upper


def free_neighbours(cells: IntArray) -> IntArray:
    """Return the free cells that share a face with one of the given cells, shape (S, 3).

    Every point of the surface of the given cells is in one of them.
    """
    found = []
    for axis, side in product(range(3), (-1, 1)):
        beside = exposed(cells, axis, side)
        beside[:, axis] += side
        found.append(beside)
    return unique(np.concatenate(found))


def exposed(cells: IntArray, axis: int, side: int) -> IntArray:
    """Return the cells whose neighbour along an axis is free.

    Args:
        cells: distinct indices of cells, shape (M, 3).
        axis: 0, 1 or 2.
        side: 1 for the next neighbour along the axis, -1 for the one before.
    """
    neighbours = cells.copy()
    neighbours[:, axis] += side
    keys = _keys(np.concatenate([cells, neighbours]))
    open_cells: IntArray = cells[~_occur(keys[len(cells) :], keys[: len(cells)])]
    return open_cells


def unique(cells: IntArray) -> IntArray:
    """Return each of the given cells once, sorted by x, y and z, shape (U, 3).

    Raises:
        ScenarioError: they are too far apart.
    """
    sides = np.ptp(cells, axis=0) + 3.0  # with a free cell on each side of them
    if np.prod(sides) > _LARGEST_BOX:
        spread = " x ".join(f"{each:g}" for each in sides)
        expected = f"a bounding box of at most {_LARGEST_BOX:g} cells"
        raise ScenarioError("", Description(f"cells that spread over {spread}"), expected)
    firsts = np.unique(_keys(cells), return_index=True)[1]
    found: IntArray = cells[firsts]
    return found


def difference(cells: IntArray, others: IntArray) -> IntArray:
    """Return the set difference of distinct cells and others, shape (D, 3)."""
    if len(cells) == 0 or len(others) == 0:
        return cells
    keys = _keys(np.concatenate([cells, others]))
    remaining: IntArray = cells[~_occur(keys[: len(cells)], keys[len(cells) :])]
    return remaining


def _occur(keys: IntArray, among: IntArray) -> BoolArray:
    """Return whether keys (M,) occur among others, as `np.isin`, in a fifth of its time."""
    among = np.sort(among, kind="stable")
    places = np.minimum(np.searchsorted(among, keys), len(among) - 1)
    return np.asarray(among[places] == keys)


def _keys(cells: IntArray) -> IntArray:
    """Return one number for each cell, in the order of x, y and z, shape (M,)."""
    lower = cells.min(axis=0)
    sides = cells.max(axis=0) - lower + 1
    keys: IntArray = np.ravel_multi_index(tuple((cells - lower).T), tuple(sides))
    return keys
