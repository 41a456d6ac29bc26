"""Obstacles (8) of every shape, at rest or moving, verified at the knots and at every instant.

A vehicle's clearance is the signed distance of its position from the shape at that time, less the
error radius and less the obstacle's uncertainty, which is linear in time between two instants.
Relative to an obstacle, a vehicle's motion is quadratic in time between two instants; where the
obstacle's track has a corner between them, the interval is cut there.

A map is verified by its parts: each step of a motion is compared with each nearby cell or triangle.
The distance from one of these is convex, as for a shape, so the same branch and bound finds its
minimum. The planners' convex cover of the map is not used here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.parts import Boxes, Parts, Triangles, nearest_on_triangles
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.times import Clock
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.continuous_time import Least, least_over_time
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory

_ROUNDING = 1e-9
"""Relative rounding error of a distance, so that the nearest part counts as near."""


@dataclasses.dataclass(frozen=True)
class Encounters:
    """Pairs of a step of a motion and a nearby cell or triangle of a map."""

    pieces: IntArray
    """index of the step among all given steps, shape (M,)"""
    steps: Steps
    """steps relative to the cells, or stacked with the constant corners of triangles, (M, D)"""
    parts: Parts
    """the cells or triangles"""

    def distance(self, x: FloatArray) -> FloatArray:
        """Return distances of the steps' positions (..., D) from their cells or triangles."""
        if isinstance(self.parts, Boxes):
            return distance_from_box(x[..., :3], x[..., 3:])
        flat = x.reshape(-1, 12)
        nearest = nearest_on_triangles(flat[:, 3:].reshape(-1, 3, 3), flat[:, :3])
        return np.asarray(np.linalg.norm(flat[:, :3] - nearest, axis=1).reshape(x.shape[:-1]))


def distance_from_box(x: FloatArray, extent: FloatArray) -> FloatArray:
    """Return signed distances from a box around the origin [m].

    They are lower bounds of the signed distances from any set inside the box.

    Args:
        x: positions [m], shape (..., 3).
        extent: half the sides of the box [m], shape (3,), or of a box for each position, of the
            shape of x; may be infinite.
    """
    beyond = np.abs(x) - extent
    outside = np.sqrt((np.maximum(beyond, 0.0) ** 2).sum(axis=-1))
    distance: FloatArray = outside + np.minimum(beyond.max(axis=-1), 0.0)
    return distance


def encounters(solid: Map, steps: Steps, within: FloatArray) -> Encounters:
    """Return the cells or triangles near each step.

    Args:
        solid: the map.
        steps: M motions relative to its centre.
        within: distance that counts as near, for each step [m], shape (M,); if infinite, the
            nearest part at the beginning of a step and all that may be nearer during it.
    """
    parts = solid.parts
    p, v, a, higher = (parts.in_frame(each) for each in (steps.p, steps.v, steps.a, steps.higher))
    ends = p + v + a / 2.0 + higher.sum(axis=1)
    bulge = steps.acceleration_norms / 8.0  # greatest distance of a curve from its chord
    finite = np.isfinite(p).all(axis=1) & np.isfinite(ends).all(axis=1)
    radii = np.maximum(within, 0.0) + bulge
    endless = np.flatnonzero(np.isinf(radii) & finite)
    if len(endless) > 0:
        nearest = np.abs(solid.parts.local_distance(steps.p[endless]))
        radii[endless] = nearest * (1.0 + _ROUNDING) + bulge[endless]
    finite &= np.isfinite(radii)
    some = np.flatnonzero(finite)
    lower, upper = np.minimum(p, ends)[some], np.maximum(p, ends)[some]
    which, numbers = parts.tree.pairs(lower, upper, radii[some])
    which = some[which]
    if not finite.all():  # NaN is compared with one part, so that the result is NaN too
        lost = np.flatnonzero(~finite)
        which = np.concatenate([which, lost])
        numbers = np.concatenate([numbers, np.zeros(len(lost), dtype=np.int64)])
    p, v, a = p[which], v[which], a[which]
    if isinstance(parts, Boxes):
        fixed, p = parts.halves[numbers], p - parts.centers[numbers]
    else:
        assert isinstance(parts, Triangles)  # noqa: S101  # there are no other parts
        fixed = parts.corners[numbers].reshape(-1, 9)
    still = np.zeros_like(fixed)
    beside = (np.hstack([p, fixed]), np.hstack([v, still]), np.hstack([a, still]))
    more = np.zeros((len(fixed), higher.shape[1], fixed.shape[1]))
    higher = np.concatenate([higher[which], more], axis=2)
    return Encounters(which, Steps(*beside, higher), parts)


def check_obstacle(trajectory: PiecewiseTrajectory, number: int) -> Iterator[Column]:
    """Verify distances from one obstacle: once it is known and, in separate checks, before.

    Args:
        trajectory: the trajectory to verify.
        number: number of the obstacle, from 1.
    """
    scenario = trajectory.scenario
    obstacle, name = scenario.bodies_in_flight[number - 1], scenario.obstacle_name(number)
    late = number not in {number for number, _ in scenario.known}
    since = obstacle.known_from if late else 0.0
    seen = relative_to(trajectory, obstacle, since)
    for known in (True, False) if late else (True,):
        both = seen.closest(obstacle.shape, since, known=known)
        for part, found in zip((AT_KNOTS, AT_ALL_TIMES), both, strict=True):
            asked = known and (part == AT_KNOTS or scenario.between_knots)
            column = obstacle_column(scenario, number, part, found, asked=asked)
            if not known:
                column = dataclasses.replace(column, constraint=f"{name} before it is known")
            counted = known and part == (AT_ALL_TIMES if scenario.between_knots else AT_KNOTS)
            yield column.softened(obstacle.prices(scenario.fleet.weights), counted=counted)


def obstacle_column(
    scenario: Scenario, number: int, part: str, found: Nearest, *, asked: bool = True
) -> Column:
    """Return the check of each vehicle's least clearance from an obstacle.

    Args:
        scenario: scenario of the motion.
        number: number of the obstacle, from 1.
        part: instants at which it is verified.
        found: least clearances.
        asked: whether the scenario requires it.
    """
    obstacle, fleet = scenario.bodies[number - 1], scenario.fleet
    required = fleet.radii + obstacle.deviation
    limits = np.where(found.errors > 0.0, required + found.errors, required)
    return Column(
        kind="obstacles",
        constraint=scenario.obstacle_name(number),
        parts=[part] * len(limits),
        times=scenario.grid.start + found.times,
        values=found.clearances,
        limits=limits,
        excess=limits - found.clearances,
        tolerances=fleet.obstacle_tolerances(obstacle.shape),
        errors=found.errors,
        unit="m",
        asked=asked,
        concerned=~np.isposinf(found.clearances),  # else it is never avoided in this flight
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Nearest:
    """Least clearance of each vehicle from an obstacle, with errors; arrays of shape (N,)."""

    times: FloatArray
    """time of the least clearance since the first knot [s]"""
    clearances: FloatArray
    """signed distance at that time, without the error radius [m]"""
    errors: FloatArray
    """error radius at that time [m]"""


@dataclasses.dataclass(frozen=True)
class RelativeMotion:
    """Motions relative to an obstacle, in pieces of constant obstacle velocity."""

    trajectory: PiecewiseTrajectory
    """trajectory with pieces cut at the corners of the obstacle's track"""
    obstacle: Obstacle
    """obstacle on a clock that is 0 at the first knot"""
    clock: Clock
    """clock that compares knots with the times at which it is known or avoided"""
    positions: FloatArray
    """positions of the vehicles relative to the obstacle's centre [m], shape (N, J + 1, 3)"""
    pieces: Steps
    """relative motions in the pieces, vehicle by vehicle, J of each"""
    uncertainty: FloatArray
    """uncertainty of the obstacle's position at the instants [m], shape (J + 1,)"""

    def lowest_at_least(self, shape: Solid, enough: FloatArray) -> FloatArray:
        """Return lower bounds of distances from the uncertain shape in each piece [m], (N, J).

        Args:
            shape: shape of the obstacle.
            enough: sufficient distances [m], of the answer's shape. Where the distance from the
                bounding box attains them, no closer bound is computed.
        """
        outside = distance_from_box(self.positions, shape.extent)
        lowest = self._between(outside, outside[:, 1:])
        near = np.flatnonzero(~(lowest >= enough).all(axis=1))
        if len(near) > 0 and not isinstance(shape, Map):  # encounters are compared with its parts
            outside[near] = shape.local_distance(self.positions[near])
            lowest = self._between(outside, outside[:, 1:])
        return lowest

    @property
    def active_pieces(self) -> BoolArray:
        """Whether the obstacle is avoided in each piece, shape (J,)."""
        elapsed = self.trajectory.elapsed
        return self.obstacle.is_active((elapsed[:-1] + elapsed[1:]) / 2.0)

    def _at_ends(self, outside: FloatArray, extent: FloatArray) -> FloatArray:
        """Return distances from a bounding box at the ends of pieces [m], (N, J).

        Args:
            outside: distances at the instants [m], shape (N, J + 1).
            extent: half the sides of the box [m], shape (3,).
        """
        k = self.trajectory.last_before_jumps
        if len(k) == 0:
            return outside[:, 1:]
        ends = np.array(outside[:, 1:])
        jumped = self.trajectory.positions[:, k + 1] - self.trajectory.ends[0][:, k]
        ends[:, k] = distance_from_box(self.positions[:, k + 1] - jumped, extent)
        return ends

    def _between(self, distances: FloatArray, ends: FloatArray) -> FloatArray:
        """Return lower bounds in pieces from distances at instants and ends [m], shape (N, J).

        In a piece a distance changes no faster than at the greatest speed. The given distances are
        from the obstacle's nominal position, the bounds from every possible position.
        """
        lengths = self.pieces.speeds.reshape(len(distances), -1)
        lowest: FloatArray = (distances[:, :-1] + ends - lengths) / 2.0
        return lowest - self.grown

    @property
    def grown(self) -> FloatArray:
        """Largest uncertainty in each piece [m], shape (J,)."""
        return self.uncertainty[1:]

    def closest(self, shape: Solid, since: float, *, known: bool) -> tuple[Nearest, Nearest]:
        """Return the least clearances from the shape: at the knots, and at all times.

        Exact distances are skipped at instants that the bounding box shows not to be closest.

        Args:
            shape: shape of the obstacle.
            since: time at which the obstacle becomes known, since the first knot [s].
            known: whether to consider the time from `since` on, or the time before.
        """
        trajectory, instants = self.trajectory, self.trajectory.elapsed
        outside = distance_from_box(self.positions, shape.extent)
        later = ~self.clock.before(instants, since)
        active = self.obstacle.is_active(instants, self.clock)
        knots = trajectory.knots & (later if known else ~later) & active
        count = len(self.positions)
        times, values, off = np.zeros(count), np.full(count, np.inf), np.zeros(count)
        if knots.any():
            x, errors = self.positions[:, knots], trajectory.errors(knots)
            beyond = errors + self.uncertainty[knots]
            k, values = least_at(shape, x, outside[:, knots] - beyond, beyond)
            times, off = instants[knots][k], errors[k]
        at_knots = Nearest(times, values + off, off)

        # a smooth motion begins before the first knot, from which obstacles are known
        since = since if since > 0.0 else instants[0]
        during = (instants[:-1] >= since) == known
        during &= self.active_pieces
        lowest = self._between(outside, self._at_ends(outside, shape.extent))
        lowest -= trajectory.errors_over
        owners, piece = np.nonzero(~(lowest >= values[:, None]) & during)  # true for NaN as well
        near = self.pieces.select(owners * len(during) + piece)
        distance = shape.local_distance
        if isinstance(shape, Map):
            within = values[owners] + trajectory.errors_over[piece] + self.grown[piece]
            met = encounters(shape, near, within)
            owners, piece, near, distance = (
                owners[met.pieces],
                piece[met.pieces],
                met.steps,
                met.distance,
            )
        error_radii = subtracted = trajectory.error_radii(piece)
        if self.obstacle.is_uncertain:
            subtracted = error_radii.plus_linear(self.uncertainty[piece], self.grown[piece])
        least = least_over_time(
            near,
            owners[:, None],
            distance,
            PRECISION * trajectory.scenario.fleet.obstacle_tolerances(shape)[owners],
            Least.unknown(values),
            subtracted,
        )
        found = (least.steps >= 0).nonzero()[0]
        always, off, at = np.array(times), np.array(off), least.steps[found]
        always[found] = trajectory.moments(piece[at], least.moments[found])
        off[found] = error_radii.radii(at, least.moments[found, None])[:, 0]
        return at_knots, Nearest(always, least.values + off, off)


def relative_to(
    trajectory: PiecewiseTrajectory, obstacle: Obstacle, since: float = 0.0
) -> RelativeMotion:
    """Return the motions of all vehicles relative to an obstacle.

    Args:
        trajectory: the trajectory to verify.
        obstacle: obstacle on a clock that is 0 at the first knot.
        since: additional time at which pieces are cut [s].
    """
    clock = trajectory.scenario.grid.clock
    trajectory = trajectory.cut(np.append(obstacle.corners, since))
    centers = obstacle.centers(trajectory.elapsed)
    positions = trajectory.positions - centers
    width = trajectory.durations[:, None]
    velocities = width * trajectory.velocities[:, :-1] - np.diff(centers, axis=0)
    pieces = (positions[:, :-1], velocities, width**2 * trajectory.accelerations)
    p, v, a = (each.reshape(-1, 3) for each in pieces)
    steps = Steps(p, v, a, trajectory.steps.higher)
    errors = obstacle.uncertainty(trajectory.elapsed)
    return RelativeMotion(trajectory, obstacle, clock, positions, steps, errors)


def least_at(
    shape: Solid, x: FloatArray, at_least: FloatArray, errors: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return the index of each vehicle's closest position to a shape, and its distance there.

    Args:
        shape: shape of the obstacle.
        x: positions relative to its centre [m], shape (N, M, 3).
        at_least: lower bounds of the distances less the error radii [m], shape (N, M).
        errors: error radii, which are subtracted from distances [m], shape (M,).

    Returns:
        Indices, and signed distances less the error radii [m], each of shape (N,).
    """
    vehicles, likely = np.arange(len(x)), np.argmin(at_least, axis=1)
    distances = np.full(at_least.shape, np.inf)
    near = shape.local_distance(x[vehicles, likely]) - errors[likely]
    distances[vehicles, likely] = near
    perhaps = ~(at_least >= near[:, None])  # true for NaN as well
    distances[perhaps] = shape.local_distance(x[perhaps]) - errors[np.nonzero(perhaps)[1]]
    k = np.argmin(distances, axis=1)
    return k, distances[vehicles, k]
