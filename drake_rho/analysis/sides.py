"""Sides of obstacles and of other vehicles on which a vehicle is at an instant: `Sides`.

A position outside a convex set is in some region of a cover, whose half-spaces are convex
constraints (`outside.py`). So every motion is in one of the branches of that cover. The position
relative to another vehicle is treated like one relative to an obstacle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_rho.analysis.outside import Forbidden, Region, forbidden_by
from drake_rho.analysis.terms import CurvedTerms
from drake_rho.motion.dynamics import Motion
from drake_rho.planning.constraints.base import HalfSpaces
from drake_rho.planning.constraints.close_pairs import separation_of
from drake_rho.planning.constraints.rows import Form
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.maps.parts import Parts
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.shapes.base import Solid
from drake_rho.scenario.shapes.unbounded import HalfSpace

_DEEP = 1e-4
"""Penetration that is ignored, as a part of the size of what is penetrated."""

_UNPRICED = 1e-3
"""Part of all multipliers that an instant counts as having in addition."""

_PER_STEP, _FINE = 8, 0.5
"""Instants of a step at which motions are divided by sides, and what a depth counts, as a part of
it, for every halving after the first by which an instant is between knots."""


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


class Multipliers(NamedTuple):
    """Multipliers of obstacles, separations and sides in a Lagrangian, of rows of length one."""

    vehicles: IntArray
    """index of the vehicle, shape (N,)"""
    partners: IntArray
    """index of the other vehicle, or of the same one, shape (N,)"""
    obstacles: IntArray
    """number of the obstacle, 0 for a separation; -1 for sides of any, shape (N,)"""
    times: FloatArray
    """time since the first knot [s], shape (N,)"""
    sizes: FloatArray
    """the multipliers, as parts of their sum, shape (N,)"""

    def near(self, number: int, one: int, other: int, times: FloatArray, step: float) -> FloatArray:
        """Return sums of the multipliers near each time, weighted by closeness, shape (T,)."""
        of_pair = ((self.vehicles == one) & (self.partners == other)) | (
            (self.vehicles == other) & (self.partners == one)
        )
        of = of_pair & ((self.obstacles == number) | (self.obstacles < 0))
        distances = np.abs(times[:, None] - self.times[of]) / step
        return np.asarray(np.maximum(0.0, 1.0 - distances) @ self.sizes[of])


Branch = Mapping[Where, Region]
"""Regions that motions of a branch are in."""


class Sides:
    """Covers of a scenario's motions by regions.

    Args:
        scenario: scenario to be covered.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self._hard = {n: each for n, each in scenario.avoided if each.penalty is None}
        per_step = _PER_STEP if scenario.between_knots else 1
        steps = (scenario.grid.knots - 1) * per_step
        self.times = scenario.grid.duration * np.arange(1, steps) / steps
        numbers = np.arange(1, steps)
        self._worths = np.ones(len(numbers))
        for parts in (2, 4):
            self._worths[numbers * parts % per_step != 0] *= _FINE

    def parts_of(
        self,
        branch: Branch,
        motion: Motion,
        multipliers: Multipliers,
        curved: CurvedTerms,
        losses: FloatArray,
    ) -> tuple[Where, Sequence[Region]] | None:
        """Return where a branch is split, and the regions of its parts; None if nothing is left.

        It is split where the relaxed motion penetrates deepest for what that counts, or else at the
        term that lowers the bound most.

        Args:
            branch: to be split.
            motion: motion that solves the relaxed problem.
            multipliers: multipliers of the Lagrangian.
            curved: curved terms of the Lagrangian.
            losses: size of each of these terms at the motion, which would be zero if the bound were
                the least cost, shape (S,).
        """
        if len(self.times) == 0:  # start and goal alone
            return None
        places = [self._deepest(branch, motion, multipliers)]
        if places[0] is None:
            order = np.argsort(-losses, kind="stable")
            places = [self._where(curved, int(each)) for each in order if losses[each] > 0.0]
        for where in places:
            if where is not None and (regions := self._regions(branch, where)):
                return where, regions
        return None

    def _where(self, curved: CurvedTerms, index: int) -> Where | None:
        """Return where a term's constraint is, at the nearest instant; None of soft limits."""
        one, other = int(curved.vehicles[index]), int(curved.partners[index])
        instant = int(np.argmin(np.abs(self.times - curved.times[index])))
        number, part = int(curved.obstacles[index]), int(curved.sides[index])
        if number == 0:
            return Where(min(one, other), max(one, other), 0, 0, instant)
        obstacle = self._hard.get(number)
        if obstacle is None or not _is_there(obstacle, self.times)[instant]:
            return None
        return Where(one, other, number, part, instant)

    def _regions(self, branch: Branch, where: Where) -> Sequence[Region]:
        """Return the regions into which a branch is split at an instant; none if nowhere."""
        forbidden, region = self._forbidden(where), branch.get(where)
        if region is None:
            return forbidden.regions if forbidden.has_middle else ()
        refined = forbidden.bulge(region) > _DEEP * float(forbidden.scales.max())
        return region.halves() if refined else ()

    def rows(self, where: Where, regions: Sequence[Region]) -> list[HalfSpaces]:
        """Return the half-spaces that contain all positions in each region, outside of the set."""
        form = Form(quantity="position", coupled=where.obstacle == 0)
        found = list[HalfSpaces]()
        for normals, bounds in self._half_spaces(where, regions):
            count = len(normals)
            found.append(
                HalfSpaces(
                    form,
                    np.full(count, where.vehicle),
                    np.full(count, where.partner),
                    np.zeros(count, dtype=int),
                    np.full(count, self.times[where.instant]),
                    normals,
                    bounds,
                    np.ones(count),
                )
            )
        return found

    def place(self, where: Where) -> tuple[float, FloatArray]:
        """Return the time of an instant since the first knot [s], and the scales of cones, (3,)."""
        return float(self.times[where.instant]), self._forbidden(where).scales

    def _half_spaces(
        self, where: Where, regions: Sequence[Region]
    ) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the half-spaces n · p >= b of regions, with normals (H, 3) and bounds (H,)."""
        forbidden = self._forbidden(where)
        middle = forbidden.middle
        if where.obstacle > 0:
            time = self.times[where.instant : where.instant + 1]
            middle = middle + self._hard[where.obstacle].centers(time)[0]
        for normals, bounds in forbidden.half_spaces(regions):
            yield normals, bounds + normals @ middle

    def requirements(self, branch: Branch) -> tuple[KeepIn, ...]:
        """Return the half-spaces of a branch as requirements."""
        names, found = self.scenario.names, list[KeepIn]()
        for where, region in branch.items():
            clock = float(self.scenario.grid.start + self.times[where.instant])
            ((normals, bounds),) = self._half_spaces(where, [region])
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

    def _deepest(self, branch: Branch, motion: Motion, multipliers: Multipliers) -> Where | None:
        """Return where a motion penetrates most; None if it penetrates nothing.

        What counts is the depth times the root of the multipliers nearby: a depth alone may cost
        nothing, and multipliers alone may be where hardly anything is left to split. In a region of
        the branch, a depth is at most what may be between the region's plane and the surface.
        """
        found, most = None, 0.0
        for number, shape, one, other, x in self._relative(motion):
            depths = self._depths(number, shape, x)
            for where, region in branch.items():
                if where.obstacle == number:
                    row = int(np.flatnonzero((one == where.vehicle) & (other == where.partner))[0])
                    at = row, where.instant
                    if where.part == _part_at(shape, x[at]):
                        depths[at] = min(depths[at], self._forbidden(where).bulge(region))
            depths *= self._worths
            for i in np.flatnonzero(depths.max(axis=1) > _DEEP * shape.size):
                who = int(one[i]), int(other[i])
                near = multipliers.near(number, *who, self.times, self.scenario.grid.step)
                scores = np.maximum(depths[i], 0.0) * np.sqrt(near + _UNPRICED)
                scores[depths[i] <= _DEEP * shape.size] = 0.0
                if scores.max() > most:
                    k, most = int(np.argmax(scores)), float(scores.max())
                    found = Where(*who, number, _part_at(shape, x[i, k]), k)
        return found

    def _relative(
        self, motion: Motion
    ) -> Iterator[tuple[int, Solid, IntArray, IntArray, FloatArray]]:
        """Yield obstacles' numbers and shapes, P vehicles, partners, and positions (P, T, 3)."""
        at = motion.at("position", self.times)
        everyone = np.arange(len(at))
        for number, obstacle in self._hard.items():
            yield number, obstacle.shape, everyone, everyone, at - obstacle.centers(self.times)
        if self.scenario.separation is not None and len(at) > 1:
            one, other = np.triu_indices(len(at), 1)
            yield 0, separation_of(self.scenario).shape, one, other, at[one] - at[other]

    def _depths(self, number: int, shape: Solid, x: FloatArray) -> FloatArray:
        """Return how deep relative positions penetrate [m], shape (P, T)."""
        depths: FloatArray = -shape.local_distance(x)
        if number > 0:
            depths += self._required(self._hard[number], self.times)
            depths[:, ~_is_there(self._hard[number], self.times)] = 0.0
        return depths


def _part_at(shape: Solid, x: FloatArray) -> int:
    """Return the number of a map's part nearest to a relative position; 0 for a shape."""
    return int(shape.nearest(x)) if isinstance(shape, Parts) else 0


def _is_there(obstacle: Obstacle, times: FloatArray) -> BoolArray:
    """Return whether an obstacle is active at times, shape (T,)."""
    return np.broadcast_to(obstacle.is_active(times), times.shape)
