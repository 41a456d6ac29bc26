"""Distances between vehicles in continuous time, without a visit to every pair.

The distance of two is measured where the separation is a sphere: with z divided by its downwash.
"""

from __future__ import annotations

import dataclasses
from functools import reduce

import numpy as np

from drake_rho.motion.clearance import nearest_moments
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Separation


@dataclasses.dataclass(frozen=True)
class Meetings:
    """Instants at which two vehicles are close, one for each pair and step that has one."""

    one: IntArray
    """index of the one vehicle, shape (M,)"""
    other: IntArray
    """index of the other, which is larger, shape (M,)"""
    times: FloatArray
    """when, since the first knot [s], shape (M,)"""
    distances: FloatArray
    """how close [m], shape (M,)"""

    def __len__(self) -> int:
        """M."""
        return len(self.times)

    def select(self, which: BoolArray | IntArray) -> Meetings:
        """Only some of them."""
        return Meetings(
            self.one[which], self.other[which], self.times[which], self.distances[which]
        )

    def and_also(self, more: Meetings) -> Meetings:
        """These and others, pair by pair and in the order of time; the same instant once."""
        one = np.concatenate([self.one, more.one])
        other = np.concatenate([self.other, more.other])
        times = np.concatenate([self.times, more.times])
        distances = np.concatenate([self.distances, more.distances])
        order = np.lexsort((times, other, one))
        every = Meetings(one, other, times, distances).select(order)
        again = np.diff(every.one, prepend=-1) == 0
        again &= np.diff(every.other, prepend=-1) == 0
        again &= np.abs(np.diff(every.times, prepend=-1.0)) <= 1e-9 * (1.0 + every.times)
        return every.select(~again)


@dataclasses.dataclass(frozen=True)
class Nearest:
    """The closest that any other vehicle comes to each."""

    partners: IntArray
    """which other, shape (N,)"""
    times: FloatArray
    """when, since the first knot [s], shape (N,)"""
    distances: FloatArray
    """how close [m], shape (N,)"""


def at_knots(motion: Motion, separation: Separation, within: float) -> Meetings:
    """Pairs closer than `within` [m] at the knots, pair by pair and in the order of time."""
    scaled = separation.scaled(motion.positions)
    found = []
    for k in range(scaled.shape[1]):
        pairs = _pairs_within(scaled[:, k], within)
        found.append(np.column_stack([pairs, np.full(len(pairs), k)]))
    one, other, k = np.concatenate(found).T
    order = np.lexsort((k, other, one))
    one, other, k = one[order], other[order], k[order]
    distances = np.linalg.norm(scaled[one, k] - scaled[other, k], axis=1)
    return Meetings(one, other, motion.step * k, distances)


def closest(motion: Motion, separation: Separation, within: float) -> Meetings:
    """Closest approaches below `within` [m] in the steps, exact, pair by pair.

    A pair is looked at in a step if it is close enough at its first knot to get there.
    """
    h = motion.step
    p, v = separation.scaled(motion.positions[:, :-1]), separation.scaled(motion.velocities[:, :-1])
    a = separation.scaled(motion.accelerations)
    reach = h * (np.linalg.norm(v, axis=2) + h / 2 * np.linalg.norm(a, axis=2))
    found = []
    for k in range(p.shape[1]):
        radius = within + 2.0 * float(reach[:, k].max())
        pairs = _pairs_within(p[:, k], radius)
        found.append(np.column_stack([pairs, np.full(len(pairs), k)]))
    one, other, k = np.concatenate(found).T
    apart = np.linalg.norm(p[one, k] - p[other, k], axis=1)
    near = apart - reach[one, k] - reach[other, k] < within
    one, other, k = one[near], other[near], k[near]
    order = np.lexsort((k, other, one))
    one, other, k = one[order], other[order], k[order]
    dp, dv, da = (each[one, k] - each[other, k] for each in (p, v, a))
    s = nearest_moments(dp, dv, da, h)[:, None]
    distances = np.linalg.norm(dp + s * (dv + s / 2 * da), axis=1)
    close = distances < within
    return Meetings(one, other, h * k + s[:, 0], distances).select(close)


def nearest(motion: Motion, separation: Separation, *, every_instant: bool) -> Nearest:
    """For every vehicle the closest that another comes to it in the whole flight.

    Exact wherever it is less than four times the separation; for a vehicle that no other comes so
    close to, that of the one which is nearest at a knot.

    Args:
        motion: of N >= 2 vehicles.
        separation: how distances are measured.
        every_instant: whether the time between knots is looked at too.
    """
    found = _nearest_at_knots(motion, separation)
    if not every_instant or not np.all(np.isfinite(found.distances)):
        return found
    within = min(float(found.distances.max()), 4.0 * separation.distance)
    close = closest(motion, separation, within)
    if far := np.flatnonzero(found.distances > within).tolist():
        alone = [_pair(motion, separation, one, int(found.partners[one])) for one in far]
        close = reduce(Meetings.and_also, alone, close)
    vehicles = np.concatenate([close.one, close.other])
    partners = np.concatenate([close.other, close.one])
    times, distances = np.tile(close.times, 2), np.tile(close.distances, 2)
    order = np.lexsort((distances, vehicles))
    first = order[np.append(True, np.diff(vehicles[order]) != 0)] if len(order) else order
    first = first[distances[first] < found.distances[vehicles[first]]]
    who = vehicles[first]
    found.partners[who], found.times[who] = partners[first], times[first]
    found.distances[who] = distances[first]
    return found


def _nearest_at_knots(motion: Motion, separation: Separation) -> Nearest:
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    count = len(motion.positions)
    if not np.all(np.isfinite(motion.positions)):
        return Nearest(np.zeros(count, dtype=int), np.zeros(count), np.full(count, np.nan))
    found = Nearest(np.zeros(count, dtype=int), np.zeros(count), np.full(count, np.inf))
    for k, points in enumerate(np.moveaxis(separation.scaled(motion.positions), 1, 0)):
        distances, indices = cKDTree(points).query(points, k=2)
        own = indices[:, 0] == np.arange(count)  # not where two are in the same place
        partners = np.where(own, indices[:, 1], indices[:, 0])
        closer = distances[:, 1] < found.distances
        found.partners[closer], found.times[closer] = partners[closer], k * motion.step
        found.distances[closer] = distances[closer, 1]
    return found


def _pair(motion: Motion, separation: Separation, one: int, other: int) -> Meetings:
    """The closest approach of two vehicles."""
    two = motion.of(np.array([one, other]))
    far = float(np.linalg.norm(np.diff(separation.scaled(two.positions), axis=0), axis=2).max())
    every = closest(two, separation, 2.0 * far + separation.distance)
    best = every.select(np.argmin(every.distances, keepdims=True))
    ends = np.array([min(one, other)]), np.array([max(one, other)])
    return Meetings(*ends, best.times, best.distances)


def closest_over_time(motion: Motion, separation: Separation, *, per_step: int) -> Meetings:
    """The closest two of all vehicles over time, in the order of time.

    There is one meeting at each of `per_step` instants of every step, and one, exact, where two
    come closer than at all of these: the least distance of a step is that of one of its meetings.

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
        closer = closest(step, separation, float(bound))
        if len(closer) > 0:
            m = np.argmin(closer.distances)
            time = h * k + closer.times[m]
            found.append((closer.one[m], closer.other[m], time, closer.distances[m]))
    one, other, instants, distances = (np.array(each) for each in zip(*found, strict=True))
    return Meetings(one, other, instants, distances).select(np.argsort(instants, kind="stable"))


def _closest_two(points: FloatArray, time: float) -> tuple[int, int, float, float]:
    """Indices of the closest two of several points, rising; `time`; and their distance."""
    from scipy.spatial import cKDTree  # see above

    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    distances, neighbours = tree.query(points, k=2)
    one = int(np.argmin(distances[:, 1]))
    # of two points in the same place either may come first
    other = int(neighbours[one, int(neighbours[one, 0] == one)])
    return min(one, other), max(one, other), time, float(distances[one, 1])


def _pairs_within(points: FloatArray, radius: float) -> IntArray:
    """Indices of all pairs of points closer than `radius`, rising, shape (P, 2)."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    pairs: IntArray = cKDTree(points).query_pairs(radius, output_type="ndarray")
    return pairs
