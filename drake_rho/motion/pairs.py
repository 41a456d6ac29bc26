"""Distances between vehicles in continuous time, without a visit to every pair.

The distance of two is measured where the separation is a sphere: with z divided by its downwash.
"""

from __future__ import annotations

import dataclasses

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


def _pairs_within(points: FloatArray, radius: float) -> IntArray:
    """Indices of all pairs of points closer than `radius`, rising, shape (P, 2)."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    pairs: IntArray = cKDTree(points).query_pairs(radius, output_type="ndarray")
    return pairs
