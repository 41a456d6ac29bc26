"""Candidate pairs: vehicles whose paths in a step may come within a distance of each other.

K-d trees find them without visiting all pairs, as Verlet lists do in molecular dynamics: for paths
in enlarged balls, so that the same candidates serve all motions that stay inside these balls.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.motion.extremes import lengths_of
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray

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

_SKIN = 0.1
"""Increase of a ball's radius, as a fraction of the distance: the larger, the more motions stay in
their balls, and the more candidates there are."""


def chunks_of_steps(count: int, steps: int) -> list[slice]:
    """Return consecutive slices of the steps of `count` vehicles, for separate searches."""
    size = _INSTANTS * max(1, _MANY // (_INSTANTS * count))
    return [slice(first, min(first + size, steps)) for first in range(0, steps, size)]


@dataclasses.dataclass(frozen=True, eq=False)
class CandidatePairs:
    """All pairs of vehicles whose balls come within a distance, in T successive steps.

    A path that stays in its vehicle's ball throughout a step comes within the distance of another
    such path only if the pair is a candidate in this step.
    """

    within: float
    """the distance"""
    centers: FloatArray
    """centres of the balls, shape (N, T, 3)"""
    radii: FloatArray
    """radii of the balls, shape (N, T); negative for none"""
    found: tuple[IntArray, ...]
    """candidates of every `_INSTANTS` steps: smaller index, larger index and number of the step
    among these, shape (3, M)"""

    @classmethod
    def unknown(cls, count: int, steps: int, within: float) -> CandidatePairs:
        """Return no candidates of `count` vehicles, whose balls do not exist yet."""
        nothing = (np.zeros((3, 0), dtype=np.int64),) * -(-steps // _INSTANTS)
        return cls(within, np.zeros((count, steps, 3)), np.full((count, steps), -1.0), nothing)

    def of_paths(self, middles: FloatArray, travel: FloatArray) -> CandidatePairs:
        """Return candidates for other paths: the same ones, except where paths leave their balls.

        Args:
            middles: positions in the middle of the steps, shape (N, T, 3).
            travel: bounds on the distance of the paths from these positions, shape (N, T).
        """
        if len(middles) <= _HANDFUL:
            radii = travel + _SKIN * self.within
            every = (_by_enumeration(middles, self.within, radii),)
            return CandidatePairs(self.within, middles, radii, every)
        outside: BoolArray = ~(lengths_of(middles - self.centers) + travel <= self.radii)
        if not outside.any():
            return self
        centers, radii, found = self.centers.copy(), self.radii.copy(), list(self.found)
        for number, first in enumerate(range(0, middles.shape[1], _INSTANTS)):
            steps = slice(first, first + _INSTANTS)
            moved = np.flatnonzero(outside[:, steps].any(axis=1))
            if len(moved) == 0:
                continue
            if _FEW * len(moved) >= len(middles):
                moved = np.arange(len(middles))
            centers[moved, steps] = middles[moved, steps]
            radii[moved, steps] = travel[moved, steps] + _SKIN * self.within
            balls = centers[:, steps], radii[:, steps]
            found[number] = _renewed(found[number], moved, self.within, *balls)
        return CandidatePairs(self.within, centers, radii, tuple(found))

    def pairs(self, of: IntArray | None) -> tuple[IntArray, IntArray, IntArray]:
        """Return the smaller and the larger index and the step of candidates, each pair in order.

        Args:
            of: indices of vehicles; only pairs with one or two of them are returned. All pairs if
                not given.
        """
        one, other, k = np.concatenate(self.found, axis=1)
        begins = _INSTANTS * np.arange(len(self.found))
        k += np.repeat(begins, [each.shape[1] for each in self.found])
        if of is None or len(of) == len(self.radii):
            return one, other, k
        selected = np.zeros(len(self.radii), dtype=bool)
        selected[of] = True
        required = np.flatnonzero(selected[one] | selected[other])
        return one[required], other[required], k[required]


def _renewed(
    found: IntArray, moved: IntArray, within: float, centers: FloatArray, radii: FloatArray
) -> IntArray:
    """Return the candidates of a few steps after the balls of some vehicles have moved.

    Args:
        found: the candidates before, shape (3, M).
        moved: increasing indices of these vehicles.
        within: the distance.
        centers: centres of the balls, shape (N, T, 3).
        radii: radii of the balls, shape (N, T).
    """
    if len(moved) == len(centers):
        return _pairs_during(centers, within, radii, None)
    has_moved = np.zeros(len(centers), dtype=bool)
    has_moved[moved] = True
    others = found[:, np.flatnonzero(~(has_moved[found[0]] | has_moved[found[1]]))]
    return np.concatenate([others, _pairs_during(centers, within, radii, moved)], axis=1)


def _by_enumeration(points: FloatArray, within: float, travel: FloatArray) -> IntArray:
    """Return candidates by visiting all pairs, shape (3, M)."""
    one, other = np.triu_indices(len(points), 1)
    x = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(x, x) <= (within + travel[one] + travel[other]) ** 2
    which, instants = np.nonzero(close)
    return np.stack([one[which], other[which], instants])


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
