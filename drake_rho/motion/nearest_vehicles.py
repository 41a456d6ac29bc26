"""Nearest vehicles over time: of each vehicle, and the closest two of all."""

from __future__ import annotations

import numpy as np

from drake_rho.motion.close_pairs import CloseApproaches, PairSearch
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.pairs import closest_two, nearest_others
from drake_rho.scenario.parts import Separation


def nearest_vehicles(positions: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the distance and the index of the nearest other vehicle of each vehicle over time.

    Args:
        positions: scaled by the metric in which distances are measured [m], shape (N, M, 3).

    Returns:
        Distances [m], inf for a single vehicle, and indices, both of shape (N, M).
    """
    count, times = positions.shape[:2]
    if count == 1:
        return np.full((1, times), np.inf), np.zeros((1, times), dtype=np.int64)
    away, others = zip(*(nearest_others(positions[:, m]) for m in range(times)), strict=True)
    return np.stack(away, axis=1), np.stack(others, axis=1)


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
    closest = [closest_two(scaled[:, m]) for m in range(len(times))]
    found = [(one, other, t, d) for (one, other, d), t in zip(closest, times, strict=True)]
    least = np.array([distance for *_, distance in closest])
    ends = motion.before, motion.after  # which distances do not depend on
    for k in range(steps):
        p, v = motion.positions[:, k : k + 2], motion.velocities[:, k : k + 2]
        step = Motion(h, p, v, motion.accelerations[:, k : k + 1], *ends)
        bound = least[k * per_step : (k + 1) * per_step + 1].min()
        closer = PairSearch(separation).in_steps(step, float(bound))
        if len(closer) > 0:
            m = np.argmin(closer.distances)
            time = h * k + closer.times[m]
            found.append((closer.one[m], closer.other[m], time, closer.distances[m]))
    one, other, instants, distances = (np.array(each) for each in zip(*found, strict=True))
    order = np.argsort(instants, kind="stable")
    return CloseApproaches(one, other, instants, distances).select(order)
