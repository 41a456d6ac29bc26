"""Close pairs of vehicles: the closest approach of each pair in every step, exact in time.

Distances are measured in coordinates with z divided by the downwash, in which the separation is a
sphere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.motion.candidate_pairs import CandidatePairs, chunks_of_steps
from drake_rho.motion.dynamics import Motion, vectors_of
from drake_rho.motion.extremes import lengths_of, nearest_moments
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.system.table import Table
from drake_rho.system.threads import thread_pool

_ROUNDING = 1e-9
"""Relative rounding error of lower bounds, generously rounded up."""


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


@dataclasses.dataclass(frozen=True)
class _Steps:
    """Motions of several vehicles in T successive steps, scaled to a round separation."""

    step: float
    """h [s]"""
    first: int
    """number of the first step"""
    last: bool
    """whether the motions end with the last one"""
    p: FloatArray
    """positions at the beginning of the steps and at the end of the last, shape (N, T+1, 3)"""
    v: FloatArray
    """velocities at the beginning of the steps, shape (N, T, 3)"""
    a: FloatArray
    """accelerations, shape (N, T, 3)"""
    middles: FloatArray
    """positions in the middle of the steps, shape (N, T, 3)"""
    travel: FloatArray
    """bounds on the distance from these positions within the steps, shape (N, T)"""

    @classmethod
    def of(cls, motion: Motion, separation: Separation, steps: slice) -> _Steps:
        """Return the motions in a slice of the steps."""
        knots, h = slice(steps.start, steps.stop + 1), motion.step
        p, v, a = motion.positions, motion.velocities, motion.accelerations
        parts = p[:, knots], v[:, steps], a[:, steps]
        p, v, a = (np.ascontiguousarray(separation.scaled(each)) for each in parts)
        last = steps.stop == motion.accelerations.shape[1]
        middles = p[:, :-1] + h / 2 * (v + h / 4 * a)
        return cls(h, steps.start, last, p, v, a, middles, _travel(h, v, a))

    def closest(
        self, within: float, one: IntArray, other: IntArray, k: IntArray
    ) -> CloseApproaches:
        """Return the closest approaches of candidate pairs in their steps, if below a distance."""
        x = _relative(self.middles, one, other, k)
        bounds = within + _entries(self.travel, one, k) + _entries(self.travel, other, k)
        near = np.flatnonzero(np.vecdot(x, x) <= bounds**2)
        x, one, other, k = x[near], one[near], other[near], k[near]
        w, b = (_relative(each, one, other, k) for each in (self.v, self.a))
        # close bounds leave few pairs, since computing minima is expensive
        near = np.flatnonzero(_lower_bounds(x, w, b, self.step) < (1.0 + _ROUNDING) * within)
        one, other, k, w, b = one[near], other[near], k[near], w[near], b[near]
        p = _relative(self.p, one, other, k)
        return _closest_below(within, self.step, one, other, self.first + k, p, w, b)

    def at_knots(
        self, within: float, one: IntArray, other: IntArray, k: IntArray
    ) -> CloseApproaches:
        """Return candidate pairs that are within a distance where their steps begin.

        Those of the last step are also compared at its end, if the motions end there.
        """
        if self.last:
            ending = np.flatnonzero(k == self.travel.shape[1] - 1)
            one, other = np.append(one, one[ending]), np.append(other, other[ending])
            k = np.append(k, k[ending] + 1)
        x = _relative(self.p, one, other, k)
        near = np.flatnonzero(np.vecdot(x, x) <= within**2)
        one, other, k = one[near], other[near], k[near]
        times: FloatArray = (self.first + k) * np.float64(self.step)
        return CloseApproaches(one, other, times, lengths_of(x[near]))


_Exact = Callable[[_Steps, float, IntArray, IntArray, IntArray], CloseApproaches]
"""Method of `_Steps` that returns the close approaches among candidate pairs."""


class PairSearch:
    """Search for close pairs of vehicles, which begins with the candidates of the last search.

    Successive motions of an optimisation differ little, so most candidates remain. The result does
    not depend on earlier searches: candidates are renewed wherever a motion has left the balls for
    which they are complete (`CandidatePairs`).

    Args:
        separation: ellipsoid that defines the distance.
    """

    def __init__(self, separation: Separation) -> None:
        self.separation = separation
        self._candidates = list[CandidatePairs]()

    def in_steps(
        self, motion: Motion, within: float, *, of: IntArray | None = None
    ) -> CloseApproaches:
        """Return the closest approach of each pair in each step, if it is below a distance.

        Args:
            motion: of several vehicles, arrays of shape (N, ..., 3).
            within: the distance [m].
            of: increasing indices of vehicles; only pairs with one or two of them are considered.
                All pairs if not given.

        Returns:
            Close approaches, sorted by pair and then by time.
        """
        return self._in_chunks(_Steps.closest, motion, within, of)

    def at_knots(
        self, motion: Motion, within: float, *, of: IntArray | None = None
    ) -> CloseApproaches:
        """Return pairs that are within a distance at the knots; see `in_steps`."""
        return self._in_chunks(_Steps.at_knots, motion, within, of)

    def _in_chunks(
        self, exact: _Exact, motion: Motion, within: float, of: IntArray | None
    ) -> CloseApproaches:
        """Search the steps chunk by chunk, in threads if there are several chunks.

        Args:
            exact: returns the close approaches among candidates.
            motion: of several vehicles.
            within: the distance [m].
            of: as in `in_steps`.
        """
        count, steps, _ = motion.accelerations.shape
        if of is not None and len(of) == 0:
            return NO_APPROACHES
        chunks = chunks_of_steps(count, steps)
        before = self._candidates
        sizes = [(count, each.stop - each.start) for each in chunks]
        if [each.radii.shape for each in before] != sizes or before[0].within < within:
            before = [CandidatePairs.unknown(*each, within) for each in sizes]

        def search(
            steps: slice, candidates: CandidatePairs
        ) -> tuple[CandidatePairs, CloseApproaches]:
            own = _Steps.of(motion, self.separation, steps)
            candidates = candidates.of_paths(own.middles, own.travel)
            return candidates, exact(own, within, *candidates.pairs(of))

        each_of = thread_pool().map if len(chunks) > 1 else map
        candidates, every = zip(*each_of(search, chunks, before), strict=True)
        self._candidates = list(candidates)
        found = CloseApproaches.joined(every)
        order = np.argsort(found.one * count + found.other, kind="stable")  # keeps order of time
        return found.select(order)


def _relative(vectors: FloatArray, one: IntArray, other: IntArray, k: IntArray) -> FloatArray:
    """Return differences of two vehicles' vectors at some instants, shape (M, 3)."""
    return vectors_of(vectors, one, k) - vectors_of(vectors, other, k)


def _entries(array: FloatArray, vehicles: IntArray, k: IntArray) -> FloatArray:
    """Return array[vehicles, k] of a contiguous array (N, T), shape (M,)."""
    entries: FloatArray = array.reshape(-1).take(vehicles * array.shape[1] + k)
    return entries


def _travel(step: float, v: FloatArray, a: FloatArray) -> FloatArray:
    """Return bounds on how far motions get from their positions in the middle of a step."""
    travel = lengths_of(v + step / 2 * a)
    travel += step / 4 * lengths_of(a)
    travel *= step / 2
    return travel


def _lower_bounds(x: FloatArray, w: FloatArray, b: FloatArray, h: float) -> FloatArray:
    """Return lower bounds on the lengths of relative positions during steps, shape (M,).

    A path with constant acceleration b deviates from its chord by at most h²/8 norm(b).

    Args:
        x: relative positions in the middle of the steps, shape (M, 3).
        w: relative velocities at the beginning of the steps, shape (M, 3).
        b: relative accelerations, shape (M, 3).
        h: duration of the steps.
    """
    middle, half = x + h**2 / 8 * b, h / 2 * (w + h / 2 * b)  # of the chord
    squares = np.maximum(np.vecdot(half, half), np.finfo(float).tiny)
    s = np.clip(-np.vecdot(middle, half) / squares, -1.0, 1.0)
    bounds: FloatArray = lengths_of(middle + s[:, None] * half) - h**2 / 8 * lengths_of(b)
    return bounds


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
