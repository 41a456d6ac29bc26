"""Sides of obstacles and of other vehicles on which a vehicle is at an instant: `Sides`.

A position outside a convex set is in some cone of directions from a point inside, and beyond the
plane through the points at which the cone's edges meet the surface (`outside.py`). So every motion
is in one of the branches of a cover by cones, whose half-spaces are convex constraints. The
position relative to another vehicle is treated like one relative to an obstacle.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from drake_rho.analysis.outside import Forbidden, forbidden_by, halves_of
from drake_rho.analysis.terms import CurvedTerms
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.close_pairs import separation_of
from drake_rho.planning.constraints.rows import Form
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.shapes.unbounded import HalfSpace

_DEEP = 1e-4
"""Penetration that is ignored, as a part of the size of what is penetrated."""

_NARROWEST = 1e-3
"""Angle between the edges of a cone below which it is not split [rad]."""


class Where(NamedTuple):
    """Vehicle, obstacle or other vehicle, and instant of a side."""

    vehicle: int
    """index of the vehicle"""
    partner: int
    """index of the other vehicle, or the vehicle's own for an obstacle"""
    obstacle: int
    """number of the obstacle, from 1; 0 for another vehicle"""
    part: int
    """number of the part of a map; 0 for a shape"""
    instant: int
    """number of the instant"""


Branch = Mapping[Where, FloatArray]
"""Cones that motions of a branch are in, each as the directions of its edges, shape (3, 3)."""


class Sides:
    """Covers of a scenario's motions by cones.

    Args:
        scenario: scenario to be covered.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._hard = {n: each for n, each in scenario.avoided if each.penalty is None}
        steps = (scenario.grid.knots - 1) * (2 if scenario.between_knots else 1)
        self.times = scenario.grid.duration * np.arange(1, steps) / steps

    def parts_of(
        self, branch: Branch, curved: CurvedTerms, losses: FloatArray, motion: Motion
    ) -> tuple[Where, list[FloatArray]] | None:
        """Return where a branch is split, and the cones of its parts; None if nothing is left.

        Args:
            branch: to be split.
            curved: terms of its Lagrangian.
            losses: size of each term at the Lagrangian's minimum, which would be zero if the bound
                were the least cost, shape (S,).
            motion: motion at the Lagrangian's minimum.
        """
        if len(self.times) == 0:  # start and goal alone
            return None
        for index in np.argsort(-losses, kind="stable").tolist():
            if losses[index] <= 0.0:
                break
            where = self._where(curved, index)
            if cones := self._cones(branch, where):
                return where, cones
        deepest = self._deepest(motion)
        if deepest is None or not (cones := self._cones(branch, deepest)):
            return None
        return deepest, cones

    def _where(self, curved: CurvedTerms, index: int) -> Where:
        """Return where a term's constraint is, at the nearest instant."""
        one, other = int(curved.vehicles[index]), int(curved.partners[index])
        instant = int(np.argmin(np.abs(self.times - curved.times[index])))
        number, part = int(curved.obstacles[index]), int(curved.sides[index])
        return Where(min(one, other), max(one, other), number, part if number > 0 else 0, instant)

    def _cones(self, branch: Branch, where: Where) -> list[FloatArray]:
        """Return the cones into which a branch is split at an instant; none if nowhere."""
        time = self.times[where.instant : where.instant + 1]
        if where.obstacle > 0:
            obstacle = self._hard.get(where.obstacle)
            if obstacle is None or not _is_there(obstacle, time)[0]:
                return []
        if (cone := branch.get(where)) is not None:
            unit = cone / np.linalg.norm(cone, axis=1, keepdims=True)
            widest = np.min(np.vecdot(unit, np.roll(unit, -1, axis=0)))
            return halves_of(cone) if widest < np.cos(_NARROWEST) else []
        forbidden = self._forbidden(where)
        return forbidden.cones if forbidden.has_middle else []

    def rows(self, where: Where, cone: FloatArray) -> HalfSpaces:
        """Return the half-spaces that contain all positions in a cone, outside of the set."""
        normals, bounds = self._half_spaces(where, cone)
        count = len(normals)
        form = Form(quantity="position", coupled=where.obstacle == 0)
        return HalfSpaces(
            form,
            np.full(count, where.vehicle),
            np.full(count, where.partner),
            np.zeros(count, dtype=int),
            np.full(count, self.times[where.instant]),
            normals,
            bounds,
            np.ones(count),
        )

    def place(self, where: Where) -> tuple[float, FloatArray]:
        """Return the time of an instant since the first knot [s], and the scales of cones, (3,)."""
        return float(self.times[where.instant]), self._forbidden(where).scales

    def _half_spaces(self, where: Where, cone: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return half-spaces n · p >= b, with normals of shape (4, 3) and bounds [m], (4,)."""
        forbidden = self._forbidden(where)
        normals, bounds = forbidden.half_spaces(cone)
        middle = forbidden.middle
        if where.obstacle > 0:
            time = self.times[where.instant : where.instant + 1]
            middle = middle + self._hard[where.obstacle].centers(time)[0]
        return normals, bounds + normals @ middle

    def requirements(self, branch: Branch) -> tuple[KeepIn, ...]:
        """Return the half-spaces of a branch as requirements."""
        names, found = self.scenario.names, list[KeepIn]()
        for where, cone in branch.items():
            clock = float(self.scenario.grid.start + self.times[where.instant])
            normals, bounds = self._half_spaces(where, cone)
            found += [
                KeepIn(
                    HalfSpace(-normal, -bound),
                    vehicles=names[where.vehicle],
                    relative_to=None if where.obstacle > 0 else names[where.partner],
                    active=(clock, clock),
                )
                for normal, bound in zip(normals, bounds.tolist(), strict=True)
            ]
        return tuple(found)

    def _forbidden(self, where: Where) -> Forbidden:
        """Return the convex set that the position is outside of."""
        if where.obstacle == 0:
            shape = separation_of(self.scenario).shape
            return Forbidden(shape.local_distance, 0.0, np.zeros(3), shape.extent)
        obstacle = self._hard[where.obstacle]
        required = self._required(obstacle, self.times[where.instant : where.instant + 1])
        return forbidden_by(obstacle.shape, where.part, float(required[where.vehicle, 0]))

    def _required(self, obstacle: Obstacle, times: FloatArray) -> FloatArray:
        """Return the distances required from an obstacle by all plans [m], shape (N, T)."""
        radii = self.scenario.fleet.radii[:, None]
        return np.asarray(radii + obstacle.deviation + obstacle.uncertainty(times))

    def _deepest(self, motion: Motion) -> Where | None:
        """Return where a motion penetrates deepest; None if it penetrates nothing."""
        times, found, deepest = self.times, None, 0.0
        at = motion.at("position", times)
        for number, obstacle in self._hard.items():
            x, shape = at - obstacle.centers(times), obstacle.shape
            depths = self._required(obstacle, times) - shape.local_distance(x)
            depths[:, ~_is_there(obstacle, times)] = 0.0
            i, k = (int(each) for each in np.unravel_index(np.argmax(depths), depths.shape))
            if depths[i, k] > max(deepest, _DEEP * shape.size):
                part = int(shape.nearest(x[i, k])) if isinstance(shape, Parts) else 0
                found, deepest = Where(i, i, number, part, k), float(depths[i, k])
        if self.scenario.separation is not None and len(at) > 1:
            shape = separation_of(self.scenario).shape
            one, other = np.triu_indices(len(at), 1)
            depths = -shape.local_distance(at[one] - at[other])
            pair, k = (int(each) for each in np.unravel_index(np.argmax(depths), depths.shape))
            if depths[pair, k] > max(deepest, _DEEP * shape.size):
                found = Where(int(one[pair]), int(other[pair]), 0, 0, k)
        return found


def _is_there(obstacle: Obstacle, times: FloatArray) -> BoolArray:
    """Return whether an obstacle is active at times, shape (T,)."""
    return np.broadcast_to(obstacle.is_active(times), times.shape)
