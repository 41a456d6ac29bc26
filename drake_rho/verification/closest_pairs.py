"""How close other vehicles come to each, without a visit to every pair.

Distances are those of the separation: with z divided by its downwash. With errors around positions
they are measured from the separation's ellipsoid, since what errors take is the same in every
direction: then a distance is the separation and how far beyond the ellipsoid the other one is, and
the closest is what comes closest to it with the errors of both. In the space in which the ellipsoid
is a ball, a way is `scales.max()` times as long at most.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.course import Course
from drake_rho.verification.steps import Steps

FAR = 4.0
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
    errors: FloatArray
    """radii of both vehicles' errors then [m], shape (N,)"""

    @property
    def less_errors(self) -> FloatArray:
        """What is least: distances less errors [m], shape (N,)."""
        return np.asarray(self.distances - self.errors)


def closest_at_knots(course: Course, separation: Separation) -> Closest:
    """The closest at the knots, of N >= 2 vehicles."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to load, so only where needed

    positions = course.positions[:, course.knots]
    points = np.moveaxis(separation.scaled(positions), 1, 0)
    count, errors = points.shape[1], 2.0 * course.errors(course.knots)
    if not np.all(np.abs(points) < _LARGEST):  # nor with a NaN
        nothing = np.zeros(count)
        return Closest(np.zeros(count, dtype=int), nothing, np.full(count, np.nan), nothing)
    found = [cKDTree(each).query(each, k=2) for each in points]
    distances = np.array([each[0][:, 1] for each in found])
    neighbours = np.array([each[1] for each in found])  # oneself is the first, or, where two are
    own = neighbours[..., 0] == np.arange(count)  # in the same place, perhaps the second
    partners = np.where(own, neighbours[..., 1], neighbours[..., 0])
    if course.tubes is not None and not separation.is_round:
        far = FAR * separation.distance + errors
        partners, distances = _closest_to_ellipsoid(positions, separation, partners, far)
    k, vehicles = np.argmin(distances - errors[:, None], axis=0), np.arange(count)
    times = course.elapsed[course.knots][k]
    return Closest(partners[k, vehicles], times, distances[k, vehicles], errors[k])


def _closest_to_ellipsoid(
    positions: FloatArray, separation: Separation, partners: IntArray, far: FloatArray
) -> tuple[IntArray, FloatArray]:
    """At each knot the partner that is closest to the ellipsoid around a vehicle, and how close.

    Args:
        positions: at the knots [m], shape (N, K, 3).
        separation: what is kept.
        partners: the closest where the ellipsoid is a ball, shape (K, N).
        far: pairs further apart are not looked at, but for these [m], shape (K,).

    Returns:
        Partners, and distances [m], shape (K, N).
    """
    from scipy.spatial import cKDTree  # see above

    scales, own = separation.shape.scales, separation.distance
    partners, closest = np.array(partners), np.empty(partners.shape)
    for k, most in enumerate(far):
        p = positions[:, k]
        closest[k] = from_ellipsoid(separation, p - p[partners[k]])
        within = np.minimum(closest[k], most).max()
        radius = own + scales.max() * max(within - own, 0.0)
        pairs = cKDTree(separation.scaled(p)).query_pairs(radius, output_type="ndarray")
        beside = np.concatenate([pairs, pairs[:, ::-1]])
        one, other = beside.T
        found = from_ellipsoid(separation, p[one] - p[other])
        order = np.argsort(-found, kind="stable")  # of several the closest comes last
        order = order[found[order] < closest[k, one[order]]]
        closest[k, one[order]], partners[k, one[order]] = found[order], other[order]
    return partners, closest


def from_ellipsoid(separation: Separation, x: FloatArray) -> FloatArray:
    """The separation and how far beyond its ellipsoid ways x between vehicles lead [m]."""
    distances: FloatArray = separation.distance + separation.shape.signed_distance(x)
    return distances


def closest_at_all_times(
    course: Course, separation: Separation, knots: Closest, precision: float, far: float = FAR
) -> Closest:
    """Return the closest at every instant.

    It is the least of all others where that is not far; for a vehicle that no other comes so close
    to, it is not above that of the one which is closest at a knot.

    Args:
        course: of N >= 2 vehicles.
        separation: how distances are measured.
        knots: the closest at the knots.
        precision: by how much a smaller distance may be missed [m].
        far: in separations, what is no longer looked for.
    """
    if not np.all(np.isfinite(knots.distances)):
        return knots
    count = len(course.durations)
    states = (course.positions, course.velocities, course.accelerations)
    scaled = course.steps_of(*(separation.scaled(each) for each in states))
    pairs, k = _candidates(scaled, course, separation, knots, far * separation.distance)
    one, other = (count * vehicle + k for vehicle in pairs.T)
    exactly = course.tubes is not None and not separation.is_round
    steps = course.steps if exactly else scaled
    relative = Steps(*(each[one] - each[other] for each in (steps.p, steps.v, steps.a)))
    around = course.around(k, vehicles=2.0)
    least = least_over_time(
        relative,
        pairs,
        lambda x: from_ellipsoid(separation, x) if exactly else np.linalg.norm(x, axis=-1),
        np.full(len(k), precision),
        Least.unknown(knots.less_errors),
        around,
    )
    found = np.flatnonzero(least.steps >= 0)  # else it is closest at a knot
    at, moments = least.steps[found], least.moments[found]
    partners, times = np.array(knots.partners), np.array(knots.times)
    errors = np.array(knots.errors)
    partners[found] = pairs[at].sum(axis=1) - found
    times[found] = course.moments(k[at], moments)
    if around is not None:
        errors[found] = around.radii(at, moments[:, None])[:, 0]
    return Closest(partners, times, least.values + errors, errors)


def _candidates(
    steps: Steps, course: Course, separation: Separation, knots: Closest, far: float
) -> tuple[IntArray, IntArray]:
    """Pairs, shape (M, 2), and steps, shape (M,), in which a distance known may be undercut.

    In the first half of a step a vehicle makes at most half the way of its greatest speed, and so
    in the second: two that are further apart in the middle do not get close in it.

    Args:
        steps: of all vehicles, vehicle by vehicle, in a space where the separation is a sphere.
        course: what is judged.
        separation: how distances are measured.
        knots: the distances known.
        far: pairs further apart, errors not counted, are no candidates, but for the closest at a
            knot [m].
    """
    from scipy.spatial import cKDTree  # see above

    vehicles, count = len(knots.distances), len(course.durations)
    middles = (steps.p + steps.v / 2 + steps.a / 8).reshape(vehicles, count, 3)
    reach = steps.speeds.reshape(vehicles, count) / 2
    errors = 2.0 * course.errors_over
    undercut, scale = knots.less_errors, float(separation.shape.scales.max())
    found = [np.empty((0, 2), dtype=int)]
    for k in range(count):
        within = np.minimum(undercut, far)
        if course.tubes is not None:  # a distance in the space of the sphere that is no smaller
            beyond = np.minimum(undercut, far) + errors[k] - separation.distance
            within = separation.distance + scale * np.maximum(beyond, 0.0)
        points, radius = middles[:, k], within.max() + 2.0 * reach[:, k].max()
        pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
        one, other = pairs.T
        apart = np.linalg.norm(points[one] - points[other], axis=1)
        known = np.maximum(within[one], within[other])
        found.append(pairs[apart - reach[one, k] - reach[other, k] < known])
    during = np.repeat(np.arange(-1, count), [len(pairs) for pairs in found])
    alone = np.flatnonzero(undercut > far)
    couples = np.column_stack([alone, knots.partners[alone]]).repeat(count, axis=0)
    every_step = np.tile(np.arange(count), len(alone))
    return np.concatenate([*found, couples]), np.append(during, every_step)
