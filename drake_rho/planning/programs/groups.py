"""Groups of vehicles that rows couple, and the rows of each group."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from drake_rho.planning.constraints.rows import Rows
from drake_rho.scenario.fields import IntArray


def groups_of(vehicles: int, coupled: Sequence[Rows]) -> IntArray:
    """Return the number of each vehicle's group; vehicles that rows couple are in one group.

    Args:
        vehicles: the number of vehicles, N.
        coupled: the rows that couple two vehicles.
    """
    if not coupled:
        return np.arange(vehicles)
    one = np.concatenate([part.vehicles for part in coupled])
    other = np.concatenate([part.partners for part in coupled])
    links = coo_array((np.ones(len(one)), (one, other)), shape=(vehicles, vehicles))
    labels: IntArray = connected_components(links, directed=False)[1]
    return labels


def each_of(
    wanted: IntArray, numbers: IntArray, rows: Sequence[Rows]
) -> Iterator[tuple[int, list[Rows]]]:
    """Yield the rows of parts of a fleet; rows are sorted by part once, since there may be many.

    Args:
        wanted: the numbers of the parts to yield.
        numbers: the number of each vehicle's part, shape (N,).
        rows: the rows of all vehicles.

    Yields:
        The number of each part, and the rows of its vehicles.
    """
    if len(wanted) == 0:
        return
    rows = [part.select(np.argsort(numbers[part.vehicles], kind="stable")) for part in rows]
    labels = [numbers[part.vehicles] for part in rows]
    for number in wanted.tolist():
        ranges = [slice(*np.searchsorted(label, [number, number + 1])) for label in labels]
        own = [part.select(each) for part, each in zip(rows, ranges, strict=True)]
        yield number, [part for part in own if len(part) > 0]
