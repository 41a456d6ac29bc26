"""Obstacles (8) of every shape, at rest or moving, judged at the knots and at every instant.

A vehicle's clearance is the signed distance of its position from the shape, where that is at the
time. Seen from an obstacle a vehicle's motion is quadratic between two knots, and where a track has
a corner between them, up to it and from it on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Self

import numpy as np

from drake_rho.assurance.continuous_time import Least, least_over_time
from drake_rho.assurance.report import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.assurance.steps import Steps
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes import Shape

_KNOT = 1e-9
"""Part of a step by which a knot may be early and still be the time at which a thing is known."""


def check_obstacles(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """The checks of every obstacle: from when it is known, and apart from these, before."""
    at_once = {number for number, _ in scenario.known}
    for number, obstacle in enumerate(scenario.bodies, start=1):
        name, late = scenario.obstacle_name(number), number not in at_once
        since = obstacle.known_from - scenario.grid.start if late else 0.0
        seen = _Seen.of(scenario.grid, motion, obstacle, since)
        for known in (True, False) if late else (True,):
            closest = seen.closest(obstacle.shape, since, known=known)
            for part, (times, clearances) in zip((AT_KNOTS, AT_ALL_TIMES), closest, strict=True):
                limits = scenario.fleet.radii + obstacle.deviation
                yield Column(
                    constraint=name if known else f"{name} before it is known",
                    parts=[part] * len(clearances),
                    times=scenario.grid.start + times,
                    values=clearances,
                    limits=limits,
                    excess=limits - clearances,
                    tolerances=np.full(len(clearances), obstacle.shape.tolerance),
                    unit="m",
                    asked=known and (part == AT_KNOTS or scenario.between_knots),
                )


@dataclasses.dataclass(frozen=True)
class _Seen:
    """Motions as an obstacle sees them: less its own, in pieces of time in which it is constant."""

    instants: FloatArray
    """at which pieces begin and end, knots among them; since the first knot [s], shape (J + 1,)"""
    knots: BoolArray
    """which of them are knots, shape (J + 1,)"""
    tolerance: float
    """by how much a knot may be early and still count as the time at which it is known [s]"""
    positions: FloatArray
    """of the vehicles then, from the middle of the obstacle [m], shape (N, J + 1, 3)"""
    pieces: Steps
    """vehicle by vehicle, J of each"""

    @classmethod
    def of(cls, grid: Grid, motion: Motion, obstacle: Obstacle, since: float) -> Self:
        """The motions of a scenario's vehicles, with pieces that end or begin at `since` [s]."""
        cuts = np.append(obstacle.corners - grid.start, since)
        cuts = cuts[(cuts > 0.0) & (cuts < grid.duration)]
        instants = np.union1d(grid.elapsed, cuts)
        k = np.searchsorted(grid.elapsed, instants, side="right") - 1
        knots = grid.elapsed[k] == instants
        k = np.minimum(k, grid.knots - 2)  # the last knot ends a step and begins none
        s = (instants - grid.elapsed[k])[:, None]
        p, v, a = motion.positions[:, k], motion.velocities[:, k], motion.accelerations[:, k]
        velocities = v + s * a
        centers = obstacle.centers(grid.start + instants)
        positions = p + s / 2 * (v + velocities) - centers
        width = np.diff(instants)[:, None]
        ways = width * velocities[:, :-1] - np.diff(centers, axis=0)
        pieces = (positions[:, :-1], ways, width**2 * a[:, :-1])
        steps = Steps(*(each.reshape(-1, 3) for each in pieces))
        return cls(instants, knots, _KNOT * grid.step, positions, steps)

    def closest(
        self, shape: Shape, since: float, *, known: bool
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """When each vehicle is closest to the shape, and its clearance: at knots, at all times.

        Nothing is measured exactly where the distance from the bounding box shows that another
        instant is closer.

        Args:
            shape: of the obstacle.
            since: when it is known [s].
            known: whether the time from then on is looked at, or the time before.

        Returns:
            Twice, times since the first knot [s] and signed distances [m], arrays of shape (N,).
        """
        at_least = _outside_of_box(self.positions, shape.extent)
        later = self.instants >= since - self.tolerance
        judged = self.knots & (later if known else ~later)
        k, values = _least_at(shape, self.positions[:, judged], at_least[:, judged])
        times = self.instants[judged][k]

        during = (self.instants[:-1] >= since) == known
        ways = self.pieces.speeds.reshape(len(values), -1)
        lowest = (at_least[:, :-1] + at_least[:, 1:] - ways) / 2.0  # of two slopes that meet
        owners, piece = np.nonzero(~(lowest >= values[:, None]) & during)  # what is no number too
        least = least_over_time(
            self.pieces.select(owners * len(during) + piece),
            owners[:, None],
            shape.signed_distance,
            np.full(len(owners), PRECISION * shape.tolerance),
            Least.unknown(values),
        )
        begins, widths = self.instants[:-1][piece], np.diff(self.instants)[piece]
        always, found = np.array(times), np.flatnonzero(least.steps >= 0)
        at = least.steps[found]
        always[found] = begins[at] + least.moments[found] * widths[at]
        return (times, values), (always, least.values)


def _least_at(shape: Shape, x: FloatArray, at_least: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At which of its positions each vehicle is closest to a shape, and the signed distance there.

    Args:
        shape: what it is close to.
        x: positions from its centre [m], shape (N, M, 3).
        at_least: a lower bound of the distance of each [m], shape (N, M).

    Returns:
        Indices and distances [m], each of shape (N,).
    """
    vehicles, likely = np.arange(len(x)), np.argmin(at_least, axis=1)
    distances = np.full(at_least.shape, np.inf)
    near = distances[vehicles, likely] = shape.signed_distance(x[vehicles, likely])
    perhaps = ~(at_least >= near[:, None])  # what is no number too
    distances[perhaps] = shape.signed_distance(x[perhaps])
    k = np.argmin(distances, axis=1)
    return k, distances[vehicles, k]


def _outside_of_box(x: FloatArray, extent: FloatArray) -> FloatArray:
    """Signed distances from a box around the origin, which those from what is in it exceed [m].

    Args:
        x: positions [m], shape (..., 3).
        extent: half its sides [m], shape (3,); may be infinite.
    """
    beyond = np.abs(x) - extent
    outside = np.sqrt(np.sum(np.maximum(beyond, 0.0) ** 2, axis=-1))
    distance: FloatArray = outside + np.minimum(beyond.max(axis=-1), 0.0)
    return distance
