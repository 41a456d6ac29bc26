"""The vehicles of a scenario as arrays, one row each, for arithmetic on all of them at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.norms import NORMS, Norm, NormLimit
from drake_rho.scenario.parts import Grid, Limits, Quantity, Vehicle
from drake_rho.scenario.shapes.base import TOLERANCE, Shape
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.waypoints import Waypoints, waypoints_of

if TYPE_CHECKING:
    from drake_rho.scenario.obstacles import Obstacle

_ROUNDINGS = 8.0
"""Roundings of a coordinate at each knot that a tolerance has room for: twice as many as sums of
two terms a knot can add up to."""


@dataclasses.dataclass(frozen=True)
class Bounds:
    """A box for every vehicle; where a vehicle has none, its bounds are infinite."""

    lower: FloatArray
    """in the quantity's unit, shape (N, 3)"""
    upper: FloatArray
    """in the quantity's unit, shape (N, 3)"""
    tolerances: FloatArray
    """how far outside still counts as inside, in the quantity's unit, shape (N, 3)"""

    def check(self, where: str, values: FloatArray) -> None:
        """See that `values`, shape (N, 3), are inside; what is no number is not judged.

        Raises:
            ScenarioError: one is outside; `where` names it within its vehicle.
        """
        outside = values < self.lower - self.tolerances
        outside |= values > self.upper + self.tolerances
        if np.any(outside):
            i = int(np.argmax(np.any(outside, axis=1)))
            quantity, least, most = where.split(".")[1], self.lower[i], self.upper[i]
            expected = f"a {quantity} within {least.tolist()} to {most.tolist()}"
            raise ScenarioError(f"vehicles[{i}].{where}", values[i].tolist(), expected)


class Fleet:
    """Starts, goals, scales and bounds of all vehicles, each computed when first asked for."""

    def __init__(
        self,
        grid: Grid,
        vehicles: Sequence[Vehicle],
        limits: Limits,
        aside: float = 0.0,
        bodies: Sequence[Obstacle] = (),
    ) -> None:
        self._grid, self._vehicles, self._limits = grid, vehicles, limits
        self._aside, self._bodies = aside, bodies
        self._whole: Fleet | None = None
        self._sides: dict[Quantity, tuple[FloatArray, FloatArray] | None] = {}
        self._bounds: dict[Quantity, Bounds | None] = {}
        self._largest: dict[Norm, FloatArray] | None = None

    @cached_property
    def radii(self) -> FloatArray:
        """How far the vehicles keep from obstacles [m], shape (N,)."""
        return np.array([vehicle.radius for vehicle in self._vehicles])

    @cached_property
    def start_positions(self) -> FloatArray:
        """p[1] [m], shape (N, 3)."""
        return np.array([vehicle.start.position for vehicle in self._vehicles])

    @cached_property
    def start_velocities(self) -> FloatArray:
        """v[1] [m/s], shape (N, 3)."""
        return np.array([vehicle.start.velocity for vehicle in self._vehicles])

    @property
    def start_states(self) -> FloatArray:
        """Positions p[1] [m] and velocities v[1] [m/s] side by side, shape (N, 6)."""
        return np.concatenate([self.start_positions, self.start_velocities], axis=1)

    @cached_property
    def accelerations_before(self) -> FloatArray:
        """Accelerations just before the first knot [m/s²], shape (N, 3); NaN where free."""
        given = [vehicle.start.acceleration for vehicle in self._vehicles]
        return np.array([np.full(3, np.nan) if each is None else each for each in given])

    @cached_property
    def goal_positions(self) -> FloatArray:
        """p[K] [m], shape (N, 3)."""
        return np.array([vehicle.goal.position for vehicle in self._vehicles])

    @cached_property
    def goal_velocities(self) -> FloatArray:
        """v[K] [m/s], shape (N, 3)."""
        return np.array([vehicle.goal.velocity for vehicle in self._vehicles])

    @cached_property
    def waypoints(self) -> list[Waypoints]:
        """The waypoints of all vehicles, number by number; none if no vehicle has any."""
        return waypoints_of(self._vehicles)

    @cached_property
    def lengths(self) -> FloatArray:
        """Length scale of each motion [m], for tolerances, shape (N,).

        That of `ways`, but of what is left of a flight no more than that of the whole flight, so
        that what holds for all of its windows holds for it.
        """
        return self.ways if self._whole is None else np.minimum(self.ways, self._whole.lengths)

    @cached_property
    def ways(self) -> FloatArray:
        """Length scale of each motion [m], for a solver's numbers, shape (N,).

        The largest of the ways that a vehicle has to make: to its goal, to its waypoints, those
        that the given velocities and acceleration cover in the duration T, aside for others (the
        separation) and for obstacles that move across its way. It depends on no coordinates, but
        is never so small that their rounding shows. A vehicle that has nothing to do has 1 m.
        """
        T = self._grid.duration
        ways = np.array(
            [
                self.goal_positions - self.start_positions,
                T * self.start_velocities,
                T * self.goal_velocities,
                T**2 * self.accelerations_before,
                *(each.positions - self.start_positions for each in self.waypoints),
            ]
        )
        lengths: FloatArray = np.sqrt(
            np.fmax.reduce(np.vecdot(ways, ways))
        )  # what is free is a NaN
        lengths = np.maximum(np.maximum(lengths, self._aside), self._aside_of_obstacles())
        lengths[lengths == 0.0] = 1.0
        coordinates = np.maximum(np.abs(self.start_positions), np.abs(self.goal_positions))
        rounding = _ROUNDINGS * self._grid.knots * np.finfo(np.float64).eps
        lengths[:] = np.maximum(lengths, rounding / TOLERANCE * coordinates.max(axis=1))
        return lengths

    def _aside_of_obstacles(self) -> FloatArray:
        """How far vehicles may have to move aside of obstacles that cross their ways [m], (N,).

        What an obstacle keeps free at least, and the distance kept from it, where it comes close
        enough to a vehicle on the straight way to its goal; but no more than it moves, since a
        vehicle that is clear of it at first can go with it. Nothing for one that stands still.
        """
        aside, T = np.zeros(len(self._vehicles)), self._grid.duration
        for body in self._bodies:
            if not body.is_steady:
                kept = self.radii + body.deviation
                met = self._nearest_to(body) <= np.linalg.norm(body.shape.extent) + kept
                corners = body.corners[(body.corners > 0.0) & (body.corners < T)]
                places = body.centers(np.concatenate([[0.0], corners, [T]]))
                gone = float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
                most = np.minimum(body.shape.extent.min() + kept, gone)
                aside[met] = np.maximum(aside, most)[met]
        return aside

    def _nearest_to(self, body: Obstacle) -> FloatArray:
        """How close straight ways to the goals come to the middle of an obstacle [m], (N,).

        Both go straight from one corner of its track to the next.
        """
        T = self._grid.duration
        corners = body.corners[(body.corners > 0.0) & (body.corners < T)]
        times = np.concatenate([[0.0], corners, [T]])
        ways = self.goal_positions - self.start_positions
        straight = self.start_positions[:, None] + times[:, None] / T * ways[:, None]
        x = straight - body.centers(times)
        begins, legs = x[:, :-1], np.diff(x, axis=1)
        squares = np.vecdot(legs, legs)
        part = -np.vecdot(begins, legs) / np.where(squares > 0.0, squares, 1.0)
        nearest = begins + np.clip(part, 0.0, 1.0)[..., None] * legs
        distances: FloatArray = np.linalg.norm(nearest, axis=2).min(axis=1)
        return distances

    def obstacle_tolerances(self, shape: Shape) -> FloatArray:
        """How deep inside of an obstacle still counts as outside, for each vehicle [m], (N,).

        `TOLERANCE` of its size, but no more than of the motion's scale, so that a ground that is
        made wide lets nobody in.
        """
        return TOLERANCE * np.minimum(shape.size, self.lengths)

    def scale(self, quantity: Quantity) -> FloatArray:
        """What is large for a quantity of each motion, in its SI unit, shape (N,).

        L, L/T, L/T² and L/(T² h) with the motion's length scale L; of what is left of a flight no
        more than of the whole.
        """
        h, T = self._grid.step, self._grid.duration
        powers = {"position": 1.0, "velocity": T, "acceleration": T**2, "jerk": T**2 * h}
        scale: FloatArray = self.lengths / powers[quantity]
        return scale if self._whole is None else np.minimum(scale, self._whole.scale(quantity))

    @property
    def units(self) -> FloatArray:
        """Acceleration that counts as one in programs [m/s²], shape (N,): `ways` over T²."""
        return self.ways / self._grid.duration**2

    def bounds(self, quantity: Quantity) -> Bounds | None:
        """The boxes of a quantity, with their tolerances; None if no vehicle has one.

        The tolerance is `TOLERANCE` of a box's side, but no more than of the motion's scale, so
        that a side made wide to be no limit does not loosen the other, and no less than of a
        thousandth of it, which a solver can still tell.
        """
        if quantity not in self._bounds:
            self._bounds[quantity] = self._make_bounds(quantity)
        return self._bounds[quantity]

    def _make_bounds(self, quantity: Quantity) -> Bounds | None:
        if quantity not in self._sides:
            self._sides[quantity] = self._make_sides(quantity)
        sides = self._sides[quantity]
        if sides is None:
            return None
        lower, upper = sides
        scale = self.scale(quantity)[:, None]
        width = np.minimum(np.maximum(upper - lower, 1e-3 * scale), scale)
        return Bounds(lower, upper, TOLERANCE * width)

    def _make_sides(self, quantity: Quantity) -> tuple[FloatArray, FloatArray] | None:
        """Lower and upper bounds, each of shape (N, 3)."""
        count = len(self._vehicles)
        lower, upper = np.full((count, 3), -np.inf), np.full((count, 3), np.inf)
        common: Box | None = getattr(self._limits, quantity)
        if common is not None:
            lower[:], upper[:] = common.lower, common.upper
        for index, vehicle in enumerate(self._vehicles):
            own: Box | None = getattr(vehicle.limits, quantity, None)
            if own is not None:
                lower[index], upper[index] = own.lower, own.upper
        return (lower, upper) if np.any(np.isfinite(lower)) else None

    @cached_property
    def norms(self) -> dict[Norm, NormLimit]:
        """The limits on norms that some vehicle has, with their tolerances, by their field."""
        if self._largest is None:
            self._largest = self._make_largest()
        limits = {}
        for norm, most in self._largest.items():
            kind = NORMS[norm]
            limits[norm] = NormLimit(norm, kind, most, kind.sets(most, self.scale(kind.quantity)))
        return limits

    def _make_largest(self) -> dict[Norm, FloatArray]:
        """The largest norms of all vehicles, each of shape (N,), where some vehicle has one."""
        owns = [(i, each.limits) for i, each in enumerate(self._vehicles) if each.limits]
        found = {}
        for norm in NORMS:
            most = np.full(len(self._vehicles), getattr(self._limits, norm) or np.inf)
            for index, own in owns:
                most[index] = getattr(own, norm) or most[index]
            if np.any(np.isfinite(most)):
                found[norm] = most
        return found

    def started_at(
        self,
        grid: Grid,
        vehicles: Sequence[Vehicle],
        positions: FloatArray,
        velocities: FloatArray,
        before: FloatArray,
        bodies: Sequence[Obstacle],
    ) -> Fleet:
        """The same vehicles with other starts, arrays of shape (N, 3), on another grid.

        Obstacles are on the clock of that grid.
        """
        fleet = Fleet(grid, vehicles, self._limits, self._aside, bodies)
        fleet.start_positions, fleet.start_velocities = positions, velocities
        fleet.accelerations_before = before
        fleet._whole = self._whole or self
        fleet.goal_positions, fleet.goal_velocities = self.goal_positions, self.goal_velocities
        fleet._sides, fleet._largest = self._sides, self._largest
        return fleet
