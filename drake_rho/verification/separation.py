"""Separation of every two vehicles, verified at the knots and at every instant.

The closest other vehicle of each vehicle is found without visiting every pair. Distances are those
of the separation constraint: z is divided by the downwash factor. With position errors they are
measured from the separation's ellipsoid instead, because an error radius is the same in every
direction: a distance is then the separation plus the signed distance from the ellipsoid, and the
closest vehicle is the one with the least distance less both vehicles' error radii. In the scaled
space in which the ellipsoid is a ball, a length grows by `scales.max()` at most.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.parts import Separation
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory

FAR = 4.0
"""Cut-off distance in separations: of pairs further apart, only each vehicle's closest pair at a
knot is followed over time."""

_LARGEST = 1e150
"""Largest coordinate whose square does not overflow [m]."""


@dataclasses.dataclass(frozen=True)
class Closest:
    """Closest approach of any other vehicle to each of N vehicles."""

    partners: IntArray
    """index of the closest other vehicle, shape (N,)"""
    times: FloatArray
    """time of the approach since the first knot [s], shape (N,)"""
    distances: FloatArray
    """distance at that time [m], shape (N,); NaN where positions overflow or are NaN"""
    errors: FloatArray
    """sum of both vehicles' error radii at that time [m], shape (N,)"""

    @property
    def less_errors(self) -> FloatArray:
        """Distances less error radii, the quantity minimised [m], shape (N,)."""
        return np.asarray(self.distances - self.errors)


def closest_at_knots(trajectory: PiecewiseTrajectory, separation: Separation) -> Closest:
    """Return the closest approaches at the knots, for N >= 2 vehicles."""
    from scipy.spatial import cKDTree  # imported here because it takes a tenth of a second to load

    positions = trajectory.positions[:, trajectory.knots]
    points = np.moveaxis(separation.scaled(positions), 1, 0)
    count, errors = points.shape[1], 2.0 * trajectory.errors(trajectory.knots)
    if not np.all(np.abs(points) < _LARGEST):  # also where a coordinate is NaN
        nothing = np.zeros(count)
        return Closest(np.zeros(count, dtype=int), nothing, np.full(count, np.nan), nothing)
    found = [cKDTree(each).query(each, k=2) for each in points]
    distances = np.array([each[0][:, 1] for each in found])
    neighbours = np.array([each[1] for each in found])  # a point's first neighbour is the point
    own = neighbours[..., 0] == np.arange(count)  # itself, or its second if two coincide
    partners = np.where(own, neighbours[..., 1], neighbours[..., 0])
    if trajectory.has_errors and not separation.is_round:
        far = FAR * separation.distance + errors
        partners, distances = _closest_to_ellipsoid(positions, separation, partners, far)
    k, vehicles = np.argmin(distances - errors[:, None], axis=0), np.arange(count)
    times = trajectory.elapsed[trajectory.knots][k]
    return Closest(partners[k, vehicles], times, distances[k, vehicles], errors[k])


def _closest_to_ellipsoid(
    positions: FloatArray, separation: Separation, partners: IntArray, far: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return, at each knot, the vehicle closest to the ellipsoid around each vehicle.

    Args:
        positions: positions at the knots [m], shape (N, K, 3).
        separation: the separation constraint.
        partners: closest vehicles in the scaled space, where the ellipsoid is a ball, shape (K, N).
        far: cut-off: other pairs further apart than this are ignored [m], shape (K,).

    Returns:
        Closest vehicles and their distances [m], each of shape (K, N).
    """
    from scipy.spatial import cKDTree  # slow to load, see above

    scales, own = separation.shape.scales, separation.distance
    partners, closest = np.array(partners), np.empty(partners.shape)
    for k, most in enumerate(far):
        p = positions[:, k]
        closest[k] = ellipsoid_distance(separation, p - p[partners[k]])
        within = np.minimum(closest[k], most).max()
        radius = own + scales.max() * max(within - own, 0.0)
        pairs = cKDTree(separation.scaled(p)).query_pairs(radius, output_type="ndarray")
        beside = np.concatenate([pairs, pairs[:, ::-1]])
        one, other = beside.T
        found = ellipsoid_distance(separation, p[one] - p[other])
        order = np.argsort(-found, kind="stable")  # the closest of several comes last and stays
        order = order[found[order] < closest[k, one[order]]]
        closest[k, one[order]], partners[k, one[order]] = found[order], other[order]
    return partners, closest


def ellipsoid_distance(separation: Separation, x: FloatArray) -> FloatArray:
    """Return the separation plus the signed distance of relative positions x from its ellipsoid.

    Distances are in metres; x has shape (..., 3).
    """
    distances: FloatArray = separation.distance + separation.shape.local_distance(x)
    return distances


def closest_at_all_times(
    trajectory: PiecewiseTrajectory,
    separation: Separation,
    knots: Closest,
    precision: float,
    far: float = FAR,
) -> Closest:
    """Return the closest approaches over all times.

    A distance within the cut-off `far` is the least over all other vehicles. A distance beyond it
    is an upper bound: the least distance over time from the vehicle that is closest at a knot.

    Args:
        trajectory: trajectory of N >= 2 vehicles.
        separation: the separation constraint, which defines distances.
        knots: closest approaches at the knots.
        precision: amount by which a smaller distance may be missed [m].
        far: cut-off distance, in separations.
    """
    if not np.all(np.isfinite(knots.distances)):
        return knots
    count = len(trajectory.durations)
    states = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
    p, v, a, higher = (separation.scaled(each) for each in (*states, trajectory.higher))
    scaled = trajectory.steps_of(p, v, a, higher)
    pairs, k = _candidates(scaled, trajectory, separation, knots, far * separation.distance)
    one, other = (count * vehicle + k for vehicle in pairs.T)
    exactly = trajectory.has_errors and not separation.is_round
    steps = trajectory.steps if exactly else scaled
    relative = steps.select(one).less(steps.select(other))
    error_radii = trajectory.error_radii(k, vehicles=2.0)
    least = least_over_time(
        relative,
        pairs,
        lambda x: ellipsoid_distance(separation, x) if exactly else np.linalg.norm(x, axis=-1),
        np.full(len(k), precision),
        Least.unknown(knots.less_errors),
        error_radii,
    )
    found = np.flatnonzero(least.steps >= 0)  # the others are closest at a knot
    at, moments = least.steps[found], least.moments[found]
    partners, times = np.array(knots.partners), np.array(knots.times)
    errors = np.array(knots.errors)
    partners[found] = pairs[at].sum(axis=1) - found
    times[found] = trajectory.moments(k[at], moments)
    errors[found] = error_radii.radii(at, moments[:, None])[:, 0]
    return Closest(partners, times, least.values + errors, errors)


def _candidates(
    steps: Steps,
    trajectory: PiecewiseTrajectory,
    separation: Separation,
    knots: Closest,
    far: float,
) -> tuple[IntArray, IntArray]:
    """Return pairs (M, 2) and steps (M,) that may come closer than the least known distance.

    In either half of a step a vehicle moves at most half a step at its greatest speed. So two
    vehicles that are far enough apart in the middle of a step do not get close within it.

    Args:
        steps: steps of all vehicles, vehicle by vehicle, in the scaled space where the separation
            is a sphere.
        trajectory: the trajectory to verify.
        separation: the separation constraint, which defines distances.
        knots: closest approaches at the knots, the least distances known.
        far: pairs further apart than this, errors not counted, are no candidates, except each
            vehicle's closest at a knot [m].
    """
    from scipy.spatial import cKDTree  # slow to load, see above

    vehicles, count = len(knots.distances), len(trajectory.durations)
    every = np.arange(len(steps.p))
    middles = steps.at(every, np.full((len(every), 1), 0.5)).reshape(vehicles, count, 3)
    travel = steps.speeds.reshape(vehicles, count) / 2
    errors = 2.0 * trajectory.errors_over
    undercut, scale = knots.less_errors, float(separation.shape.scales.max())
    found = [np.empty((0, 2), dtype=int)]
    for k in range(count):
        within = np.minimum(undercut, far)
        if trajectory.has_errors:  # an upper bound of the distance in the scaled space
            beyond = np.minimum(undercut, far) + errors[k] - separation.distance
            within = separation.distance + scale * np.maximum(beyond, 0.0)
        points, radius = middles[:, k], within.max() + 2.0 * travel[:, k].max()
        pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
        one, other = pairs.T
        apart = np.linalg.norm(points[one] - points[other], axis=1)
        known = np.maximum(within[one], within[other])
        found.append(pairs[apart - travel[one, k] - travel[other, k] < known])
    during = np.repeat(np.arange(-1, count), [len(pairs) for pairs in found])
    distant = np.flatnonzero(undercut > far)
    couples = np.column_stack([distant, knots.partners[distant]]).repeat(count, axis=0)
    every_step = np.tile(np.arange(count), len(distant))
    return np.concatenate([*found, couples]), np.append(during, every_step)


def check_separation(trajectory: PiecewiseTrajectory, far: float = FAR) -> Iterator[Column]:
    """Verify each vehicle's distance from its closest other vehicle, at knots and all times.

    The distance is that of the separation constraint: z is divided by the downwash factor. With
    position errors it is the separation plus the signed distance of the other vehicle from the
    separation's ellipsoid, because an error radius is the same in every direction.

    Args:
        trajectory: the trajectory to verify.
        far: cut-off distance in separations, as in `closest_at_all_times`.
    """
    scenario = trajectory.scenario
    separation = scenario.separation
    if separation is None or len(scenario.vehicles) < 2:
        return
    knots = closest_at_knots(trajectory, separation)
    precision = PRECISION * separation.tolerance
    always = closest_at_all_times(trajectory, separation, knots, precision, far)
    for part, found in ((AT_KNOTS, knots), (AT_ALL_TIMES, always)):
        asked = part == AT_KNOTS or scenario.between_knots
        yield separation_column(scenario, separation, part, found, asked=asked)


def separation_column(
    scenario: Scenario, separation: Separation, part: str, found: Closest, *, asked: bool = True
) -> Column:
    """Return the check of each vehicle's distance from its closest other vehicle.

    Args:
        scenario: scenario of the motion.
        separation: its separation constraint.
        part: instants at which it is verified.
        found: closest approaches, of infinite distances for vehicles without any.
        asked: whether the scenario requires it.
    """
    names = [scenario.vehicles[partner].name for partner in found.partners]
    limits = separation.distance + found.errors
    return Column(
        kind="separation",
        constraint="separation",
        parts=[f"from {name} {part}" for name in names],
        times=scenario.grid.start + found.times,
        values=found.distances,
        limits=limits,
        excess=limits - found.distances,
        tolerances=np.full(len(names), separation.tolerance),
        errors=found.errors,
        unit="m",
        concerned=~np.isposinf(found.distances),
        asked=asked,
        partners=found.partners,
    )
