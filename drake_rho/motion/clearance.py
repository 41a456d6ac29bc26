"""Exact distances and extremes in continuous time, without sampling.

In every step a relative motion is quadratic in time, so its squared length is a quartic and the
derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which is
quadratic. In each of these at most three intervals of a step, Newton's iteration, safeguarded by
bisection, finds the root, if there is one, to the last digit. Everything is vectorised. K-d trees
find the close pairs of vehicles without visiting all pairs; distances are measured in coordinates
with z divided by the downwash, in which the separation is a sphere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.motion.dynamics import Motion, vectors_of
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.system.threads import threads

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_STEPS = 60
"""Bound on the iterations of root finding; bisection alone reaches the last digit of a double."""

_FEW = 4
"""Least ratio of all points to the selected ones from which a tree of the selected ones pays."""

_HANDFUL = 32
"""Number of points up to which all pairs are visited, which is faster than trees."""

_MANY = 40_000
"""Approximate number of points per chunk: its data fit into caches, and chunks run in parallel."""

_INSTANTS = 3
"""Number of instants that share one tree: with fewer, building trees takes longer; with more, there
are more candidate pairs."""

_LAST_DIGIT = 1e-15
"""Relative change of a root at which the iteration has converged."""


@dataclasses.dataclass(frozen=True)
class CloseApproaches:
    """Instants at which a vehicle is close to another vehicle or to a point."""

    one: IntArray
    """index of the vehicle, shape (M,)"""
    other: IntArray
    """larger index of the other vehicle; the vehicle's own index for a point, shape (M,)"""
    times: FloatArray
    """times since the first knot [s], shape (M,)"""
    distances: FloatArray
    """distances [m], shape (M,)"""

    def __len__(self) -> int:
        """Return the number of instants, M."""
        return len(self.times)

    @classmethod
    def joined(cls, parts: Sequence[CloseApproaches]) -> CloseApproaches:
        """Concatenate close approaches in the given order."""
        arrays = zip(*((p.one, p.other, p.times, p.distances) for p in parts), strict=True)
        return cls(*map(np.concatenate, arrays))

    def select(self, which: BoolArray | IntArray | slice) -> CloseApproaches:
        """Return a selection of the close approaches."""
        return CloseApproaches(
            self.one[which], self.other[which], self.times[which], self.distances[which]
        )

    def and_also(self, more: CloseApproaches) -> CloseApproaches:
        """Return the union of both, sorted by pair and then by time, without duplicate instants."""
        every = CloseApproaches.joined([self, more])
        every = every.select(np.lexsort((every.times, every.other, every.one)))
        duplicate = np.diff(every.one, prepend=-1) == 0
        duplicate &= np.diff(every.other, prepend=-1) == 0
        duplicate &= np.abs(np.diff(every.times, prepend=-1.0)) <= 1e-9 * (1.0 + every.times)
        return every.select(~duplicate)


_NOBODY = np.zeros(0, dtype=np.int64)
NONE = CloseApproaches(_NOBODY, _NOBODY, np.zeros(0), np.zeros(0))
"""No close approaches."""


def closest_approach(motion: Motion, center: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the exact least distance of a motion from a point, in every step.

    Args:
        motion: of one vehicle or several.
        center: the point [m], shape (3,), or any shape that broadcasts against (..., K-1, 3).

    Returns:
        Times since the first knot [s] and distances [m], shape (..., K-1).
    """
    h, a = motion.step, motion.accelerations
    p, v = motion.positions[..., :-1, :] - center, motion.velocities[..., :-1, :]
    s = nearest_moments(p, v, a, h)
    at = p + s[..., None] * (v + s[..., None] / 2 * a)
    return h * np.arange(a.shape[-2]) + s, _lengths(at)


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
        middle, reach = p + h / 2 * (v + h / 4 * a), _reach(h, v, a)
        one, other, k = _pairs_at(middle, within, reach, of)
        # bounds by the relative motion leave fewer pairs: computing minima is expensive
        x, w, b = (_relative(each, one, other, k) for each in (middle, v, a))
        near = _lengths(x) - _reach(h, w, b) < within
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
        return CloseApproaches(one, other, times, _lengths(_relative(p, one, other, k)))

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
    each_of = threads().map if len(chunks) > 1 else map
    every = CloseApproaches.joined(list(each_of(found, chunks)))
    order = np.argsort(every.one * count + every.other, kind="stable")  # keeps the order of time
    return every.select(order)


def _relative(vectors: FloatArray, one: IntArray, other: IntArray, k: IntArray) -> FloatArray:
    """Return differences of two vehicles' vectors at some instants, shape (M, 3)."""
    return vectors_of(vectors, one, k) - vectors_of(vectors, other, k)


def _reach(step: float, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return bounds on the distance of motions in a step from their positions in its middle."""
    reach = _lengths(v + step / 2 * a)
    reach += step / 4 * _lengths(a)
    reach *= step / 2
    return reach


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the norms of vectors (..., 3), three times as fast as `np.linalg.norm`."""
    lengths: FloatArray = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return lengths


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
    distances = _lengths(p + s * (v + s / 2 * a))
    return CloseApproaches(one, other, step * k + s[:, 0], distances).select(distances < within)


def _pairs_at(
    points: FloatArray, within: float, reach: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """Return pairs of points closer than a distance plus the reach of both, at T instants.

    Args:
        points: positions of all vehicles, shape (N, T, 3).
        within: the distance.
        reach: distance that each point may move, shape (N, T).
        of: indices of points; only pairs with one or two of them are returned. All pairs if not
            given.

    Returns:
        Indices of both points, the smaller first, and of the instant, each pair in time order.
    """
    if len(points) <= _HANDFUL:
        return _pairs_by_enumeration(points, within, reach, of)
    few = of if of is not None and _FEW * len(of) < len(points) else None

    every = list[IntArray]()
    for first in range(0, points.shape[1], _INSTANTS):
        chunk = slice(first, first + _INSTANTS)
        every.append(_pairs_during(points[:, chunk], within, reach[:, chunk], few))
        every[-1][2] += first
    one, other, instants = np.concatenate(every, axis=1)
    if of is not None and few is None:
        selected = np.isin(np.arange(len(points)), of)
        required = selected[one] | selected[other]
        one, other, instants = one[required], other[required], instants[required]
    return one, other, instants


def _pairs_by_enumeration(
    points: FloatArray, within: float, reach: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """Return `_pairs_at` by visiting all pairs, without trees."""
    one, other = np.triu_indices(len(points), 1)
    if of is not None:
        selected = np.isin(np.arange(len(points)), of)
        required = selected[one] | selected[other]
        one, other = one[required], other[required]
    x = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(x, x) <= (within + reach[one] + reach[other]) ** 2
    which, instants = np.nonzero(close)
    return one[which], other[which], instants


def _pairs_during(
    points: FloatArray, within: float, reach: FloatArray, few: IntArray | None
) -> IntArray:
    """Return `_pairs_at` for a few instants, as pairs and instants, shape (3, M).

    One tree of the points at the middle instant is searched for all instants, with a radius larger
    by how far both points move until the other instants. If they move far, each instant has its
    own tree.

    Args:
        points: shape (N, T, 3) with few instants T.
        within: the distance.
        reach: distance that each point may move, shape (N, T).
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
            _pairs_during(points[:, k : k + 1], within, reach[:, k : k + 1], few)
            for k in range(count)
        ]
        for k, found in enumerate(each):
            found[2] = k
        return np.concatenate(each, axis=1)
    away += reach.max(axis=1)
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
    close = np.vecdot(x, x) <= (within + reach[one] + reach[other]) ** 2
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


def nearest_moments(
    p: FloatArray, v: FloatArray, a: FloatArray, h: float | FloatArray
) -> FloatArray:
    """Return the s in [0, h] at which the length of p + s v + s²/2 a is least, shape (...).

    Args:
        p: relative positions [m], shape (..., 3).
        v: relative velocities [m/s], shape (..., 3).
        a: relative accelerations [m/s²], shape (..., 3).
        h: durations [s], shape (...), or one for all.
    """

    def dot(one: FloatArray, other: FloatArray) -> FloatArray:
        product: FloatArray = np.einsum("...i,...i->...", one, other)
        return product

    def distance(s: FloatArray) -> FloatArray:
        return _lengths(p + s[..., None] * (v + s[..., None] / 2 * a))

    # half the derivative of the squared length: c0 + c1 s + c2 s² + c3 s³
    coefficients = dot(p, v), dot(v, v) + dot(p, a), 1.5 * dot(v, a), 0.5 * dot(a, a)
    first, second = _quadratic_roots(coefficients[1], 2 * coefficients[2], 3 * coefficients[3], h)
    zero = np.zeros_like(first)
    bounds = [zero, first, second, zero + h]
    moments = [zero, zero + h]
    moments += [_rising_root(coefficients, low, high) for low, high in pairwise(bounds)]
    candidates = np.stack(moments)
    lengths = np.stack([distance(s) for s in moments])
    best = np.argmin(lengths, axis=0)[None]
    nearest: FloatArray = np.take_along_axis(candidates, best, axis=0)[0]
    return nearest


def _quadratic_roots(
    c0: FloatArray, c1: FloatArray, c2: FloatArray, h: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the real roots of c0 + c1 s + c2 s², sorted and clipped to [0, h]; 0 without any."""
    discriminant = c1 * c1 - 4 * c2 * c0
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (c1 + np.where(c1 < 0, -root, root))  # this form avoids cancellation
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = q / c2, c0 / q
    real = discriminant > 0
    one = np.where(real & np.isfinite(one), one, 0.0)
    other = np.where(real & np.isfinite(other), other, 0.0)
    low, high = np.minimum(one, other), np.maximum(one, other)
    return np.clip(low, 0.0, h), np.clip(high, 0.0, h)


def _rising_root(
    coefficients: tuple[FloatArray, ...], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the point between `low` and `high` where a cubic rises through zero, or `low`."""
    c0, c1, c2, c3 = coefficients
    rises = (c0 + low * (c1 + low * (c2 + low * c3)) < 0) & (
        c0 + high * (c1 + high * (c2 + high * c3)) > 0
    )
    if not np.any(rises):
        return low
    roots = np.array(low)
    c0, c1, c2, c3, low, high = (each[rises] for each in (c0, c1, c2, c3, low, high))
    s = (low + high) / 2
    for _ in range(_STEPS):
        value = c0 + s * (c1 + s * (c2 + s * c3))
        low, high = np.where(value < 0, s, low), np.where(value < 0, high, s)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - value / (c1 + s * (2 * c2 + s * 3 * c3))
        inside = (newton > low) & (newton < high)  # false for NaN
        following = np.where(inside, newton, (low + high) / 2)
        moved = np.abs(following - s) > _LAST_DIGIT * high
        s = following
        if not np.any(moved):
            break
    roots[rises] = s
    return roots


def turning_points(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return the extremes of each coordinate between the knots.

    Args:
        motion: of one vehicle or several.

    Returns:
        Times since the first knot [s] and positions [m], shape (..., K-1, 3), one per step and
        axis; those of the beginning of the step where a coordinate has no extreme inside.
    """
    h, v, a = motion.step, motion.velocities[..., :-1, :], motion.accelerations
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -v / a
    s = np.where(np.isfinite(s) & (s > 0) & (s < h), s, 0.0)
    times = h * np.arange(a.shape[-2])[:, None] + s
    return times, motion.positions[..., :-1, :] + s * (v + s / 2 * a)


def closest_over_time(motion: Motion, separation: Separation, *, per_step: int) -> CloseApproaches:
    """Return the closest pair of all vehicles over time, in the order of time.

    The result has an entry at each of `per_step` instants of every step. A step in which vehicles
    come closer between these instants has one more, exact entry, so that the least distance of
    every step is that of an entry.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3), N >= 2.
        separation: ellipsoid that defines the distance.
        per_step: number of instants in a step, at least 1, the first at its knot.
    """
    h, steps = motion.step, motion.accelerations.shape[1]
    times = h / per_step * np.arange(steps * per_step + 1)
    scaled = separation.scaled(motion.at("position", times))
    found = [_closest_two(scaled[:, m], time) for m, time in enumerate(times)]
    least = np.array([distance for *_, distance in found])
    for k in range(steps):
        p, v = motion.positions[:, k : k + 2], motion.velocities[:, k : k + 2]
        step = Motion(h, p, v, motion.accelerations[:, k : k + 1], motion.before)
        bound = least[k * per_step : (k + 1) * per_step + 1].min()
        closer = close_pairs(step, separation, float(bound))
        if len(closer) > 0:
            m = np.argmin(closer.distances)
            time = h * k + closer.times[m]
            found.append((closer.one[m], closer.other[m], time, closer.distances[m]))
    one, other, instants, distances = (np.array(each) for each in zip(*found, strict=True))
    order = np.argsort(instants, kind="stable")
    return CloseApproaches(one, other, instants, distances).select(order)


def _closest_two(points: FloatArray, time: float) -> tuple[int, int, float, float]:
    """Return the indices of the closest two points, the smaller first; `time`; their distance."""
    from scipy.spatial import cKDTree  # imported here: slow to load

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances, neighbours = tree.query(points, k=2)
    one = int(np.argmin(distances[:, 1]))
    # where two points coincide, either may be the first neighbour
    other = int(neighbours[one, int(neighbours[one, 0] == one)])
    return min(one, other), max(one, other), time, float(distances[one, 1])
