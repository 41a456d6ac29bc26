"""Exact distances and extremes in continuous time, without sampling.

In every step a relative motion is quadratic in time, so its squared length is a quartic and the
derivative of that a cubic. A cubic is monotone between the roots of its own derivative, which are
those of a quadratic: in each of these at most three pieces of a step its root, if there is one, is
found to the last digit by Newton's steps, and by bisection where these lead outside. Everything is
vectorised. Which pairs of vehicles come close is asked of k-d trees, never of all pairs; their
distance is measured where their separation is a sphere, with z divided by its downwash.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.motion.dynamics import Motion, vectors_of
from drake_rho.motion.threads import threads
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Separation

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_STEPS = 60
"""Bound on the steps to a root; bisections alone would be past the last digit of a double."""

_FEW = 4
"""How many times as many as are asked for there have to be before a tree of those few pays."""

_HANDFUL = 32
"""Points up to which all pairs are looked at: trees would take longer."""

_MANY = 40_000
"""About how many points are looked at in one go, so that what is computed of them stays in caches,
and others are side by side with them."""

_INSTANTS = 3
"""Instants for which one tree is searched: trees of fewer take longer, and with more there are more
pairs to look at."""

_LAST_DIGIT = 1e-15
"""Relative change of a root below which it is found."""


@dataclasses.dataclass(frozen=True)
class CloseApproaches:
    """Instants at which a vehicle is close to another, or to a point."""

    one: IntArray
    """index of the vehicle, shape (M,)"""
    other: IntArray
    """index of the other, which is larger; the vehicle's own for a point, shape (M,)"""
    times: FloatArray
    """when, since the first knot [s], shape (M,)"""
    distances: FloatArray
    """how close [m], shape (M,)"""

    def __len__(self) -> int:
        """M."""
        return len(self.times)

    @classmethod
    def joined(cls, parts: Sequence[CloseApproaches]) -> CloseApproaches:
        """Some of them, then others."""
        arrays = zip(*((p.one, p.other, p.times, p.distances) for p in parts), strict=True)
        return cls(*map(np.concatenate, arrays))

    def select(self, which: BoolArray | IntArray | slice) -> CloseApproaches:
        """Only some of them."""
        return CloseApproaches(
            self.one[which], self.other[which], self.times[which], self.distances[which]
        )

    def and_also(self, more: CloseApproaches) -> CloseApproaches:
        """These and others, pair by pair and in the order of time; equal instants once."""
        every = CloseApproaches.joined([self, more])
        every = every.select(np.lexsort((every.times, every.other, every.one)))
        again = np.diff(every.one, prepend=-1) == 0
        again &= np.diff(every.other, prepend=-1) == 0
        again &= np.abs(np.diff(every.times, prepend=-1.0)) <= 1e-9 * (1.0 + every.times)
        return every.select(~again)


_NOBODY = np.zeros(0, dtype=np.int64)
NONE = CloseApproaches(_NOBODY, _NOBODY, np.zeros(0), np.zeros(0))
"""Where nobody is close."""


def closest_approach(motion: Motion, center: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The exact least distance of a motion from a point, in every step.

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
    """Closest approaches of vehicles below a distance, in each step, pair by pair.

    A pair is looked at in a step if it is close enough in the middle of it to get there.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3).
        separation: how distances are measured.
        within: the distance [m].
        of: vehicles of which each pair has one or two, rising indices; all if not given.
    """
    h = motion.step

    def found(steps: slice) -> CloseApproaches:
        quantities = motion.positions, motion.velocities, motion.accelerations
        p, v, a = (np.ascontiguousarray(separation.scaled(each[:, steps])) for each in quantities)
        middle, reach = p + h / 2 * (v + h / 4 * a), _reach(h, v, a)
        one, other, k = _pairs_at(middle, within, reach, of)
        # of their common way nothing is lost or gained: it leaves fewer, and minima take long
        apart, v_apart, a_apart = (_apart(each, one, other, k) for each in (middle, v, a))
        near = _lengths(apart) - _reach(h, v_apart, a_apart) < within
        one, other, k = one[near], other[near], k[near]
        relative = _apart(p, one, other, k), v_apart[near], a_apart[near]
        return _closest_below(within, h, one, other, steps.start + k, *relative)

    return _side_by_side(found, *motion.accelerations.shape[:2])


def close_pairs_at_knots(
    motion: Motion, separation: Separation, within: float, *, of: IntArray | None = None
) -> CloseApproaches:
    """Vehicles closer than a distance at the knots, pair by pair; arguments as for all instants."""

    def found(knots: slice) -> CloseApproaches:
        p = np.ascontiguousarray(separation.scaled(motion.positions[:, knots]))
        one, other, k = _pairs_at(p, within, np.zeros(p.shape[:2]), of)
        times: FloatArray = (knots.start + k) * np.float64(motion.step)
        return CloseApproaches(one, other, times, _lengths(_apart(p, one, other, k)))

    return _side_by_side(found, *motion.positions.shape[:2])


def _side_by_side(
    found: Callable[[slice], CloseApproaches], count: int, instants: int
) -> CloseApproaches:
    """What is found of so many vehicles in each stretch of so many instants, pair by pair."""
    size = _INSTANTS * max(1, _MANY // (_INSTANTS * count))
    stretches = [slice(first, min(first + size, instants)) for first in range(0, instants, size)]
    each_of = threads().map if len(stretches) > 1 else map
    every = CloseApproaches.joined(list(each_of(found, stretches)))
    order = np.argsort(every.one * count + every.other, kind="stable")  # which keeps that of time
    return every.select(order)


def _apart(vectors: FloatArray, one: IntArray, other: IntArray, k: IntArray) -> FloatArray:
    """Differences of two vehicles' vectors at some instants, shape (M, 3)."""
    return vectors_of(vectors, one, k) - vectors_of(vectors, other, k)


def _reach(step: float, v: FloatArray, a: FloatArray) -> FloatArray:
    """How far motions get in a step from where they are in the middle of it."""
    reach = _lengths(v + step / 2 * a)
    reach += step / 4 * _lengths(a)
    reach *= step / 2
    return reach


def _lengths(vectors: FloatArray) -> FloatArray:
    """Of vectors (..., 3): their norms, three times as fast as by the function for any norm."""
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
    """The closest approaches below a distance among relative motions in some steps."""
    p, v, a = relative
    if len(k) == 0:
        return CloseApproaches(one, other, np.zeros(0), np.zeros(0))
    s = nearest_moments(p, v, a, step)[:, None]
    distances = _lengths(p + s * (v + s / 2 * a))
    return CloseApproaches(one, other, step * k + s[:, 0], distances).select(distances < within)


def _pairs_at(
    points: FloatArray, within: float, reach: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of points (N, T, 3) closer than a distance and the reach of both, at T instants.

    Args:
        points: where everyone is.
        within: how close.
        reach: how much closer each may come, shape (N, T).
        of: indices of points of which each pair has one or two; all if not given.

    Returns:
        Indices, rising, of the two, and of the instant: of each pair in the order of time.
    """
    if len(points) <= _HANDFUL:
        return _of_all_pairs(points, within, reach, of)
    some = of if of is not None and _FEW * len(of) < len(points) else None

    every = list[IntArray]()
    for first in range(0, points.shape[1], _INSTANTS):
        own = slice(first, first + _INSTANTS)
        every.append(_pairs_during(points[:, own], within, reach[:, own], some))
        every[-1][2] += first
    one, other, instants = np.concatenate(every, axis=1)
    if of is not None and some is None:
        asked = np.isin(np.arange(len(points)), of)
        wanted = asked[one] | asked[other]
        one, other, instants = one[wanted], other[wanted], instants[wanted]
    return one, other, instants


def _of_all_pairs(
    points: FloatArray, within: float, reach: FloatArray, of: IntArray | None
) -> tuple[IntArray, IntArray, IntArray]:
    """`_pairs_at` without trees."""
    one, other = np.triu_indices(len(points), 1)
    if of is not None:
        asked = np.isin(np.arange(len(points)), of)
        wanted = asked[one] | asked[other]
        one, other = one[wanted], other[wanted]
    apart = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(apart, apart) <= (within + reach[one] + reach[other]) ** 2
    which, instants = np.nonzero(close)
    return one[which], other[which], instants


def _pairs_during(
    points: FloatArray, within: float, reach: FloatArray, some: IntArray | None
) -> IntArray:
    """`_pairs_at` for a few instants, those of `some` if given; pairs and instants, shape (3, M).

    One tree is searched for all of them, in the middle of which pairs are as much further apart as
    both get from where they are then. Where that is far, each instant has its own.
    """
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    count = points.shape[1]
    middle = points[:, count // 2]
    ways = points - middle[:, None]
    away = np.sqrt(np.vecdot(ways, ways).max(axis=1))
    if count > 1 and float(away.max()) > within:
        each = [
            _pairs_during(points[:, k : k + 1], within, reach[:, k : k + 1], some)
            for k in range(count)
        ]
        for k, found in enumerate(each):
            found[2] = k
        return np.concatenate(each, axis=1)
    away += reach.max(axis=1)
    tree = cKDTree(middle, balanced_tree=False, compact_nodes=False)
    furthest = within + 2.0 * float(away.max())
    if some is None:
        pairs: IntArray = tree.query_pairs(furthest, output_type="ndarray")
    else:
        pairs = _pairs_of(some, middle, tree, furthest)
    one, other = pairs.T
    apart = middle.take(one, axis=0) - middle.take(other, axis=0)
    near = np.vecdot(apart, apart) <= (within + away[one] + away[other]) ** 2
    one, other = one[near], other[near]
    apart = points.take(one, axis=0) - points.take(other, axis=0)
    close = np.vecdot(apart, apart) <= (within + reach[one] + reach[other]) ** 2
    which, instants = np.nonzero(close)
    return np.stack([one[which], other[which], instants])


def _pairs_of(some: IntArray, points: FloatArray, tree: cKDTree, radius: float) -> IntArray:
    """Pairs, in rising order, of which one or two are among some of the points, shape (M, 2)."""
    own = type(tree)(points[some], balanced_tree=False, compact_nodes=False)
    near = own.sparse_distance_matrix(tree, radius, output_type="ndarray")
    one, other = some[near["i"]], near["j"]
    keys = np.minimum(one, other) * len(points) + np.maximum(one, other)
    keys = np.unique(keys[one != other])  # each is found next to itself, and two of the some twice
    pairs: IntArray = np.stack(np.divmod(keys, len(points)), axis=1)
    return pairs


def nearest_moments(
    p: FloatArray, v: FloatArray, a: FloatArray, h: float | FloatArray
) -> FloatArray:
    """When in [0, h] the length of p + s v + s²/2 a is least; vectors (..., 3), h (...) or one."""

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
    """Real roots of c0 + c1 s + c2 s², clipped to [0, h] and in order; 0 where there are none."""
    discriminant = c1 * c1 - 4 * c2 * c0
    root = np.sqrt(np.maximum(discriminant, 0.0))
    q = -0.5 * (c1 + np.where(c1 < 0, -root, root))  # without cancellation
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
    """The point between `low` and `high` where a cubic rises through zero, else `low`."""
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
        inside = (newton > low) & (newton < high)  # never with a NaN
        following = np.where(inside, newton, (low + high) / 2)
        moved = np.abs(following - s) > _LAST_DIGIT * high
        s = following
        if not np.any(moved):
            break
    roots[rises] = s
    return roots


def turning_points(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """The extremes of each coordinate between the knots, where it turns round inside a step.

    Args:
        motion: of one vehicle or several.

    Returns:
        Times [s] and positions [m], shape (..., K-1, 3), one for each axis; where an axis does
        not turn inside a step, the beginning of the step stands for it.
    """
    h, v, a = motion.step, motion.velocities[..., :-1, :], motion.accelerations
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -v / a
    s = np.where(np.isfinite(s) & (s > 0) & (s < h), s, 0.0)
    times = h * np.arange(a.shape[-2])[:, None] + s
    return times, motion.positions[..., :-1, :] + s * (v + s / 2 * a)


def closest_over_time(motion: Motion, separation: Separation, *, per_step: int) -> CloseApproaches:
    """The closest two of all vehicles over time, in the order of time.

    There is one at each of `per_step` instants of every step, and one, exact, where two
    come closer than at all of these: the least distance of a step is that of one of them.

    Args:
        motion: of several vehicles, arrays of shape (N, ..., 3), N >= 2.
        separation: by which distances are measured.
        per_step: instants in a step, at least 1, the first at its knot.
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
    """Indices of the closest two of several points, rising; `time`; and their distance."""
    from scipy.spatial import cKDTree  # slow to load, so only where needed

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances, neighbours = tree.query(points, k=2)
    one = int(np.argmin(distances[:, 1]))
    # of two points in the same place either may come first
    other = int(neighbours[one, int(neighbours[one, 0] == one)])
    return min(one, other), max(one, other), time, float(distances[one, 1])
