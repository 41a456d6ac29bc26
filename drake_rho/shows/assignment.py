"""Which vehicle flies to which place, in every scene of a show.

Vehicles from rest to rest have the least effort in proportion to the squared distance, so the
cheapest assignment of one transition has the least sum of squares: a linear assignment. Where each
vehicle has to return to its own pad, assignments of successive transitions depend on each other.
Then each scene's is solved again for both transitions beside it, in turn, until the sum hardly
falls; last, vehicles with the longest flights exchange places where that makes transitions shorter.

Linear assignments are solved exactly by scipy, which is many times as fast once costs are reduced
by nearly optimal prices. Sinkhorn's scaling finds them (Peyré and Cuturi, Computational Optimal
Transport, 2019, chapter 4).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Limits
from drake_rho.shows.show import Show

_ROUNDS = 20
"""Largest number of rounds over all scenes."""

_FALL = 2e-3
"""Relative fall of the sum of squares in one round below which rounds end."""

_BLURS, _SCALINGS = (0.1, 0.01), 20
"""Costs at which a pair is e times as unlikely, relative to the median cost, one after another; and
the number of scalings with each."""

_UNIT = 2.0**-20
"""Unit of prices, relative to the median cost. Rounding makes them the same on every machine."""

_SHORTER = 1e-9
"""Relative fall of a time that makes an exchange worth it."""


@dataclasses.dataclass(frozen=True)
class Places:
    """Places of one scene: those that have to be taken, and those that may be."""

    required: FloatArray
    """points of the formation [m], shape (M, 3)"""
    optional: FloatArray
    """places to wait [m], shape (W, 3), at least N - M"""

    @property
    def all(self) -> FloatArray:
        """All places [m], shape (M + W, 3)."""
        return np.concatenate([self.required, self.optional])


def places_of(show: Show) -> list[Places]:
    """Return the places of every scene."""
    return [
        Places(
            scene.formation.positions,
            show.waiting_for(scene)
            if len(scene.formation.positions) < len(show.home)
            else np.zeros((0, 3)),
        )
        for scene in show.scenes
    ]


def assigned(show: Show) -> list[IntArray]:
    """Return, for each scene, the place of each vehicle as an index of `Places.all`, shape (N,).

    After the scenes, the last entry is the pad on which each vehicle lands.
    """
    places, home = places_of(show), show.waiting_places
    found, before = list[IntArray](), home
    for each in places:
        found.append(_cheapest(_squares(before, each.all), len(each.required)))
        before = each.all[found[-1]]
    if show.landing == "any":
        return [*found, _cheapest(_squares(before, home), len(home))]
    found = _in_rounds(places, home, found)
    return [*_exchanged(places, home, found, show.limits), np.arange(len(home))]


def _squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances of all pairs of places [m²], shape (len(a), len(b))."""
    from scipy.spatial.distance import cdist  # slow to load, so only where needed

    squares: FloatArray = cdist(a, b, "sqeuclidean")
    return squares


def _cheapest(costs: FloatArray, required: int) -> IntArray:
    """Return the column of each row for which the sum of costs is least.

    Args:
        costs: finite costs, with at least as many columns as rows.
        required: number of columns, the first ones, that all have to be taken.
    """
    count = len(costs)
    return _matched(_square(costs, count, (count, required)))[:count]


def _in_rounds(
    places: Sequence[Places], home: FloatArray, found: Sequence[IntArray]
) -> list[IntArray]:
    """Return assignments with a smaller sum of squares, for landings on own pads."""
    found, last = list(found), np.inf
    solved: dict[int, list[FloatArray]] = {}
    for _ in range(_ROUNDS):
        for index, each in enumerate(places):
            beside = [*_beside(places, home, found, index)]
            if index in solved and all(map(np.array_equal, solved[index], beside)):
                continue
            solved[index] = beside
            costs = sum(_squares(other, each.all) for other in beside)
            found[index] = _cheapest(np.asarray(costs), len(each.required))
        total = sum(squares.sum() for squares in _flown(places, home, found))
        if total > last * (1.0 - _FALL):
            break
        last = total
    return found


def _beside(
    places: Sequence[Places], home: FloatArray, found: Sequence[IntArray], index: int
) -> tuple[FloatArray, FloatArray]:
    """Return the positions of all vehicles in the scenes before and after one [m], (N, 3)."""
    before = home if index == 0 else places[index - 1].all[found[index - 1]]
    is_last = index == len(places) - 1
    return before, home if is_last else places[index + 1].all[found[index + 1]]


def _flown(
    places: Sequence[Places], home: FloatArray, found: Sequence[IntArray]
) -> Iterator[FloatArray]:
    """Yield the squared distances that vehicles fly in each transition [m²], shape (N,)."""
    at = [home, *(each.all[index] for each, index in zip(places, found, strict=True)), home]
    for a, b in pairwise(at):
        yield np.sum((b - a) ** 2, axis=1)


def _exchanged(
    places: Sequence[Places], home: FloatArray, found: Sequence[IntArray], limits: Limits
) -> list[IntArray]:
    """Return assignments after exchanges of two vehicles' places that make transitions shorter.

    In each scene the vehicle with the longest flight to it, or from it, exchanges places with the
    one for which the sum of the two transitions' times is least, as long as that sum falls.
    """
    found = [each.copy() for each in found]
    for index, each in enumerate(places):
        before, after = _beside(places, home, found, index)
        for _ in range(len(home)):
            at = each.all[found[index]]
            to, on = least_times(at - before, limits), least_times(after - at, limits)
            pair = _best_exchange(before, at, after, to, on, limits)
            if pair is None:
                break
            found[index][list(pair)] = found[index][list(pair[::-1])]
    return found


def _best_exchange(
    before: FloatArray,
    at: FloatArray,
    after: FloatArray,
    to: FloatArray,
    on: FloatArray,
    limits: Limits,
) -> tuple[int, int] | None:
    """Return the two vehicles whose exchange shortens both transitions together the most, or None.

    Args:
        before: positions of vehicles in the scene before [m], shape (N, 3).
        at: positions in the scene, shape (N, 3).
        after: positions in the scene after, shape (N, 3).
        to: least times of the flights to the scene [s], shape (N,).
        on: least times of the flights from it [s], shape (N,).
        limits: of every vehicle.
    """
    best, least = None, to.max() + on.max()
    everyone = np.arange(len(at))
    for first in {int(np.argmax(to)), int(np.argmax(on))}:
        mine_to = least_times(at - before[first], limits)
        mine_on = least_times(after[first] - at, limits)
        others_to = least_times(at[first] - before, limits)
        others_on = least_times(after - at[first], limits)
        sums = np.maximum(np.maximum(mine_to, others_to), _others(to, first)) + np.maximum(
            np.maximum(mine_on, others_on), _others(on, first)
        )
        sums[everyone == first] = np.inf
        second = int(np.argmin(sums))
        if sums[second] < least * (1.0 - _SHORTER):
            best, least = (first, second), float(sums[second])
    return best


def _others(times: FloatArray, first: int) -> FloatArray:
    """Return, for each vehicle, the largest time of all but this one and `first`, shape (N,)."""
    left = times.copy()
    left[first] = -np.inf
    order = np.argsort(left)
    largest = np.full(len(left), left[order[-1]])
    if len(left) > 1:
        largest[order[-1]] = left[order[-2]]
    return largest


def least_times(ways: FloatArray, limits: Limits) -> FloatArray:
    """Return lower bounds of the times from rest to rest [s], shape (...).

    Along a line, with a speed of at most v and an acceleration of at most a, a distance d takes
    2 sqrt(d/a), or d/v + v/a where the speed v is reached. Each axis and the whole way are such
    lines, with the limits in their directions; limits of jerk and tilt are left out.

    Args:
        ways: changes of position [m], shape (..., 3).
        limits: of the vehicle.
    """
    whole = np.linalg.norm(ways, axis=-1)
    times = _along(whole, limits.max_speed or np.inf, limits.max_acceleration or np.inf)
    for axis in range(3):
        speed, acceleration = (
            np.inf if box is None else max(abs(box.lower[axis]), abs(box.upper[axis]))
            for box in (limits.velocity, limits.acceleration)
        )
        times = np.maximum(times, _along(np.abs(ways[..., axis]), speed, acceleration))
    return times


def _along(distances: FloatArray, speed: float, acceleration: float) -> FloatArray:
    """Return the least times from rest to rest along a line [s]."""
    if acceleration == np.inf:
        return distances / speed
    reached = distances * acceleration > speed**2
    with np.errstate(invalid="ignore"):
        cruise = distances / speed + speed / acceleration
    return np.where(reached, cruise, 2.0 * np.sqrt(distances / acceleration))


def least_sum(before: Places, after: Places, count: int) -> float:
    """Return the least sum of squared distances over all assignments of one transition [m²].

    Which places to wait are taken before and after is free, so this is a lower bound for any show.

    Args:
        before: places of the scene before.
        after: places of the scene after.
        count: number of vehicles N.
    """
    costs = _squares(before.all, after.all)
    square = _square(costs, count, (len(before.required), len(after.required)))
    return float(square[np.arange(len(square)), _matched(square)].sum())


def least_longest(before: Places, after: Places, count: int, limits: Limits) -> float:
    """Return the least time in which any assignment of one transition can be flown [s].

    It is a lower bound: the longest flight of the assignment for which that is shortest.
    """
    ways = after.all[None, :, :] - before.all[:, None, :]
    times = least_times(ways, limits)
    candidates = np.unique(times)
    required = len(before.required), len(after.required)
    low, high = 0, len(candidates) - 1
    while low < high:
        middle = (low + high) // 2
        square = _square((times > candidates[middle]).astype(np.float64), count, required)
        longer = square[np.arange(len(square)), _matched(square)].sum() > 0.5
        low, high = (middle + 1, high) if longer else (low, middle)
    return float(candidates[low])


def _square(costs: FloatArray, count: int, required: tuple[int, int]) -> FloatArray:
    """Return a square matrix of costs whose cheapest assignment takes `count` of the given pairs.

    Rows and columns that are not required may be matched with further columns and rows, without a
    cost; those cannot be matched with each other.

    Args:
        costs: finite costs, not negative.
        count: number of pairs.
        required: numbers of rows and of columns, the first ones, that all have to be taken.
    """
    rows, columns = costs.shape
    more_rows, more_columns = columns - count, rows - count
    never = costs.max() * (count + 1) + 1.0
    square = np.zeros((rows + more_rows, columns + more_columns))
    square[:rows, :columns] = costs
    square[rows:, : required[1]] = never
    square[: required[0], columns:] = never
    square[rows:, columns:] = never
    return square


def _matched(costs: FloatArray) -> IntArray:
    """Return the column of each row in the cheapest assignment of a square matrix."""
    from scipy.optimize import linear_sum_assignment  # slow to load, so only where needed

    chosen: IntArray = linear_sum_assignment(_reduced(costs))[1]
    return chosen


def _reduced(costs: FloatArray) -> FloatArray:
    """Return square costs less prices of rows and columns, for which assignments rank the same."""
    scale = float(np.median(costs)) or 1.0
    costs = _with_zeros(costs)
    for blur in _BLURS:
        kernel, columns = np.exp(costs / (-blur * scale)), np.ones(len(costs))
        for _ in range(_SCALINGS):  # every row and column has a 1, so that no sum vanishes
            rows = 1.0 / (kernel @ columns)
            columns = 1.0 / (rows @ kernel)
        prices = (blur / _UNIT) * np.log([rows, columns])
        one, other = scale * _UNIT * np.rint(prices)
        costs = _with_zeros(costs - one[:, None] - other)
    return costs


def _with_zeros(costs: FloatArray) -> FloatArray:
    """Return costs less the least of each row, and then of each column."""
    costs = costs - costs.min(axis=1, keepdims=True)
    costs -= costs.min(axis=0)
    return costs
