"""Close pairs of vehicles: the closest approach of each pair in every step, exact in time.

K-d trees find the close pairs without visiting all pairs; distances are measured in coordinates
with z divided by the downwash, in which the separation is a sphere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.motion.dynamics import Motion, vectors_of
from drake_rho.motion.extremes import lengths_of, nearest_moments
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.system.table import Table
from drake_rho.system.threads import thread_pool

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


_FEW = 4
"""Least ratio of all points to the selected ones from which a tree of the selected ones pays."""

_HANDFUL = 32
"""Number of points up to which all pairs are visited, which is faster than trees."""

_MANY = 40_000
"""Approximate number of points per chunk: its data fit into caches, and chunks run in parallel."""

_INSTANTS = 3
"""Number of instants that share one tree: with fewer, building trees takes longer; with more, there
are more candidate pairs."""


@dataclasses.dataclass(frozen=True)
class CloseApproaches(Table):
    """Instants at which a vehicle is close to another vehicle or to a point."""

    one: IntArray
    """index of the vehicle, shape (M,)"""
    other: IntArray
    """larger index of the other vehicle; the vehicle's own index for a point, shape (M,)"""
    times: FloatArray
    """times since the first knot [s], shape (M,)"""
    distances: FloatArray
    """distances [m], shape (M,)"""

    def merged(self, more: CloseApproaches) -> CloseApproaches:
        """Return the union of both, sorted by pair and then by time, without duplicate instants."""
        every = self.union(more)
        every = every.select(np.lexsort((every.times, every.other, every.one)))
        duplicate = np.diff(every.one, prepend=-1) == 0
        duplicate &= np.diff(every.other, prepend=-1) == 0
        duplicate &= np.abs(np.diff(every.times, prepend=-1.0)) <= 1e-9 * (1.0 + every.times)
        return every.select(~duplicate)


_NOBODY = np.zeros(0, dtype=np.int64)
NO_APPROACHES = CloseApproaches(_NOBODY, _NOBODY, np.zeros(0), np.zeros(0))
"""No close approaches."""


def close_pairs(
    motion: Motion, separation: Separation, within: float, *, of: IntArray | None = None
) -> CloseApproaches:
    """Return the closest approach of each pair in each step, if it is below a distance.

    The minimum is computed only for pairs that are close enough at the middle of a step to come
    within the distance during the step.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        separation: ellipsoid that defines the distance.
        within: the distance [m].
        of: increasing indices of vehicles; only pairs with one or two of them are considered. All
            pairs if not given.

    Returns:
        Close approaches, sorted by pair and then by time.
    """
    h = motion.step

    def found(steps: slice) -> CloseApproaches:
        quantities = motion.positions, motion.velocities, motion.accelerations
        p, v, a = (np.ascontiguousarray(separation.scaled(each[:, steps])) for each in quantities)
        middle, travel = p + h / 2 * (v + h / 4 * a), _travel(h, v, a)
        one, other, k = _pairs_at(middle, within, travel, of)
        # bounds by the relative motion leave fewer pairs: computing minima is expensive
        x, w, b = (_relative(each, one, other, k) for each in (middle, v, a))
        near = lengths_of(x) - _travel(h, w, b) < within
        one, other, k = one[near], other[near], k[near]
        relative = _relative(p, one, other, k), w[near], b[near]
        return _closest_below(within, h, one, other, steps.start + k, *relative)

    return _in_chunks(found, *motion.accelerations.shape[:2])


def close_pairs_at_knots(
    motion: Motion, separation: Separation, within: float, *, of: IntArray | None = None
) -> CloseApproaches:
    """Return pairs of vehicles closer than a distance at the knots; see `close_pairs`."""

    def found(knots: slice) -> CloseApproaches:
        p = np.ascontiguousarray(separation.scaled(motion.positions[:, knots]))
        one, other, k = _pairs_at(p, within, np.zeros(p.shape[:2]), of)
        times: FloatArray = (knots.start + k) * np.float64(motion.step)
        return CloseApproaches(one, other, times, lengths_of(_relative(p, one, other, k)))

    return _in_chunks(found, *motion.positions.shape[:2])


def _in_chunks(
    found: Callable[[slice], CloseApproaches], count: int, instants: int
) -> CloseApproaches:
    """Evaluate a function of instants chunk by chunk, in threads if there are several chunks.

    Args:
        found: returns the close approaches in a slice of the instants, in the order of time.
        count: of vehicles.
        instants: number of all instants.

    Returns:
        All close approaches, sorted by pair and then by time.
    """
    size = _INSTANTS * max(1, _MANY // (_INSTANTS * count))
    chunks = [slice(first, min(first + size, instants)) for first in range(0, instants, size)]
    each_of = thread_pool().map if len(chunks) > 1 else map
    every = CloseApproaches.joined(list(each_of(found, chunks)))
    order = np.argsort(every.one * count + every.other, kind="stable")  # keeps the order of time
    return every.select(order)


def _relative(vectors: FloatArray, one: IntArray, other: IntArray, k: IntArray) -> FloatArray:
    """Return differences of two vehicles' vectors at some instants, shape (M, 3)."""
    return vectors_of(vectors, one, k) - vectors_of(vectors, other, k)


def _travel(step: float, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return bounds on how far motions get from their positions in the middle of a step."""
    travel = lengths_of(v + step / 2 * a)
    travel += step / 4 * lengths_of(a)
    travel *= step / 2
    return travel


def _closest_below(
    within: float,
    step: float,
    one: IntArray,
    other: IntArray,
    k: IntArray,
    *relative: FloatArray,
) -> CloseApproaches:
    """Return the closest approaches below a distance among relative motions in some steps."""
    p, v, a = relative
    if len(k) == 0:
        return CloseApproaches(one, other, np.zeros(0), np.zeros(0))
    s = nearest_moments(p, v, a, step)[:, None]
    distances = lengths_of(p + s * (v + s / 2 * a))
    return CloseApproaches(one, other, step * k + s[:, 0], distances).select(distances < within)


def _pairs_at(
    points: FloatArray, within: float, travel: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """Return pairs of points that may come within a distance, at T instants.

    Args:
        points: positions of all vehicles, shape (N, T, 3).
        within: the distance.
        travel: distance that each point may move, shape (N, T).
        of: indices of points; only pairs with one or two of them are returned. All pairs if not
            given.

    Returns:
        Indices of both points, the smaller first, and of the instant, each pair in time order.
    """
    if len(points) <= _HANDFUL:
        return _pairs_by_enumeration(points, within, travel, of)
    few = of if of is not None and _FEW * len(of) < len(points) else None

    every = list[IntArray]()
    for first in range(0, points.shape[1], _INSTANTS):
        chunk = slice(first, first + _INSTANTS)
        every.append(_pairs_during(points[:, chunk], within, travel[:, chunk], few))
        every[-1][2] += first
    one, other, instants = np.concatenate(every, axis=1)
    if of is not None and few is None:
        selected = np.isin(np.arange(len(points)), of)
        required = selected[one] | selected[other]
        one, other, instants = one[required], other[required], instants[required]
    return one, other, instants


def _pairs_by_enumeration(
    points: FloatArray, within: float, travel: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """Return `_pairs_at` by visiting all pairs, without trees."""
    one, other = np.triu_indices(len(points), 1)
    if of is not None:
        selected = np.isin(np.arange(len(points)), of)
        required = selected[one] | selected[other]
        one, other = one[required], other[required]
    x = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(x, x) <= (within + travel[one] + travel[other]) ** 2
    which, instants = np.nonzero(close)
    return one[which], other[which], instants


def _pairs_during(
    points: FloatArray, within: float, travel: FloatArray, few: IntArray | None
) -> IntArray:
    """Return `_pairs_at` for a few instants, as pairs and instants, shape (3, M).

    One tree of the points at the middle instant is searched for all instants, with a radius larger
    by how far both points move until the other instants. If they move far, each instant has its
    own tree.

    Args:
        points: shape (N, T, 3) with few instants T.
        within: the distance.
        travel: distance that each point may move, shape (N, T).
        few: indices of few points; only pairs with one or two of them are returned. All pairs if
            None.
    """
    from scipy.spatial import cKDTree  # imported here: slow to load

    count = points.shape[1]
    middle = points[:, count // 2]
    moved = points - middle[:, None]
    away = np.sqrt(np.vecdot(moved, moved).max(axis=1))
    if count > 1 and float(away.max()) > within:
        each = [
            _pairs_during(points[:, k : k + 1], within, travel[:, k : k + 1], few)
            for k in range(count)
        ]
        for k, found in enumerate(each):
            found[2] = k
        return np.concatenate(each, axis=1)
    away += travel.max(axis=1)
    tree = cKDTree(middle, balanced_tree=False, compact_nodes=False)
    radius = within + 2.0 * float(away.max())
    if few is None:
        pairs: IntArray = tree.query_pairs(radius, output_type="ndarray")
    else:
        pairs = _pairs_of(few, middle, tree, radius)
    one, other = pairs.T
    x = middle.take(one, axis=0) - middle.take(other, axis=0)
    near = np.vecdot(x, x) <= (within + away[one] + away[other]) ** 2
    one, other = one[near], other[near]
    x = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(x, x) <= (within + travel[one] + travel[other]) ** 2
    which, instants = np.nonzero(close)
    return np.stack([one[which], other[which], instants])


def _pairs_of(few: IntArray, points: FloatArray, tree: cKDTree, radius: float) -> IntArray:
    """Return pairs with one or two of a few points, smaller index first, sorted, shape (M, 2)."""
    tree_of_few = type(tree)(points[few], balanced_tree=False, compact_nodes=False)
    near = tree_of_few.sparse_distance_matrix(tree, radius, output_type="ndarray")
    one, other = few[near["i"]], near["j"]
    keys = np.minimum(one, other) * len(points) + np.maximum(one, other)
    keys = np.unique(keys[one != other])  # each point finds itself, and two of the few each other
    pairs: IntArray = np.stack(np.divmod(keys, len(points)), axis=1)
    return pairs
