"""Vehicles of a scenario as arrays with one row each, for vectorised arithmetic."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, get_args

import numpy as np

from drake_rho.scenario.bounds import Bounds
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray, read_only
from drake_rho.scenario.goals import set_in
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.nominal_goals import nearest_in, nominal_position
from drake_rho.scenario.norms import NORMS, Norm, NormLimit
from drake_rho.scenario.parts import Grid, Quantity, Vehicle
from drake_rho.scenario.shapes.base import TOLERANCE, Shape, Solid
from drake_rho.scenario.shapes.polyhedra import Box
from drake_rho.scenario.waypoints import Waypoints, waypoints_of

if TYPE_CHECKING:
    from drake_rho.scenario.obstacles import Obstacle

_ROUNDINGS = 8.0
"""Roundings of a coordinate, per knot, that a tolerance allows for: twice as many as accumulate in
sums of two terms per knot."""


_ROUNDED_DOWN = 1.0 - 1e-9
"""Factor by which a distance is at most rounded up."""


def _last_place(vehicle: Vehicle) -> FloatArray:
    """Return the position of a vehicle's last waypoint, or of its start without waypoints [m]."""
    if not vehicle.waypoints:
        return vehicle.start.position
    times = [np.inf if each.time is None else each.time for each in vehicle.waypoints]
    last = max(range(len(times)), key=lambda index: (times[index], index))
    return vehicle.waypoints[last].position


_OF_GOALS = (
    "goal_positions",
    "goal_velocities",
    "accelerations_after",
    "given_positions",
    "given_velocities",
    "fixed_positions",
    "fixed_velocities",
    "open_end",
)
"""Properties that the rest of a flight has in common with the whole."""


class Fleet:
    """Starts, goals, scales and bounds of all vehicles, each computed on first use."""

    def __init__(
        self,
        grid: Grid,
        vehicles: Sequence[Vehicle],
        limits: Limits,
        separation: float = 0.0,
        bodies: Sequence[Obstacle] = (),
        missed: tuple[bool, bool] = (False, False),
        reaches: FloatArray | float = 0.0,
    ) -> None:
        self._grid, self._vehicles, self._limits = grid, vehicles, limits
        self._separation, self._bodies = separation, bodies
        self._missed, self._reaches = missed, reaches
        self._whole_flight: Fleet | None = None

    @cached_property
    def radii(self) -> FloatArray:
        """Required distances of the vehicles from obstacles [m], shape (N,)."""
        return np.array([vehicle.radius for vehicle in self._vehicles])

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the vehicles in the cost, shape (N,)."""
        return np.array([vehicle.weight for vehicle in self._vehicles])

    @cached_property
    def start_positions(self) -> FloatArray:
        """Start positions p[1] [m], shape (N, 3)."""
        return np.array([vehicle.start.position for vehicle in self._vehicles])

    @cached_property
    def start_velocities(self) -> FloatArray:
        """Start velocities v[1] [m/s], shape (N, 3)."""
        return np.array([vehicle.start.velocity for vehicle in self._vehicles])

    @property
    def start_states(self) -> FloatArray:
        """Start positions p[1] [m] and velocities v[1] [m/s] side by side, shape (N, 6)."""
        return np.concatenate([self.start_positions, self.start_velocities], axis=1)

    @cached_property
    def accelerations_before(self) -> FloatArray:
        """Accelerations just before the first knot [m/s²], shape (N, 3); NaN where unknown."""
        return np.array([vehicle.start.acceleration_outside for vehicle in self._vehicles])

    @cached_property
    def accelerations_after(self) -> FloatArray:
        """Accelerations just after the last knot [m/s²], shape (N, 3); NaN where unknown."""
        after = np.array([vehicle.goal.acceleration_outside for vehicle in self._vehicles])
        after[~self.fixed_velocities] = np.nan  # vehicles may arrive in motion
        return after

    @cached_property
    def flown(self) -> FloatArray | None:
        """Accelerations before the first knot that enter the averages [m/s²], (N, REACHED, 3).

        None for motions that begin at rest (`State.flown`).
        """
        flown = [each.start.flown for each in self._vehicles if each.start.flown is not None]
        return np.array(flown) if len(flown) == len(self._vehicles) else None

    @cached_property
    def jerks_before(self) -> FloatArray:
        """Jerks at the knot before the first [m/s³], shape (N, 3); NaN where there is none."""
        every = (vehicle.start.jerk_before for vehicle in self._vehicles)
        return np.array([np.full(3, np.nan) if each is None else each for each in every])

    @cached_property
    def goal_positions(self) -> FloatArray:
        """Goal positions p[K] [m], shape (N, 3); nominal ones where `given_positions` is false.

        A nominal goal is the point of a set that is nearest to the last waypoint, or to the start
        without one. It is in the position box and, if possible, clear of obstacles and other goals.
        """
        if self.given_positions.all():
            return np.array([vehicle.goal.position for vehicle in self._vehicles])
        goals = np.full((len(self._vehicles), 3), np.nan)
        for i in np.flatnonzero(self.given_positions).tolist():
            goals[i] = self._vehicles[i].goal.position
        for i in np.flatnonzero(~self.given_positions).tolist():
            vehicle, box = self._vehicles[i], self.projection("position", i)
            towards = _last_place(vehicle)
            goals[i] = nominal_position(
                set_in(vehicle.goal.position),
                box,
                towards,
                float(np.linalg.norm(towards - vehicle.start.position)) or 1.0,
                partial(self._is_clear, vehicle=i, goals=goals),
            )
        return goals

    @cached_property
    def goal_velocities(self) -> FloatArray:
        """Goal velocities v[K] [m/s], shape (N, 3); nominal ones where they are not given.

        A nominal velocity is the least one of a set.
        """
        if self.given_velocities.all():
            return np.array([vehicle.goal.velocity for vehicle in self._vehicles])
        goals = np.zeros((len(self._vehicles), 3))
        for i, vehicle in enumerate(self._vehicles):
            velocity = vehicle.goal.velocity
            if self.given_velocities[i]:
                goals[i] = velocity
            elif velocity is not None:
                goals[i], _ = nearest_in(velocity, self.projection("velocity", i), np.zeros(3))
        return goals

    @cached_property
    def given_positions(self) -> BoolArray:
        """Mask of the vehicles with a goal at one position, shape (N,)."""
        return self._given("position")

    @cached_property
    def given_velocities(self) -> BoolArray:
        """Mask of the vehicles with one velocity at their goals, shape (N,)."""
        return self._given("velocity")

    def _given(self, quantity: Quantity) -> BoolArray:
        values = [getattr(vehicle.goal, quantity) for vehicle in self._vehicles]
        return np.array([isinstance(each, np.ndarray) for each in values])

    def given_goals(self, quantity: Quantity) -> FloatArray:
        """Return goals' positions or velocities, shape (N, 3); NaN where not one value is given."""
        position = quantity == "position"
        goals = self.goal_positions if position else self.goal_velocities
        given = self.given_positions if position else self.given_velocities
        return goals if given.all() else np.where(given[:, None], goals, np.nan)

    @cached_property
    def fixed_positions(self) -> BoolArray:
        """Mask of the vehicles that have to reach a position at the last knot, shape (N,)."""
        return self.given_positions & (not self._missed[0])

    @cached_property
    def fixed_velocities(self) -> BoolArray:
        """Mask of the vehicles that have to reach a velocity at the last knot, shape (N,)."""
        return self.given_velocities & (not self._missed[1])

    def projection(self, quantity: Quantity, vehicle: int) -> Callable[[FloatArray], FloatArray]:
        """Return the function that projects values (..., 3) onto the box of one vehicle."""
        sides = self.sides(quantity)
        if sides is None:
            return np.asarray
        lower, upper = (each[vehicle] for each in sides)
        return lambda x: np.clip(x, lower, upper)

    def _is_clear(self, x: FloatArray, vehicle: int, goals: FloatArray) -> BoolArray:
        """Return whether a vehicle could end at positions (M, 3), among obstacles and goals."""
        clear, end = np.ones(len(x), dtype=bool), np.array([self._grid.duration])
        for body in self._bodies:
            clear &= body.distances(x, end) >= self.radii[vehicle] + body.deviation
        if self._separation > 0.0:
            others = np.linalg.norm(x[:, None] - goals, axis=2)
            clear &= ~np.any(others < self._separation, axis=1)  # false for NaN
        return clear

    @cached_property
    def open_end(self) -> bool:
        """Whether a position or a velocity at the last knot is free."""
        return not (self.fixed_positions.all() and self.fixed_velocities.all())

    def fixed(self, quantity: Quantity) -> BoolArray:
        """Return the mask of the vehicles that have to reach a value at the last knot, (N,)."""
        if quantity == "position":
            return self.fixed_positions
        if quantity == "velocity":
            return self.fixed_velocities
        return np.zeros(len(self._vehicles), dtype=bool)

    def missed(self, quantity: Quantity, last: FloatArray) -> FloatArray:
        """Return differences from goals, shape (N, 3); zero where the goal need not be reached.

        Args:
            quantity: position or velocity.
            last: its values at the last knot, shape (N, 3).
        """
        goals = self.goal_positions if quantity == "position" else self.goal_velocities
        return np.where(self.fixed(quantity)[:, None], last - goals, 0.0)

    @property
    def rest_at_goals(self) -> BoolArray:
        """Mask of the vehicles that are at rest from the last knot on, shape (N,)."""
        moving = (self.goal_velocities != 0.0) | (self.accelerations_after != 0.0)
        return np.asarray(~np.any(moving, axis=1))

    @property
    def counted_ends(self) -> tuple[IntArray, IntArray]:
        """How often the jerks at the first and at the last knot count in a cost, shape (N,) each.

        Twice where the vehicle is at rest outside, once where its acceleration there is known, as
        in the remainder of a flight, and not at all where it is unknown.
        """
        before, after = (
            np.isfinite(each).all(axis=1).astype(int)
            for each in (self.accelerations_before, self.accelerations_after)
        )
        still = ~np.any((self.start_velocities != 0.0) | (self.accelerations_before != 0.0), axis=1)
        return before + (still & (self._whole_flight is None)), after + self.rest_at_goals

    @property
    def are_at_rest(self) -> bool:
        """Whether all vehicles are at rest before the first knot and after the last one."""
        starts = self.start_velocities.any() or self.accelerations_before.any()
        return not starts and bool(self.rest_at_goals.all())

    @cached_property
    def waypoints(self) -> list[Waypoints]:
        """Waypoints of all vehicles, grouped by number; empty if no vehicle has any."""
        return waypoints_of(self._vehicles, self._grid)

    @cached_property
    def lengths(self) -> FloatArray:
        """Length scale of each motion [m], for tolerances, shape (N,).

        It equals `solver_lengths`, but for the remainder of a flight it is at most that of the
        whole flight: constraints met in all windows of a flight are then met in the flight.
        """
        lengths = self.solver_lengths
        whole = self._whole_flight
        return lengths if whole is None else np.minimum(lengths, whole.lengths)

    @cached_property
    def solver_lengths(self) -> FloatArray:
        """Length scale of each motion [m], for scaling programs, shape (N,).

        It is the largest distance that a vehicle has to cover: to its goal, to its waypoints, at
        the given velocities and accelerations during T, along a path of its objective or to where
        requirements send it without an exact goal, sideways to avoid others (the separation), and
        sideways to avoid obstacles that move across its straight path. It does not depend on the
        origin of coordinates, but is large enough for their rounding to be negligible. It is 1 m
        for a vehicle that has none of these.
        """
        T = self._grid.duration
        distances = np.array(
            [
                self.goal_positions - self.start_positions,
                T * self.start_velocities,
                T * self.goal_velocities,
                T**2 * self.accelerations_before,
                T**2 * self.accelerations_after,
                *[each.positions - self.start_positions for each in self.waypoints],
            ]
        )
        # fmax ignores NaN, which stands for unknown accelerations and waypoints that are not given
        lengths: FloatArray = np.sqrt(np.fmax.reduce(np.vecdot(distances, distances)))
        lengths = np.maximum(np.maximum(lengths, self._separation), self._reaches)
        lengths = np.maximum(lengths, self._evasion_lengths(lengths))
        lengths[lengths == 0.0] = 1.0
        errors = self.summed_errors
        nowhere = ~self.given_positions & (lengths <= errors)
        lengths[nowhere] = 1.0  # a free goal at the start but for rounding
        return np.maximum(lengths, errors / TOLERANCE)

    @cached_property
    def coordinate_errors(self) -> FloatArray:
        """Upper bound of the rounding errors of a position's coordinates [m], shape (N,)."""
        coordinates = np.maximum(np.abs(self.start_positions), np.abs(self.goal_positions))
        errors: FloatArray = _ROUNDINGS * sys.float_info.epsilon * coordinates.max(axis=1)
        return errors

    @property
    def summed_errors(self) -> FloatArray:
        """Upper bound of the rounding errors of positions that are summed over steps [m], (N,)."""
        return self._grid.knots * self.coordinate_errors

    def _evasion_lengths(self, lengths: FloatArray) -> FloatArray:
        """Return the evasive distances that moving obstacles may require [m], shape (N,).

        An obstacle counts if it comes close enough to a vehicle that moves straight to its goal.
        The length is then the obstacle's least extent plus the required distance from it, but at
        most the length of the obstacle's own path: a vehicle that is outside it at first can move
        along with it, unless the obstacle appears around it. Obstacles at rest do not count, nor
        do those that would take at most the given lengths, shape (N,).
        """
        evasion = np.zeros(len(self._vehicles))
        changing = [body for body in self._bodies if not body.is_steady]
        for body in self._may_be_met(changing, lengths) if changing else ():
            instants = self._instants(body)
            errors = body.uncertainty(instants)
            required = self.radii + body.deviation + errors[-1]
            met = self._closest_to(body) <= np.linalg.norm(body.shape.extent) + required
            centers = body.centers(instants)
            moved = float(np.linalg.norm(np.diff(centers, axis=0), axis=1).sum())
            moved += float(errors[-1] - errors[0])
            moved = moved if body.active is None else np.inf
            most = np.minimum(body.shape.thickness + required, moved)
            evasion[met] = np.maximum(evasion, most)[met]
        return evasion

    def _may_be_met(self, bodies: Sequence[Obstacle], lengths: FloatArray) -> Iterator[Obstacle]:
        """Yield obstacles that may take longer to evade than given lengths (N,).

        They are not far from the boxes around straight paths to the goals. This saves most of the
        time, and leaves out none that `_closest_to` would find close.
        """
        ends, end = (self.start_positions, self.goal_positions), np.array([self._grid.duration])
        lower, upper = np.minimum(*ends), np.maximum(*ends)
        for body in bodies:
            required = self.radii + body.deviation + body.uncertainty(end)
            if (body.shape.thickness + required <= lengths).all():
                continue
            required += float(np.linalg.norm(body.shape.extent))
            if not (_ROUNDED_DOWN * body.gaps(lower, upper, 0.0) > required).all():  # or NaN
                yield body

    def _closest_to(self, body: Obstacle) -> FloatArray:
        """Return the least distances of straight paths to the goals from an obstacle [m], (N,).

        Distances are measured at equal times from the obstacle's centre; the relative motion is
        straight between the corners of its track.
        """
        times, T = self._instants(body), self._grid.duration
        displacements = self.goal_positions - self.start_positions
        straight = self.start_positions[:, None] + times[:, None] / T * displacements[:, None]
        x = straight - body.centers(times)
        begins, legs = x[:, :-1], np.diff(x, axis=1)
        squares = np.vecdot(legs, legs)
        part = -np.vecdot(begins, legs) / np.where(squares > 0.0, squares, 1.0)
        nearest = begins + np.clip(part, 0.0, 1.0)[..., None] * legs
        distances: FloatArray = np.linalg.norm(nearest, axis=2).min(axis=1)
        return distances

    def _instants(self, body: Obstacle) -> FloatArray:
        """Return the first knot, the corners of an obstacle's motion, and the last knot [s]."""
        T = self._grid.duration
        corners = body.corners[(body.corners > 0.0) & (body.corners < T)]
        return np.concatenate([[0.0], corners, [T]])

    def obstacle_tolerances(self, shape: Solid) -> FloatArray:
        """Return the depth in an obstacle that still counts as outside, per vehicle [m], (N,).

        It is `TOLERANCE` times the obstacle's size or the motion's length scale, if that is less:
        a wide box that stands for the ground has no large tolerance.
        """
        return TOLERANCE * np.minimum(shape.size, self.lengths)

    def extent_to_evade(self, shape: Solid) -> float:
        """Return the thickness of an obstacle that vehicles have to evade [m].

        Parts of a map may be as thin as a sheet, from whose middle a vehicle still moves by its
        radius.
        """
        if isinstance(shape, Shape):
            return shape.thickness
        return shape.cover.thickness + float(self.radii.min())

    def scale(self, quantity: Quantity) -> FloatArray:
        """Return the characteristic magnitude of a quantity in each motion, in SI units, (N,).

        It is L, L/T, L/T² or L/(T² h) with the motion's length scale L; for the remainder of a
        flight it is at most that of the whole flight.
        """
        return self._scales[quantity]

    def largest_scale(self, quantity: Quantity) -> FloatArray:
        """Return the scale for the whole flight, not less than for its remainder, shape (N,)."""
        return (self._whole_flight or self).scale(quantity)

    @cached_property
    def _scales(self) -> dict[Quantity, FloatArray]:
        h, T, L = self._grid.step, self._grid.duration, self.lengths
        own: dict[Quantity, FloatArray] = {
            "position": L,
            "velocity": L / T,
            "acceleration": L / T**2,
            "jerk": L / (T**2 * h),
        }
        if self._whole_flight is None:
            return own
        whole = self._whole_flight._scales
        return {each: np.minimum(scale, whole[each]) for each, scale in own.items()}

    @property
    def units(self) -> FloatArray:
        """Unit of acceleration in programs [m/s²], shape (N,).

        It is `solver_lengths` over T² or, where a leg between two waypoints needs more, its length
        over the square of its time: of 200 legs, each takes thousands of times the former.
        """
        units = self.solver_lengths / self._grid.duration**2
        times, places = np.full(len(units), self._grid.start), self.start_positions
        for each in self.waypoints:
            longer = each.present & (each.times > times)
            lasting = np.where(longer, each.times - times, np.inf)
            legs = np.linalg.norm(np.where(longer[:, None], each.positions - places, 0.0), axis=1)
            units = np.maximum(units, legs / lasting**2)
            times = np.where(longer, each.times, times)
            places = np.where(longer[:, None], each.positions, places)
        return units

    @property
    def units_of_violations(self) -> FloatArray:
        """Unit of acceleration in programs that may violate constraints [m/s²], shape (N,).

        It is the geometric mean of `units` and the whole flight's. In the former, tolerances of
        positions late in a flight would have too few digits beside a short leg's accelerations, in
        the latter limits on a short leg.
        """
        whole = self.solver_lengths / self._grid.duration**2
        units: FloatArray = np.sqrt(whole * self.units)
        return units

    def bounds(self, quantity: Quantity) -> Bounds | None:
        """Return the boxes of a quantity, with their tolerances; None if no vehicle has one.

        A tolerance is `TOLERANCE` times the box's side. The side is taken as at most the motion's
        scale, so that a distant bound that stands for no limit does not loosen the opposite one,
        and at least a thousandth of it, which a solver can still resolve.
        """
        return self._bounds.get(quantity)

    @cached_property
    def _bounds(self) -> dict[Quantity, Bounds]:
        bounds = dict[Quantity, Bounds]()
        for quantity, (lower, upper) in self._sides.items():
            scale = self._scales[quantity][:, None]
            width = np.minimum(np.maximum(upper - lower, 1e-3 * scale), scale)
            bounds[quantity] = Bounds(lower, upper, TOLERANCE * width)
        return bounds

    def sides(self, quantity: Quantity) -> tuple[FloatArray, FloatArray] | None:
        """Return the corners of the boxes of a quantity, (N, 3) each; None if no vehicle has one.

        They need no scales, unlike `bounds`.
        """
        return self._sides.get(quantity)

    @cached_property
    def _sides(self) -> dict[Quantity, tuple[FloatArray, FloatArray]]:
        """Lower and upper bounds, (N, 3) each, of the quantities that any vehicle limits."""
        sides, count = dict[Quantity, tuple[FloatArray, FloatArray]](), len(self._vehicles)
        own = [(i, each.limits) for i, each in enumerate(self._vehicles) if each.limits]
        for quantity in get_args(Quantity):
            lower, upper = np.full((count, 3), -np.inf), np.full((count, 3), np.inf)
            box: Box | None = getattr(self._limits, quantity)
            if box is not None:
                lower[:], upper[:] = box.lower, box.upper
            for index, limits in own:
                if (box := getattr(limits, quantity)) is not None:
                    lower[index], upper[index] = box.lower, box.upper
            if np.isfinite(lower).any():
                sides[quantity] = lower, upper
        return sides

    @cached_property
    def norms(self) -> dict[Norm, NormLimit]:
        """Limits on norms that any vehicle has, with tolerances, by field of `Limits`."""
        limits = {}
        for norm, most in self.largest_norms.items():
            kind = NORMS[norm]
            limits[norm] = NormLimit(norm, kind, most, kind.sets(most, self.scale(kind.quantity)))
        return limits

    @cached_property
    def largest_norms(self) -> dict[Norm, FloatArray]:
        """Limits (N,) of each norm that any vehicle limits; they need no scales, unlike `norms`."""
        owns = [(i, each.limits) for i, each in enumerate(self._vehicles) if each.limits]
        found = {}
        for norm in NORMS:
            most = np.full(len(self._vehicles), getattr(self._limits, norm) or np.inf)
            for index, own in owns:
                most[index] = getattr(own, norm) or most[index]
            if np.any(np.isfinite(most)):
                found[norm] = most
        return found

    def reaching(self, distance: FloatArray | float) -> Fleet:
        """Return the fleet with scales of motions that cover at least a distance [m], (N,)."""
        reaches = np.maximum(self._reaches, distance)
        parts = self._separation, self._bodies, self._missed, reaches
        return Fleet(self._grid, self._vehicles, self._limits, *parts)

    def aimed(self, vehicles: Sequence[Vehicle]) -> Fleet:
        """Return the fleet of the rest of a flight with other goals, missed at a price."""
        parts = self._separation, self._bodies, (True, False), self._reaches
        fleet = Fleet(self._grid, vehicles, self._limits, *parts)
        fleet.start_positions, fleet.start_velocities = self.start_positions, self.start_velocities
        fleet.accelerations_before, fleet.weights = self.accelerations_before, self.weights
        fleet._whole_flight = self._whole_flight
        fleet._sides, fleet.largest_norms = self._sides, self.largest_norms
        return fleet

    def started_at(
        self,
        grid: Grid,
        vehicles: Sequence[Vehicle],
        positions: FloatArray,
        velocities: FloatArray,
        before: FloatArray,
        bodies: Sequence[Obstacle],
        rests: FloatArray | None = None,
    ) -> Fleet:
        """Return the fleet with other starts, arrays of shape (N, 3), on another grid.

        The obstacles' clocks are 0 at that grid's first knot. Stopping positions [m], if given,
        replace the goals.
        """
        missed = self._missed if rests is None else (False, False)
        parts = self._separation, bodies, missed, self._reaches
        fleet = Fleet(grid, vehicles, self._limits, *parts)
        fleet.start_positions, fleet.start_velocities = positions, velocities
        fleet.accelerations_before = before
        fleet._whole_flight = self._whole_flight or self
        if rests is None:
            for name in _OF_GOALS:
                setattr(fleet, name, getattr(self, name))
        else:
            fleet.goal_positions = read_only(rests)
            fleet.goal_velocities = fleet.accelerations_after = np.zeros(rests.shape)
        fleet._sides, fleet.largest_norms = self._sides, self.largest_norms
        fleet.weights = self.weights
        return fleet
