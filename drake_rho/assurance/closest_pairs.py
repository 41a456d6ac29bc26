"""How close other vehicles come to each, without a visit to every pair.

Distances are those of the separation: with z divided by its downwash.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.assurance.continuous_time import Least, least_over_time
from drake_rho.assurance.steps import Steps
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation

_FAR = 4.0
"""In separations: beyond it only the pairs that are closest at a knot are followed in time."""

_LARGEST = 1e150
"""Coordinates whose squares do not overflow [m]."""


@dataclasses.dataclass(frozen=True)
class Closest:
    """The closest that any other vehicle comes to each of N."""

    partners: IntArray
    """which other, shape (N,)"""
    times: FloatArray
    """when, since the first knot [s], shape (N,)"""
    distances: FloatArray
    """how close [m], shape (N,); NaN where positions overflow or are no numbers"""


def closest_at_knots(motion: Motion, separation: Separation) -> Closest:
    """The closest at the knots, of N >= 2 vehicles."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    points = np.moveaxis(separation.scaled(motion.positions), 1, 0)
    count = points.shape[1]
    if not np.all(np.abs(points) < _LARGEST):  # nor with a NaN
        return Closest(np.zeros(count, dtype=int), np.zeros(count), np.full(count, np.nan))
    found = [cKDTree(each).query(each, k=2) for each in points]
    distances = np.array([each[0][:, 1] for each in found])
    neighbours = np.array([each[1] for each in found])  # oneself is the first, or, where two are
    own = neighbours[..., 0] == np.arange(count)  # in the same place, perhaps the second
    partners = np.where(own, neighbours[..., 1], neighbours[..., 0])
    k, vehicles = np.argmin(distances, axis=0), np.arange(count)
    return Closest(partners[k, vehicles], motion.step * k, distances[k, vehicles])


def closest_at_all_times(
    motion: Motion, separation: Separation, knots: Closest, precision: float
) -> Closest:
    """The closest at every instant.

    It is the least of all others where that is below four separations; for a vehicle that no other
    comes so close to, it is not above that of the one which is closest at a knot.

    Args:
        motion: of N >= 2 vehicles.
        separation: how distances are measured.
        knots: the closest at the knots.
        precision: by how much a smaller distance may be missed [m].
    """
    if not np.all(np.isfinite(knots.distances)):
        return knots
    count = motion.accelerations.shape[1]
    steps = Steps.of(
        motion.step,
        separation.scaled(motion.positions),
        separation.scaled(motion.velocities),
        separation.scaled(motion.accelerations),
    )
    pairs, k = _candidates(steps, count, knots, _FAR * separation.distance)
    one, other = (count * vehicle + k for vehicle in pairs.T)
    relative = Steps(*(each[one] - each[other] for each in (steps.p, steps.v, steps.a)))
    least = least_over_time(
        relative,
        pairs,
        lambda positions: np.linalg.norm(positions, axis=-1),
        np.full(len(k), precision),
        Least.unknown(knots.distances),
    )
    found = np.flatnonzero(least.steps >= 0)  # else it is closest at a knot
    partners, times = np.array(knots.partners), np.array(knots.times)
    partners[found] = pairs[least.steps[found]].sum(axis=1) - found
    times[found] = motion.step * (k[least.steps[found]] + least.moments[found])
    return Closest(partners, times, least.values)


def _candidates(steps: Steps, count: int, knots: Closest, far: float) -> tuple[IntArray, IntArray]:
    """Pairs, shape (M, 2), and steps, shape (M,), in which a distance known may be undercut.

    In the first half of a step a vehicle makes at most half the way of its greatest speed, and so
    in the second: two that are further apart in the middle do not get close in it.

    Args:
        steps: of all vehicles, vehicle by vehicle, in a space where the separation is a sphere.
        count: of steps of each.
        knots: the distances known.
        far: pairs further apart are no candidates [m], but for the closest at a knot.
    """
    from scipy.spatial import cKDTree  # see above

    vehicles = len(knots.distances)
    middles = (steps.p + steps.v / 2 + steps.a / 8).reshape(vehicles, count, 3)
    reach = steps.speeds.reshape(vehicles, count) / 2
    within = np.minimum(knots.distances, far)
    found = [np.empty((0, 2), dtype=int)]
    for k in range(count):
        points, radius = middles[:, k], within.max() + 2.0 * reach[:, k].max()
        pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
        one, other = pairs.T
        apart = np.linalg.norm(points[one] - points[other], axis=1)
        known = np.maximum(within[one], within[other])
        found.append(pairs[apart - reach[one, k] - reach[other, k] < known])
    during = np.repeat(np.arange(-1, count), [len(pairs) for pairs in found])
    alone = np.flatnonzero(knots.distances > far)
    couples = np.column_stack([alone, knots.partners[alone]]).repeat(count, axis=0)
    every_step = np.tile(np.arange(count), len(alone))
    return np.concatenate([*found, couples]), np.append(during, every_step)
